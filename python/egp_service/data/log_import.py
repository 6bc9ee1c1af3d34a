"""Import of a log as a dataset: conversion of units, and checks of period and magnitudes."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import STANDARD_GRAVITY, EgpError
from egp_service.data import held_values, motion_limits, plausibility
from egp_service.data.dataset import Dataset
from egp_service.data.messages import check_folder, is_recording
from egp_service.data.recording import read_fields, topics
from egp_service.data.table import comes_twice, numbers, read_table, some
from egp_service.quantities import GP_INPUT, GP_STATE_NAMES, NY, TILT

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import polars as pl
    from numpy.typing import NDArray

    from egp_service.data.provenance import Provenance

# unit: (SI unit, factor)
UNITS: Final = {
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "m/s": ("m/s", 1.0),
    "km/h": ("m/s", 1.0 / 3.6),
    "mph": ("m/s", 0.44704),
    "rad": ("rad", 1.0),
    "deg": ("rad", np.pi / 180.0),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", np.pi / 180.0),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "m/s2": ("m/s2", 1.0),
    "g": ("m/s2", STANDARD_GRAVITY),
}

_SI_UNITS: Final = {"time": "s", "a_x": "m/s2"} | GP_INPUT | TILT
_STEERING: Final = {"delta", "delta_dot"}
# Share of the rows from which larger values are a wrong unit, and not single wrong rows.
_OFTEN: Final = 0.01
# Logs are split into trajectories of this length for the validation split, whatever breaks them:
# between short pieces it would hold out what lies next to the training data.
_TRAJECTORY_SECONDS: Final = 10.0
# Share of dt by which so many periods of the log may differ from it.
_PERIOD_ERROR: Final = 5e-3
# Share of the usual step by which a step may differ from it without breaking the log.
_UNEVEN: Final = 0.2
# Stamps may be rounded to multiples of one of these, s, and the computer rounds them once more.
_RESOLUTIONS: Final = (1e-3, 1e-2, 1e-1)
_ROUNDING: Final = 1e-6


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of the log and its unit."""

    name: str
    unit: str

    def __post_init__(self) -> None:
        """Check the unit."""
        if self.unit not in UNITS:
            raise EgpError(
                f"'{self.name}:{self.unit}': unknown unit '{self.unit}', expected one of "
                f"{', '.join(UNITS)}"
            )

    @staticmethod
    def parse(text: str) -> Column:
        """Read `name:unit`, for example `speed:km/h`."""
        name, separator, unit = text.rpartition(":")
        if not separator or not name:
            raise EgpError(f"'{text}': expected COLUMN:UNIT, for example speed:km/h")
        return Column(name, unit)


def import_log(
    path: str | Path,
    columns: Mapping[str, Column],
    provenance: Provenance,
    *,
    mass: float | None = None,
    wheelbase: float | None = None,
    front_share: float | None = None,
    separator: str = ",",
    steering_ratio: float = 1.0,
    report: Callable[[int, int], None] | None = None,
) -> Dataset:
    """Convert a log into transitions of `provenance.dt` seconds.

    A log is a CSV or Parquet file, an MCAP file, or a bag of ROS 1 or 2. `columns` maps `time, v_x,
    v_y, omega, delta` and `F_x`, or `a_x` (acceleration, multiplied by `mass` in kg), to the log's
    columns. Those of MCAP files and bags are fields of messages as `read_fields` names them,
    with the times of the messages of `v_x`; `report` receives the number of messages that were
    read, and of all.

    The force is taken for the one that acts at the wheels. A measured acceleration has already lost
    what the front tyres take of it in bends, `f_f sin(delta)` per mass, and a fitted vehicle
    subtracts it again. If `a_x` is that of an accelerometer, state as `front_share` the front
    axle's share of the load, `l_r / (l_f + l_r)`: `front_share v_x omega tan(delta)` is then added,
    which is this part in a steady bend (Rajamani, Vehicle Dynamics and Control, 2nd edition,
    section 3.3).

    Faster logs are thinned: states are those at the ends of a period, the force is its mean over
    the period, and the steering rate is the change of `delta`, so that it is consistent with the
    steering angle. A `delta_dot` column is only compared with this rate. With columns for `grade`
    or `bank` of the road (`quantities.TILT`), the changes are those without gravity's part, which
    follows from the means of these angles over the period. Trajectories are 10 s long, and gaps in
    time or stamps that are late break them: the steps of a trajectory are not consecutive there.
    Single outliers of the steering angle are gaps, too.
    Steering angles are divided by `steering_ratio`, that of the steering wheel's angle to the road
    wheels'. A known `wheelbase` in m sharpens the checks of steering and speed.

    Raises:
        EgpError: if columns are missing, magnitudes are implausible, columns contradict each other,
            the period is uneven or not suitable, or values are not finite.

    """
    path = Path(path)
    _check_separator(separator)
    if not 0.0 < steering_ratio < np.inf:
        raise EgpError(f"expected a positive --steering-ratio, got {steering_ratio:g}")
    if mass is not None and not 1.0 <= mass <= plausibility.HEAVIEST:
        raise EgpError(f"expected a --mass of 1 to {plausibility.HEAVIEST:g} kg, got {mass:g}")
    if front_share is not None and "a_x" not in columns:
        raise EgpError("no column is named for the accelerometer: add --column a_x=NAME:UNIT")
    if is_recording(path):
        check_folder(path)
        columns = _with_time(path, columns)
        base = columns["v_x"].name
        others = {c.name for q, c in columns.items() if q != "time"} - {base}
        _check_quantities(columns, mass)
        frame = read_fields(path, [base, *sorted(others)], provenance.dt, report)
        if texts := [c.name for c in frame if not c.dtype.is_numeric()]:
            raise EgpError(f"{path}: '{texts[0]}' is no number: it is a text")
    else:
        _check_columns(columns, "NAME:UNIT", lambda: _header(path, separator))
        _check_quantities(columns, mass)
        frame = read_table(path, separator)
    log = _read(path, columns, frame, steering_ratio, wheelbase)
    _check_time(log["time"])
    plausibility.check(log, columns, mass, wheelbase)
    motion_limits.check(log, columns, wheelbase)
    if mass is not None and "a_x" in log:
        a_x = log["a_x"]
        if front_share is not None:
            a_x = a_x + front_share * log["v_x"] * log["omega"] * np.tan(log["delta"])
        log["F_x"] = mass * a_x
        provenance = dataclasses.replace(provenance, force_from_a_x=True)
    return _transitions(log, columns, provenance, plausibility.largest("delta_dot", wheelbase))


def _transitions(
    log: Mapping[str, NDArray[np.float64]],
    columns: Mapping[str, Column],
    provenance: Provenance,
    fastest: float,
) -> Dataset:
    """Make the transitions of a log, without those that steer faster than `fastest` rad/s."""
    pieces, every, gaps = _pieces(log["time"], provenance.dt)
    block_periods = round(_TRAJECTORY_SECONDS / provenance.dt)
    z, y, trajectory, step, tilt, rates = [], [], [], [], [], []
    used = 0
    for first, last in pieces:
        ends = np.arange(first, last, every)
        state = np.column_stack([log[q][ends] for q in GP_STATE_NAMES])
        force, *angles = (
            np.add.reduceat(log[q][first : ends[-1]], ends[:-1] - first) / every
            if q in log
            else np.zeros(len(ends) - 1)
            for q in ("F_x", *TILT)
        )
        delta_dot = np.diff(log["delta"][ends]) / provenance.dt
        if "delta_dot" in log:
            rates.append((delta_dot, log["delta_dot"][ends[:-1]]))
        possible = np.abs(delta_dot) <= fastest
        wrong = np.diff(np.flatnonzero(np.diff(~possible, prepend=False, append=False)))[::2]
        gaps += tuple((wrong * provenance.dt).tolist())
        z.append(np.column_stack([state[:-1], force, delta_dot])[possible])
        tilt.append(np.column_stack(angles)[possible])
        y.append(np.diff(state[:, :NY], axis=0)[possible])
        periods = (log["time"][first] - log["time"][0]) / provenance.dt + np.arange(len(force))
        trajectory.append((periods // block_periods).astype(np.uint32)[possible])
        step.append(np.arange(used, used + len(force), dtype=np.uint32)[possible])
        used += len(force) + 1  # a number is left out where the log is broken
    if rates:
        change, logged = np.hstack(rates)
        _check_rate(change, logged, columns["delta_dot"])
    numbers, steps = np.concatenate(trajectory), np.concatenate(step)
    _, start, own = np.unique(numbers, return_index=True, return_inverse=True)
    found = Dataset(
        z=np.concatenate(z),
        y=np.concatenate(y),
        trajectory=numbers,
        step=steps - steps[start][own],
        provenance=provenance,
        gaps=gaps,
    )
    held_values.check(found, columns)
    if not TILT.keys() & log.keys():
        return found
    found = dataclasses.replace(found, tilt=np.concatenate(tilt))
    return dataclasses.replace(found, y=found.y - found.by_gravity)


def _check_separator(separator: str) -> None:
    if len(separator) != 1 or not separator.isascii() or separator in '"\n\r#':
        raise EgpError(
            "expected one ASCII character as --separator, which is no quote, # or end of a line, "
            f"got {separator!r}"
        )


def _with_time(path: Path, columns: Mapping[str, Column]) -> Mapping[str, Column]:
    """Add the column of the time, which a recording states with its messages."""
    if "time" in columns:
        raise EgpError(
            f"{path}: the recording states the time of its messages: leave out --column "
            f"time={columns['time'].name}:{columns['time'].unit}"
        )
    columns = {"time": Column("time", "s")} | dict(columns)
    _check_columns(columns, "TOPIC/FIELD:UNIT", lambda: f"{path} has the topics {topics(path)}")
    return columns


def _check_columns(
    columns: Mapping[str, Column], expected: str, contents: Callable[[], str]
) -> None:
    missing = [q for q in ("time", *GP_STATE_NAMES) if q not in columns]
    if not {"F_x", "a_x"} & columns.keys():
        missing.append("F_x or a_x")
    if missing:
        raise EgpError(
            f"no column is named for {', '.join(missing)}: add --column {missing[0].split()[0]}="
            f"{expected} for each; {contents()}"
        )
    if {"F_x", "a_x"} <= columns.keys():
        raise EgpError("columns for F_x and a_x are named: expected exactly one of F_x and a_x")


def _check_quantities(columns: Mapping[str, Column], mass: float | None) -> None:
    """Errors if a quantity is unknown, has a unit of another one or the column of another one.

    Also errors if the force cannot be computed.
    """
    first: dict[str, str] = {}
    for quantity, column in columns.items():
        if quantity not in plausibility.LARGEST:
            raise EgpError(
                f"unknown quantity '{quantity}': expected {', '.join(plausibility.LARGEST)}"
            )
        if UNITS[column.unit][0] != _SI_UNITS[quantity]:
            raise EgpError(
                f"{quantity} from '{column.name}': {column.unit} is not a unit of {quantity}"
            )
        if (other := first.setdefault(column.name, quantity)) != quantity:
            raise EgpError(
                f"{other} and {quantity} are both the column '{column.name}': expected a column of "
                "its own for each --column"
            )
    if "a_x" in columns and mass is None:
        raise EgpError(
            "a_x requires the vehicle's mass in kg for the force F_x = mass a_x: state --mass"
        )


def _header(path: Path, separator: str) -> str:
    """Say which columns a table has."""
    try:
        names = read_table(path, separator).columns
    except EgpError as error:
        return str(error)
    return f"{path.name} has the columns {some(names)}"


def _read(
    path: Path,
    columns: Mapping[str, Column],
    frame: pl.DataFrame,
    steering_ratio: float,
    wheelbase: float | None,
) -> dict[str, NDArray[np.float64]]:
    log = {}
    for quantity, column in columns.items():
        largest = plausibility.largest(quantity, wheelbase)
        unit, factor = UNITS[column.unit]
        if column.name not in frame.columns:
            if comes_twice(column.name, frame.columns):
                raise EgpError(
                    f"{path}: two columns are named '{column.name}' when spaces around names are "
                    "left out: rename one of them"
                )
            raise EgpError(f"{path}: no column '{column.name}', found {some(frame.columns)}")
        values = numbers(path, frame[column.name]) * factor
        ratio = ""
        if quantity in _STEERING:
            values = values / steering_ratio
            ratio = ", and state --steering-ratio if it is the steering wheel's angle"
        beyond = np.flatnonzero(np.abs(values) > largest)
        if 0 < len(beyond) <= _OFTEN * len(values):
            row = int(beyond[0])
            more = f", and {len(beyond) - 1} other rows are alike" if len(beyond) > 1 else ""
            raise EgpError(
                f"{quantity} is {values[row]:.4g} {unit} at row {row} of '{column.name}'{more}: "
                f"more than {largest:g} {unit} is implausible, correct or remove these rows"
            )
        if len(beyond):
            raise EgpError(
                f"{quantity} reaches {np.abs(values).max():.4g} {unit} when '{column.name}' is "
                f"read in {column.unit}: more than {largest:g} {unit} is implausible, check the "
                f"unit{ratio}"
            )
        log[quantity] = values
    return log


def _check_time(time: NDArray[np.float64]) -> None:
    if len(time) < 2:  # noqa: PLR2004
        raise EgpError(f"the log has {len(time)} rows: expected at least two")
    steps = np.diff(time)
    if steps.min() <= 0.0:
        row = int(np.argmin(steps > 0.0)) + 1
        raise EgpError(
            f"time does not increase at row {row}: sort the log and remove duplicate rows; if many "
            "rows have the same time, export it with more digits"
        )


def _pieces(
    time: NDArray[np.float64], dt: float
) -> tuple[list[tuple[int, int]], int, tuple[float, ...]]:
    """Split where a step in time is not the usual one.

    Returns row ranges [first, last), the rows per dt, and the lengths of the gaps in s.
    """
    steps = np.diff(time)
    period = float(np.median(steps))
    # Steps between rounded stamps differ by their resolution, and only their mean is the period.
    rounding = 1.01 * _resolution(steps, period)
    for _ in range(2):
        steady = np.abs(steps - period) < max(_UNEVEN * period, rounding)
        if steady.mean() < 0.9:  # noqa: PLR2004
            raise EgpError(
                f"only {100 * steady.mean():.0f} % of the time steps are within {_UNEVEN:.0%} of "
                f"the usual one, {period:.6g} s: resample the log evenly"
            )
        period = float(steps[steady].mean())
    every = max(1, round(dt / period))
    if abs(every * period - dt) > _PERIOD_ERROR * dt:
        raise EgpError(
            f"the log's period is {period:.6g} s: dt {dt:g} s is no multiple of it; "
            f"choose --dt {every * period:.6g} or resample the log"
        )
    breaks = [0, *(np.flatnonzero(~steady) + 1), len(time)]
    pieces = [piece for piece in itertools.pairwise(breaks) if piece[1] - piece[0] > every]
    if not pieces:
        raise EgpError(f"no unbroken stretch of the log is longer than dt {dt:g} s")
    return pieces, every, tuple(steps[~steady & (steps > period)].tolist())


def _resolution(steps: NDArray[np.float64], median: float) -> float:
    """Return the resolution in s to which the stamps are rounded; 0 if they are not.

    It is at most half of the median step: otherwise a missing row would look like rounding.
    """
    rounded = [
        resolution
        for resolution in _RESOLUTIONS
        if resolution <= 0.5 * median
        and np.abs(steps - resolution * np.round(steps / resolution)).max() < _ROUNDING
    ]
    return max(rounded, default=0.0)


def _check_rate(change: NDArray[np.float64], logged: NDArray[np.float64], column: Column) -> None:
    """Compare the change of delta with the logged rate; a factor of 57 is a wrong unit."""
    ours, theirs = float(np.std(change)), float(np.std(logged))
    if ours > 1e-3 and not 0.2 < theirs / ours < 5.0:  # noqa: PLR2004
        raise EgpError(
            f"'{column.name}' in {column.unit} is {theirs / ours:.3g} times the change of the "
            "steering angle: check both units"
        )
