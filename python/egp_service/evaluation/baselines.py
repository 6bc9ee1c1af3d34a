"""Baselines as libraries: their members are vehicles without GPs.

The nominal vehicles are not fitted to data; their parameters are those published with CommonRoad,
or those that the library states of its vehicle.
Equations: `SingleTrack` and `Kinematic` in `rust/core/src/vehicle`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from egp_service._core import EgpError, Library, MemberData, VehicleParameters, write_library
from egp_service.quantities import NY, NZ
from egp_service.training.euler import euler_steps
from egp_service.training.vehicle_priors import priors
from egp_service.vehicle import simulated_name

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from egp_service._core import Member

KINDS: Final = ("fitted", "single-track", "kinematic")
# The middle of the roads' frictions, the best choice without adaptation.
NOMINAL_FRICTION: Final = 0.8
# Mass, kg; centre of mass to front and rear axle, m; yaw inertia, kg m²; height of that centre, m.
_CHASSIS: Final = {
    1: (1225.887, 0.88392, 1.50876, 1538.853371, 0.557784),
    2: (1093.2952, 1.1561957064, 1.4227170936, 1791.599521, 0.574),
}
# Cornering stiffness over load, 1/rad, of CommonRoad's single-track vehicle.
_STIFFNESS: Final = 20.898
# Shape C of the tyres; beyond its peak the force decreases as that of the simulated tyres does.
_SHAPE: Final = 1.5
_NO_LIMIT: Final = 1e6  # of the longitudinal grip: the tyres let every force through
_NO_COUPLING: Final = 1e-6  # of drive and braking with the lateral force


def single_track(vehicle: int | VehicleParameters) -> NDArray[np.float64]:
    """Parameters (17,) of a vehicle with lateral saturation at `NOMINAL_FRICTION`."""
    mass, front, rear, inertia, height = _chassis(vehicle)
    stiffness = _STIFFNESS / (_SHAPE * NOMINAL_FRICTION)
    tyre = (_NO_COUPLING, _NO_COUPLING, NOMINAL_FRICTION, stiffness, _SHAPE)
    body = (mass, front, rear, inertia / mass, height, _NO_LIMIT, _NO_LIMIT)
    return np.array([*body, *tyre, *tyre])


def kinematic(vehicle: int | VehicleParameters) -> NDArray[np.float64]:
    """Parameters (3,) of a vehicle whose wheels roll without slip."""
    return np.array(_chassis(vehicle)[:3])


def _chassis(vehicle: int | VehicleParameters) -> tuple[float, ...]:
    """Return the chassis of a CommonRoad number, or of parameters, which state no height."""
    if isinstance(vehicle, int):
        return _CHASSIS[vehicle]
    height = priors(vehicle)["h"].centre
    return vehicle.mass, vehicle.l_f, vehicle.l_r, vehicle.yaw_inertia, height


def write(path: Path, kind: str, source: Path, members: Sequence[int], vehicle: int | None) -> None:
    """Write the library of a baseline for comparison with members of the library `source`.

    `fitted` contains the vehicle of each of these members. `single-track` and `kinematic` contain
    one CommonRoad vehicle with the number `vehicle`, or without a number the vehicle of `source`,
    with the range of all their training data.

    Raises:
        EgpError: if a member has no vehicle.

    """
    library = Library.load(source)
    chosen = [library.members[index] for index in members]
    name, parameters = library.vehicle, library.parameters
    if kind == "fitted":
        alone = [_fitted(member) for member in chosen]
    else:
        if vehicle is not None:
            name, parameters = simulated_name(vehicle), VehicleParameters.commonroad(vehicle)
        known = parameters if vehicle is None else vehicle
        model: dict[str, Any] = {"kinematic": kinematic(known)}
        if kind == "single-track":
            tyred = single_track(known)
            model = {"single_track": tyred, "euler_steps": euler_steps(tyred, library.dt)}
        envelope = np.array(
            [
                np.min([member.envelope[0] for member in chosen], axis=0),
                np.max([member.envelope[1] for member in chosen], axis=0),
            ]
        )
        alone = [_vehicle_alone(kind, NOMINAL_FRICTION, chosen[0], envelope, model)]
    write_library(
        path,
        dt=library.dt,
        kernel=library.kernel,
        vehicle=name,
        parameters=parameters,
        members=alone,
        provenance={"baseline": kind, "subset_of": library.id},
    )


def _fitted(member: Member) -> MemberData:
    if member.single_track is None:
        raise EgpError(f"{member.label} has no vehicle: train with mean = 'single-track'")
    vehicle: dict[str, Any] = {
        "single_track": member.single_track,
        "euler_steps": member.euler_steps,
    }
    if member.resistance is not None and member.resistance.any():
        vehicle["resistance"] = member.resistance
    return _vehicle_alone(member.label, member.friction, member, member.envelope, vehicle)


def _vehicle_alone(
    label: str,
    friction: float,
    like: Member,
    envelope: NDArray[np.float64],
    vehicle: Mapping[str, Any],
) -> MemberData:
    """Return a member without training points; its noise and its data are those of `like`.

    `vehicle` has the parameters that `MemberData` takes.
    """
    return MemberData(
        label=label,
        friction=friction,
        dataset=like.dataset,
        inputs=np.empty((0, NZ)),
        targets=np.empty((0, NY)),
        input_mean=np.zeros(NZ),
        input_std=np.ones(NZ),
        target_mean=np.zeros(NY),
        target_std=like.noise_std,
        lengthscales=np.ones((NY, NZ)),
        outputscale=np.zeros(NY),
        noise=np.ones(NY),
        constant=np.zeros(NY),
        alpha=np.empty((NY, 0)),
        envelope=envelope,
        golden_z=np.empty((0, NZ)),
        golden_mean=np.empty((0, NY)),
        golden_jacobian=np.empty((0, NY, NZ)),
        golden_variance=np.empty((0, NY)),
        **vehicle,
    )
