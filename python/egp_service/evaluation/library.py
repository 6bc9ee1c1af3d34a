"""The evaluation's libraries.

`shipped/evaluation-library.safetensors` was made by this file from
`shipped/evaluation-recipe.toml`; `egp evaluate --train` makes it again. It has members of four
surfaces and the members of the baselines. The libraries of vehicles with a disturbance are made by
`shipped/disturbance-recipe.toml`.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from egp_service.files import make_folder
from egp_service.shipped import DISTURBANCE_RECIPE, EVALUATION_RECIPE
from egp_service.training.export import export
from egp_service.training.recipe import Displays, Recipe, follow, training_provenance
from egp_service.training.train import train

if TYPE_CHECKING:
    from pathlib import Path

    from egp_service.simulation.scenario import Disturbances

_OUTER: Final = (0.5, 1.1)
_WHOLE_CHANGE_POINTS: Final = 700  # more points did not improve GPs without a vehicle


def make(
    path: Path, displays: Displays, *, jobs: int | None = None, cluster: str | None = None
) -> None:
    """Train a member for each surface, and the baselines on the data of the outer two surfaces.

    The baselines are one GP on both surfaces' pooled data, with as many transitions as both members
    together, and members with constant means as in the paper.
    """
    recipe = Recipe.read(EVALUATION_RECIPE)
    datasets, members = follow(recipe, jobs=jobs, cluster=cluster, displays=displays)
    settings = recipe.training
    outer = [data for data in datasets if data.provenance.friction in _OUTER]
    middle = sum(_OUTER) / len(_OUTER)
    pooled = [data.relabelled("pooled 0.5 + 1.1", middle) for data in outer]
    twice = dataclasses.replace(settings, max_points=len(_OUTER) * settings.max_points)
    paper = [
        data.relabelled(f"{data.provenance.surface}, constant mean", data.provenance.friction)
        for data in outer
    ]
    constant = dataclasses.replace(settings, mean="constant", max_points=_WHOLE_CHANGE_POINTS)
    with displays.fitting() as report:
        others = train(pooled, twice, report)
    with displays.fitting() as report:
        others += train(paper, constant, report)
    export(path, members + others, settings, training_provenance(settings))


def make_disturbed(
    path: Path,
    disturbances: Disturbances,
    displays: Displays,
    *,
    recipe: Path = DISTURBANCE_RECIPE,
    jobs: int | None = None,
    cluster: str | None = None,
) -> None:
    """Write the library of the recipe's two surfaces for a vehicle with `disturbances`."""
    values = {name: v for name, v in dataclasses.asdict(disturbances).items() if v != 0.0}
    read = Recipe.read(recipe)
    disturbed = (dataclasses.replace(one, disturbances=values) for one in read.experiments)
    read = dataclasses.replace(read, experiments=tuple(disturbed))
    _, members = follow(read, jobs=jobs, cluster=cluster, displays=displays)
    make_folder(path.parent)
    export(path, members, read.training, training_provenance(read.training))
