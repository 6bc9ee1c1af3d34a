"""Open-loop evaluation on logs: what models that are trained on part of a log predict of the rest.

Blocks of a log are its trajectories; every fifth is held out. Members of one log also predict the
held-out blocks of the others.
"""

from __future__ import annotations

import contextlib
import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError, solve_weights
from egp_service.data.alignment import Delays, align
from egp_service.data.channels import Channels, channels
from egp_service.data.dataset import check_one_car
from egp_service.evaluation.residual import Residual, fit_residual, moving_runs
from egp_service.quantities import NORMAL_95, NY
from egp_service.training.average_member import average_member
from egp_service.training.choice import hold_out
from egp_service.training.delays import find_delays
from egp_service.training.open_loop import LINEAR, Skill, linear, skill
from egp_service.training.prior_mean import PriorMean
from egp_service.training.recipe import Displays
from egp_service.training.threads import one_thread
from egp_service.training.train import TrainingSettings, check_data, train_parts

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters
    from egp_service.data.dataset import Dataset
    from egp_service.training.open_loop import Predictor
    from egp_service.training.train import FitProgress
    from egp_service.training.trained import TrainedMember

OURS: Final = "member"
PAPER: Final = "paper's GPs"
VEHICLE: Final = "single-track alone"
OTHER: Final = "member of {}"
"""Name of the predictor that is trained on another log."""
LAST_CHANGE: Final = "linear and last change"
_WINDOW: Final = 0.5  # s, from which weights are estimated
_STRENGTH: Final = 1e-3  # of the quadratic prior on the weights


@dataclasses.dataclass(frozen=True, eq=False)
class LogOutcome:
    """What was found on one log."""

    name: str
    channels: Channels
    delays: Delays
    """Delays by which the log's inputs were moved before training and prediction."""
    member: TrainedMember
    """The member that is trained on the log, whose validation data are the held-out blocks."""
    skill: Skill
    """Skill of all predictors on the held-out blocks."""
    last_change: NDArray[np.float64]
    """RMS errors (3,) over one period of the linear model that also gets the last change."""
    residual: Residual
    """The residual that is fitted to the member's errors on its training data."""
    with_residual: NDArray[np.float64]
    """RMS errors (3,) over one period of the member with the residual."""
    residual_coverage: NDArray[np.float64]
    """Like `coverage`, with the residual and its variance."""
    coverage: NDArray[np.float64]
    """Share (3,) of the held-out changes that count inside the member's 95 % intervals."""
    predicted: NDArray[np.float64]
    """The member's predictions of the held-out changes (n, 3)."""
    deviation: NDArray[np.float64]
    """Standard deviations (n, 3) of the same, with noise."""
    others: tuple[str, ...]
    """Names of the other logs, whose members predict this one, too."""
    weights: NDArray[np.float64] | None
    """Weights (n, N) of the other logs' members at the held-out transitions, in the order of
    `others`, NaN where the window is not full; None with fewer than two other logs."""


def evaluate_logs(
    logs: Sequence[Dataset],
    vehicle: VehicleParameters | None,
    settings: TrainingSettings,
    displays: Displays | None = None,
    comparing: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext,
) -> list[LogOutcome]:
    """Train on four of five blocks of each log and predict the fifth.

    All predictors get the log with its inputs moved by the delays found in the four blocks.
    `displays` show the two trainings, and the context of `comparing` is around the rest.

    Raises:
        EgpError: if two logs have the same name of a surface, or differ in car or period, as
            `check_data`, if the held-out blocks have no transition with moved inputs, or if
            training fails.

    """
    names = [log.provenance.surface for log in logs]
    if len(set(names)) < len(names):
        raise EgpError("two logs have the same surface: import each with its own --surface")
    check_one_car([log.provenance for log in logs], "comparison")
    for log in logs:
        check_data(log, vehicle)
    logs = [log.of_vehicle(vehicle) for log in logs]
    split = [hold_out(log) for log in logs]
    with one_thread(settings.max_points):
        delays = [find_delays([rest], vehicle) for rest, _ in split]
    parts = [
        (align(rest, own), align(held, own))
        for (rest, held), own in zip(split, delays, strict=True)
    ]
    fitting = (displays or Displays()).fitting
    with fitting() as report:
        members = _train(parts, settings, vehicle, report)
    with fitting() as report:
        paper = _train(parts, dataclasses.replace(settings, mean="constant"), vehicle, report)
    with comparing():
        return [
            _outcome(number, (logs[number], delays[number]), members, paper[number], settings)
            for number in range(len(logs))
        ]


def _train(
    parts: Sequence[tuple[Dataset, Dataset]],
    settings: TrainingSettings,
    vehicle: VehicleParameters | None,
    report: Callable[[FitProgress], None],
) -> list[TrainedMember]:
    rngs = [np.random.default_rng([settings.seed, number]) for number in range(len(parts))]
    return train_parts(parts, settings, report, vehicle=vehicle, rngs=rngs)


def _outcome(
    number: int,
    source: tuple[Dataset, Delays],
    members: Sequence[TrainedMember],
    paper: TrainedMember,
    settings: TrainingSettings,
) -> LogOutcome:
    log, delays = source
    member, others = members[number], [m for i, m in enumerate(members) if i != number]
    held = member.validation
    predictors: dict[str, Predictor] = {OURS: member.predict_mean, PAPER: paper.predict_mean}
    axles = (1.0, 1.0)
    if member.vehicle is not None:
        body, steps = member.vehicle.values, member.vehicle.steps
        axles = (float(body[1]), float(body[2]))
        part = (member.dataset, held)
        rng = np.random.default_rng(settings.seed)
        alone = average_member(part, PriorMean(single_track=body, steps=steps), settings, rng, None)
        predictors[VEHICLE] = alone.predict_mean
    predictors[LINEAR] = linear(member.dataset, axles)
    predictors |= {OTHER.format(m.dataset.provenance.surface): m.predict_mean for m in others}
    predicted, _, variance = member.predict(held.z)
    deviation = np.sqrt(variance + member.noise_variance)
    residual = fit_residual(member.predict_mean, member.dataset)
    with_residual, residual_coverage = _with_residual(member, residual)
    moving = held.counts
    inside = np.abs(held.y - predicted) < NORMAL_95 * deviation
    return LogOutcome(
        name=log.provenance.surface,
        channels=channels(log),
        delays=delays,
        member=member,
        skill=skill(predictors, held),
        last_change=_last_change(member.dataset, held, axles),
        residual=residual,
        with_residual=with_residual,
        residual_coverage=residual_coverage,
        coverage=inside[moving].mean(axis=0) if moving.any() else np.full(NY, np.nan),
        predicted=predicted,
        deviation=deviation,
        others=tuple(m.dataset.provenance.surface for m in others),
        weights=_weights(held, others) if len(others) > 1 else None,
    )


def _last_change(
    training: Dataset, held: Dataset, axles: tuple[float, float]
) -> NDArray[np.float64]:
    """RMS errors (3,) of a linear model of the linear model's error by the last change.

    They are NaN if no two consecutive held-out transitions count.
    """
    first = linear(training, axles)
    known, rest = _consecutive(training, first)
    weights = np.linalg.lstsq(known, rest, rcond=None)[0]
    known, rest = _consecutive(held, first)
    if len(rest) == 0:
        return np.full(NY, np.nan)
    return np.asarray(np.sqrt(np.mean((rest - known @ weights) ** 2, axis=0)))


def _with_residual(
    member: TrainedMember, residual: Residual
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """RMS errors (3,) with the residual on the held-out blocks, and shares (3,) in its intervals.

    The first transition of each run has no errors before it and is left out.
    """
    held, runs = moving_runs(member.validation)
    mean, _, variance = member.predict(held.z)
    rest = held.y - mean
    left, deviations = [], []
    for rows in runs:
        found, of_residual = residual.predict(rest[rows], held.provenance.dt)
        left.append((rest[rows] - found)[1:])
        total = variance[rows] + member.noise_variance + of_residual
        deviations.append(np.sqrt(total)[1:])
    if not left:
        return np.full(NY, np.nan), np.full(NY, np.nan)
    errors = np.concatenate(left)
    inside = np.abs(errors) < NORMAL_95 * np.concatenate(deviations)
    return np.sqrt(np.mean(errors**2, axis=0)), inside.mean(axis=0)


def _consecutive(
    data: Dataset, first: Predictor
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Last changes, z and a constant (n, 10), and errors of `first` (n, 3), that count."""
    rows = np.flatnonzero(data.follows & data.counts[1:]) + 1
    inputs = np.column_stack([data.y[rows - 1], data.z[rows], np.ones(len(rows))])
    return inputs, data.y[rows] - first(data.z[rows])


def _weights(held: Dataset, members: Sequence[TrainedMember]) -> NDArray[np.float64]:
    """Weights (n, N) of the members from the window before each held-out transition."""
    window = max(1, round(_WINDOW / held.provenance.dt))
    predictions = np.stack([member.predict_mean(held.z) for member in members], axis=1)
    noise = np.mean([member.noise_variance for member in members], axis=0)
    found = np.full((len(held), len(members)), np.nan)
    uniform = np.full(len(members), 1.0 / len(members))
    last = uniform
    unbroken = held.unbroken(window)
    for row in range(window, len(held)):
        before = slice(row - window, row)
        if not unbroken[row - window]:
            last = uniform
            continue
        last = solve_weights(
            predictions[before], held.y[before], np.sqrt(noise), last, "quadratic", _STRENGTH
        )
        found[row] = last
    return found
