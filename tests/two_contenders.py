"""Experiments with the ensemble and the oracle alone, for tests that read no other contender."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from egp_service.evaluation.contenders import ENSEMBLE, ORACLE

if TYPE_CHECKING:
    from egp_service.evaluation.experiment import ClosedLoopExperiment


def of_two_contenders(experiment: ClosedLoopExperiment) -> ClosedLoopExperiment:
    """Return the experiment without its other contenders."""
    own = tuple(c for c in experiment.contenders if c.name in {ENSEMBLE, ORACLE})
    assert len(own) == 2
    return replace(experiment, contenders=own)
