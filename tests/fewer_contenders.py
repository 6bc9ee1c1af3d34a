"""Experiments with fewer contenders or runs, for tests that read no other ones."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING

from egp_service.evaluation.contenders import ENSEMBLE
from egp_service.evaluation.experiment import ClosedLoopExperiment

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from egp_service.evaluation.experiment import Trial


def with_contenders(experiment: ClosedLoopExperiment, *names: str) -> ClosedLoopExperiment:
    """Return the experiment with the contenders of these names alone."""
    own = tuple(c for c in experiment.contenders if c.name in names)
    assert len(own) == len(names)
    return replace(experiment, contenders=own)


class _OthersOnce(ClosedLoopExperiment):
    def trials(self, seeds: Iterable[int]) -> Iterator[Trial]:
        for number, seed in enumerate(seeds):
            for trial in super().trials([seed]):
                if number == 0 or trial.contender.name == ENSEMBLE:
                    yield trial


def others_once(experiment: ClosedLoopExperiment) -> ClosedLoopExperiment:
    """Return the experiment with all contenders at the first seed, and the ensemble at all."""
    return _OthersOnce(**{f.name: getattr(experiment, f.name) for f in fields(experiment)})
