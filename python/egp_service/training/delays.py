"""The delays of a log's columns, by what a vehicle with moved inputs predicts of held-out blocks.

The force's delay is that with which a linear model predicts the changes of `v_x` best; the delay of
the measured states is that with which a fitted single-track vehicle predicts the changes of `omega`
best. Inputs are moved and changes are not, so that the errors of all delays have the same noise.

A force that was made from a filtered acceleration is not only late: it is too small where it
changes. The filter's time constant is that with which a linear model predicts the changes of `v_x`
over 1 s best.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import minimize_scalar

from egp_service.data.alignment import Delays, align, consecutive
from egp_service.data.channels import MOVING
from egp_service.training.choice import hold_out
from egp_service.training.open_loop import linear, student_loss
from egp_service.training.prior_mean import predict
from egp_service.training.vehicle_fit import fit_vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters
    from egp_service.data.dataset import Dataset

_EARLIEST_FORCE: Final = -1.5  # s; a filtered acceleration is late by its filter
_LATEST: Final = 0.32  # s
_STEP: Final = 0.04  # s
# Nats by which a delay must predict better than none: per error, and altogether, because the best
# of many delays is better than none by chance.
_GAIN: Final = 0.02
_EVIDENCE: Final = 20.0
_SHORTEST: Final = 2.0  # s of consecutive transitions; less is lost to the shift
_ROWS: Final = 1000  # transitions of a surface that a vehicle is fitted to
_FEWEST: Final = 200  # transitions above 5 m/s, each for the fit and for the comparison
_FILTERS: Final = tuple(0.1 * 2.0 ** (0.5 * k) for k in range(13))  # s; up to 6.4 s
# Delays of a filtered force in half periods: a difference of states belongs to the middle of two.
_FILTER_DELAYS: Final = range(-4, 5)
_WINDOW: Final = 1.0  # s, over which changes of v_x identify the filter
_V_X, _OMEGA = 0, 2


def find_delays(logs: Sequence[Dataset], vehicle: VehicleParameters | None) -> Delays:
    """Return the delays that all logs of one car have in common; zero if not identified.

    A delay is identified if its optimum lies inside the range that is searched (states 0 to 0.32 s,
    force -1.5 to 0.32 s), and predicts better than no delay by 0.02 nats per error and 20 nats
    altogether. For the delay of the states the vehicle must also predict the yaw rate better than
    the linear model. If both delays agree within a period, both are their mean, since one sensor
    measures all states. Only runs of at least 2 s count. `vehicle` is what is known about the car.

    A first-order filter of the force (0.1 to 6.4 s, with a delay of at most two periods) is
    identified if it predicts the changes of `v_x` over 1 s better than any delay without a filter,
    by the same differences. For this only runs count that are 1 s longer than the largest delay.

    Raises:
        EgpError: if a fit fails.

    """
    runs = (_long_runs(log, _SHORTEST / log.provenance.dt) for log in logs)
    parts = [part for part in runs if part is not None]
    if not parts:
        return Delays()
    dt = parts[0].provenance.dt
    axles = (1.0, 1.0) if vehicle is None else (vehicle.l_f, vehicle.l_r)

    def of_force(delay: float) -> float:
        return _mean([_linear_error(*_split(p, Delays(force=delay)), axles, _V_X) for p in parts])

    errors = sum(int(np.sum(hold_out(part)[1].z[:, 0] > MOVING)) for part in parts)
    gain = max(_GAIN, _EVIDENCE / errors)
    filtered = _filtered(parts, axles)
    of_inputs = filtered or Delays(force=_optimum(of_force, _EARLIEST_FORCE, gain)[0])
    force = of_inputs.force

    def of_states(delay: float) -> float:
        split = [_split(part, dataclasses.replace(of_inputs, measurement=delay)) for part in parts]
        return _mean(_vehicle_errors(split, vehicle))

    states, error = _optimum(of_states, 0.0, gain)
    split = [_split(part, dataclasses.replace(of_inputs, measurement=states)) for part in parts]
    if error > _mean([_linear_error(*s, axles, _OMEGA) for s in split]):
        states = 0.0
    if filtered is None and states > 0.0 and abs(force - states) < dt:
        states = force = 0.5 * (states + force)
    return Delays(round(states, 4), round(force, 4), round(of_inputs.force_filter, 4))


def _filtered(parts: Sequence[Dataset], axles: Sequence[float]) -> Delays | None:
    """Return filter and delay of the force, or None if no filter is identified."""
    dt = parts[0].provenance.dt
    steps = range(round(_EARLIEST_FORCE / _STEP), round(_LATEST / _STEP) + 1)
    grid = [Delays(0.0, 0.5 * k * dt, filter_) for k in _FILTER_DELAYS for filter_ in _FILTERS]
    # Only runs that have a window for each delay count, so that all losses are those of the same
    # runs. A filter's derivative takes half a period more.
    lost = max(-steps[0] * _STEP / dt, 0.5 * _FILTER_DELAYS[-1] + 0.5)
    least = math.ceil(lost) + round(_WINDOW / dt)
    parts = [found for part in parts if (found := _long_runs(part, least)) is not None]
    if not parts:
        return None

    def loss(delays: Delays) -> float:
        split = [hold_out(_over_windows(align(part, delays))) for part in parts]
        return _mean([_linear_error(*pair, axles, _V_X) for pair in split])

    none = min(loss(Delays(force=k * _STEP)) for k in steps)
    best = min(grid, key=loss)
    if best.force_filter in (_FILTERS[0], _FILTERS[-1]):
        return None
    refined = minimize_scalar(
        lambda log: loss(dataclasses.replace(best, force_filter=float(np.exp(log)))),
        bounds=np.log(best.force_filter) + 0.5 * np.log(2.0) * np.array([-1.0, 1.0]),
        method="bounded",
        options={"xatol": 1e-3},
    )
    windows = sum(int(np.sum(hold_out(_over_windows(p))[1].z[:, 0] > MOVING)) for p in parts)
    if none - refined.fun < max(_GAIN, _EVIDENCE / max(windows, 1)):
        return None
    return dataclasses.replace(best, force_filter=float(np.exp(refined.x)))


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
    runs = [rows for rows in consecutive(log) if len(rows) >= least]
    if len({log.trajectory[rows[0]] for rows in runs}) < 2:  # noqa: PLR2004 - one is held out
        return None
    kept = log.select(np.concatenate(runs))
    train, held = hold_out(kept)
    enough = all(np.sum(part.z[:, 0] > MOVING) > _FEWEST for part in (train, held))
    return kept if enough else None


def _split(part: Dataset, delays: Delays) -> tuple[Dataset, Dataset]:
    return hold_out(align(part, delays))


def _optimum(loss: Callable[[float], float], low: float, gain: float) -> tuple[float, float]:
    """Return the delay of least loss and the loss near it; 0 if the loss is less by under `gain`.

    Delays are searched between `low` and `_LATEST` in steps of `_STEP`, upwards from 0 to the first
    minimum if `low` is 0. Half a step about the best one a parabola through three points follows.
    """
    losses: dict[int, float] = {}
    for number in range(round(low / _STEP), round(_LATEST / _STEP) + 1):
        losses[number] = loss(number * _STEP)
        if low == 0.0 and number > 0 and losses[number] > losses[number - 1]:
            break
    best = min(losses, key=lambda number: losses[number])
    if best in (0, min(losses), max(losses)):
        return 0.0, losses[0]
    centre = best * _STEP
    before, here, after = loss(centre - 0.5 * _STEP), losses[best], loss(centre + 0.5 * _STEP)
    curvature = before - 2.0 * here + after
    if curvature <= 0.0 or losses[0] - here < gain:
        return 0.0, losses[0]
    found = 0.25 * _STEP * (before - after) / curvature
    return centre + float(np.clip(found, -0.5 * _STEP, 0.5 * _STEP)), min(before, here, after)


def _linear_error(train: Dataset, held: Dataset, axles: Sequence[float], output: int) -> float:
    """Loss of a linear model's held-out errors, see `student_loss`."""
    moving = held.z[:, 0] > MOVING
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
        moving = held.z[:, 0] > MOVING
        errors: NDArray[np.float64] = held.y[moving] - predict(
            held.z[moving], fitted.values, held.provenance.dt, fitted.steps
        )
        found.append(float(student_loss(errors)[_OMEGA]))
    return found


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
