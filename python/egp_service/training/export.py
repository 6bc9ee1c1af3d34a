"""Export of trained members to a library file, with GPyTorch's predictions for its self-test."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import MemberData, write_library
from egp_service.data.channels import channels
from egp_service.training.threads import one_thread
from egp_service.training.vehicle_priors import SINGLE_TRACK
from egp_service.vehicle import known_vehicle, simulated_vehicle

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters
    from egp_service.training.train import TrainingSettings
    from egp_service.training.trained import TrainedMember

_INSIDE: Final = 12
_OUTSIDE: Final = 4


def export(
    path: Path,
    members: Sequence[TrainedMember],
    settings: TrainingSettings,
    provenance: Mapping[str, str],
    vehicle: VehicleParameters | None = None,
) -> None:
    """Write the members as one library; the writer verifies it by loading it again.

    Without `vehicle` the data must come from a simulated one, whose parameters are known. A library
    that was trained on logs states noise and delay of their measured states, from which the control
    step takes them.

    Raises:
        EgpError: if the vehicle is neither given nor simulated.
        LibraryError: if the members do not pass the checks of the library.

    """
    first = members[0].dataset.provenance
    with one_thread(settings.max_points):
        exported = [_member(member) for member in members]
    write_library(
        path,
        dt=first.dt,
        kernel=settings.kernel,
        vehicle=first.vehicle,
        parameters=vehicle or known_vehicle(first.vehicle),
        members=exported,
        provenance={**provenance, **_findings(members)},
        measurement_noise=_measurement_noise(members),
        measurement_delay=_measurement_delay(members),
    )


def _measurement_noise(members: Sequence[TrainedMember]) -> NDArray[np.float64] | None:
    """Return the noise (3,) of `[v_x, v_y, omega]` in the noisiest log of each channel.

    A log that has too few consecutive transitions above 5 m/s does not tell its noise, and is left
    out. None if this applies to all logs, if a channel's values are held over periods in all
    others, or if the data were simulated, which have exact states.
    """
    if simulated_vehicle(members[0].dataset.provenance.vehicle) is not None:
        return None
    found = np.array([channels(member.dataset).noise for member in members])
    told = found[~np.isnan(found).all(axis=1)]
    if len(told) == 0:
        return None
    noise: NDArray[np.float64] = told.max(axis=0)
    return noise if np.all(noise > 0.0) else None


def _measurement_delay(members: Sequence[TrainedMember]) -> float | None:
    """Return the delay in s by which the members' inputs were moved; None if there is none."""
    delays = members[0].delays
    return delays.measurement if delays is not None and delays.measurement > 0.0 else None


def _findings(members: Sequence[TrainedMember]) -> dict[str, str]:
    """Return what training found out about each member, as JSON by the member's label.

    These are the fit of its vehicle, and its kind with the likelihoods of all kinds.
    """
    found: dict[str, dict[str, object]] = {}
    for member in members:
        own: dict[str, object] = {}
        if member.vehicle is not None:
            own["vehicle"] = member.vehicle.summary()
        if member.kind:
            likelihoods = {name: round(value, 4) for name, value in member.likelihoods.items()}
            own |= {"kind": member.kind, "likelihoods": likelihoods}
        if own:
            found[member.dataset.provenance.surface] = own
    return {"members": json.dumps(found, sort_keys=True)} if found else {}


def _member(member: TrainedMember) -> MemberData:
    golden_z = _golden_points(member.inputs)
    golden_mean, golden_jacobian, golden_variance = member.predict(golden_z)
    values = [process.hyperparameters for process in member.processes]
    scaling, fitted = member.scaling, member.mean.single_track
    return MemberData(
        label=member.dataset.provenance.surface,
        friction=member.dataset.provenance.friction,
        dataset=member.dataset.digest(),
        inputs=member.inputs,
        targets=member.targets,
        input_mean=scaling.input_mean,
        input_std=scaling.input_std,
        target_mean=scaling.target_mean,
        target_std=scaling.target_std,
        lengthscales=np.array([v.lengthscales for v in values]),
        outputscale=np.array([v.outputscale for v in values]),
        noise=np.array([v.noise for v in values]),
        constant=np.array([v.constant for v in values]),
        alpha=member.alpha,
        # The envelope is that of all training data: between the chosen points GPs interpolate.
        envelope=np.stack([member.dataset.z.min(axis=0), member.dataset.z.max(axis=0)]),
        golden_z=golden_z,
        golden_mean=golden_mean,
        golden_jacobian=golden_jacobian,
        golden_variance=golden_variance,
        single_track=None if fitted is None else fitted[:SINGLE_TRACK],
        resistance=None if fitted is None or len(fitted) == SINGLE_TRACK else fitted[SINGLE_TRACK:],
        kinematic=member.mean.kinematic,
        euler_steps=member.mean.steps,
    )


def _golden_points(inputs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return midpoints of training points, then points up to three ranges outside."""
    n = len(inputs)
    at = np.linspace(0, n - 1, _INSIDE).astype(int)
    inside = 0.5 * (inputs[at] + inputs[(at + n // 2) % n])
    low, high = inputs.min(axis=0), inputs.max(axis=0)
    outside = [high + factor * (high - low) for factor in np.linspace(-4.0, 3.0, _OUTSIDE)]
    return np.vstack([inside, outside])
