"""Export of trained members to a library file, with GPyTorch's predictions for its self-test."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

import numpy as np
import torch

from egp_service._core import MemberData, write_library
from egp_service.training.gaussian_process import exact
from egp_service.vehicle import known_vehicle

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters
    from egp_service.training.train import TrainedMember, TrainingSettings

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

    Without `vehicle` the data must come from a simulated one, whose parameters are known.

    Raises:
        EgpError: if the vehicle is neither given nor simulated.
        LibraryError: if the members do not pass the checks of the library.

    """
    first = members[0].dataset.provenance
    write_library(
        path,
        dt=first.dt,
        kernel=settings.kernel,
        vehicle=first.vehicle,
        parameters=vehicle or known_vehicle(first.vehicle),
        members=[_member(member) for member in members],
        provenance={**provenance, **_fits(members)},
    )


def _fits(members: Sequence[TrainedMember]) -> dict[str, str]:
    """Return what the fit of each member's vehicle found out, as JSON by the member's label."""
    fits = {
        member.dataset.provenance.surface: member.vehicle.summary()
        for member in members
        if member.vehicle is not None
    }
    return {"vehicle fits": json.dumps(fits, sort_keys=True)} if fits else {}


def _member(member: TrainedMember) -> MemberData:
    golden_z = _golden_points(member.inputs)
    golden_mean, golden_jacobian, golden_variance = member.predict(golden_z)
    values = [process.hyperparameters for process in member.processes]
    return MemberData(
        label=member.dataset.provenance.surface,
        friction=member.dataset.provenance.friction,
        dataset=member.dataset.digest(),
        inputs=member.inputs,
        targets=member.targets,
        input_mean=member.input_mean,
        input_std=member.input_std,
        target_mean=member.target_mean,
        target_std=member.target_std,
        lengthscales=np.array([v.lengthscales for v in values]),
        outputscale=np.array([v.outputscale for v in values]),
        noise=np.array([v.noise for v in values]),
        constant=np.array([v.constant for v in values]),
        alpha=_alpha(member),
        # The envelope is that of all training data: between the chosen points GPs interpolate.
        envelope=np.stack([member.dataset.z.min(axis=0), member.dataset.z.max(axis=0)]),
        golden_z=golden_z,
        golden_mean=golden_mean,
        golden_jacobian=golden_jacobian,
        golden_variance=golden_variance,
        single_track=member.single_track,
    )


def _alpha(member: TrainedMember) -> NDArray[np.float64]:
    """Solve `(K + s²I) alpha = y - constant` for every output, (3, M)."""
    rows = []
    with torch.no_grad(), exact():
        for process in member.processes:
            z = process.inputs
            K = process.covar_module(z).to_dense()
            K.diagonal().add_(process.likelihood.noise)
            y = process.train_targets - process.mean_module(z)
            rows.append(torch.cholesky_solve(y[:, None], torch.linalg.cholesky(K))[:, 0].cpu())
    return torch.stack(rows).numpy()


def _golden_points(inputs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return midpoints of training points, then points up to three ranges outside."""
    n = len(inputs)
    at = np.linspace(0, n - 1, _INSIDE).astype(int)
    inside = 0.5 * (inputs[at] + inputs[(at + n // 2) % n])
    low, high = inputs.min(axis=0), inputs.max(axis=0)
    outside = [high + factor * (high - low) for factor in np.linspace(-4.0, 3.0, _OUTSIDE)]
    return np.vstack([inside, outside])
