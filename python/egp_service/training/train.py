"""Training of a library from datasets, one member for each surface.

Trajectories of each surface are split off for validation, and one single-track vehicle is fitted to
all surfaces with a set of tyres for each (`vehicle_fit`). With `mean="single-track"` the processes
correct it (`correction_member`). With `mean="best"` each member takes the kind that predicts
held-out blocks best (`choice`), and each output has a kernel and a noise of its own
(`average_member`). With `mean="constant"` no vehicle is fitted, and the processes are exact as in
the paper (`exact_member`).
"""

from __future__ import annotations

import dataclasses
import operator
from typing import TYPE_CHECKING, Final, Literal, get_args

import numpy as np

from egp_service._core import EgpError
from egp_service.data.alignment import align
from egp_service.data.dataset import Dataset, check_one_car, merge
from egp_service.data.experiment import check_seed
from egp_service.data.plausibility import HEAVIEST, LARGEST, largest
from egp_service.quantities import GP_INPUT, GP_OUTPUT, NZ
from egp_service.training.average_member import MOST_POINTS
from egp_service.training.choice import BUDGET, best_member, blocks_to_compare
from egp_service.training.correction_member import CORRECTION_ITERATIONS, correction_member
from egp_service.training.delays import find_delays
from egp_service.training.exact_member import exact_member, spread
from egp_service.training.kernel import KernelName
from egp_service.training.threads import one_thread
from egp_service.training.vehicle_fit import VehicleFitError, fit_vehicle
from egp_service.vehicle import simulated_vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from egp_service._core import VehicleParameters
    from egp_service.data.provenance import Provenance
    from egp_service.training.trained import TrainedMember
    from egp_service.training.vehicle_fit import FittedVehicle


# A library file has at most as many training points of a member (docs/library.md).
_MOST_POINTS: Final = 5000
_SHORTEST_WHEELBASE: Final = 0.02  # m, of the ranges of a vehicle's file


@dataclasses.dataclass(frozen=True)
class TrainingSettings:
    """Settings of training. The same data, settings and machine give the same bytes."""

    kernel: KernelName = "matern52"
    """Covariance function of every process."""
    mean: Literal["single-track", "constant", "best"] = "single-track"
    """Prior mean of the GPs: a vehicle fitted to the surface, or constants as in the paper.

    With "best" each member takes the kind of `choice.KINDS` that predicts held-out blocks best.

    The residuals of a vehicle are small and hardly determine the kernels, so with "single-track"
    all (z-scored) outputs share one kernel and noise, which halves the time of a prediction. With
    constants each output has its own kernel.
    """
    max_points: int = 400
    """Largest number of transitions of a member, at most 5000, as in a library; the control step's
    time grows with it. With "best" it is at most 150, also by default."""
    first_points: int = 400
    """With "constant", the number of random transitions of the first fit, whose lengthscales choose
    the final ones."""
    restarts: int = 1
    """With "constant", the number of additional starts of the final fit from random
    hyperparameters."""
    max_iterations: int = 150
    """With "constant", the L-BFGS iterations per start."""
    validation_fraction: float = 0.2
    """Share of each surface's trajectories that are held out of training."""
    seed: int = 0
    """Seed of the split, the subset and the random starts."""

    def __post_init__(self) -> None:
        """Check types and ranges of the settings; counts become `int`."""
        for name in ("max_points", "first_points", "restarts", "max_iterations", "seed"):
            value = getattr(self, name)
            try:
                object.__setattr__(self, name, operator.index(value))
            except TypeError as error:
                raise EgpError(f"{name} is {value!r}: expected a whole number") from error
        if self.kernel not in get_args(KernelName):
            known = ", ".join(get_args(KernelName))
            raise EgpError(f"kernel is {self.kernel!r}: expected one of {known}")
        if self.mean not in ("single-track", "constant", "best"):
            raise EgpError(f"mean is {self.mean!r}: expected 'single-track', 'constant' or 'best'")
        points = 2 * NZ
        smallest = {
            "max_points": points,
            "first_points": points,
            "restarts": 0,
            "max_iterations": 1,
        }
        for name, least in smallest.items():
            if getattr(self, name) < least:
                raise EgpError(f"{name} is {getattr(self, name)}: expected at least {least}")
        if self.max_points > _MOST_POINTS:
            raise EgpError(
                f"max_points is {self.max_points}: expected at most {_MOST_POINTS}, as many as a "
                "library holds for a member"
            )
        stated = self.max_points != type(self).max_points
        if self.mean == "best" and stated and self.max_points > MOST_POINTS:
            raise EgpError(
                f"max_points is {self.max_points}: expected at most {MOST_POINTS} with the mean "
                "'best', whose processes are sparse; state fewer, or another mean"
            )
        if not (0.0 < self.validation_fraction < 1.0):
            raise EgpError(
                f"validation_fraction is {self.validation_fraction}: expected between 0 and 1"
            )
        check_seed(self.seed)


@dataclasses.dataclass(frozen=True)
class FitProgress:
    """Progress of a fit: `done` of at most `total` L-BFGS iterations of the whole library."""

    stage: str
    loss: float
    done: int
    total: int


def split(dataset: Dataset, fraction: float, rng: np.random.Generator) -> tuple[Dataset, Dataset]:
    """Split by trajectory, of which two are needed, into training and validation data."""
    trajectories = np.unique(dataset.trajectory)
    if len(trajectories) < 2:  # noqa: PLR2004
        raise EgpError(
            f"surface {dataset.provenance.surface} has one trajectory: validation needs at least "
            "two (collect more seeds, or record a log of more than 10 s)"
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
    The logs of a real car are trained with their inputs moved by the delays that are found in them.
    Delays are found before the split, so that validation data contribute to them, too. With
    `mean="constant"` that of the states is not searched, because this fits a vehicle.

    Raises:
        EgpError: if datasets differ in dt or vehicle, cannot be split or compared, as `check_data`,
            or if a fit fails.

    """
    surfaces: dict[tuple[float, str], list[Dataset]] = {}
    for dataset in datasets:
        key = (dataset.provenance.friction, dataset.provenance.surface)
        surfaces.setdefault(key, []).append(dataset)
    if not datasets:
        raise EgpError("no datasets: give at least one Parquet file")
    check_one_library([dataset.provenance for dataset in datasets])
    rngs = [np.random.default_rng([settings.seed, number]) for number in range(len(surfaces))]
    logs = [merge(surfaces[key]).of_vehicle(vehicle) for key in sorted(surfaces)]
    try:
        return _train(logs, settings, report, vehicle=vehicle, rngs=rngs)
    except VehicleFitError as error:
        error.add_note("or train with --mean constant")
        raise


def _train(
    logs: Sequence[Dataset],
    settings: TrainingSettings,
    report: Callable[[FitProgress], None],
    *,
    vehicle: VehicleParameters | None,
    rngs: Sequence[np.random.Generator],
) -> list[TrainedMember]:
    """Train one member for each log, as `train`."""
    delays = None
    if simulated_vehicle(logs[0].provenance.vehicle) is None:
        for log in logs:
            check_data(log, vehicle)  # errors of the fits that find the delays name no column
        with one_thread(settings.max_points):
            delays = find_delays(logs, vehicle, may_fit=settings.mean != "constant")
        logs = [align(log, delays) for log in logs]
    parts = [
        split(log, settings.validation_fraction, rng) for log, rng in zip(logs, rngs, strict=True)
    ]
    members = train_parts(parts, settings, report, vehicle=vehicle, rngs=rngs)
    return [dataclasses.replace(member, delays=delays) for member in members]


def train_parts(
    parts: Sequence[tuple[Dataset, Dataset]],
    settings: TrainingSettings,
    report: Callable[[FitProgress], None] = lambda _: None,
    *,
    vehicle: VehicleParameters | None = None,
    rngs: Sequence[np.random.Generator],
) -> list[TrainedMember]:
    """Train one member for each part, which has training and held-out data of one surface.

    `vehicle` is as for `train`. Each part has a generator of random numbers.

    Raises:
        EgpError: if data are implausible, constant or too few, or if a fit fails.

    """
    budget = len(parts) * _iterations(settings)
    members: list[TrainedMember] = []
    known = vehicle or simulated_vehicle(parts[0][0].provenance.vehicle)
    with one_thread(settings.max_points):
        for data, _ in parts:
            check_data(data, known)
            if settings.mean == "best":
                blocks_to_compare(data)  # an error here comes before the minutes of training
        vehicles: list[FittedVehicle | None] = [None for _ in parts]
        if settings.mean != "constant":
            vehicles = [*fit_vehicle([data for data, _ in parts], known, rngs)]
        for number, (part, fitted, rng) in enumerate(zip(parts, vehicles, rngs, strict=True)):

            def on_fit(stage: str, loss: float, done: int, number: int = number) -> None:
                offset = number * budget // len(parts)
                report(FitProgress(stage, loss, offset + done, budget))

            if fitted is None:
                members.append(exact_member(part, settings, rng, on_fit))
            elif settings.mean == "best":
                members.append(best_member(part, fitted, settings, rng, on_fit))
            else:
                members.append(correction_member(part, fitted, settings, rng, on_fit))
    return members


def _iterations(settings: TrainingSettings) -> int:
    """Largest number of iterations that a member's training reports."""
    match settings.mean:
        case "best":
            return BUDGET
        case "single-track":
            return CORRECTION_ITERATIONS
        case "constant":
            return (settings.restarts + 2) * settings.max_iterations


def check_one_library(origins: Sequence[Provenance]) -> None:
    """Errors unless data of these origins, of which there is at least one, make one library.

    One label has one friction coefficient, and all data have the same period and vehicle.
    """
    frictions: dict[str, float] = {}
    for origin in origins:
        first = frictions.setdefault(origin.surface, origin.friction)
        if origin.friction != first:
            raise EgpError(
                f"frictions {first:g} and {origin.friction:g} share a surface label, "
                f"'{origin.surface}': give each surface its own label"
            )
    check_one_car(origins, "library")


def check_data(data: Dataset, vehicle: VehicleParameters | None) -> None:
    """Errors as `check_magnitudes`, or if an input or output of the data is constant."""
    check_magnitudes(data, vehicle)
    spread(data.z, GP_INPUT, data.provenance.surface)
    spread(data.y, GP_OUTPUT, data.provenance.surface)


def check_magnitudes(data: Dataset, vehicle: VehicleParameters | None) -> None:
    """Errors if a number is larger than that of any vehicle; one such row would spoil the fit.

    Small vehicles turn and steer faster, and an unknown one may be small.
    """
    wheelbase = _SHORTEST_WHEELBASE if vehicle is None else vehicle.l_f + vehicle.l_r
    for names, values in ((GP_INPUT, data.z), (GP_OUTPUT, data.y)):
        for name, column in zip(names, values.T, strict=True):
            # The force of a log may be its acceleration times the mass.
            limit = HEAVIEST * LARGEST["a_x"]
            if name != "F_x":
                limit = largest(name.removeprefix("d_"), wheelbase)
            value = column[np.argmax(np.abs(column))]
            if abs(value) > limit:
                raise EgpError(
                    f"surface {data.provenance.surface}: {name} is {value:.4g} in a row of the "
                    f"training data, more than {limit:.3g}: remove such rows from the log and "
                    "collect it again"
                )
