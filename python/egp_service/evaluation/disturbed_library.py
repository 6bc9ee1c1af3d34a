"""Libraries of vehicles with a disturbance, trained by `shipped/disturbance-recipe.toml`."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING

from egp_service.shipped import DISTURBANCE_RECIPE
from egp_service.training.export import export
from egp_service.training.recipe import Displays, Recipe, follow, training_provenance

if TYPE_CHECKING:
    from pathlib import Path

    from egp_service.simulation.scenario import Disturbances


def train(
    path: Path,
    disturbances: Disturbances,
    displays: Displays,
    *,
    recipe: Path = DISTURBANCE_RECIPE,
    jobs: int | None = None,
    cluster: str | None = None,
) -> None:
    """Write the library of the recipe's two surfaces for a vehicle with `disturbances`.

    Raises:
        EgpError: if the recipe cannot be read.

    """
    values = {name: value for name, value in asdict(disturbances).items() if value != 0.0}
    read = Recipe.read(recipe)
    surfaces = tuple(replace(surface, disturbances=values) for surface in read.experiments)
    read = replace(read, experiments=surfaces)
    _, members = follow(read, jobs=jobs, cluster=cluster, displays=displays)
    path.parent.mkdir(parents=True, exist_ok=True)
    export(path, members, read.training, training_provenance(read.training))
