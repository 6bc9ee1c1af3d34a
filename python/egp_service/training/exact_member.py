"""A member whose exact processes are fitted to some of the transitions.

The processes correct a vehicle, or predict the whole change as in the paper. Corrections are small
beside the noise that a single transition has from states that are not measured, such as roll and
the speed of the wheels. Once the hyperparameters are fitted, their targets are therefore replaced
by averages over all transitions (`sparse`). On held-out data of the demo's recipe the RMS error of
the change of v_y fell from 0.35 to 0.27 m/s² on friction 0.5, and from 0.35 to 0.32 m/s² on 1.1. In
steady bends on 0.5, at 20 to 80 % of the grip, this change was predicted too far inwards by 0.08 to
0.12 m/s² in the mean, and is by at most 0.03 m/s² now.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
import torch

from egp_service._core import EgpError
from egp_service.quantities import GP_OUTPUT, NY, NZ
from egp_service.training.gaussian_process import (
    CORRECTIONS,
    WHOLE_CHANGES,
    Hyperparameters,
    OutputProcess,
    fit,
    share_kernel,
)
from egp_service.training.prior_mean import PriorMean
from egp_service.training.sparse import average_targets
from egp_service.training.subset import select, spikes
from egp_service.training.trained import Scaling, TrainedMember

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.training.train import TrainingSettings
    from egp_service.training.vehicle_fit import FittedVehicle


def exact_member(
    part: tuple[Dataset, Dataset],
    fitted: FittedVehicle | None,
    settings: TrainingSettings,
    rng: np.random.Generator,
    report: Callable[[str, float, int], None],
) -> TrainedMember:
    """Train a member on training data, with the held-out ones in `part`.

    The prior mean is the fitted vehicle, or constants without one. `report` gets the stage, the
    loss and the number of iterations so far.

    Raises:
        EgpError: if a fit fails.

    """
    data, validation = part
    label = data.provenance.surface
    mean, rest, bounds = PriorMean(), data.y, WHOLE_CHANGES
    if fitted is not None:
        mean = PriorMean(single_track=fitted.values, steps=fitted.steps)
        rest = data.y - mean.predict(data.z, data.provenance.dt)
        bounds = CORRECTIONS
    scaling = Scaling.of(data.z, rest.mean(axis=0), spread(rest, GP_OUTPUT, label))
    z, y = scaling.inputs(data.z), scaling.targets(rest)

    def fit_all(
        rows: NDArray[np.int64], starts: list[list[Hyperparameters]], done: int, stage: str
    ) -> list[OutputProcess]:
        processes = [
            OutputProcess(z[rows], y[rows, j].contiguous(), settings.kernel, bounds)
            for j in range(NY)
        ]
        together = [range(NY)] if fitted is not None else [range(j, j + 1) for j in range(NY)]
        for number, outputs in enumerate(together):
            group = [processes[j] for j in outputs]
            share_kernel(group)
            before = number * len(starts) * settings.max_iterations
            names = ", ".join(list(GP_OUTPUT)[j] for j in outputs)

            def on_step(
                start: int, iteration: int, loss: float, before: int = before, names: str = names
            ) -> None:
                at = before + start * settings.max_iterations + iteration
                at = done + math.ceil(at / len(together))
                report(f"{label}: {stage} fit of {names}", loss, at)

            own = [[start[j] for j in outputs] for start in starts]
            fit(group, own, settings.max_iterations, on_step)
        return processes

    first_rows = np.sort(rng.permutation(len(data))[: settings.first_points])
    first = fit_all(first_rows, [[START] * NY], 0, "first")
    rows = select(z, first, settings.max_points, rng, spikes(data))
    starts = [
        [process.hyperparameters for process in first],
        *([_random_start(rng) for _ in range(NY)] for _ in range(settings.restarts)),
    ]
    processes = fit_all(rows, starts, settings.max_iterations, "final")
    targets = data.y[rows]
    if fitted is not None:
        known = targets - rest[rows] + scaling.target_mean
        targets = known + scaling.target_std * _averaged(processes, z, y)
    return TrainedMember(
        dataset=data,
        validation=validation,
        inputs=data.z[rows],
        targets=targets,
        scaling=scaling,
        processes=tuple(processes),
        mean=mean,
        vehicle=fitted,
    )


def _averaged(
    processes: list[OutputProcess], z: torch.Tensor, y: torch.Tensor
) -> NDArray[np.float64]:
    """Give the processes averages over all transitions z (n, 6), y (n, 3) as targets.

    Returns these, (M, 3); all are z-scored.
    """
    columns = average_targets(processes, z, [y[:, j].contiguous() for j in range(NY)])
    for process, targets in zip(processes, columns, strict=True):
        process.replace_targets(targets)
    return torch.stack(columns, dim=1).numpy()


# The residual of one period is almost linear in z, hence the long lengthscales and little noise.
# Values of this start and of the random ones are moved inside the bounds.
START: Final = Hyperparameters(lengthscales=(3.0,) * NZ, outputscale=3.0, noise=1e-2, constant=0.0)


def _random_start(rng: np.random.Generator) -> Hyperparameters:
    return Hyperparameters(
        lengthscales=tuple(np.exp(rng.uniform(np.log(1.0), np.log(10.0), NZ))),
        outputscale=float(np.exp(rng.uniform(0.0, np.log(10.0)))),
        noise=float(np.exp(rng.uniform(np.log(1e-4), np.log(1e-1)))),
        constant=0.0,
    )


def spread(values: NDArray[np.float64], names: dict[str, str], label: str) -> NDArray[np.float64]:
    """Return the standard deviation of each column; a constant column is an error."""
    std: NDArray[np.float64] = values.std(axis=0)
    for name, s in zip(names, std, strict=True):
        if not s > 1e-9:  # noqa: PLR2004 - rounding noise of a constant
            raise EgpError(
                f"surface {label}: {name} never changes; collect data in which it varies"
            )
    return std
