"""`docs/your-data.md` names every key of a recipe, with the default that the program has."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from pathlib import Path

from egp_service.data.collect import CollectionSettings
from egp_service.data.experiment import Experiment
from egp_service.data.exploration import ExplorationSettings
from egp_service.data.sampling import SamplingBounds
from egp_service.shipped import DEMO_RECIPE
from egp_service.training.on_policy import OnPolicySettings
from egp_service.training.recipe import Recipe
from egp_service.training.train import TrainingSettings

DOCUMENT = Path(__file__).parents[2] / "docs/your-data.md"
TABLES = {
    "top, `surface`": Experiment,
    "`collection`": CollectionSettings,
    "`collection.exploration`": ExplorationSettings,
    "`collection.sampling`": SamplingBounds,
    "`training`": TrainingSettings,
    "`on_policy`": OnPolicySettings,
}
# These have no default that a recipe can state.
WITHOUT = {"label", "friction", "disturbances"}


def test_the_document_has_every_key_of_a_recipe() -> None:
    rows = re.findall(
        r"^\|([^|]*)\| `(\w+)` \|([^|]*)\| .+ \|$", DOCUMENT.read_text("utf-8"), re.MULTILINE
    )
    found: dict[str, dict[str, object]] = {}
    table = ""
    for name, key, cell in rows:
        table = name.strip() or table
        default = cell.strip("` ")
        value = None if key in WITHOUT else tomllib.loads(f"value = {default}")["value"]
        found.setdefault(table, {})[key] = value
    nested = {"exploration", "sampling"}
    for table, kind in TABLES.items():
        expected = {
            field.name: None if field.name in WITHOUT else field.default
            for field in dataclasses.fields(kind)
            if field.name not in nested
        }
        assert found[table] == {
            name: list(default) if isinstance(default, tuple) else default
            for name, default in expected.items()
        }


def test_a_recipe_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text(DEMO_RECIPE.read_text(encoding="utf-8"), encoding="utf-8-sig")
    assert Recipe.read(path) == Recipe.read(DEMO_RECIPE)
