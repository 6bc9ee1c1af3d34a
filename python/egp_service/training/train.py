"""Training of a library from datasets: one member per surface, one exact process per output.

Trajectories of each surface are split off for validation, and one single-track vehicle is fitted to
all surfaces with a set of tyres for each (`vehicle_fit`). Then, for each surface, its residuals are
z-scored, the lengthscales are fitted on a random subset, `max_points` transitions are chosen with
them (`subset`), and the processes are fitted on these.
With a vehicle as prior mean the outputs' processes share kernel and noise.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
import torch

from egp_service._core import EgpError
from egp_service.data.dataset import Dataset, merge
from egp_service.quantities import GP_INPUT, GP_OUTPUT, NY, NZ
from egp_service.training import prior_mean
from egp_service.training.gaussian_process import (
    CORRECTIONS,
    WHOLE_CHANGES,
    FitStep,
    Hyperparameters,
    KernelName,
    OutputProcess,
    exact,
    fit,
    share_kernel,
)
from egp_service.training.subset import select
from egp_service.training.vehicle_fit import fit_vehicle
from egp_service.vehicle import simulated_vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters
    from egp_service.training.vehicle_fit import FittedVehicle

_ONE_THREAD: Final = 1000


@dataclasses.dataclass(frozen=True)
class TrainingSettings:
    """Settings of training. The same data, settings and machine give the same bytes."""

    kernel: KernelName = "matern52"
    """Covariance function of every process: "rbf" or "matern52"."""
    mean: Literal["single-track", "constant"] = "single-track"
    """Prior mean of the GPs: a vehicle fitted to the surface, or constants as in the paper.

    The residuals of a vehicle are small and hardly determine the kernels, so all (z-scored) outputs
    share one kernel and noise, which halves the time of a prediction. With constants each output
    has its own kernel.
    """
    max_points: int = 400
    """Number of transitions of a member; the control step's time grows with it."""
    first_points: int = 400
    """Number of random transitions of the first fit, whose lengthscales choose the final ones."""
    restarts: int = 1
    """Number of additional starts of the final fit from random hyperparameters."""
    max_iterations: int = 150
    """L-BFGS iterations per start."""
    validation_fraction: float = 0.2
    """Share of each surface's trajectories that are held out of training."""
    seed: int = 0
    """Seed of the split, the subset and the random starts."""

    def __post_init__(self) -> None:
        """Check the ranges of the settings."""
        if self.kernel not in ("rbf", "matern52"):
            raise EgpError(f"kernel is {self.kernel!r}: expected 'rbf' or 'matern52'")
        if self.mean not in ("single-track", "constant"):
            raise EgpError(f"mean is {self.mean!r}: expected 'single-track' or 'constant'")
        least = 2 * NZ
        for name in ("max_points", "first_points"):
            if getattr(self, name) < least:
                raise EgpError(f"{name} is {getattr(self, name)}: expected at least {least}")
        if self.restarts < 0 or self.max_iterations < 1:
            raise EgpError("restarts must be 0 or more and max_iterations 1 or more")
        if not (0.0 < self.validation_fraction < 1.0):
            raise EgpError(
                f"validation_fraction is {self.validation_fraction}: expected between 0 and 1"
            )


@dataclasses.dataclass(frozen=True)
class FitProgress:
    """Progress of a fit: `done` of at most `total` L-BFGS iterations of the whole library."""

    stage: str
    loss: float
    done: int
    total: int


@dataclasses.dataclass(frozen=True, eq=False)
class TrainedMember:
    """One surface's processes with their scaling."""

    dataset: Dataset
    """The training data before the selection, whose hash and bounds are exported."""
    validation: Dataset
    """The held-out trajectories."""
    inputs: NDArray[np.float64]
    """The chosen transitions' inputs (M, 6) and targets (M, 3), physical units."""
    targets: NDArray[np.float64]
    input_mean: NDArray[np.float64]
    input_std: NDArray[np.float64]
    target_mean: NDArray[np.float64]
    """Mean of the targets less the vehicle's prediction."""
    target_std: NDArray[np.float64]
    processes: tuple[OutputProcess, ...]
    single_track: NDArray[np.float64] | None
    """Parameters (17,) of the vehicle that is the prior mean, if any."""
    vehicle: FittedVehicle | None
    """The same vehicle with intervals of its parameters."""

    def predict(
        self, z: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Mean (n, 3), autograd Jacobian (n, 3, 6) and latent variance (n, 3), physical units."""
        device = self.processes[0].inputs.device
        query = torch.tensor(z, dtype=torch.float64, device=device, requires_grad=True)
        scaled = (query - query.new_tensor(self.input_mean)) / query.new_tensor(self.input_std)
        mean, variance = np.empty((len(z), NY)), np.empty((len(z), NY))
        jacobian = np.empty((len(z), NY, NZ))
        known = query.new_zeros((len(z), NY))
        if self.single_track is not None:
            vehicle, dt = query.new_tensor(self.single_track), self.dataset.provenance.dt
            known = prior_mean.change(query, vehicle, dt)
        with exact():
            for j, process in enumerate(self.processes):
                posterior = process(scaled)
                f = posterior.mean * self.target_std[j] + self.target_mean[j] + known[:, j]
                # Row i of the mean depends on row i of the query only, so one backward pass of
                # the sum gives the gradients of all rows.
                (gradient,) = torch.autograd.grad(f.sum(), query, retain_graph=True)
                mean[:, j] = f.detach().cpu().numpy()
                variance[:, j] = posterior.variance.detach().cpu().numpy() * self.target_std[j] ** 2
                jacobian[:, j] = gradient.cpu().numpy()
        return mean, jacobian, variance


def split(dataset: Dataset, fraction: float, rng: np.random.Generator) -> tuple[Dataset, Dataset]:
    """Split by trajectory into training and validation data.

    Raises:
        EgpError: if there are fewer than two trajectories.

    """
    trajectories = np.unique(dataset.trajectory)
    if len(trajectories) < 2:  # noqa: PLR2004
        raise EgpError(
            f"surface {dataset.provenance.surface} has one trajectory: validation needs at least "
            "two (collect more seeds, or split the log where it was interrupted)"
        )
    count = min(max(1, round(fraction * len(trajectories))), len(trajectories) - 1)
    held_out = np.isin(dataset.trajectory, rng.choice(trajectories, count, replace=False))
    return dataset.select(~held_out), dataset.select(held_out)


def train(
    datasets: Sequence[Dataset],
    settings: TrainingSettings,
    report: Callable[[FitProgress], None] = lambda _: None,
    *,
    vehicle: VehicleParameters | None = None,
) -> list[TrainedMember]:
    """Train one member per surface label, ordered by friction and label.

    What is known about the vehicle are the parameters `vehicle`, or those of a simulated vehicle.

    Raises:
        EgpError: if datasets differ in dt or vehicle, or a fit fails.

    """
    surfaces: dict[tuple[float, str], list[Dataset]] = {}
    for dataset in datasets:
        key = (dataset.provenance.friction, dataset.provenance.surface)
        surfaces.setdefault(key, []).append(dataset)
    _check_consistent([parts[0].provenance.surface for parts in surfaces.values()], datasets)
    budget = len(surfaces) * (settings.restarts + 2) * settings.max_iterations
    members: list[TrainedMember] = []
    rngs = [np.random.default_rng([settings.seed, number]) for number in range(len(surfaces))]
    with _threads(settings.max_points):
        parts = [
            split(merge(surfaces[key]), settings.validation_fraction, rng)
            for key, rng in zip(sorted(surfaces), rngs, strict=True)
        ]
        vehicles: list[FittedVehicle | None] = [None for _ in parts]
        for data, _ in parts:
            _check_varies(data)
        if settings.mean == "single-track":
            known = vehicle or simulated_vehicle(datasets[0].provenance.vehicle)
            vehicles = [*fit_vehicle([data for data, _ in parts], known, rngs)]
        for number, (part, fitted, rng) in enumerate(zip(parts, vehicles, rngs, strict=True)):

            def on_fit(stage: str, loss: float, done: int, number: int = number) -> None:
                offset = number * budget // len(surfaces)
                report(FitProgress(stage, loss, offset + done, budget))

            members.append(_train_member(part, fitted, settings, rng, on_fit))
    return members


@contextlib.contextmanager
def _threads(points: int) -> Iterator[None]:
    """Use one thread for small matrices, for which further threads would only busy-wait."""
    before = torch.get_num_threads()
    if points <= _ONE_THREAD:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _check_consistent(labels: list[str], datasets: Sequence[Dataset]) -> None:
    if not labels:
        raise EgpError("no datasets: give at least one Parquet file")
    if len(set(labels)) < len(labels):
        raise EgpError("two frictions share a surface label: give each surface its own label")
    first = datasets[0].provenance
    for other in (dataset.provenance for dataset in datasets):
        if (other.dt, other.vehicle) != (first.dt, first.vehicle):
            raise EgpError(
                f"surface {other.surface} was recorded at dt {other.dt} with vehicle "
                f"{other.vehicle}, surface {first.surface} at dt {first.dt} with vehicle "
                f"{first.vehicle}: one library has one dt and one vehicle"
            )


def _check_varies(data: Dataset) -> None:
    """Errors if an input or output of the data is constant."""
    _spread(data.z, GP_INPUT, data.provenance.surface)
    _spread(data.y, GP_OUTPUT, data.provenance.surface)


def _train_member(
    part: tuple[Dataset, Dataset],
    fitted: FittedVehicle | None,
    settings: TrainingSettings,
    rng: np.random.Generator,
    report: Callable[[str, float, int], None],
) -> TrainedMember:
    data, validation = part
    label = data.provenance.surface
    input_mean, input_std = data.z.mean(axis=0), data.z.std(axis=0)
    vehicle, rest, bounds = None, data.y, WHOLE_CHANGES
    if fitted is not None:
        vehicle = fitted.values
        rest = data.y - prior_mean.predict(data.z, vehicle, data.provenance.dt)
        bounds = CORRECTIONS
    target_mean, target_std = rest.mean(axis=0), _spread(rest, GP_OUTPUT, label)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    z = torch.tensor((data.z - input_mean) / input_std, dtype=torch.float64, device=device)
    y = torch.tensor((rest - target_mean) / target_std, dtype=torch.float64, device=device)

    def fit_all(
        rows: NDArray[np.int64], starts: list[list[Hyperparameters]], done: int, stage: str
    ) -> list[OutputProcess]:
        processes = [
            OutputProcess(z[rows], y[rows, j].contiguous(), settings.kernel, bounds)
            for j in range(NY)
        ]
        together = [range(NY)] if vehicle is not None else [range(j, j + 1) for j in range(NY)]
        for number, outputs in enumerate(together):
            group = [processes[j] for j in outputs]
            share_kernel(group)
            before = number * len(starts) * settings.max_iterations
            names = ", ".join(list(GP_OUTPUT)[j] for j in outputs)

            def on_step(step: FitStep, before: int = before, names: str = names) -> None:
                at = before + step.start * settings.max_iterations + step.iteration
                at = done + math.ceil(at / len(together))
                report(f"{label}: {stage} fit of {names}", step.loss, at)

            own = [[start[j] for j in outputs] for start in starts]
            fit(group, own, settings.max_iterations, on_step)
        return processes

    first_rows = np.sort(rng.permutation(len(data))[: settings.first_points])
    first = fit_all(first_rows, [[_START] * NY], 0, "first")
    rows = select(z, first, settings.max_points, rng)
    starts = [
        [process.hyperparameters for process in first],
        *([_random_start(rng) for _ in range(NY)] for _ in range(settings.restarts)),
    ]
    processes = fit_all(rows, starts, settings.max_iterations, "final")
    return TrainedMember(
        dataset=data,
        validation=validation,
        inputs=data.z[rows],
        targets=data.y[rows],
        input_mean=input_mean,
        input_std=input_std,
        target_mean=target_mean,
        target_std=target_std,
        processes=tuple(processes),
        single_track=vehicle,
        vehicle=fitted,
    )


# The residual of one period is almost linear in z, hence the long lengthscales and little noise.
# Values of this start and of the random ones are moved inside the bounds.
_START: Final = Hyperparameters(lengthscales=(3.0,) * NZ, outputscale=3.0, noise=1e-2, constant=0.0)


def _random_start(rng: np.random.Generator) -> Hyperparameters:
    return Hyperparameters(
        lengthscales=tuple(np.exp(rng.uniform(np.log(1.0), np.log(10.0), NZ))),
        outputscale=float(np.exp(rng.uniform(0.0, np.log(10.0)))),
        noise=float(np.exp(rng.uniform(np.log(1e-4), np.log(1e-1)))),
        constant=0.0,
    )


def _spread(values: NDArray[np.float64], names: dict[str, str], label: str) -> NDArray[np.float64]:
    """Return the standard deviation of each column; a constant column is an error."""
    std: NDArray[np.float64] = values.std(axis=0)
    for name, s in zip(names, std, strict=True):
        if not s > 1e-9:  # noqa: PLR2004 - rounding noise of a constant
            raise EgpError(
                f"surface {label}: {name} never changes; collect data in which it varies"
            )
    return std
