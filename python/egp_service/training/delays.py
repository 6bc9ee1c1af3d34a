"""The delays of a log's columns, by what a vehicle with moved inputs predicts of held-out blocks.

The force's delay is that with which a linear model predicts the changes of `v_x` best; the delay of
the measured states is that with which a fitted single-track vehicle predicts the changes of `omega`
best. Inputs are moved and changes are not, and two delays are compared on the transitions that have
inputs with both, so that the errors of both have the same noise.

A force that was made from a filtered acceleration is not only late: it is too small where it
changes. The filter's time constant is that with which a linear model predicts the changes of `v_x`
over 1 s best.
"""

from __future__ import annotations

import dataclasses
import functools
import logging
import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import minimize_scalar

from egp_service.data.alignment import Delays, align, available, consecutive
from egp_service.training.choice import hold_out
from egp_service.training.open_loop import linear, student_loss
from egp_service.training.prior_mean import PriorMean
from egp_service.training.vehicle_fit import fit_vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters
    from egp_service.data.dataset import Dataset

_EARLIEST_FORCE: Final = -1.52  # s; a filtered acceleration is late by its filter
_LATEST: Final = 0.32  # s
_STEP: Final = 0.04  # s
# Nats by which a delay must predict better than none: per error, and altogether, because the best
# of many delays is better than none by chance.
_GAIN: Final = 0.02
_EVIDENCE: Final = 20.0
_SHORTEST: Final = 2.0  # s of consecutive transitions; less is lost to the shift
_ROWS: Final = 1000  # transitions of a surface that a vehicle is fitted to
_FEWEST: Final = 200  # transitions that count, each for the fit and for the comparison
_FILTERS: Final = tuple(0.1 * 2.0 ** (0.5 * k) for k in range(13))  # s; up to 6.4 s
# Delays of a filtered force in half periods: a difference of states belongs to the middle of two.
_FILTER_DELAYS: Final = range(-4, 5)
_WINDOW: Final = 1.0  # s, over which changes of v_x identify the filter
_V_X, _OMEGA = 0, 2
_log = logging.getLogger(__name__)


def find_delays(
    logs: Sequence[Dataset], vehicle: VehicleParameters | None, *, may_fit: bool = True
) -> Delays:
    """Return the delays that all logs of one car have in common; zero if not identified.

    A delay is identified if its optimum lies inside the range that is searched (states 0 to 0.32 s,
    force -1.52 to 0.32 s), and predicts better than no delay by 0.02 nats per error and 20 nats
    altogether. For the delay of the states the vehicle must also predict the yaw rate better than
    the linear model. If both delays agree within a period, both are their mean, since one sensor
    measures all states. Only runs of at least 2 s count, and delays that leave enough of them.
    `vehicle` is what is known about the car.

    With `may_fit=False` no vehicle is fitted: the delay of the states is then 0, and a warning says
    that it was not searched.

    A first-order filter of the force (0.1 to 6.4 s, with a delay of at most two periods) is
    identified if it predicts the changes of `v_x` over 1 s better than any delay without a filter,
    by the same differences. For this only runs count that are 1 s longer than the largest delay.

    Raises:
        VehicleFitError: if no vehicle fits the logs.

    """
    runs = (_long_runs(log, _SHORTEST / log.provenance.dt) for log in logs)
    parts = [part for part in runs if part is not None]
    if not parts:
        _log.warning(
            "delays are not searched: this needs two trajectories with runs of at least %g s, and "
            "each with more than %d transitions above %.3g m/s",
            _SHORTEST,
            _FEWEST,
            logs[0].least_speed,
        )
        return Delays()
    dt = parts[0].provenance.dt
    axles = (1.0, 1.0) if vehicle is None else (vehicle.l_f, vehicle.l_r)

    def of_force(delays: Sequence[float]) -> _Losses | None:
        splits = _splits(parts, [Delays(force=delay) for delay in delays])
        return _Losses.of(splits, axles, _V_X)

    filtered = _filtered(parts, axles)
    of_inputs = filtered or Delays(force=_optimum(of_force, _EARLIEST_FORCE))
    force = of_inputs.force
    latest = dataclasses.replace(of_inputs, measurement=_LATEST)
    if not _splits(parts, [of_inputs, latest]):
        return of_inputs
    if not may_fit:
        _log.warning(
            "the delay of the measured states is not searched, because this needs the fit of a "
            "vehicle, which training with a constant mean does without"
        )
        return dataclasses.replace(
            of_inputs, force=round(force, 4), force_filter=round(of_inputs.force_filter, 4)
        )

    @functools.cache
    def split_of_states(delay: float) -> list[tuple[Dataset, Dataset]]:
        moved = dataclasses.replace(of_inputs, measurement=delay)
        return _splits(parts, [moved, of_inputs, latest])[0]

    @functools.cache
    def of_state(delay: float) -> float:
        return _mean(_vehicle_errors(split_of_states(delay), vehicle))

    def of_states(delays: Sequence[float]) -> _Losses:
        return _Losses([of_state(delay) for delay in delays], _count(split_of_states(0.0)))

    states = _optimum(of_states, 0.0)
    linear_error = _mean([_linear_error(*pair, axles, _OMEGA) for pair in split_of_states(states)])
    if of_state(states) > linear_error:
        states = 0.0
    if filtered is None and states > 0.0 and abs(force - states) < dt:
        states = force = 0.5 * (states + force)
    return Delays(round(states, 4), round(force, 4), round(of_inputs.force_filter, 4))


@dataclasses.dataclass(frozen=True)
class _Losses:
    """Losses of several delays on the same held-out errors, see `student_loss`."""

    values: list[float]
    errors: int
    """Number of the errors."""

    @staticmethod
    def of(
        splits: Sequence[Sequence[tuple[Dataset, Dataset]]], axles: Sequence[float], output: int
    ) -> _Losses | None:
        """Compare linear models on splits of the same transitions, if there are any."""
        if not splits:
            return None
        values = [_mean([_linear_error(*pair, axles, output) for pair in own]) for own in splits]
        return _Losses(values, _count(splits[0]))

    def tell(self, worse: int, better: int) -> bool:
        """Return whether one delay is better than another one by enough."""
        gain = max(_GAIN, _EVIDENCE / max(self.errors, 1))
        return self.values[worse] - self.values[better] >= gain


def _filtered(parts: Sequence[Dataset], axles: Sequence[float]) -> Delays | None:
    """Return filter and delay of the force, or None if no filter is identified."""
    dt = parts[0].provenance.dt
    steps = range(round(_EARLIEST_FORCE / _STEP), round(_LATEST / _STEP) + 1)
    grid = [Delays(0.0, 0.5 * k * dt, filter_) for k in _FILTER_DELAYS for filter_ in _FILTERS]
    # Only runs that have a window for each delay count. A filter's derivative takes half a period
    # more, and its delay is at most that of the grid.
    of_filter = 0.5 * _FILTER_DELAYS[-1] + 0.5
    lost = math.ceil(max(-steps[0] * _STEP / dt, of_filter)) + math.ceil(of_filter)
    runs = (_long_runs(part, lost + round(_WINDOW / dt)) for part in parts)
    parts = [part for part in runs if part is not None]
    if not parts:
        return None

    def losses(delays: Sequence[Delays]) -> _Losses | None:
        return _Losses.of(_splits(parts, delays, _over_windows), axles, _V_X)

    def of_time(log: float) -> float:
        found = losses([dataclasses.replace(best, force_filter=math.exp(log))])
        return math.inf if found is None else found.values[0]

    found = losses(grid)
    if found is None:
        return None
    best = grid[found.values.index(min(found.values))]
    if best.force_filter in (_FILTERS[0], _FILTERS[-1]):
        return None
    refined = minimize_scalar(
        of_time,
        bounds=math.log(best.force_filter) + 0.5 * math.log(2.0) * np.array([-1.0, 1.0]),
        method="bounded",
        options={"xatol": 1e-3},
    )
    best = dataclasses.replace(best, force_filter=math.exp(refined.x))
    pairs = (losses([Delays(force=k * _STEP), best]) for k in steps)
    return best if all(pair is not None and pair.tell(0, 1) for pair in pairs) else None


def _over_windows(part: Dataset) -> Dataset:
    """Return means of inputs and sums of changes over windows of `_WINDOW`, as transitions."""
    size = round(_WINDOW / part.provenance.dt)
    runs = [rows[: len(rows) // size * size].reshape(-1, size) for rows in consecutive(part)]
    rows = np.concatenate(runs)
    return dataclasses.replace(
        part.select(rows[:, 0]), z=part.z[rows].mean(axis=1), y=part.y[rows].sum(axis=1)
    )


def _long_runs(log: Dataset, least: float) -> Dataset | None:
    """Return the runs of at least `least` transitions, or None if there are too few of them."""
    kept = np.zeros(len(log), dtype=bool)
    for rows in consecutive(log):
        kept[rows] = len(rows) >= least
    return log.select(kept) if _enough(log, kept) else None


def _enough(part: Dataset, kept: NDArray[np.bool_]) -> bool:
    """Return whether some of the transitions are enough to hold a part of them out."""
    if len(np.unique(part.trajectory[kept])) < 2:  # noqa: PLR2004 - one is held out
        return False
    halves = hold_out(part.select(kept))
    return all(np.sum(half.counts) > _FEWEST for half in halves)


def _splits(
    parts: Sequence[Dataset],
    delays: Sequence[Delays],
    change: Callable[[Dataset], Dataset] = lambda moved: moved,
) -> list[list[tuple[Dataset, Dataset]]]:
    """Move the inputs of the parts by each of the delays, and hold some trajectories out.

    All delays have the same transitions, which are those that have inputs with all of them. Parts
    with too few of these are left out; without any other one there are no splits. `change` is made
    before trajectories are held out.
    """
    found = []
    for part in parts:
        kept = np.logical_and.reduce([available(part, own) for own in delays])
        if _enough(part, kept):
            found.append([hold_out(change(align(part, own, kept))) for own in delays])
    return [list(own) for own in zip(*found, strict=True)]


def _count(split: Sequence[tuple[Dataset, Dataset]]) -> int:
    return sum(int(np.sum(held.counts)) for _, held in split)


def _optimum(losses: Callable[[Sequence[float]], _Losses | None], low: float) -> float:
    """Return the delay of least loss; 0 if it is not better than none by enough.

    Each delay from 0 up to `_LATEST`, and down to `low`, is compared with the best one so far, in
    steps of `_STEP`; if `low` is 0, up to the first minimum. The result is refined to the minimum
    of the parabola through the losses at the best step and half a step to both sides of it, or to
    one of these ends if the minimum is not between them.
    """
    best, least, largest = 0, 0, 0
    for direction, end in ((1, _LATEST), (-1, -low)):
        for number in range(1, round(end / _STEP) + 1):
            pair = losses([best * _STEP, direction * number * _STEP])
            if pair is None:
                break
            least, largest = min(least, direction * number), max(largest, direction * number)
            if pair.values[1] < pair.values[0]:
                best = direction * number
            elif low == 0.0:
                break
    if best in (0, least, largest):
        return 0.0
    centre = best * _STEP
    about = losses([0.0, centre - 0.5 * _STEP, centre, centre + 0.5 * _STEP])
    if about is None or not about.tell(0, 2):
        return 0.0
    _, before, here, after = about.values
    curvature = before - 2.0 * here + after
    if curvature <= 0.0:  # the least loss is at one of the ends
        return centre + math.copysign(0.5 * _STEP, before - after)
    found = 0.25 * _STEP * (before - after) / curvature
    return centre + float(np.clip(found, -0.5 * _STEP, 0.5 * _STEP))


def _linear_error(train: Dataset, held: Dataset, axles: Sequence[float], output: int) -> float:
    """Loss of a linear model's held-out errors, see `student_loss`."""
    moving = held.counts
    errors = held.y[moving] - linear(train, axles)(held.z[moving])
    return float(student_loss(errors)[output])


def _vehicle_errors(
    split: Sequence[tuple[Dataset, Dataset]], vehicle: VehicleParameters | None
) -> list[float]:
    """Losses of the fitted vehicle's held-out errors of `omega`, see `student_loss`."""
    rngs = [np.random.default_rng(number) for number in range(len(split))]
    training = [
        train.select(rng.permutation(len(train))[:_ROWS])
        for (train, _), rng in zip(split, rngs, strict=True)
    ]
    vehicles = fit_vehicle(training, vehicle, rngs)
    found = []
    for (_, held), fitted in zip(split, vehicles, strict=True):
        moving = held.counts
        mean = PriorMean(fitted.values, fitted.steps)
        errors = held.y[moving] - mean.predict(held.z[moving], held.provenance.dt)
        found.append(float(student_loss(errors)[_OMEGA]))
    return found


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
