"""The evaluation's library: members of four surfaces and the members of the baselines.

`shipped/evaluation-library.safetensors` was made by this file from
`shipped/evaluation-recipe.toml`; `egp evaluate --train` makes it again.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError
from egp_service.shipped import EVALUATION_RECIPE
from egp_service.training import prior_mean
from egp_service.training.export import export
from egp_service.training.gaussian_process import CORRECTIONS, OutputProcess
from egp_service.training.recipe import Displays, Recipe, follow, training_provenance
from egp_service.training.train import train

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from egp_service.data.dataset import Dataset
    from egp_service.training.gaussian_process import KernelName
    from egp_service.training.train import TrainedMember

_OUTER: Final = (0.5, 1.1)
_BARE_POINTS: Final = 20
_WHOLE_CHANGE_POINTS: Final = 700  # more points did not improve GPs without a vehicle


def make(displays: Displays, *, cluster: str | None = None) -> list[TrainedMember]:
    """Train a member for each surface, and the baselines on the data of the outer two surfaces.

    The baselines are one GP on both surfaces' pooled data, with as many transitions as both members
    together; members with constant means as in the paper; and vehicles without GPs.
    """
    recipe = Recipe.read(EVALUATION_RECIPE)
    datasets, members = follow(recipe, cluster=cluster, displays=displays)
    settings = recipe.training
    outer = [data for data in datasets if data.provenance.friction in _OUTER]
    middle = sum(_OUTER) / len(_OUTER)
    pooled = [_as(data, "pooled 0.5 + 1.1", middle) for data in outer]
    twice = dataclasses.replace(settings, max_points=len(_OUTER) * settings.max_points)
    paper = [
        _as(data, f"{data.provenance.surface}, constant mean", data.provenance.friction)
        for data in outer
    ]
    constant = dataclasses.replace(settings, mean="constant", max_points=_WHOLE_CHANGE_POINTS)
    with displays.fitting() as report:
        others = train(pooled, twice, report) + train(paper, constant, report)
    bare = [_bare(m, settings.kernel) for m in members if m.dataset.provenance.friction in _OUTER]
    return members + others + bare


def _as(data: Dataset, surface: str, friction: float) -> Dataset:
    provenance = dataclasses.replace(data.provenance, surface=surface, friction=friction)
    return dataclasses.replace(data, provenance=provenance)


def _bare(member: TrainedMember, kernel: KernelName) -> TrainedMember:
    """Return the member's vehicle without GP corrections: GPs of a few points with zero targets."""
    provenance = member.dataset.provenance
    if member.single_track is None:
        raise EgpError(f"{provenance.surface} has no vehicle: train with mean = 'single-track'")
    z = member.inputs[:_BARE_POINTS]
    processes = []
    for process in member.processes:
        few = process.inputs[:_BARE_POINTS]
        bare = OutputProcess(few, few.new_zeros(len(few)), kernel, CORRECTIONS)
        bare.assign(dataclasses.replace(process.hyperparameters, constant=0.0))
        bare.eval()
        bare.likelihood.eval()
        processes.append(bare)
    return dataclasses.replace(
        member,
        dataset=_as(member.dataset, f"{provenance.surface}, vehicle only", provenance.friction),
        inputs=z,
        targets=prior_mean.predict(z, member.single_track, provenance.dt),
        target_mean=np.zeros_like(member.target_mean),
        processes=tuple(processes),
    )


def write(path: Path, members: Sequence[TrainedMember]) -> None:
    """Write the library file."""
    settings = Recipe.read(EVALUATION_RECIPE).training
    export(path, members, settings, training_provenance(settings))
