"""The evaluation's library: four surfaces, and one GP on the pooled data of the outer two.

`data/evaluation-library.safetensors` was made by this file from `data/evaluation-recipe.toml`;
`egp evaluate --train` makes it again.
"""

from __future__ import annotations

import dataclasses
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final

from egp_service.export import export
from egp_service.recipe import Displays, Recipe, follow, training_provenance
from egp_service.training import train

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service.training import TrainedMember

_DATA: Final = Path(str(resources.files("egp_service"))) / "data"
RECIPE: Final = _DATA / "evaluation-recipe.toml"
_POOLED: Final = (0.5, 1.1)


def make(displays: Displays) -> list[TrainedMember]:
    """Train a member for each surface, and one GP on the outer two surfaces' pooled data.

    The pooled GP keeps as many transitions as both of its surfaces' members together.
    """
    recipe = Recipe.read(RECIPE)
    datasets, members = follow(recipe, displays=displays)
    settings = recipe.training
    middle = sum(_POOLED) / len(_POOLED)
    pooled = [
        dataclasses.replace(
            data,
            provenance=dataclasses.replace(
                data.provenance, surface="pooled 0.5 + 1.1", friction=middle
            ),
        )
        for data in datasets
        if data.provenance.friction in _POOLED
    ]
    twice = dataclasses.replace(settings, max_points=len(_POOLED) * settings.max_points)
    with displays.fitting() as report:
        return members + train(pooled, twice, report)


def write(path: Path, members: Sequence[TrainedMember]) -> None:
    """Write the library file."""
    settings = Recipe.read(RECIPE).training
    export(path, members, settings, training_provenance(settings))
