"""The shipped demo library is what its recipe makes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service import EgpError
from egp_service._core import Library
from egp_service.export import export
from egp_service.recipe import DEMO_RECIPE, Recipe, follow, training_provenance
from egp_service.validation import validate

if TYPE_CHECKING:
    from pathlib import Path

SHIPPED = DEMO_RECIPE.with_name("demo-library.safetensors")

# RMS difference of the means, in standard deviations of the members' noise. The same machine gives
# the same bytes. Another BLAS rounds differently and L-BFGS follows: 4e-7 with MKL's and torch's
# vector paths switched off.
TOLERANCE_IN_NOISE = 0.1


def test_rebuilds_from_its_recipe(tmp_path: Path) -> None:
    recipe = Recipe.read(DEMO_RECIPE)
    _, members = follow(recipe)
    path = tmp_path / "rebuilt.safetensors"
    export(path, members, recipe.training, training_provenance(recipe.training))
    rebuilt, shipped = Library.load(path), Library.load(SHIPPED)
    assert rebuilt.dt == shipped.dt
    assert rebuilt.vehicle == shipped.vehicle
    assert rebuilt.kernel == shipped.kernel
    for index, (member, ours, theirs) in enumerate(
        zip(members, rebuilt.members, shipped.members, strict=True)
    ):
        assert (ours.label, ours.friction) == (theirs.label, theirs.friction)
        assert ours.n_points == theirs.n_points
        z = member.validation.z
        difference = rebuilt.predict(z, index)[0] - shipped.predict(z, index)[0]
        rms = np.sqrt(np.mean(difference**2, axis=0))
        assert np.all(rms < TOLERANCE_IN_NOISE * theirs.noise_std), (member.dataset, rms)
    held_out = {member.dataset.provenance.surface: member.validation for member in members}
    for i, row in enumerate(validate(shipped, held_out)):
        own, other = row[i], row[1 - i]
        # After a second of driving at and beyond the limit; measured .22, .25 m/s, .06 rad/s.
        assert np.all(own.rollout < [0.5, 0.5, 0.2])
        assert np.all(own.rmse < 0.7 * other.rmse)
        assert np.all(own.coverage > 0.85)


def test_is_small() -> None:
    assert SHIPPED.stat().st_size < 1_000_000


def test_recipe_refuses_unknown_fields(tmp_path: Path) -> None:
    text = DEMO_RECIPE.read_text(encoding="utf-8")
    (tmp_path / "recipe.toml").write_text(text.replace("max_points", "max_point"))
    with pytest.raises(EgpError, match="max_point"):
        Recipe.read(tmp_path / "recipe.toml")
    (tmp_path / "recipe.toml").write_text("dt = [")
    with pytest.raises(EgpError, match=r"recipe\.toml"):
        Recipe.read(tmp_path / "recipe.toml")
