"""The kind of an error tells an argument that cannot be used from data that are damaged."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from egp_service import (
    Controller,
    EgpError,
    InvalidArgumentError,
    Library,
    Path,
    Plant,
    RoadBelief,
    SpeedPlanner,
    SpeedProfile,
    VehicleParameters,
    horizon_reference,
)
from egp_service._core import (
    FRICTION_HYPOTHESES,
    Engine,
    VehicleLostError,
    check_settings,
    decode_ready,
    merge_tiles,
    surface_friction,
)
from egp_service.shipped import DEMO_LIBRARY
from egp_service.simulation.configuration import ConfigurationError
from egp_service.simulation.scenario import parse_scenario
from egp_service.simulation.scenario_checks import ScenarioError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path as FilePath

PATH = Path.rounded_rectangle()
CAR = VehicleParameters.commonroad(1)
PROFILE = SpeedProfile(PATH, CAR)
NAN = float("nan")
NOTHING: Any = None


def belief() -> RoadBelief:
    return RoadBelief(PATH)


def planner() -> SpeedPlanner:
    return SpeedPlanner(PATH, CAR)


def test_zones_that_cannot_be_read_name_their_file(tmp_path: FilePath) -> None:
    file, text = tmp_path / "zones.csv", 'name = "own"\nzones_file = "zones.csv"\n'
    with pytest.raises(ScenarioError, match=f"zones_file {file}: No such file or directory; state"):
        parse_scenario(text, tmp_path, "own.toml")
    file.write_text("start,friction,friction\n0,0.9,0.2\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=f"{file}: column 'friction' comes twice"):
        parse_scenario(text, tmp_path, "own.toml")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: RoadBelief(PATH, window=0), "1 to 1000 transitions for window, got 0"),
        (lambda: setattr(belief(), "window", 0), "for window, got 0"),
        (lambda: belief().update(NAN), "for s, got NaN"),
        (lambda: belief().ahead([0.0, 1.0], 2.0), "probability in .* got 2"),
        (lambda: belief().preview([0.0]), "the number of places, got 1"),
        (lambda: belief().quantiles([0.0], 0.0), "probability in .* got 0"),
        (lambda: belief().tile(99), "tile in 0..3 .* got 99"),
        (lambda: belief().report(99, belief().tile(0)), "tile in 0..3 .* got 99"),
        (lambda: merge_tiles([], capacity=0.0), "for capacity, got 0"),
        (lambda: SpeedPlanner(PATH, CAR, grip=2.0), "for grip, got 2"),
        (lambda: planner().plan(0.0, [0.5]), "friction at .* places, got 1"),
        (lambda: SpeedProfile(PATH, CAR, v_max=0.0), "for v_max, got 0"),
        (lambda: SpeedProfile.constant(PATH, -1.0), "for speed, got -1"),
        (lambda: horizon_reference(PATH, PROFILE, np.zeros(7), 0.0, 5), "for dt, got 0"),
        (lambda: Path.from_points(np.zeros((2, 2)), closed=False), "at least 4 distinct points"),
        (lambda: Path.rounded_rectangle(width=20.0), "too short for its two corners"),
        (lambda: Path.random(1, length=-1.0), "got -1"),
        (lambda: PATH.with_friction([(0.5, 1.0)]), "zone 0 starts at 0.5"),
        (lambda: PATH.with_friction([(0.0, "mud")]), 'no surface "mud"'),
        (lambda: PATH.with_friction([(0.0, -1.0)]), "friction coefficient > 0"),
        (lambda: PATH.project([0.0, NAN]), r"expected a finite position, got \[0.0, NaN\]"),
        (lambda: PATH.project([0.0, 0.0], NAN), "expected a finite hint, got NaN"),
        (lambda: Plant(0), "CommonRoad vehicles 1, 2, got 0"),
        (lambda: Plant(1, {"breeze": 1.0}), "disturbances: unknown field `breeze`"),
        (lambda: Plant().reset(0.0, 0.0, 0.0, -1.0), "only drives forward"),
        (lambda: Plant().reset(0.0, 0.0, 0.0, 1e9), "v_x from 0 to 100 m/s, got 1000000000"),
        (lambda: Plant().reset(0, 0, 0, 5.0, v_y=1e9), "v_y from -50 to 50 m/s, got 1000000000"),
        (lambda: Plant().reset(0, 0, 0, 5.0, yaw_rate=21.0), "omega from -20 to 20 rad/s, got 21"),
        (lambda: Plant().reset(0, 0, 0, 5.0, delta=2.0), "delta from -1.5 to 1.5 rad, got 2"),
        (lambda: Plant().step([0.0, 0.0], 0.0, 1.0), "period dt > 0"),
        (lambda: Plant().step([0.0, 0.0], 0.02, 1.0, NAN), "expected a finite hint, got NaN"),
        (lambda: surface_friction({"peek": 1.0}), "a surface needs its `peak`"),
        (lambda: VehicleParameters.commonroad(9), "CommonRoad vehicles 1, 2, got 9"),
        (
            lambda: VehicleParameters(**CAR.fields() | {"mass": -1.0}),
            "`mass` is -1.0 kg: expected 1 to 100000; check its unit",
        ),
        (lambda: check_settings("horizon = 0"), "horizon"),
        (lambda: Engine(DEMO_LIBRARY, "horizon = 0"), "horizon"),
        (
            lambda: Controller(DEMO_LIBRARY, gate=CAR.gate_limits() | {"force_min": -1e5}),
            "gate limit force_min is -100000 N",
        ),
    ],
)
def test_a_value_outside_its_domain_is_an_invalid_argument(
    call: Callable[[], Any], message: str
) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        call()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: Plant().step([0.0, 0.0], 0.02, NOTHING),
            "friction: expected a Path, a friction coefficient, .*, got None",
        ),
        (
            lambda: Plant().step([0.0, 0.0], 0.02, np.zeros((40, 2))),  # type: ignore[arg-type]
            "got an object of the type ndarray",
        ),
        (
            lambda: surface_friction({"peak": NOTHING}),
            "surface: expected a friction coefficient, .*, got {'peak': None}",
        ),
    ],
)
def test_what_is_no_surface_is_shown_in_a_line(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(TypeError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_an_unusable_speed_keeps_the_state_of_a_plant() -> None:
    plant = Plant()
    plant.reset(1.0, 2.0, 0.3, 100.0)
    before = plant.state
    fast = before.copy()
    fast[3] = 100.5
    told = r"v_x from 0 to 100 m/s, got 100\.5"
    with pytest.raises(InvalidArgumentError, match=told):
        plant.reset(0.0, 0.0, 0.0, 100.5)
    with pytest.raises(InvalidArgumentError, match=told):
        plant.state = fast
    np.testing.assert_array_equal(plant.state, before)


def test_a_plant_is_not_reset_to_the_numbers_of_a_state_in_another_order() -> None:
    plant = Plant()
    with pytest.raises(TypeError, match="reset"):
        plant.reset(*plant.vehicle_state)


def test_data_that_are_damaged_and_a_vehicle_that_spins_are_no_invalid_argument(
    tmp_path: FilePath,
) -> None:
    other = RoadBelief(Path.l_shape())
    track = tmp_path / "track.csv"
    track.write_text("1,2,3,4\n1,2,oops,4\n")
    plant = Plant()
    plant.reset(0.0, 0.0, 0.0, 5.0, yaw_rate=20.0)
    for call, kind in (
        (lambda: belief().recall(other.to_bytes()), EgpError),
        (lambda: belief().recall(b"damaged"), EgpError),
        (lambda: belief().report(0, b"no tile"), EgpError),
        (lambda: merge_tiles([(b"no tile", 0.0)]), EgpError),
        (lambda: decode_ready(b"noise"), EgpError),
        (lambda: Path.from_csv(track), EgpError),
        (lambda: Path.from_csv(tmp_path / "none.csv"), EgpError),
        (lambda: plant.step([0.0, 0.0], 0.05, 1.0), VehicleLostError),
    ):
        with pytest.raises(kind) as caught:
            call()
        assert caught.type is kind
        assert "os error" not in str(caught.value)
    with pytest.raises(InvalidArgumentError, match="for scale, got -1"):
        Path.from_csv(track, scale=-1.0)


def test_what_is_no_regular_file_is_an_error_of_the_system(tmp_path: FilePath) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for file, kind, number in (
        (tmp_path, IsADirectoryError, errno.EISDIR),
        (pipe, OSError, errno.EINVAL),
        (tmp_path / "none", FileNotFoundError, errno.ENOENT),
    ):
        for stated in (file, str(file)):
            with pytest.raises(kind) as caught:
                Library.load(stated)
            assert caught.type is kind
            assert (caught.value.errno, caught.value.filename) == (number, str(file))
            assert "os error" not in str(caught.value)


def test_the_hypotheses_are_those_of_a_belief_and_of_its_evidence() -> None:
    assert len(FRICTION_HYPOTHESES) == 17
    assert (FRICTION_HYPOTHESES[0], FRICTION_HYPOTHESES[-1]) == (0.1, 1.3)
    expected = 0.1 * 13.0 ** (np.arange(17) / 16)
    np.testing.assert_allclose(FRICTION_HYPOTHESES, expected, rtol=1e-15)
    road = belief()
    wanted = FRICTION_HYPOTHESES[9]
    evidence = -0.5 * (np.log(np.array(FRICTION_HYPOTHESES) / wanted) / 0.05) ** 2
    for s in np.arange(0.0, 60.0, 0.25):
        road.update(s, evidence)
    assert road.quantiles([20.0], 0.5)[0] == pytest.approx(wanted, rel=0.02)
