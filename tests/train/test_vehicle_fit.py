"""The fit of a vehicle: one body for all surfaces, priors, intervals and what they leave open."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.optimize import least_squares
from surfaces import TOY, provenance
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service._core import VehicleParameters
from egp_service.cli import app
from egp_service.data.dataset import Dataset
from egp_service.training.autocorrelation import autocorrelation
from egp_service.training.euler import euler_steps
from egp_service.training.normal_equations import NormalEquationProblem
from egp_service.training.prior_mean import PriorMean
from egp_service.training.vehicle_file import Line, vehicle_lines, vehicle_toml
from egp_service.training.vehicle_fit import FittedParameter, fit_vehicle
from egp_service.training.vehicle_priors import priors
from egp_service.vehicle import read_vehicle

if TYPE_CHECKING:
    from numpy.typing import NDArray

DT = 0.05
GYRATION = TOY.yaw_inertia / TOY.mass
BODY = [TOY.mass, TOY.l_f, TOY.l_r, GYRATION, 0.5]
DRAG = 5e-4
DRY = np.array([*BODY, 0.5, 0.8, 1.2, 1.2, 0.9, 15.0, 1.5, 0.8, 1.1, 1.0, 18.0, 1.3, 0.15, DRAG])
ICE = np.array([*BODY, 0.05, 0.09, 9.0, 9.0, 0.1, 8.0, 1.5, 7.0, 9.0, 0.11, 9.0, 1.3, 0.3, DRAG])
WHOLE = np.array([8.0, 0.6, 0.5, 0.1, 6000.0, 0.3])
# A drive in which the car hardly turns.
STRAIGHT = np.array([8.0, 0.0, 0.0, 0.0, 3000.0, 0.0])


def predict(z: NDArray[np.float64], vehicle: NDArray[np.float64]) -> NDArray[np.float64]:
    return PriorMean(vehicle, euler_steps(vehicle, DT)).predict(z, DT)


def drive(
    vehicle: NDArray[np.float64],
    spread: NDArray[np.float64],
    noise: float,
    seed: int,
    speed: float = 15.0,
) -> Dataset:
    """Transitions of a vehicle (19,) from independent states about this speed, m/s."""
    rng = np.random.default_rng(seed)
    z = np.array([speed, *np.zeros(5)]) + spread * rng.uniform(-1.0, 1.0, (1500, 6))
    y = predict(z, vehicle) + noise * rng.standard_normal((1500, 3))
    return Dataset(
        z=z,
        y=y,
        trajectory=np.arange(1500, dtype=np.uint32),
        step=np.zeros(1500, dtype=np.uint32),
        provenance=provenance(),
    )


def rngs(count: int) -> list[np.random.Generator]:
    return [np.random.default_rng(number) for number in range(count)]


def test_trial_points_without_a_solution_are_left_again() -> None:
    """Beyond 2 the slopes are no numbers, and at 2 they vanish; the first step leads to 3.75."""

    def equations(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        slope = np.nan if x[0] > 2.0 else float(x[0] < 2.0)
        distance = x - 1.5
        return np.array([[0.4 * slope]]), slope * distance, 2.5 * float(distance @ distance)

    problem = NormalEquationProblem(equations)
    for unusable in (2.0, 3.0):
        assert np.isinf(problem.residuals(np.array([unusable]))).all()
    found = least_squares(problem.residuals, np.array([0.0]), jac=problem.jacobian)
    np.testing.assert_allclose(found.x, [1.5], atol=1e-3)


def test_surfaces_share_the_body_and_differ_in_the_tyres() -> None:
    # The road is known to be level: otherwise a slope might be what slows the car.
    surfaces = [
        dataclasses.replace(drive(vehicle, WHOLE, 0.003, seed), tilt=np.zeros((1500, 2)))
        for seed, vehicle in enumerate((DRY, ICE))
    ]
    dry, ice = (vehicle.values for vehicle in fit_vehicle(surfaces, TOY, rngs(2)))
    np.testing.assert_array_equal(dry[:5], ice[:5])
    # Measured: 1 % of the mass, 3 % of the peaks.
    np.testing.assert_allclose(dry[:3], BODY[:3], rtol=0.03)
    np.testing.assert_allclose(dry[[9, 14]], DRY[[9, 14]], rtol=0.1)
    np.testing.assert_allclose(ice[[9, 14]], ICE[[9, 14]], rtol=0.1)
    # Drag belongs to the body, and rolling resistance to the road.
    assert dry[18] == ice[18] == pytest.approx(DRAG, rel=0.1)
    assert dry[17] == pytest.approx(DRY[17], abs=0.05)
    assert ice[17] == pytest.approx(ICE[17], abs=0.05)


def test_intervals_hold_the_vehicle() -> None:
    held = []
    for seed in range(4):
        (found,) = fit_vehicle([drive(DRY, WHOLE, 0.01, seed)], None, rngs(1))
        held += [p.low <= v <= p.high for p, v in zip(found.parameters, DRY, strict=True)]
        assert not any(p.at_bound for p in found.parameters)
    assert np.mean(held) > 0.85  # measured 0.94


def test_what_the_data_do_not_determine_is_reported() -> None:
    straight = drive(DRY, STRAIGHT, 0.01, 0)
    (found,) = fit_vehicle([straight], None, rngs(1))
    parameters = {parameter.name: parameter for parameter in found.parameters}
    assert parameters["m"].determined
    for name in ("l_f", "B_f", "D_f", "B_r"):
        assert not parameters[name].determined
        assert abs(parameters[name].distance) < 1.0
    coasting = drive(DRY, STRAIGHT * [1, 1, 1, 1, 1e-6, 1], 0.01, 0)
    (found,) = fit_vehicle([coasting], None, rngs(1))
    assert not found.parameters[0].determined
    # Narrower than the prior of any vehicle, but not as narrow as a vehicle's file.
    noisy = drive(DRY, STRAIGHT * [1, 1, 1, 1, 0.2, 1], 0.05, 0)
    (found,) = fit_vehicle([noisy], None, rngs(1))
    assert found.parameters[0].high / found.parameters[0].low < 2.0
    assert not found.parameters[0].determined


def test_an_end_of_the_range_is_reported() -> None:
    peakless = DRY.copy()
    peakless[11] = 1.0
    (found,) = fit_vehicle([drive(peakless, WHOLE * [1, 4, 4, 4, 1, 1], 0.0, 0)], TOY, rngs(1))
    assert [p.name for p in found.parameters if p.at_bound] == ["C_f"]


def test_a_vehicle_file_narrows_the_body_only() -> None:
    known, general = priors(TOY), priors(None)
    assert known["m"].centre == TOY.mass
    assert known["k²"].centre == pytest.approx(GYRATION)
    changed = {name for name in known if known[name] != general[name]}
    assert changed == {"m", "l_f", "l_r", "k²"}


# A car of 1:10 and a kart: vehicle file, fitted parameters, and the spread of the inputs about the
# speed.
MODEL_CAR = VehicleParameters(
    **TOY.fields() | {"mass": 3.74, "yaw_inertia": 0.047, "l_f": 0.159, "l_r": 0.171, "width": 0.27}
)
KART = VehicleParameters(
    **TOY.fields() | {"mass": 250.0, "yaw_inertia": 90.0, "l_f": 0.55, "l_r": 0.5, "width": 1.2}
)
TYRES = [0.8, 0.9, 1.2, 1.2, 0.9, 9.0, 1.4, 0.8, 1.1, 0.9, 10.0, 1.4]


@pytest.mark.parametrize(
    ("known", "height", "speed", "spread"),
    [
        (MODEL_CAR, 0.05, 3.0, [1.8, 0.5, 3.0, 0.3, 20.0, 1.0]),
        (KART, 0.25, 8.0, [5.0, 0.6, 1.0, 0.2, 1200.0, 0.5]),
    ],
)
def test_small_vehicles_are_found_around_their_file(
    known: VehicleParameters, height: float, speed: float, spread: list[float]
) -> None:
    gyration = known.yaw_inertia / known.mass
    body = [1.03 * known.mass, 1.02 * known.l_f, 0.98 * known.l_r, 0.9 * gyration, height]
    vehicle = np.array([*body, *TYRES, 0.1, 1e-3])
    log = drive(vehicle, np.array(spread), 0.003, 0, speed)
    (found,) = fit_vehicle([log], known, rngs(1))
    assert not any(p.at_bound for p in found.parameters)
    np.testing.assert_allclose(found.values[:4], body[:4], rtol=0.05)
    np.testing.assert_allclose(found.values[[9, 10, 14, 15]], vehicle[[9, 10, 14, 15]], rtol=0.1)


def test_repeated_errors_count_once() -> None:
    rng = np.random.default_rng(0)
    data = dataclasses.replace(
        drive(DRY, WHOLE, 0.0, 0),
        trajectory=np.zeros(1500, dtype=np.uint32),
        step=np.arange(1500, dtype=np.uint32),
    )
    independent = rng.standard_normal((1500, 3))
    repeated = np.repeat(independent[:150], 10, axis=0)
    # Correlations 1 - k / 10 at lag k: their sum is 4.5.
    np.testing.assert_allclose(autocorrelation(repeated, data), 4.5, atol=1.0)
    np.testing.assert_allclose(autocorrelation(independent, data), 0.0, atol=0.2)
    alone = drive(DRY, WHOLE, 0.0, 0)
    np.testing.assert_array_equal(autocorrelation(independent, alone), 0.0)


def file_lines(*surfaces: Dataset, known: VehicleParameters | None = None) -> dict[str, Line]:
    return {line.name: line for line in vehicle_lines(surfaces, known)[0]}


def test_a_grip_is_doubted_if_its_own_parameters_are() -> None:
    grips = ("peak_slip", "lateral_grip", "braking_grip", "driving_grip")
    turning = drive(DRY, WHOLE, 0.003, 0)
    z = turning.z.copy()
    z[:, 4] = np.abs(z[:, 4])
    never_braking = dataclasses.replace(turning, z=z, y=predict(z, DRY))
    lines = file_lines(never_braking, known=TOY)
    assert [name for name in grips if lines[name].warning] == ["braking_grip"]
    assert "do not reach the tyres' limits" in lines["braking_grip"].warning
    assert "a_x" not in lines["braking_grip"].warning
    of_a_x = dataclasses.replace(never_braking.provenance, force_from_a_x=True)
    lines = file_lines(dataclasses.replace(never_braking, provenance=of_a_x), known=TOY)
    assert "or do not show them, as a measured a_x does not" in lines["braking_grip"].warning
    never_turning = drive(DRY, STRAIGHT * [1, 1, 1, 1, 4, 1], 0.003, 0)
    lines = file_lines(never_turning, known=TOY)
    assert [name for name in grips if lines[name].warning] == ["peak_slip", "lateral_grip"]
    peakless = DRY.copy()
    peakless[11] = 1.0
    lines = file_lines(drive(peakless, WHOLE * [1, 4, 4, 4, 1, 1], 0.0, 0), known=TOY)
    assert [name for name in grips if lines[name].warning] == ["peak_slip"]
    assert lines["peak_slip"].warning == "at the end of the range that is searched"


def test_an_assumed_mass_is_not_determined() -> None:
    measured = drive(DRY, WHOLE, 0.01, 0)
    assert not file_lines(measured)["mass"].warning
    origin = provenance(force_from_a_x=True)
    of_a_x = dataclasses.replace(measured, provenance=origin)
    (found,) = fit_vehicle([of_a_x], None, rngs(1))
    # It is left out where it is false, so that libraries of measured forces keep their bytes.
    assert [name for name, row in found.summary().items() if "assumed" in row] == ["m"]
    lines = file_lines(of_a_x)
    for name in ("mass", "yaw_inertia"):
        assert "the value scales with the mass of the import" in lines[name].warning
    assert "write it here" in lines["mass"].warning
    assert "write it here" not in lines["yaw_inertia"].warning


@pytest.mark.parametrize("width", [-1.0, 0.0, 182.0, float("nan"), float("inf")])
def test_a_width_is_checked_before_the_fit(width: float) -> None:
    least, most = VehicleParameters.ranges()["width"]
    expected = f"the width is {width:g} m: expected {least:g} to {most:g} m; check the unit"
    with pytest.raises(EgpError, match=expected):
        vehicle_lines([], width=width)


def test_the_yaw_inertia_is_as_uncertain_as_the_mass() -> None:
    def width(parameter: FittedParameter) -> float:
        return float(np.log(parameter.high / parameter.low))

    lines, (found,) = vehicle_lines([drive(DRY, WHOLE * [1, 1, 1, 1, 0.1, 1], 0.01, 0)])
    mass, gyration, (inertia,) = found.parameters[0], found.parameters[3], found.derived
    # Forces along tell the mass and forces across k², so that their errors are independent.
    independent = np.hypot(width(mass), width(gyration))
    assert width(inertia) == pytest.approx(independent, rel=0.02)  # measured 0.001
    assert inertia.low < TOY.yaw_inertia < inertia.high
    (line,) = [line for line in lines if line.name == "yaw_inertia"]
    assert f"{inertia.low:.4g} to {inertia.high:.4g}" in line.origin
    assert not line.warning
    coasting = file_lines(drive(DRY, WHOLE * [1, 1, 1, 1, 0.01, 1], 0.01, 0))
    assert "not determined accurately by the logs" in coasting["yaw_inertia"].warning


def test_errors_for_logs_that_give_no_vehicle() -> None:
    data = drive(DRY, WHOLE, 0.003, 0)
    other = dataclasses.replace(data, provenance=provenance(0.9, vehicle="van"))
    with pytest.raises(EgpError, match=r"vehicle van, .*vehicle toy: one fit has one dt and one"):
        vehicle_lines([data, other])
    with pytest.raises(EgpError, match="seed is -1"):
        vehicle_lines([data], seed=-1)
    # Such as a log without a sensor of the sideslip, whose column of v_y is zero.
    blind = dataclasses.replace(data, z=data.z * [1, 0, 1, 1, 1, 1], y=data.y * [1, 0, 1])
    with pytest.raises(EgpError, match=f"{data.provenance.surface}: d_v_y never changes"):
        vehicle_lines([data, blind])
    with pytest.raises(EgpError, match=r"has 28 transitions, which are 1\.4 s .* at least 10 s"):
        vehicle_lines([data, data.select(np.arange(1500) < 28)])
    with pytest.raises(EgpError, match=r"d_v_x is [-\d.e+]+ in a row of the training data"):
        vehicle_lines([dataclasses.replace(data, y=1e6 * data.y)])


def test_a_fit_to_ice_alone_gives_a_file_that_can_be_read(tmp_path: Path) -> None:
    ice = dataclasses.replace(drive(ICE, WHOLE, 0.003, 1), provenance=provenance(0.1))
    lines, _ = vehicle_lines([ice])
    file = tmp_path / "vehicle.toml"
    file.write_text(vehicle_toml(lines), encoding="utf-8")
    assert read_vehicle(file).peak_slip == 1.5  # rad; the peak at 0.22 rad belongs to friction 0.1
    (slip,) = [line for line in lines if line.name == "peak_slip"]
    assert re.search(r"the fit gave \d\.\d+, which no file may state", slip.warning)


def test_the_file_of_a_vehicle_from_logs(tmp_path: Path) -> None:
    paths = []
    for name, vehicle, seed in (("dry", DRY, 0), ("ice", ICE, 1)):
        data = drive(vehicle, WHOLE, 0.003, seed)
        friction = {"dry": 0.9, "ice": 0.1}[name]
        origin = dataclasses.replace(data.provenance, surface=name, friction=friction)
        paths.append(str(tmp_path / f"{name}.parquet"))
        dataclasses.replace(data, provenance=origin).write(Path(paths[-1]))
    file = tmp_path / "vehicle.toml"
    result = CliRunner().invoke(app, ["vehicle", "fit", *paths, "-o", str(file), "--width", "1.7"])
    assert result.exit_code == 0, result.output
    found = read_vehicle(file)
    # Without a prior the mass is told by the tyres' forces alone.
    assert found.width == 1.7
    lines = dict(re.findall(r"^(\w+) = .*?# (.*)$", file.read_text(), re.MULTILINE))
    assert lines.keys() == TOY.fields().keys()
    interval = [
        float(end) for end in re.findall(r"interval ([\d.]+) to ([\d.]+)", lines["mass"])[0]
    ]
    assert interval[0] < found.mass < interval[1]
    assert "CHECK" in lines["steering_angle"]
    # What the intervals are not is said where they are shown.
    assert "the error of the single-track" in file.read_text(encoding="utf-8")
    assert "the error of the single-track" in " ".join(result.output.split())
    # The steering angle of the data is uniform up to 0.1 rad.
    assert found.steering_angle == pytest.approx(0.1, rel=0.02)
    assert found.a_max == pytest.approx(6000.0 / found.mass, rel=0.02)
    # With what is known, limits are kept and the body stays close to it.
    known = tmp_path / "known.toml"
    known.write_text("".join(f"{name} = {value}\n" for name, value in TOY.fields().items()))
    command = ["vehicle", "fit", *paths, "-o", str(file), "--known", str(known)]
    result = CliRunner().invoke(app, command, env={"FORCE_COLOR": "1"})
    assert result.exit_code == 0
    assert "fitting the vehicle" in result.output  # as a terminal shows it
    again = read_vehicle(file)
    assert (again.steering_angle, again.width) == (TOY.steering_angle, TOY.width)
    assert again.mass == pytest.approx(TOY.mass, rel=0.03)
    assert again.lateral_grip == pytest.approx(min(0.8 / 0.9, 1.0), rel=0.15)
