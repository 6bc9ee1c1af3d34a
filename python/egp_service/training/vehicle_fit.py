"""The fit of one vehicle on several surfaces, with what is known about it as priors.

The body (mass, axles, yaw inertia, height, drag) is the same on all surfaces; the tyres and the
rolling resistance belong to a surface. The logarithm of each parameter has a Gaussian prior. With a
vehicle's parameters the priors of the body are narrow; without them they cover small cars to vans.
The fit is the maximum a posteriori by robust least squares. Its intervals are those of the Laplace
approximation with the Gauss-Newton Hessian (Bishop, *Pattern Recognition and Machine Learning*,
section 4.4). They hold if the equations do: a vehicle that is no single track has a nearest one,
and its parameters are what the intervals are about (`tests/bench/vehicle_intervals.py` measures how
far off they are).
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Final

import numpy as np
import torch
from scipy.optimize import least_squares

from egp_service._core import EgpError
from egp_service.data.channels import MAD, channels
from egp_service.quantities import NORMAL_95, NY
from egp_service.training.autocorrelation import autocorrelation
from egp_service.training.euler import euler_steps
from egp_service.training.normal_equations import NormalEquationProblem
from egp_service.training.prior_mean import change
from egp_service.training.vehicle_priors import (
    BODY,
    DRAG,
    KNOWN_WIDTHS,
    PARAMETERS,
    ROLLING,
    TYRES,
    Parameter,
    priors,
)
from egp_service.vehicle import simulated_vehicle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters
    from egp_service.data.dataset import Dataset

_FIT_POINTS: Final = 8000
# Scale of the robust loss in standard deviations of the change. Larger residuals have a bounded
# influence: effects outside the model (a spin, a locked wheel) are left to the GPs.
_OUTLIER: Final = 0.1
# Smallest spread of the errors in units of this scale. Without noise the errors are those of the
# equations, which no number of transitions reduces.
_LEAST_SPREAD: Final = 0.1
# Standard deviations of constant disturbances, m/s², m/s², rad/s²: slope, bank, crosswind.
_DISTURBANCE: Final = np.array([0.3, 1.0, 0.1])
# Share of these standard deviations that is left where grade and bank of the road were measured.
_LEFT: Final = 0.1
# A parameter counts as determined if its posterior width is at most this share of its prior width.
# Mass, axle distances and k² must also be at least as narrow as the prior from a vehicle's file
# (`KNOWN_WIDTHS`).
_DETERMINED: Final = 0.5
# If the errors of the predicted changes of v_x are below this share of the noise of these changes,
# the force was computed from v_x itself.
_NO_SENSOR: Final = 0.5
_AT_BOUND: Final = 1e-3  # of the logarithm
# Relative changes of the sum of squares at which the two fits end. Of the first one only weights
# are used, and noise without a vehicle in it needs hundreds of iterations for the last digits. The
# vehicles of the shipped recipes differ by at most 0.2 standard deviations from those with 1e-8.
_FIRST_TOLERANCE: Final = 1e-5
_TOLERANCE: Final = 1e-8


class VehicleFitError(EgpError):
    """Data that no vehicle fits."""


@dataclasses.dataclass(frozen=True)
class FittedParameter:
    """A parameter of a fitted vehicle and what is known about it."""

    name: str
    value: float
    low: float
    """Ends of the 95 % interval."""
    high: float
    distance: float
    """Distance of the logarithm from the prior's centre in standard deviations of the prior."""
    determined: bool
    """Whether the data narrow the prior to at most half of its width and, for mass, axle distances
    and yaw inertia, tell it as well as a vehicle's file does (mass: to 3 %). The mass is not
    determined by a force that was computed with an assumed mass."""
    at_bound: bool
    """Whether the value is an end of the range that is searched."""
    assumed: bool = False
    """Whether the value scales with the mass with which the force was computed."""


@dataclasses.dataclass(frozen=True)
class FittedVehicle:
    """The vehicle on one surface: its parameters in the order of `PARAMETERS`.

    Those of the resistance, the last two, are left out where the data do not contain one.
    """

    parameters: tuple[FittedParameter, ...]
    steps: int = 1
    """Number of Euler steps in a period, with which the vehicle was fitted."""
    derived: tuple[FittedParameter, ...] = ()
    """What a vehicle's file states in place of parameters: the yaw inertia `I_z`, m k²."""

    @property
    def values(self) -> NDArray[np.float64]:
        """The values (17,) or (19,), as those of `PriorMean.single_track`."""
        return np.array([parameter.value for parameter in self.parameters])

    def summary(self) -> dict[str, dict[str, float | bool]]:
        """Return each parameter's fields by its name, with six digits; `assumed` only if true."""
        return {
            parameter.name: {
                name: float(f"{value:.6g}") if isinstance(value, float) else value
                for name, value in dataclasses.asdict(parameter).items()
                if name != "name" and (parameter.assumed or name != "assumed")
            }
            for parameter in self.parameters
        }


def fit_vehicle(
    surfaces: Sequence[Dataset],
    vehicle: VehicleParameters | None,
    rngs: Sequence[np.random.Generator],
) -> list[FittedVehicle]:
    """Fit one body, and the tyres of each surface, to the changes on all surfaces.

    The fit is made twice. The errors of the first one give the weight of a surface's data beside
    the priors: errors that are large, or alike in consecutive periods, count for less than as many
    small and independent ones. A constant disturbance of each output and surface is estimated
    along, so that a slope or a bank does not change the tyres; it is not part of the result. Each
    surface has a generator of random numbers, which chooses its transitions.

    The Euler method has one step in a period, or as many as the fitted vehicles need to be stable.

    Drag and rolling resistance are fitted unless the car is a simulated one, which has none, or the
    force of a surface follows from the changes of the speed, which contain both. Rolling resistance
    and a constant slope slow alike; only with a measured tilt the data tell one from the other.

    Raises:
        VehicleFitError: if the fit does not converge.

    """
    parts = [_Surface.of(dataset, rng) for dataset, rng in zip(surfaces, rngs, strict=True)]
    about = [data.provenance for data in surfaces]
    slowed = simulated_vehicle(about[0].vehicle) is None
    slowed = slowed and not any(own.force_from_a_x for own in about)
    problem = _Problem(parts, priors(vehicle), slowed=slowed)
    found = problem.solve(np.zeros(problem.size), _FIRST_TOLERANCE)
    for surface, unknowns in zip(problem.surfaces, problem.parts(found), strict=True):
        surface.weigh(*problem.physical(surface, torch.from_numpy(unknowns)))
    if slowed and any(surface.circular for surface in parts):
        problem = _Problem(parts, priors(vehicle), slowed=False)
        found = np.zeros(problem.size)
    while True:
        found = problem.solve(found, _TOLERANCE)
        steps = problem.stable_steps(found)
        if steps <= problem.steps:
            return problem.vehicles(found)
        problem.steps = steps


@dataclasses.dataclass(eq=False)
class _Surface:
    """The data of one surface."""

    dataset: Dataset
    z: torch.Tensor
    """Inputs (n, 6) and changes (n, 3) of the transitions that the fit uses."""
    y: torch.Tensor
    scale: torch.Tensor
    """Scale of the robust loss (3,)."""
    disturbance: torch.Tensor
    """Standard deviations (3,) of the constant disturbance."""
    noise: NDArray[np.float64]
    """Standard deviations (3,) of the changes by the noise of measured states; zero for simulated
    data. A force that was computed from the measured speed predicts its changes better than this,
    which tells nothing about the vehicle."""
    weight: float = 1.0
    """Weight of a transition beside the priors."""
    circular: bool = False
    """Whether the force was computed with an assumed mass: the dataset says it, or the force
    predicts the changes of `v_x` better than their noise lets any other measurement."""

    @staticmethod
    def of(dataset: Dataset, rng: np.random.Generator) -> _Surface:
        """Choose at most `_FIT_POINTS` transitions."""
        rows = rng.permutation(len(dataset))[:_FIT_POINTS]
        z, y = torch.from_numpy(dataset.z[rows]), torch.from_numpy(dataset.y[rows])
        scale = torch.from_numpy(_OUTLIER * dataset.y.std(axis=0))
        left = 1.0 if dataset.tilt is None else _LEFT
        noise = np.zeros(NY)
        if simulated_vehicle(dataset.provenance.vehicle) is None:
            noise = math.sqrt(2.0) * np.nan_to_num(channels(dataset).noise)
        return _Surface(dataset, z, y, scale, torch.from_numpy(left * _DISTURBANCE), noise)

    def weigh(self, parameters: torch.Tensor, disturbance: torch.Tensor) -> None:
        """Set scale and weight by the errors of a vehicle under a disturbance (3,).

        The vehicle was fitted with one Euler step.
        """
        data = self.dataset
        dt = data.provenance.dt
        predicted = change(torch.from_numpy(data.z), parameters, dt, 1) + dt * disturbance
        errors = ((predicted - torch.from_numpy(data.y)) / self.scale).numpy()
        spread = MAD * np.median(np.abs(errors), axis=0)
        noise = self.noise / self.scale.numpy()
        self.circular = data.provenance.force_from_a_x or bool(spread[0] < _NO_SENSOR * noise[0])
        spread = np.maximum(spread, noise)
        self.scale = self.scale * torch.from_numpy(np.maximum(spread, 1.0))
        share = len(self.z) / len(data)
        repeated = 1.0 + 2.0 * share * autocorrelation(errors, data)
        self.weight = float(np.mean(np.clip(spread, _LEAST_SPREAD, 1.0) ** -2.0 / repeated))


class _Problem:
    """Robust least squares in the logarithms of the parameters over the priors' centres.

    The unknowns are those of the body, then for each surface those of the road (the tyres) and the
    disturbances in units of their priors' widths. If the vehicle is `slowed`, the body has a drag
    and the road a rolling resistance.
    """

    def __init__(
        self, surfaces: Sequence[_Surface], prior: dict[str, Parameter], *, slowed: bool
    ) -> None:
        self.surfaces = surfaces
        self.steps = 1
        self._dt = surfaces[0].dataset.provenance.dt
        self._body = [*BODY, *(DRAG if slowed else ())]
        road = [*TYRES, *(ROLLING if slowed else ())]
        own = [*self._body, *road]
        self.names = [name for name in PARAMETERS if name in own]
        self._order = [own.index(name) for name in self.names]
        self._centre = np.array([prior[name].centre for name in own])
        widths = np.array([prior[name].width for name in own])
        low = np.log([prior[name].low for name in own] / self._centre)
        high = np.log([prior[name].high for name in own] / self._centre)
        self._own = len(road) + NY
        self.size = len(self._body) + len(surfaces) * self._own
        self._low, self._high = self._all(low, -np.inf), self._all(high, np.inf)
        self._width = self._all(widths, 1.0)

    def _all(self, values: NDArray[np.float64], disturbance: float) -> NDArray[np.float64]:
        """Return the values of a surface's parameters for all unknowns."""
        body, road = np.split(values, [len(self._body)])
        own = np.concatenate([road, np.full(NY, disturbance)])
        return np.concatenate([body, np.tile(own, len(self.surfaces))])

    def _columns(self, number: int) -> NDArray[np.int64]:
        body = len(self._body)
        first = body + number * self._own
        return np.concatenate([np.arange(body), np.arange(first, first + self._own)])

    def parts(self, x: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return the unknowns of each surface: body, road, disturbances."""
        return [x[self._columns(number)] for number in range(len(self.surfaces))]

    def physical(
        self, surface: _Surface, unknowns: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the parameters of `names` and the disturbance (3,) in physical units."""
        count = len(self._centre)
        parameters = torch.from_numpy(self._centre) * unknowns[..., :count].exp()
        return parameters[..., self._order], surface.disturbance * unknowns[..., count:]

    def stable_steps(self, x: NDArray[np.float64]) -> int:
        """Return the number of Euler steps with which the vehicles of all surfaces are stable."""
        of_surfaces = zip(self.surfaces, self.parts(x), strict=True)
        vehicles = [
            self.physical(surface, torch.from_numpy(own))[0] for surface, own in of_surfaces
        ]
        return max(euler_steps(vehicle.numpy(), self._dt) for vehicle in vehicles)

    def _errors(self, surface: _Surface, unknowns: torch.Tensor) -> torch.Tensor:
        """Errors of a surface (3n,), whose squares are the robust loss `soft_l1`."""
        parameters, disturbance = self.physical(surface, unknowns)
        predicted = change(surface.z, parameters, self._dt, self.steps) + self._dt * disturbance
        error = (predicted - surface.y) / surface.scale
        # 2 (sqrt(1 + e²) - 1) = (e sqrt(2 / (1 + sqrt(1 + e²))))²
        robust = error * (2.0 / (1.0 + (1.0 + error**2).sqrt())).sqrt()
        return math.sqrt(surface.weight) * robust.flatten()

    def _errors_and_slopes(
        self, surface: _Surface, own: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the errors (3n,) of a surface and their derivatives (3n, u) by its u unknowns.

        Each transition gets a copy of the unknowns, so that the sum of an output's errors has the
        derivatives of all transitions: three backward passes suffice.
        """
        copies = torch.from_numpy(own).repeat(len(surface.y), 1).requires_grad_()
        errors = self._errors(surface, copies)
        outputs = errors.reshape(-1, NY).sum(0)
        slopes = [torch.autograd.grad(y, copies, retain_graph=True)[0] for y in outputs]
        return errors.detach().numpy(), torch.stack(slopes, dim=1).flatten(0, 1).numpy()

    def _normal_equations(
        self, x: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Return Jᵀ J, Jᵀ r and rᵀ r of the residuals r at x, those of the priors included."""
        square = np.diag(self._width**-2.0)
        gradient = x / self._width**2
        total = float(gradient @ x)
        for number, (surface, own) in enumerate(zip(self.surfaces, self.parts(x), strict=True)):
            columns = self._columns(number)
            errors, slopes = self._errors_and_slopes(surface, own)
            square[np.ix_(columns, columns)] += slopes.T @ slopes
            gradient[columns] += slopes.T @ errors
            total += float(errors @ errors)
        return square, gradient, total

    def solve(self, start: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
        """Return the unknowns of largest posterior density.

        The search ends where an iteration changes the sum of squares by less than `tolerance` of
        it.
        """
        problem = NormalEquationProblem(self._normal_equations)
        message = "their sum of squares is not finite"
        if np.isfinite(problem.residuals(start)).all():
            found = least_squares(
                problem.residuals,
                start,
                jac=problem.jacobian,
                bounds=(self._low, self._high),
                ftol=tolerance,
            )
            if found.success and np.isfinite(found.cost):
                return np.asarray(found.x)
            message = found.message
        raise VehicleFitError(
            f"no single-track vehicle fits the data ({message}): check their units"
        )

    def vehicles(self, x: NDArray[np.float64]) -> list[FittedVehicle]:
        """Return the vehicle of each surface with its intervals."""
        square, _, _ = self._normal_equations(x)
        covariance = np.asarray(np.linalg.inv(square), dtype=np.float64)
        spread = np.sqrt(np.diag(covariance))
        at_bound = (x - self._low < _AT_BOUND) | (self._high - x < _AT_BOUND)
        circular = any(surface.circular for surface in self.surfaces)
        found = []
        for number in range(len(self.surfaces)):
            columns = self._columns(number)[self._order]
            rows = zip(self.names, self._centre[self._order], columns, strict=True)
            parameters = tuple(
                FittedParameter(
                    name,
                    value=float(centre * np.exp(x[i])),
                    low=float(centre * np.exp(x[i] - NORMAL_95 * spread[i])),
                    high=float(centre * np.exp(x[i] + NORMAL_95 * spread[i])),
                    distance=float(x[i] / self._width[i]),
                    determined=bool(
                        spread[i] <= _DETERMINED * self._width[i]
                        and spread[i] <= KNOWN_WIDTHS.get(name, np.inf)
                        and not (circular and name == "m")
                    ),
                    at_bound=bool(at_bound[i]),
                    assumed=circular and name == "m",
                )
                for name, centre, i in rows
            )
            yaw_inertia = self._yaw_inertia(parameters, x, covariance)
            found.append(FittedVehicle(parameters, self.steps, (yaw_inertia,)))
        return found

    def _yaw_inertia(
        self,
        parameters: Sequence[FittedParameter],
        x: NDArray[np.float64],
        covariance: NDArray[np.float64],
    ) -> FittedParameter:
        """Return mass times k², whose logarithms the data may determine together or not at all."""
        both = [list(BODY).index(name) for name in ("m", "k²")]
        mass, gyration = (parameters[i] for i in both)
        value = mass.value * gyration.value
        factor = math.exp(NORMAL_95 * math.sqrt(covariance[np.ix_(both, both)].sum()))
        return FittedParameter(
            "I_z",
            value=value,
            low=value / factor,
            high=value * factor,
            distance=float(x[both].sum() / math.hypot(*self._width[both])),
            determined=mass.determined and gyration.determined,
            at_bound=mass.at_bound or gyration.at_bound,
            assumed=mass.assumed,
        )
