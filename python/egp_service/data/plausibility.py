"""Checks that hold the columns of a log against each other.

A wrong unit, a wrong sign or a swapped column often gives values that are possible one by one. It
shows where columns state the same thing twice: the change of the speed and the acceleration, the
yaw rate and the steering angle. With the speed v, the steering angle delta and the wheelbase L a
slow vehicle turns at omega = v delta / L (Rajamani, *Vehicle Dynamics and Control*, 2nd ed.,
section 2.2), and understeer makes this smaller: v delta = (L + K v²) omega in a steady turn
(section 3.2, with K as the understeer gradient per acceleration).
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import MIN_SLIP_SPEED, EgpError, slip_speed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from egp_service.data.log_import import Column

    Log = Mapping[str, NDArray[np.float64]]

# Largest plausible magnitude of each quantity in SI units; larger values indicate a wrong unit.
LARGEST: Final = {
    "time": np.inf,
    "v_x": 100.0,
    "v_y": 40.0,
    "omega": 6.0,
    "delta": 1.2,
    "F_x": 1e5,
    "a_x": 30.0,
    "delta_dot": 6.0,
    "grade": 0.7,
    "bank": 0.7,
}
HEAVIEST: Final = 1e5  # kg
# Small vehicles turn and steer faster, in proportion to one over the square root of their size.
_FASTER: Final = ("omega", "delta_dot")
# s; logs of vehicles have 1 to 1000 rows in a second.
_PERIODS: Final = (1e-3, 1.0)
# Largest change from one row to the next, and per second: no road vehicle changes faster.
_JUMPS: Final = {"v_x": (3.0, 60.0), "v_y": (3.0, 60.0), "omega": (2.0, 40.0), "delta": (0.5, 10.0)}
# A column that is constant is an error only if a related column varies by more than this: standard
# deviations of the yaw rate in rad/s and of the steering angle in rad.
_RELATED_STD: Final = {"omega": 0.05, "delta": 0.02}
# The same for a constant acceleration or speed: the range in m/s of the measured speeds about those
# of a constant acceleration, or of the speeds that the measured acceleration about its mean
# implies. Vibration and slopes imply less.
_SPEED_RANGE: Final = 1.0
# If the changes of the speed have a standard deviation above this, in m/s², an acceleration whose
# standard deviation is below this share of it is an error.
_SPEED_CHANGE_STD: Final = 0.5
_LEAST_ACCELERATION_SHARE: Final = 0.03
_HEAVIEST: Final = 4000.0  # kg, for a force of a vehicle whose mass is not known
_STUCK: Final = 5.0  # s
_GAP: Final = 3.0  # median periods; what lies on both sides of a longer step is not compared
MOVING: Final = 3.0  # m/s
_ROLLING: Final = 1.0  # m/s
# Bounds of the wheelbase in m if it is not known, and as multiples of a known one.
_WHEELBASES: Final = (1.0, 7.0)
_KNOWN: Final = (0.6, 1.6)
# With understeer v delta / omega is larger than the wheelbase, and at most by this factor.
_UNDERSTEER: Final = 2.4
# A fitted wheelbase is wrong if it is so many standard errors, as if rows were independent, outside
# its bounds, and if the fastest rows are so many times as fast as the slowest.
_ERRORS: Final = 10.0
_SPREAD: Final = 1.5
# Change of v_x over acceleration: tyres and drag take a part, and nothing adds to it.
_ACCELERATIONS: Final = (0.4, 2.0)
_CERTAIN: Final = 0.7  # correlation from which a ratio is meant
# Standard deviations of v delta in m/s, omega in rad/s and the acceleration in m/s².
_EXCITED: Final = {"turning": 0.02, "omega": 0.02, "accelerating": 0.2}
# Correlations that differ by less are alike: the acceleration is late by the smallest such lag.
_ALIKE: Final = 0.05
# Share of the moving rows, those with the least v^2 delta or the least acceleration, in which tyres
# slip little.
_GENTLE: Final = 0.6
_SMOOTHING: Final = 0.5  # s
# s, by which filters may delay an acceleration
_LAGS: Final = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)


def largest(quantity: str, wheelbase: float | None) -> float:
    """Return the largest plausible magnitude for a vehicle of this wheelbase, m, if it is known."""
    if wheelbase is None or quantity not in _FASTER:
        return LARGEST[quantity]
    return LARGEST[quantity] * MIN_SLIP_SPEED / slip_speed(wheelbase)


def check(
    log: Log,
    columns: Mapping[str, Column],
    mass: float | None = None,
    wheelbase: float | None = None,
) -> None:
    """Check a log in SI units; `columns` are those it was read from.

    What is known of the vehicle, its mass in kg and its wheelbase in m, makes the checks sharper.

    Raises:
        EgpError: if columns contradict each other. The error names them, the likely mistake, and
            the option that mends it.

    """
    _check_period(log, columns)
    _check_jumps(log, columns)
    _check_direction(log, columns)
    _check_stuck(log, columns, mass)
    _check_accelerating(log, columns, mass)
    _check_turning(log, columns, wheelbase)


def _check_period(log: Log, columns: Mapping[str, Column]) -> None:
    time = columns["time"]
    period = float(np.median(np.diff(log["time"]))) if len(log["time"]) > 1 else _PERIODS[0]
    if period > 0.0 and not _PERIODS[0] <= period <= _PERIODS[1]:
        raise EgpError(
            f"'{time.name}' read in {time.unit} gives a row every {period:.3g} s, expected "
            f"{_PERIODS[0]:g} to {_PERIODS[1]:g} s: state another unit, "
            f"--column time={time.name}:s, ms, us or ns"
        )


def _check_jumps(log: Log, columns: Mapping[str, Column]) -> None:
    gaps = np.diff(log["time"])
    for quantity, (jump, rate) in _JUMPS.items():
        change = np.abs(np.diff(log[quantity]))
        beyond = np.flatnonzero(change > jump + rate * gaps)
        if len(beyond):
            row = int(beyond[0]) + 1
            before, after = log[quantity][row - 1 : row + 1]
            raise EgpError(
                f"'{columns[quantity].name}' jumps from {before:.4g} to {after:.4g} (SI units) at "
                f"row {row}, which no vehicle does: correct or remove this row"
                + (f" and {len(beyond) - 1} others" if len(beyond) > 1 else "")
            )


def _check_direction(log: Log, columns: Mapping[str, Column]) -> None:
    rolling = np.hypot(log["v_x"], log["v_y"]) > _ROLLING
    if not rolling.any():
        return
    v_x, v_y = log["v_x"][rolling], log["v_y"][rolling]
    if np.median(np.abs(v_y)) > np.median(np.abs(v_x)):
        raise EgpError(
            f"the vehicle mostly moves sideways: '{columns['v_x'].name}' and "
            f"'{columns['v_y'].name}' are probably swapped; exchange them in --column"
        )
    if np.median(v_x) < 0.0:
        raise EgpError(
            f"the vehicle mostly drives backwards: '{columns['v_x'].name}' has probably the wrong "
            "sign. Speeds are positive forward; negate the column in the log"
        )


def _acceleration(log: Log, mass: float | None) -> NDArray[np.float64]:
    """Acceleration in m/s²; of a force without a known mass, what it is at least."""
    return log["a_x"] if "a_x" in log else log["F_x"] / (mass or _HEAVIEST)


def _check_stuck(log: Log, columns: Mapping[str, Column], mass: float | None) -> None:
    """Errors if a column is constant for 5 s while one that says the same changes (`_moves`).

    Gaps in time do not count, and what lies on both sides of one is not compared.
    """
    gaps = _after_gap(log["time"])
    recorded = np.concatenate([[0.0], np.cumsum(np.where(gaps, 0.0, np.diff(log["time"])))])
    about = {**log, "a_x": _acceleration(log, mass)}
    for quantity in ("v_x", "v_y", "omega", "delta", *(("a_x",) if "a_x" in log else ())):
        values = log[quantity]
        for first, last in runs(values):
            duration = recorded[last - 1] - recorded[first]
            if duration < _STUCK or np.median(log["v_x"][first:last]) <= MOVING:
                continue
            ends = [first, *(first + 1 + np.flatnonzero(gaps[first : last - 1])), last]
            pieces = (slice(*piece) for piece in itertools.pairwise(ends))
            if any(_moves(quantity, {q: c[rows] for q, c in about.items()}) for rows in pieces):
                raise EgpError(
                    f"'{columns[quantity].name}' stays at {values[first]:.4g} (SI units) from row "
                    f"{first} to {last - 1}, {duration:.0f} s, while the vehicle moves: "
                    + (
                        "this column was probably not measured; name one that was"
                        if last - first == len(values)
                        else "the sensor was probably stuck; remove these rows"
                    )
                )


def runs(values: NDArray[np.float64]) -> Iterator[tuple[int, int]]:
    """Give the first row, and that behind the last one, of each run of equal values."""
    starts = np.concatenate(([0], np.flatnonzero(np.diff(values) != 0.0) + 1, [len(values)]))
    return itertools.pairwise(starts.tolist())


def _moves(quantity: str, log: Log) -> bool:
    """Return whether columns that say the same as `quantity` change, in rows without a gap.

    For v_x this is the acceleration, for a_x the speed, and for lateral columns a lateral one: on a
    straight road these are constant while the speed changes. At a constant steering angle, as in a
    test of steady bends, the yaw rate follows the speed.
    """
    time, v_x, omega = log["time"], log["v_x"], log["omega"]
    if len(time) < 3:  # noqa: PLR2004
        return False
    if quantity == "v_x":
        return _speed_change(time, log["a_x"]) > _SPEED_RANGE
    if quantity == "a_x":
        return _about_line(time, v_x) > _SPEED_RANGE
    if quantity == "delta":
        return _beside_speed(v_x, omega) > _RELATED_STD["omega"]
    steered = float(np.std(log["delta"])) > _RELATED_STD["delta"]
    return steered or (quantity == "v_y" and float(np.std(omega)) > _RELATED_STD["omega"])


def _after_gap(time: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether each row but the first (n - 1,) comes after a gap in time."""
    steps = np.diff(time)
    return np.asarray(steps > _GAP * np.median(steps)) if len(steps) else np.zeros(0, dtype=bool)


def _beside_speed(v_x: NDArray[np.float64], omega: NDArray[np.float64]) -> float:
    """Return the yaw rate (standard deviation) that speed and understeer leave unexplained."""
    slopes = np.column_stack([v_x, v_x**3])
    return float(np.std(omega - slopes @ np.linalg.lstsq(slopes, omega, rcond=None)[0]))


def _about_line(time: NDArray[np.float64], v_x: NDArray[np.float64]) -> float:
    """Range of the speeds in m/s about those of a constant acceleration."""
    slope, start = np.polyfit(time - time[0], v_x, 1)
    return float(np.ptp(v_x - start - slope * (time - time[0])))


def _speed_change(time: NDArray[np.float64], acceleration: NDArray[np.float64]) -> float:
    """Range of the speeds in m/s that the acceleration about its mean implies."""
    about_mean = acceleration - acceleration.mean()
    return float(np.ptp(np.cumsum(about_mean[1:] * np.diff(time))))


def _check_turning(log: Log, columns: Mapping[str, Column], wheelbase: float | None) -> None:
    """Check all rows, and then those of gentle turns, where a sliding vehicle does not hide it."""
    low, high = _WHEELBASES if wheelbase is None else (_KNOWN[0] * wheelbase, _KNOWN[1] * wheelbase)
    moving = log["v_x"] > MOVING
    for rows in (moving, _gentle(log, moving)):
        _check_turning_rows(log, columns, rows, low, high)
    _check_wheelbase(log, columns, _gentle(log, log["v_x"] > _ROLLING), low, high)


def _gentle(log: Log, rows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Those of some rows in which tyres slip least."""
    demand = log["v_x"] ** 2 * np.abs(log["delta"])
    return rows & (demand <= np.quantile(demand[rows], _GENTLE)) if rows.any() else rows


def _quiet(turned: NDArray[np.float64], omega: NDArray[np.float64]) -> bool:
    """Return whether a vehicle turns too little to tell anything.

    In a wrong unit one of both is small, so that it is quiet only if both are.
    """
    if len(omega) < 2:  # noqa: PLR2004
        return True
    ours, theirs = float(np.std(turned)), float(np.std(omega))
    return min(ours, theirs) == 0.0 or (ours < _EXCITED["turning"] and theirs < _EXCITED["omega"])


def _check_turning_rows(
    log: Log, columns: Mapping[str, Column], rows: NDArray[np.bool_], low: float, high: float
) -> None:
    turned, omega = (log["v_x"] * log["delta"])[rows], log["omega"][rows]
    if _quiet(turned, omega):
        return
    names = f"'{columns['omega'].name}' and '{columns['delta'].name}'"
    correlation = float(np.corrcoef(turned, omega)[0, 1])
    if correlation < -_CERTAIN:
        raise EgpError(
            f"{names} have opposite signs: the vehicle turns right when it steers left. Both are "
            "positive to the left (counter-clockwise); negate one of them in the log"
        )
    if correlation < _CERTAIN:
        return
    found = float(turned @ turned / (turned @ omega))
    high *= _UNDERSTEER
    if not low <= found <= high:
        likely = (
            "the steering wheel's angle in place of the road wheels' (give --steering-ratio), or "
            "a wrong unit of one of them or of the speed"
            if found > high
            else "a wrong unit of one of them, or of the speed"
        )
        raise EgpError(
            f"{names} fit a wheelbase of {found:.3g} m, expected {low:.3g} to {high:.3g} m: "
            f"{likely}"
        )


def _check_wheelbase(
    log: Log, columns: Mapping[str, Column], rows: NDArray[np.bool_], low: float, high: float
) -> None:
    """Check the wheelbase that is left when understeer is fitted, too: a wrong unit changes it."""
    v, delta, omega = (log[q][rows] for q in ("v_x", "delta", "omega"))
    if len(v) < 3:  # noqa: PLR2004
        return
    turned = v * delta
    slow, fast = np.quantile(v, [0.05, 0.95])
    if _quiet(turned, omega) or fast < _SPREAD * slow:
        return
    if float(np.corrcoef(turned, omega)[0, 1]) < _CERTAIN:
        return
    slopes = np.column_stack([omega, v**2 * omega])
    fit, _, rank, _ = np.linalg.lstsq(slopes, turned, rcond=None)
    if rank < slopes.shape[1]:
        return
    variance = np.mean((turned - slopes @ fit) ** 2) * np.linalg.inv(slopes.T @ slopes)[0, 0]
    margin = _ERRORS * float(np.sqrt(variance))
    if not low - margin <= fit[0] <= high + margin:
        speed = columns["v_x"]
        wheel = "" if fit[0] < low else ", or the steering wheel's angle (give --steering-ratio)"
        raise EgpError(
            f"'{speed.name}', '{columns['omega'].name}' and '{columns['delta'].name}' fit a "
            f"wheelbase of {fit[0]:.3g} m at low speed, expected {low:.3g} to {high:.3g} m: a "
            f"wrong unit ('{speed.name}' is read in {speed.unit}){wheel}"
        )


def _check_accelerating(log: Log, columns: Mapping[str, Column], mass: float | None) -> None:
    stated = "a_x" if "a_x" in log else "F_x"
    acceleration = _acceleration(log, mass)
    period = float(np.median(np.diff(log["time"])))
    rows = max(1, round(_SMOOTHING / period))
    if len(acceleration) < 4 * rows:
        return
    mean = np.convolve(acceleration, np.full(rows, 1.0 / rows), mode="valid")[:-1]
    change = (log["v_x"][rows:] - log["v_x"][:-rows]) / (rows * period)
    change -= (log["v_y"] * log["omega"])[rows // 2 : rows // 2 + len(change)]
    piece = np.concatenate([[0], np.cumsum(_after_gap(log["time"]))])
    moving = (log["v_x"][rows:] > MOVING) & (log["v_x"][:-rows] > MOVING)
    moving &= piece[rows:] == piece[:-rows]
    piece = np.where(moving, piece[rows:], -1)
    lagging = (_later(mean, change, piece, round(lag / period)) for lag in _LAGS)
    late = [pair for pair in lagging if pair is not None]
    names = f"'{columns['v_x'].name}' and '{columns[stated].name}'"
    of_speed = float(np.std(change[moving])) if moving.any() else 0.0
    least = _LEAST_ACCELERATION_SHARE * of_speed
    if of_speed > _SPEED_CHANGE_STD and float(np.std(mean[moving])) < least:
        raise EgpError(
            f"{names} contradict each other: the speed changes, and '{columns[stated].name}' read "
            f"in {columns[stated].unit} hardly does. Its unit is probably wrong, or the sensor is "
            "stuck"
        )
    # In a wrong unit one of both is small.
    if not late or max(map(np.std, late[0])) < _EXCITED["accelerating"]:
        return
    correlations = [float(np.corrcoef(*pair)[0, 1]) for pair in late]
    most = max(map(abs, correlations))
    best = next(i for i, found in enumerate(correlations) if abs(found) >= most - _ALIKE)
    if correlations[best] < -_CERTAIN:
        raise EgpError(
            f"{names} contradict each other: the vehicle slows down when it accelerates. "
            "Accelerations and forces are positive forward; negate the column in the log"
        )
    if stated == "F_x" and mass is None:
        return
    mean, change = late[best]
    # Demands beyond the grip change the speed little, so that on ice the ratio of all windows is
    # small although the units are right. That of the windows of small accelerations is not.
    gentle = np.abs(mean) <= np.quantile(np.abs(mean), _GENTLE)
    ratio, of_gentle = _ratio(mean, change), _ratio(mean[gentle], change[gentle])
    low, high = _ACCELERATIONS
    if correlations[best] > _CERTAIN and not (low <= ratio <= high or low <= of_gentle <= high):
        raise EgpError(
            f"{names} contradict each other: the speed changes {ratio:.2g} times as fast as the "
            f"acceleration says, expected {low:g} to {high:g}. One of their units is probably "
            f"wrong ('{columns['v_x'].name}' is read in {columns['v_x'].unit}), or the mass"
        )


def _ratio(mean: NDArray[np.float64], change: NDArray[np.float64]) -> float:
    """Slope of the changes of speed over the accelerations; 0 unless both are correlated."""
    if np.std(mean) == 0.0 or np.std(change) == 0.0:
        return 0.0
    correlation = float(np.corrcoef(mean, change)[0, 1])
    return correlation * float(np.std(change) / np.std(mean)) if correlation > _CERTAIN else 0.0


def _later(
    late: NDArray[np.float64], early: NDArray[np.float64], piece: NDArray[np.int64], rows: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return `late` and what `early` was `rows` before, where both are of one piece.

    `piece` has the number of the piece between gaps, or -1 where a value does not count.
    """
    count = max(len(early) - rows, 0)
    chosen = (piece[rows:] == piece[:count]) & (piece[rows:] >= 0)
    a, b = late[rows:][chosen], early[:count][chosen]
    return (a, b) if len(a) > 1 and np.std(a) > 0.0 and np.std(b) > 0.0 else None
