"""A member whose exact processes predict the whole change, as in the paper.

Each output has a constant mean, a kernel and a noise of its own. The lengthscales are fitted on a
random subset, the transitions to keep are chosen with them (`subset`), and the processes are fitted
on these.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError
from egp_service.quantities import GP_OUTPUT, NY, NZ
from egp_service.training.gaussian_process import (
    WHOLE_CHANGES,
    Hyperparameters,
    OutputProcess,
    fit,
)
from egp_service.training.prior_mean import PriorMean
from egp_service.training.subset import select, spikes
from egp_service.training.trained import Scaling, TrainedMember

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.training.train import TrainingSettings


def exact_member(
    part: tuple[Dataset, Dataset],
    settings: TrainingSettings,
    rng: np.random.Generator,
    report: Callable[[str, float, int], None],
) -> TrainedMember:
    """Train a member on training data, with the held-out ones in `part`.

    `report` gets the stage, the loss and the number of iterations so far.

    Raises:
        EgpError: if a fit fails.

    """
    data, validation = part
    label = data.provenance.surface
    scaling = Scaling.of(data.z, data.y.mean(axis=0), spread(data.y, GP_OUTPUT, label))
    z, y = scaling.inputs(data.z), scaling.targets(data.y)

    def fit_all(
        rows: NDArray[np.int64], starts: list[list[Hyperparameters]], done: int, stage: str
    ) -> list[OutputProcess]:
        processes = [
            OutputProcess(z[rows], y[rows, j].contiguous(), settings.kernel, WHOLE_CHANGES)
            for j in range(NY)
        ]
        for j, (process, name) in enumerate(zip(processes, GP_OUTPUT, strict=True)):
            before = j * len(starts) * settings.max_iterations

            def on_step(
                start: int, iteration: int, loss: float, before: int = before, name: str = name
            ) -> None:
                at = before + start * settings.max_iterations + iteration
                report(f"{label}: {stage} fit of {name}", loss, done + math.ceil(at / NY))

            fit(process, [start[j] for start in starts], settings.max_iterations, on_step)
        return processes

    first_rows = np.sort(rng.permutation(len(data))[: settings.first_points])
    first = fit_all(first_rows, [[START] * NY], 0, "first")
    rows = select(z, first, settings.max_points, rng, spikes(data))
    starts = [
        [process.hyperparameters for process in first],
        *([_random_start(rng) for _ in range(NY)] for _ in range(settings.restarts)),
    ]
    return TrainedMember(
        dataset=data,
        validation=validation,
        inputs=data.z[rows],
        targets=data.y[rows],
        scaling=scaling,
        processes=tuple(fit_all(rows, starts, settings.max_iterations, "final")),
        mean=PriorMean(),
        vehicle=None,
    )


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
