"""Open-loop errors: predictions of held-out transitions over one period and in rollouts.

A rollout starts at a measured state and repeats the prediction with the measured steering angles
and inputs, and with gravity where the tilt of the road was measured. Its error is the distance of
`[v_x, v_y, omega]` from the measured ones at its end.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.quantities import NY

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset

    # Changes (n, 3) over one period at inputs (n, 6).
    Predictor = Callable[[NDArray[np.float64]], NDArray[np.float64]]

HORIZONS: Final = (0.2, 0.5, 1.0, 2.0)
"""Durations of rollouts in s."""
NO_CHANGE: Final = "no change"
LINEAR: Final = "linear"
MAX_STARTS: Final = 5000
# Rows from the start of a rollout to that of the next one. Errors of satellite receivers repeat
# each second, which is a multiple of most numbers of periods, but not of 7.
_ROLLOUT_STRIDE: Final = 7
_FREEDOM: Final = 4.0  # degrees of freedom of Student's t distribution: heavy tails
_ITERATIONS: Final = 50


@dataclasses.dataclass(frozen=True, eq=False)
class Skill:
    """Errors of several predictors on the same data."""

    durations: tuple[float, ...]
    """Durations of the predictions in s: one period, then those of `HORIZONS` in the data."""
    rms: Mapping[str, NDArray[np.float64]]
    """By predictor: RMS errors of `[v_x, v_y, omega]` (durations, 3)."""
    likelihood: Mapping[str, float]
    """By predictor: mean log likelihood of an error, relative to that of no change, in nats."""
    least_speed: float
    """Speed in m/s above which predictions begin."""


def skill(predictors: Mapping[str, Predictor], dataset: Dataset) -> Skill:
    """Compare predictors with no change, which is added, on held-out data.

    The likelihood is that of Student's t distribution with four degrees of freedom, in which
    outliers count little, at the scale of largest likelihood. It is averaged over durations and
    outputs.
    """
    everyone: dict[str, Predictor] = {NO_CHANGE: lambda z: np.zeros((len(z), NY)), **predictors}
    durations: list[float] = []
    found: dict[str, list[NDArray[np.float64]]] = {name: [] for name in everyone}
    dt = dataset.provenance.dt
    for duration in (dt, *(h for h in HORIZONS if h > 1.5 * dt)):
        periods = round(duration / dt)
        start = starts(dataset, periods, 1 if periods == 1 else _ROLLOUT_STRIDE)
        start = start[dataset.counts[start]]
        if len(start) == 0:
            continue
        durations.append(duration)
        for name, predict in everyone.items():
            found[name].append(rollout(predict, dataset, start, periods))
    loss = {
        name: np.array([student_loss(errors).mean() for errors in own])
        for name, own in found.items()
    }
    return Skill(
        durations=tuple(durations),
        least_speed=dataset.least_speed,
        rms={
            name: np.array([np.sqrt(np.mean(e**2, axis=0)) for e in own]).reshape(-1, NY)
            for name, own in found.items()
        },
        likelihood={
            name: float(np.mean(loss[NO_CHANGE] - own)) if len(own) else 0.0
            for name, own in loss.items()
        },
    )


def starts(dataset: Dataset, periods: int, every: int) -> NDArray[np.int64]:
    """Return at most `MAX_STARTS` rows at which rollouts of `periods` periods start.

    These are every `every`-th of the rows with enough rows of their trajectory behind them.
    """
    found = np.flatnonzero(dataset.unbroken(periods - 1))[::every]
    if len(found) <= MAX_STARTS:
        return found
    spread: NDArray[np.int64] = found[np.linspace(0, len(found) - 1, MAX_STARTS).astype(int)]
    return spread


def rollout(
    predict: Predictor, dataset: Dataset, start: NDArray[np.int64], periods: int
) -> NDArray[np.float64]:
    """Return the errors (n, 3) after rollouts of `periods` periods from the rows `start`."""
    by_gravity = dataset.by_gravity
    state = dataset.z[start, :NY]
    for k in range(periods):
        predicted = predict(np.hstack([state, dataset.z[start + k, NY:]]))
        state = state + predicted + by_gravity[start + k]
    end = start + periods - 1
    return np.asarray(state - (dataset.z[end, :NY] + dataset.y[end] + by_gravity[end]))


def linear(dataset: Dataset, axles: Sequence[float]) -> Predictor:
    """Least squares of the changes on z, slip angles and a constant.

    `axles` are the distances in m from the centre of mass to the front and the rear axle. Only
    transitions above `least_speed` count.
    """
    moving, least = dataset.counts, dataset.least_speed
    rows = moving if moving.any() else np.ones(len(dataset), dtype=bool)
    features = _features(dataset.z[rows], axles, least)
    weights = np.linalg.lstsq(features, dataset.y[rows], rcond=None)[0]
    return lambda z: np.asarray(_features(z, axles, least) @ weights)


def _features(
    z: NDArray[np.float64], axles: Sequence[float], least_speed: float
) -> NDArray[np.float64]:
    v_x, v_y, omega, delta = z[:, :4].T
    v = np.maximum(v_x, least_speed)
    front = delta - np.arctan((v_y + axles[0] * omega) / v)
    rear = -np.arctan((v_y - axles[1] * omega) / v)
    return np.column_stack([z, front, rear, np.ones(len(z))])


def student_loss(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean negative log likelihood (3,) of errors (n, 3) in nats, up to a constant.

    The errors have Student's t distribution with `nu` = 4 degrees of freedom at its scale `s` of
    largest likelihood: `ln s + (nu + 1) / 2 mean ln(1 + e² / (nu s²))`.
    """
    scale = student_scale(errors)
    tails = np.log1p(errors**2 / (_FREEDOM * scale**2)).mean(axis=0)
    return np.asarray(np.log(scale) + 0.5 * (_FREEDOM + 1.0) * tails)


def student_scale(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale (3,) of largest likelihood, by expectation maximisation (Lange et al. 1989)."""
    tiny = np.finfo(float).tiny
    square = np.maximum(np.mean(errors**2, axis=0), tiny)
    for _ in range(_ITERATIONS):
        weight = (_FREEDOM + 1.0) / (_FREEDOM + errors**2 / square)
        square = np.maximum(np.mean(weight * errors**2, axis=0), tiny)
    return np.asarray(np.sqrt(square))
