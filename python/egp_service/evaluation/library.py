"""The evaluation's library: members of four surfaces and the members of the baselines.

`shipped/evaluation-library.safetensors` was made by this file from
`shipped/evaluation-recipe.toml`; `egp evaluate --train` makes it again.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from egp_service.shipped import EVALUATION_RECIPE
from egp_service.training.export import export
from egp_service.training.recipe import Displays, Recipe, follow, training_provenance
from egp_service.training.train import train

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from egp_service.data.dataset import Dataset
    from egp_service.training.trained import TrainedMember

_OUTER: Final = (0.5, 1.1)
_WHOLE_CHANGE_POINTS: Final = 700  # more points did not improve GPs without a vehicle


def make(
    displays: Displays, *, jobs: int | None = None, cluster: str | None = None
) -> list[TrainedMember]:
    """Train a member for each surface, and the baselines on the data of the outer two surfaces.

    The baselines are one GP on both surfaces' pooled data, with as many transitions as both members
    together, and members with constant means as in the paper.
    """
    recipe = Recipe.read(EVALUATION_RECIPE)
    datasets, members = follow(recipe, jobs=jobs, cluster=cluster, displays=displays)
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
    return members + others


def _as(data: Dataset, surface: str, friction: float) -> Dataset:
    provenance = dataclasses.replace(data.provenance, surface=surface, friction=friction)
    return dataclasses.replace(data, provenance=provenance)


def write(path: Path, members: Sequence[TrainedMember]) -> None:
    """Write the library file."""
    settings = Recipe.read(EVALUATION_RECIPE).training
    export(path, members, settings, training_provenance(settings))
