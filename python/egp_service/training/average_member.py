"""A member for noisy data: a given prior mean, with or without sparse processes on top of it.

The processes are fitted to all transitions (`sparse`). Outliers have a bounded influence: errors of
the fit beyond four robust standard deviations are moved there, and the fit is repeated
(winsorised residuals, Huber, *Robust Statistics*, section 7.8). The noise is such
that 95 % of the training errors are inside the 95 % interval, whatever their distribution.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Final

import numpy as np
import torch

from egp_service._core import EgpError
from egp_service.data.channels import MAD
from egp_service.quantities import GP_OUTPUT, NORMAL_95, NY, NZ
from egp_service.training.exact_member import START
from egp_service.training.gaussian_process import Bounds, Hyperparameters, OutputProcess
from egp_service.training.sparse import FITTED, PosteriorMean, average_targets, fit_sparse
from egp_service.training.subset import select
from egp_service.training.trained import Scaling, TrainedMember

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.training.kernel import KernelName
    from egp_service.training.prior_mean import PriorMean
    from egp_service.training.train import TrainingSettings

SMOOTH: Final = Bounds(noise=1e-3, lengthscale=0.5, outputscale=math.inf)
"""Bounds of the hyperparameters. Shorter lengthscales follow errors that are alike in neighbouring
periods. With 2 instead of 0.5 the error of v_x after 1 s on a log of an oval was 0.95 m/s instead
of 0.74 m/s."""
_MEASURED: Final = dataclasses.replace(SMOOTH, noise=1e-6)
"""Bounds of the final process, to which the noise of its errors is assigned. Nothing is fitted with
them, so that the noise may be smaller than in a fit."""
ITERATIONS: Final = 25
"""Iterations of the fit of each output's process."""
MOST_POINTS: Final = 150
"""Largest number of inducing points; smooth functions under noise need few."""
_OUTLIER: Final = 4.0  # robust standard deviations
_ROUNDS: Final = 4
_ALONE: Final = Hyperparameters((1.0,) * NZ, outputscale=1e-9, noise=1.0, constant=0.0)
"""A process that adds nothing to its mean."""


def average_member(
    part: tuple[Dataset, Dataset],
    mean: PriorMean,
    settings: TrainingSettings,
    rng: np.random.Generator,
    report: Callable[[str, float, int], None] | None,
    *,
    widening: NDArray[np.float64] | None = None,
) -> TrainedMember:
    """Train a member on training data, with the held-out ones in `part`.

    Without `report` it gets no processes. Otherwise `report` gets the stage, the loss and the
    number of iterations so far, of `ITERATIONS` for each output. The noise's standard deviations
    are multiplied by `widening` (3,), which `widening_on` computes from a member of other blocks.

    Raises:
        EgpError: if a fit fails.

    """
    data, validation = part
    rest = data.y - mean.predict(data.z, data.provenance.dt)
    moving = np.flatnonzero(data.counts)
    if len(moving) == 0:
        moving = np.arange(len(data))
    target_std = rest[moving].std(axis=0)
    for name, std in zip(GP_OUTPUT, target_std, strict=True):
        if not std > 0.0:
            raise EgpError(f"surface {data.provenance.surface}: {name} is predicted without error")
    target_mean = rest[moving].mean(axis=0) if mean.constant else np.zeros(NY)
    scaling = Scaling.of(data.z, target_mean, target_std)
    z, y = scaling.inputs(data.z), scaling.targets(rest)
    widen = np.ones(NY) if widening is None else widening
    chosen, values = moving[:1], [_ALONE] * NY
    if report is not None:
        rows = rng.permutation(moving)[:FITTED]
        kept = _without_outliers(z, y, moving)
        chosen, values = _fit((z, kept), rows, settings, rng, report)
    final = [
        _final((z, y[:, j]), chosen, values[j], settings.kernel, moving=moving, widen=widen[j])
        for j in range(NY)
    ]
    targets = torch.stack([targets for _, targets in final], dim=1).numpy()
    return TrainedMember(
        dataset=data,
        validation=validation,
        inputs=data.z[chosen],
        targets=mean.predict(data.z[chosen], data.provenance.dt)
        + target_mean
        + targets * target_std,
        scaling=scaling,
        processes=tuple(process for process, _ in final),
        mean=mean,
        vehicle=None,
    )


def widening_on(member: TrainedMember) -> NDArray[np.float64]:
    """Return factors (3,) on the noise so that 95 % of the held-out changes are in the intervals.

    The factors on standard deviations are at least 1 and at most 2. Without held-out changes
    that count they are 1.
    """
    held = member.validation
    moving = held.counts
    if not moving.any():
        return np.ones(NY)
    mean, _, variance = member.predict(held.z[moving])
    scaled = np.abs(held.y[moving] - mean) / np.sqrt(variance + member.noise_variance)
    return np.clip(np.quantile(scaled, 0.95, axis=0) / NORMAL_95, 1.0, 2.0)


def _without_outliers(z: torch.Tensor, y: torch.Tensor, moving: NDArray[np.int64]) -> torch.Tensor:
    """Return targets (n, 3) whose distances from a robust linear model in z are limited.

    The likelihood that the hyperparameters maximise is Gaussian. With the jumps of a sensor among
    its few thousand transitions it depends on how many of them are jumps.
    """
    features = torch.cat([z, torch.ones_like(z[:, :1])], dim=1)
    kept = y
    for _ in range(_ROUNDS):
        weights = torch.linalg.lstsq(features[moving], kept[moving]).solution
        predicted = features @ weights
        errors = y - predicted
        limit = _OUTLIER * MAD * errors[moving].abs().median(dim=0).values
        kept = predicted + torch.minimum(torch.maximum(errors, -limit), limit)
    return kept


def _fit(
    data: tuple[torch.Tensor, torch.Tensor],
    rows: NDArray[np.int64],
    settings: TrainingSettings,
    rng: np.random.Generator,
    report: Callable[[str, float, int], None],
) -> tuple[NDArray[np.int64], list[Hyperparameters]]:
    """Return the rows of the inducing points and the hyperparameters of each output."""
    z, y = data
    count = min(MOST_POINTS, settings.max_points, len(rows))
    processes = []
    for j, name in enumerate(GP_OUTPUT):
        process = OutputProcess(
            z[rows[:count]], y[rows[:count], j].contiguous(), settings.kernel, SMOOTH
        )
        process.assign(START)

        def on_step(iteration: int, loss: float, j: int = j, name: str = name) -> None:
            report(f"sparse fit of {name}", loss, j * ITERATIONS + iteration + 1)

        fit_sparse([process], z[rows], [y[rows, j]], ITERATIONS, on_step)
        processes.append(process)
    chosen = rows[select(z[rows], processes, count, rng)]
    return chosen, [process.hyperparameters for process in processes]


def _final(
    data: tuple[torch.Tensor, torch.Tensor],
    chosen: NDArray[np.int64],
    values: Hyperparameters,
    kernel: KernelName,
    *,
    moving: NDArray[np.int64],
    widen: float,
) -> tuple[OutputProcess, torch.Tensor]:
    """Return the exact process of one output at the chosen rows, and its targets (M,)."""
    z, y = data
    inducing = z[chosen]

    def process_of(targets: torch.Tensor) -> OutputProcess:
        process = OutputProcess(inducing, targets, kernel, _MEASURED)
        process.assign(values)
        process.eval()
        return process

    process = process_of(y.new_zeros(len(inducing)))
    mean, kept = PosteriorMean(process, z), y
    for _ in range(_ROUNDS):
        predicted = mean.given(kept)
        errors = y - predicted
        limit = _OUTLIER * MAD * errors[moving].abs().median()
        kept = predicted + errors.clamp(-limit, limit)
    errors = (y - mean.given(kept))[moving].abs()
    spread = torch.quantile(errors, 0.95) / NORMAL_95
    values = dataclasses.replace(values, noise=float(widen * spread) ** 2)
    process = process_of(y.new_zeros(len(inducing)))
    (targets,) = average_targets([process], z, [kept])
    return process_of(targets), targets
