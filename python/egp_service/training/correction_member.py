"""A member whose processes correct a fitted vehicle.

Corrections are small beside the noise that a single transition has from states that are not
measured, such as roll and the speed of the wheels, so that a few hundred transitions determine
neither the hyperparameters nor the corrections. The hyperparameters are therefore those of a sparse
process that is fitted to thousands of transitions (`sparse`), and the targets are averages over all
transitions. The outputs share kernel and noise, which halves the time of a prediction.

Fitted to 400 chosen transitions, trainings of the demo's recipe with other seeds differed: the
lengthscale of the yaw rate was 1.0 to 20 standard deviations, that of the force 1.0 to 40, and the
noise variance 0.7 to 1.9. Fitted as here, they are 1.1 to 1.9, 1.1 to 2.9 and 0.5 to 0.8 in eleven
trainings with other seeds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import torch

from egp_service.quantities import GP_OUTPUT, NY
from egp_service.training.exact_member import START, spread
from egp_service.training.gaussian_process import CORRECTIONS, OutputProcess, share_kernel
from egp_service.training.prior_mean import PriorMean
from egp_service.training.sparse import FITTED, average_targets, fit_sparse
from egp_service.training.subset import select, spikes
from egp_service.training.trained import Scaling, TrainedMember

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.training.train import TrainingSettings
    from egp_service.training.vehicle_fit import FittedVehicle

CORRECTION_ITERATIONS: Final = 40
"""Iterations of the fit of a member's hyperparameters."""
_INDUCING: Final = 200  # inducing points of the fit of the hyperparameters


def correction_member(
    part: tuple[Dataset, Dataset],
    fitted: FittedVehicle,
    settings: TrainingSettings,
    rng: np.random.Generator,
    report: Callable[[str, float, int], None],
) -> TrainedMember:
    """Train a member on training data, with the held-out ones in `part`.

    `report` gets the stage, the loss and the number of iterations so far, of
    `CORRECTION_ITERATIONS`.

    Raises:
        EgpError: if the fit fails.

    """
    data, validation = part
    label = data.provenance.surface
    mean = PriorMean(single_track=fitted.values, steps=fitted.steps)
    known = mean.predict(data.z, data.provenance.dt)
    rest = data.y - known
    scaling = Scaling.of(data.z, rest.mean(axis=0), spread(rest, GP_OUTPUT, label))
    z, y = scaling.inputs(data.z), scaling.targets(rest)

    def processes_at(rows: NDArray[np.int64]) -> list[OutputProcess]:
        processes = [
            OutputProcess(z[rows], y[rows, j].contiguous(), settings.kernel, CORRECTIONS)
            for j in range(NY)
        ]
        share_kernel(processes)
        return processes

    def on_step(iteration: int, loss: float) -> None:
        report(f"{label}: sparse fit of {', '.join(GP_OUTPUT)}", loss, iteration + 1)

    rows = rng.permutation(len(data))[:FITTED]
    sparse = processes_at(rows[:_INDUCING])
    for process in sparse:
        process.assign(START)
    fit_sparse(sparse, z[rows], list(y[rows].T), CORRECTION_ITERATIONS, on_step)

    chosen = select(z, sparse, settings.max_points, rng, spikes(data))
    processes = processes_at(chosen)
    for process, fit in zip(processes, sparse, strict=True):
        process.assign(fit.hyperparameters)
    averages = _give_averages(processes, z, y)
    return TrainedMember(
        dataset=data,
        validation=validation,
        inputs=data.z[chosen],
        targets=known[chosen] + scaling.target_mean + scaling.target_std * averages,
        scaling=scaling,
        processes=tuple(processes),
        mean=mean,
        vehicle=fitted,
    )


def _give_averages(
    processes: list[OutputProcess], z: torch.Tensor, y: torch.Tensor
) -> NDArray[np.float64]:
    """Give the processes averages over all transitions z (n, 6), y (n, 3) as targets.

    Returns these, (M, 3); all are z-scored.
    """
    columns = average_targets(processes, z, [column.contiguous() for column in y.T])
    for process, targets in zip(processes, columns, strict=True):
        process.replace_targets(targets)
        process.eval()
    averages: NDArray[np.float64] = torch.stack(columns, dim=1).numpy()
    return averages
