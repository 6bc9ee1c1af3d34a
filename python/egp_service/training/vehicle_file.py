"""A vehicle's file from logs: what the fit tells, what the logs reach, and what is left to state.

The fit tells the body and the tyres. It cannot tell the limits of actuators; the file has the
largest values in the logs instead, inside which the training data also lie.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError, VehicleParameters
from egp_service.data.dataset import check_one_car
from egp_service.data.experiment import check_seed
from egp_service.quantities import DELTA, GP_INPUT, GP_OUTPUT, GP_STATE, V_X
from egp_service.training.exact_member import spread
from egp_service.training.train import check_magnitudes
from egp_service.training.vehicle_fit import VehicleFitError, fit_vehicle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.training.vehicle_fit import FittedParameter, FittedVehicle

_WIDTH: Final = 1.8
_LEAST_SECONDS: Final = 10.0  # `egp train` and `egp evaluate --log` need more than this, too
_REACHED: Final = 0.995
"""Quantile that counts as the largest value in a log; beyond it are outliers."""
_REACHED_TEXT: Final = f"reached in the logs, outliers of {1.0 - _REACHED:.1%} left out"
_AT_BOUND_TEXT: Final = "at the end of the range that is searched"
_UNDETERMINED_TEXT: Final = "not determined accurately by the logs, so partly the prior"
_ASSUMED_TEXT: Final = (
    "not determined: the force was computed from an acceleration, so the value scales with the "
    "mass of the import"
)
_WEIGHED_TEXT: Final = "; import with the weighed mass and write it here"
_UNREACHED_TEXT: Final = "the logs do not reach the tyres' limits"
_HIDDEN_TEXT: Final = ", or do not show them, as a measured a_x does not"
# Share of the longitudinal grip that speed profiles use, so that grip is left for cornering, as
# for the simulated car (docs/settings.md, section 7).
_RESERVE: Final = 0.65
_MOST_SLIP: Final = 0.4
_BY_HAND: Final = (
    "and if they are right, write the vehicle's file by hand (`egp train --help` lists its lines), "
    "and state it with --known"
)
_LIMITS: Final = (
    *("a_min", "a_max", "power", "a_slew"),
    *("steering_angle", "steering_rate", "steering_slew"),
)
_ORDER: Final = (
    *("mass", "yaw_inertia", "l_f", "l_r", "width"),
    *_LIMITS,
    *("peak_slip", "lateral_grip", "braking_grip", "driving_grip"),
)
# Smallest values that a file states, for logs in which an actuator hardly moves.
_LEAST: Final = {
    "a_max": 0.5,
    "power": 5.0,
    "a_slew": 5.0,
    "steering_angle": 0.05,
    "steering_rate": 0.05,
    "steering_slew": 0.5,
}
_COLUMN: Final = {name: number for number, name in enumerate(GP_INPUT)}
_STATE: Final = {quantity: number for number, quantity in enumerate(GP_STATE)}


@dataclasses.dataclass(frozen=True, slots=True)
class Line:
    """A parameter of `VehicleParameters` with what is known about it."""

    name: str
    value: float
    origin: str
    """Where the value comes from, with its 95 % interval if it was fitted."""
    warning: str = ""
    """Why the value should be checked; empty if it need not."""


def vehicle_lines(
    surfaces: Sequence[Dataset],
    known: VehicleParameters | None = None,
    width: float | None = None,
    seed: int = 0,
) -> tuple[list[Line], list[FittedVehicle]]:
    """Fit a vehicle to one dataset of each surface, and give the lines of its file.

    `known` are parameters of a vehicle's file: its body is the prior of the fit, and what a fit
    cannot tell is kept. Errors if the datasets have different periods or vehicles, one has less
    than 10 s of driving or a number that is larger than that of any vehicle, `v_x`, `v_y` or
    `omega` never changes in a dataset, the seed is negative, no vehicle's file may state the width,
    or the fit fails.
    """
    least, most = VehicleParameters.ranges()["width"]
    if width is not None and not least <= width <= most:
        raise EgpError(
            f"the width is {width:g} m: expected {least:g} to {most:g} m; check the unit of --width"
        )
    check_one_car([data.provenance for data in surfaces], "fit")
    check_seed(seed)
    for data in surfaces:
        _check_length(data)
        check_magnitudes(data, known)
        spread(data.y, GP_OUTPUT, data.provenance.surface)
    surfaces = [data.of_vehicle(known) for data in surfaces]
    rngs = [np.random.default_rng([seed, number]) for number in range(len(surfaces))]
    try:
        fitted = fit_vehicle(surfaces, known, rngs)
    except VehicleFitError as error:
        error.add_note(_BY_HAND)
        raise
    frictions = [data.provenance.friction for data in surfaces]
    body = {p.name: p for p in (*fitted[0].parameters, *fitted[0].derived)}
    assumed = body["m"].assumed
    of_mass = _ASSUMED_TEXT if assumed else _UNDETERMINED_TEXT
    lines = [
        _fitted("mass", body["m"], of_mass + (_WEIGHED_TEXT if assumed else "")),
        _fitted("yaw_inertia", body["I_z"], of_mass),
        _fitted("l_f", body["l_f"]),
        _fitted("l_r", body["l_r"]),
        *_limits(surfaces, body["m"].value, known, width),
        *_tyres(fitted, frictions, _UNREACHED_TEXT + (_HIDDEN_TEXT if assumed else "")),
    ]
    return sorted(lines, key=lambda line: _ORDER.index(line.name)), fitted


def _check_length(data: Dataset) -> None:
    seconds = len(data) * data.provenance.dt
    if seconds < _LEAST_SECONDS:
        raise EgpError(
            f"surface {data.provenance.surface} has {len(data)} transitions, which are "
            f"{seconds:.3g} s of driving: a vehicle is fitted to at least {_LEAST_SECONDS:g} s of "
            "each surface, so record or collect more"
        )


def vehicle_toml(lines: Sequence[Line]) -> str:
    """Return the lines as TOML, each with its origin as a comment.

    Errors if the values are none of a vehicle.
    """
    try:
        VehicleParameters(**{line.name: line.value for line in lines})
    except (EgpError, TypeError) as error:
        raise EgpError(f"the logs give no vehicle: {error}; state it with --known") from error
    text = [
        "# A vehicle for `egp train --vehicle`; SI units. Check the lines with CHECK.",
        "# Intervals tell how well the logs determine a value; the error of the single-track",
        "# equations is not in them.",
        "",
    ]
    for line in lines:
        remark = f"{line.origin}; CHECK: {line.warning}" if line.warning else line.origin
        text.append(f"{line.name} = {line.value!r}  # {remark}")
    return "\n".join(text) + "\n"


def _fitted(name: str, parameter: FittedParameter, undetermined: str = _UNDETERMINED_TEXT) -> Line:
    warnings = []
    if parameter.at_bound:
        warnings.append(_AT_BOUND_TEXT)
    if not parameter.determined:
        warnings.append(undetermined)
    if abs(parameter.distance) > 2.0:  # noqa: PLR2004 - standard deviations
        warnings.append(f"{parameter.distance:+.1f} standard deviations from what was known")
    # At an end of the range the posterior is cut off, and an interval about its mode means nothing.
    interval = f", 95 % interval {parameter.low:.4g} to {parameter.high:.4g}"
    origin = "fitted" if parameter.at_bound else f"fitted{interval}"
    return Line(name, _rounded(parameter.value), origin, ", ".join(warnings))


def _limits(
    surfaces: Sequence[Dataset],
    mass: float,
    known: VehicleParameters | None,
    width: float | None,
) -> list[Line]:
    if known is not None:
        fields = known.fields()
        lines = [Line(name, fields[name], "as was known") for name in _LIMITS]
        own = Line("width", width or fields["width"], "stated" if width else "as was known")
        return [*lines, own]
    z = np.concatenate([data.z for data in surfaces])
    a = z[:, _COLUMN["F_x"]] / mass
    v_x = z[:, _STATE[V_X]]
    reached = {
        "a_max": float(np.quantile(a, _REACHED)),
        "power": float(np.quantile(a * np.maximum(v_x, 0.0), _REACHED)),
        "a_slew": _rate(surfaces, _COLUMN["F_x"]) / mass,
        "steering_angle": float(np.quantile(np.abs(z[:, _STATE[DELTA]]), _REACHED)),
        "steering_rate": float(np.quantile(np.abs(z[:, _COLUMN["delta_dot"]]), _REACHED)),
        "steering_slew": _rate(surfaces, _COLUMN["delta_dot"]),
    }
    advice = "the vehicle's own limit may be larger"
    lines = [
        Line(name, _rounded(max(value, _LEAST[name])), _REACHED_TEXT, advice)
        for name, value in reached.items()
    ]
    braking = min(float(np.quantile(a, 1.0 - _REACHED)), -1.0)
    lines.append(Line("a_min", _rounded(braking), _REACHED_TEXT, advice))
    if width is None:
        lines.append(Line("width", _WIDTH, "assumed", "state it with --width"))
    else:
        lines.append(Line("width", width, "stated"))
    return lines


def _rate(surfaces: Sequence[Dataset], column: int) -> float:
    """Return the largest change per second of an input between consecutive periods."""
    changes: list[NDArray[np.float64]] = []
    for data in surfaces:
        change = np.abs(np.diff(data.z[:, column]))[data.follows]
        changes.append(change / data.provenance.dt)
    all_changes = np.concatenate(changes)
    return float(np.quantile(all_changes, _REACHED)) if len(all_changes) else 0.0


def _tyres(
    fitted: Sequence[FittedVehicle], frictions: Sequence[float], unreached: str
) -> list[Line]:
    """Give slip and grips on friction 1: the least of what the surfaces show.

    `unreached` says why a grip along the vehicle may not be determined.
    """
    slips, lateral, braking, driving = [], [], [], []
    for vehicle, friction in zip(fitted, frictions, strict=True):
        p = {parameter.name: parameter for parameter in vehicle.parameters}
        slip = math.tan(math.pi / (2.0 * p["C_f"].value)) / p["B_f"].value
        slips.append(min(slip, _MOST_SLIP) / friction)
        lateral.append(min(p["D_f"].value, p["D_r"].value) / friction)
        braking.append(_RESERVE * p["D_b"].value / friction)
        driving.append(_RESERVE * p["D_d"].value / friction)
    least = "fitted, the least of the surfaces"
    reserve = f"{_RESERVE:g} of the fitted grip, the least of the surfaces"
    of_slip = _doubt(fitted, ("B_f", "C_f"), _UNREACHED_TEXT)
    across = _doubt(fitted, ("D_f", "D_r"), _UNREACHED_TEXT)
    return [
        _tyre_line("peak_slip", min(slips), least, of_slip),
        _tyre_line("lateral_grip", min(lateral), least, across),
        _tyre_line("braking_grip", min(braking), reserve, _doubt(fitted, ("D_b",), unreached)),
        _tyre_line("driving_grip", min(driving), reserve, _doubt(fitted, ("D_d",), unreached)),
    ]


def _tyre_line(name: str, value: float, origin: str, doubt: str) -> Line:
    """Give a line with the nearest value that the file of a vehicle may have."""
    least, most = VehicleParameters.ranges()[name]
    allowed = min(max(value, least), most)
    changed = f"the fit gave {value:.4g}, which no file may state" if allowed != value else ""
    return Line(name, _rounded(allowed), origin, ", ".join(filter(None, (doubt, changed))))


def _doubt(fitted: Sequence[FittedVehicle], names: tuple[str, ...], unreached: str) -> str:
    """Return the reasons to check the values of these tyre parameters; empty without a reason."""
    own = [p for vehicle in fitted for p in vehicle.parameters if p.name in names]
    warnings = []
    if any(parameter.at_bound for parameter in own):
        warnings.append(_AT_BOUND_TEXT)
    if not all(parameter.determined for parameter in own):
        warnings.append(unreached)
    return ", ".join(warnings)


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
