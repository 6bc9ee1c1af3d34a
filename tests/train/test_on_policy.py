"""Laps driven by the ensemble itself become data of the surfaces they were driven on."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service import EgpError
from egp_service.data.experiment import Experiment
from egp_service.data.exploration import STANDING
from egp_service.simulation.scenario import library_path, load_scenario
from egp_service.training import on_policy
from egp_service.training.on_policy import OnPolicySettings, distinct_surfaces, drive_laps

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

LIBRARY = library_path(load_scenario("rounded-rectangle"))
SURFACES = [
    Experiment(friction=mu, label=f"mu {mu}", dt=0.02, seed=seed)
    for seed, mu in enumerate((0.5, 1.1))
]
TWO_LAPS = OnPolicySettings(rounds=1, laps=2, grip=(0.7, 0.8))


def test_each_surface_gets_its_own_transitions() -> None:
    done: list[tuple[int, int]] = []
    datasets = drive_laps(
        LIBRARY, SURFACES, TWO_LAPS, jobs=2, report=lambda d, t: done.append((d, t))
    )
    assert done == [(1, 2), (2, 2)]
    wet, dry = datasets
    assert (wet.provenance.surface, dry.provenance.surface) == ("mu 0.5", "mu 1.1")
    for dataset, mu in ((wet, 0.5), (dry, 1.1)):
        assert len(dataset) > 200
        lateral = np.abs(dataset.z[:, 0] * dataset.z[:, 2])
        assert np.max(lateral) < 1.1 * mu * 9.81
        # A trajectory is one piece of one lap: its rows follow each other.
        same = np.diff(dataset.trajectory.astype(int)) == 0
        assert np.all(np.diff(dataset.step.astype(int))[same] == 1)
        ends = dataset.z[:-1, :3] + dataset.y[:-1]
        assert np.allclose(ends[same], dataset.z[1:, :3][same], atol=1e-12)
    assert np.max(dry.z[:, 0]) > np.max(wet.z[:, 0])
    again = drive_laps(LIBRARY, SURFACES, TWO_LAPS, jobs=1)
    assert [dataset.digest() for dataset in again] == [dataset.digest() for dataset in datasets]


def test_a_machine_that_drives_laps_needs_no_file_of_the_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = tmp_path / "library.safetensors"
    library.write_bytes(LIBRARY.read_bytes())

    def elsewhere(
        _: object, work: Callable[[object], object], parts: list[object]
    ) -> Iterator[object]:
        sent = pickle.dumps((work, parts))
        library.unlink()
        received, scenarios = pickle.loads(sent)  # noqa: S301 - as a cluster does
        return map(received, scenarios)

    monkeypatch.setattr(on_policy, "in_order", elsewhere)
    one = replace(TWO_LAPS, laps=1)
    assert sum(map(len, drive_laps(library, SURFACES, one, jobs=1))) > 200


def test_forces_alternate_at_the_end_of_the_grip(monkeypatch: pytest.MonkeyPatch) -> None:
    fast = OnPolicySettings(rounds=1, laps=1, grip=(1.0, 1.0))

    def alternations() -> int:
        found = 0
        for dataset in drive_laps(LIBRARY, SURFACES, fast, round_number=1, jobs=1):
            same = np.diff(dataset.trajectory.astype(int)) == 0
            change = np.where(same, np.diff(dataset.z[:, 4]), 0.0)
            both = np.minimum(np.abs(change[1:]), np.abs(change[:-1])) > 1000.0
            found += int(np.sum(both & (change[1:] * change[:-1] < 0.0)))
        return found

    exciting = alternations()
    monkeypatch.setattr(on_policy, "_EXCITING", {})
    # Forces alternated 137 times without the proximal term of the plans (_EXCITING), and once with
    # it.
    assert exciting > 10 * alternations() + 10


def test_vehicles_that_stand_give_no_transitions() -> None:
    x, u = np.zeros((20, 7)), np.zeros((20, 2))
    x[:, 0] = np.arange(20)  # p_x, by which rows are told apart below
    x[:, 2] = 2.0 * STANDING
    x[[0, 7, 8, 12, 19], 2] = 0.9 * STANDING
    x[12, 2] = -x[11, 2]  # as fast backwards
    x[:, 4] = x[:, 0]
    lap = on_policy._Driven(x, u, np.full(20, 0.5))  # noqa: SLF001
    found = on_policy._on_surface([lap], SURFACES[0])  # noqa: SLF001
    assert found is not None
    assert found.z[:, 1].tolist() == [1, 2, 3, 4, 5, 9, 10, 13, 14, 15, 16, 17]
    # A new trajectory begins behind each row that is left out.
    assert found.trajectory.tolist() == [0] * 5 + [1] * 2 + [2] * 5
    assert found.step.tolist() == [0, 1, 2, 3, 4, 0, 1, 0, 1, 2, 3, 4]
    standing = np.tile([0.0, 0.0, 0.9 * STANDING, 0.0, 0.0, 0.0, 0.0], (20, 1))
    lap = on_policy._Driven(standing, u, lap.friction)  # noqa: SLF001
    assert on_policy._on_surface([lap], SURFACES[0]) is None  # noqa: SLF001


def test_surfaces_of_the_same_friction_cannot_be_told_apart() -> None:
    alike = [Experiment(friction="snow", label="snow"), Experiment(friction=0.3, label="mu 0.3")]
    with pytest.raises(EgpError, match="have the same one"):
        drive_laps(LIBRARY, alike, TWO_LAPS)


def test_two_names_of_the_same_friction_cannot_be_told_apart() -> None:
    alike = [Experiment(friction=0.5, label="wet"), Experiment(friction=0.5, label="moss")]
    with pytest.raises(EgpError, match=r"'wet' \(friction 0\.5\), 'moss' .* have the same one"):
        drive_laps(LIBRARY, alike, TWO_LAPS)


def test_two_seeds_of_a_surface_get_its_laps_once(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = [replace(SURFACES[0], seed=seed) for seed in (0, 7)]
    assert distinct_surfaces([*seeds, SURFACES[1]]) == SURFACES
    x = np.tile([0.0, 0.0, 2.0 * STANDING, 0.0, 0.0, 0.0, 0.0], (20, 1))
    lap = on_policy._Driven(x, np.zeros((20, 2)), np.full(20, 0.5))  # noqa: SLF001
    monkeypatch.setattr(on_policy, "in_order", lambda *_: [lap])
    assert len(drive_laps(LIBRARY, seeds, replace(TWO_LAPS, laps=1), jobs=1)) == 1


@pytest.mark.parametrize("change", [{"vehicle": 2}, {"disturbances": {"load": 300.0}}])
def test_all_surfaces_are_driven_with_one_vehicle(change: dict[str, object]) -> None:
    other = replace(SURFACES[1], **change)  # type: ignore[arg-type]
    with pytest.raises(EgpError, match=r"'mu 1\.1' has another vehicle or other disturbances"):
        drive_laps(LIBRARY, [SURFACES[0], other], TWO_LAPS)
