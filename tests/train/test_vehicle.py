"""The vehicle of a library: found by its name if it is simulated, otherwise read from a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from surfaces import surface

from egp_service import EgpError
from egp_service._core import Plant, VehicleParameters
from egp_service.control.toml_text import dumps
from egp_service.training.export import export
from egp_service.training.train import TrainingSettings, train
from egp_service.vehicle import known_vehicle, read_vehicle

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

CAR = VehicleParameters.commonroad(1)


def test_simulated_vehicles_are_known_by_the_name_of_their_datasets() -> None:
    assert known_vehicle("commonroad-2") == Plant(2).parameters
    for unknown in ("toy", "commonroad-", "commonroad-9", "1"):
        with pytest.raises(EgpError):
            known_vehicle(unknown)


def test_a_vehicle_file_states_every_field_once(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_text(dumps(CAR.fields()), encoding="utf-8")
    assert read_vehicle(path) == CAR
    spoiled: Mapping[str, object]
    for spoiled, named in (
        ({"mass": -1.0}, "car.toml: vehicle parameter `mass`"),
        (
            {"width": 1674.0},
            r"car.toml: .*`width` is 1674.0 m: expected 0.05 to 10; check its unit",
        ),
        ({"length": 4.3}, "length"),
        ({"width": "wide"}, "car.toml: width is 'wide': expected a number"),
        ({"colour": "red"}, "unknown field `colour`"),
    ):
        path.write_text(dumps({**CAR.fields(), **spoiled}), encoding="utf-8")
        with pytest.raises(EgpError, match=named):
            read_vehicle(path)
    fields = CAR.fields()
    del fields["yaw_inertia"]
    path.write_text(dumps(fields), encoding="utf-8")
    with pytest.raises(EgpError, match="missing field `yaw_inertia`"):
        read_vehicle(path)
    with pytest.raises(EgpError, match=r"nowhere\.toml"):
        read_vehicle(tmp_path / "nowhere.toml")


def test_a_library_of_an_unknown_vehicle_is_not_written(tmp_path: Path) -> None:
    settings = TrainingSettings(
        max_points=20, first_points=20, max_iterations=3, restarts=0, mean="constant"
    )
    members = train([surface()], settings)
    with pytest.raises(EgpError, match=r"'toy' are not known.*--vehicle"):
        export(tmp_path / "library.safetensors", members, settings, {})
    assert list(tmp_path.iterdir()) == []


def test_values_are_read_by_name() -> None:
    assert CAR.mass == 1225.887
    assert repr(CAR).startswith("VehicleParameters(mass=1225.887, yaw_inertia=")
    with pytest.raises(AttributeError, match="length"):
        _ = CAR.length  # type: ignore[attr-defined]


def test_gate_limits_are_forces() -> None:
    limits = CAR.gate_limits()
    assert limits["force_max"] == 6.0 * 1225.887
    assert limits["power"] == 54.7 * 1225.887
    assert limits["steering_rate"] == 0.4


def test_a_field_that_is_no_number_is_named(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    for value in ("790", True, [1.0]):
        path.write_text(dumps({**CAR.fields(), "mass": value}), encoding="utf-8")
        with pytest.raises(EgpError, match=r"car\.toml: mass is .*: expected a number"):
            read_vehicle(path)
    path.write_text(dumps(CAR.fields()), encoding="utf-8-sig")  # as some editors write it
    assert read_vehicle(path) == CAR
