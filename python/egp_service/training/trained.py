"""A trained member: its processes, their scaling and what they are added to."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Final

import numpy as np
import torch

from egp_service.quantities import NY, NZ
from egp_service.training.gaussian_process import exact
from egp_service.training.threads import one_thread

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from egp_service.data.alignment import Delays
    from egp_service.data.dataset import Dataset
    from egp_service.training.gaussian_process import OutputProcess
    from egp_service.training.prior_mean import PriorMean
    from egp_service.training.vehicle_fit import FittedVehicle

# Inputs that GPyTorch predicts at once: it keeps a covariance of all of them with each other.
_BLOCK: Final = 1000


@dataclasses.dataclass(frozen=True, eq=False)
class Scaling:
    """The means and standard deviations that z-score inputs and targets."""

    input_mean: NDArray[np.float64]
    """Mean (6,) of the inputs of the training data, SI units as in `quantities.GP_INPUT`."""
    input_std: NDArray[np.float64]
    """Standard deviation (6,) of the same."""
    target_mean: NDArray[np.float64]
    """Mean (3,) of the targets less the prior mean's prediction, as in `quantities.GP_OUTPUT`."""
    target_std: NDArray[np.float64]
    """Standard deviation (3,) of the same."""

    @staticmethod
    def of(
        z: NDArray[np.float64], target_mean: NDArray[np.float64], target_std: NDArray[np.float64]
    ) -> Scaling:
        """Scale inputs by the statistics of z (n, 6), and targets by the given ones."""
        return Scaling(z.mean(axis=0), z.std(axis=0), target_mean, target_std)

    def inputs(self, z: NDArray[np.float64]) -> torch.Tensor:
        """Return z-scored inputs (n, 6) in float64."""
        return torch.tensor((z - self.input_mean) / self.input_std, dtype=torch.float64)

    def targets(self, y: NDArray[np.float64]) -> torch.Tensor:
        """Return z-scored targets (n, 3) in float64."""
        return torch.tensor((y - self.target_mean) / self.target_std, dtype=torch.float64)

    def query(self, z: torch.Tensor) -> torch.Tensor:
        """Return z-scored inputs (n, 6) with their derivatives."""
        return (z - z.new_tensor(self.input_mean)) / z.new_tensor(self.input_std)


@dataclasses.dataclass(frozen=True, eq=False)
class TrainedMember:
    """One surface's processes with their scaling."""

    dataset: Dataset
    """The training data before the selection, whose hash and bounds are exported."""
    validation: Dataset
    """The held-out trajectories."""
    inputs: NDArray[np.float64]
    """The chosen transitions' inputs z (M, 6), SI units as in `quantities.GP_INPUT`."""
    targets: NDArray[np.float64]
    """Their targets (M, 3), SI units as in `quantities.GP_OUTPUT`: the transitions' changes, or
    averages over all transitions (`sparse.average_targets`)."""
    scaling: Scaling
    processes: tuple[OutputProcess, ...]
    """Processes of the three outputs, with z-scored inputs and targets."""
    mean: PriorMean
    """What the processes are added to."""
    vehicle: FittedVehicle | None
    """The fitted single-track vehicle with intervals of its parameters, if one was fitted."""

    delays: Delays | None = None
    """Delays by which the inputs of a log were moved before training; None for simulated data."""
    kind: str = ""
    """The kind that was chosen among those of `choice.KINDS`, if there was a choice."""
    likelihoods: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Held-out log likelihood of each kind relative to no change, in nats per error."""

    def predict_mean(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mean (n, 3) at z (n, 6), physical units."""
        with torch.no_grad():
            query = torch.tensor(z, dtype=torch.float64)
            mean = self.mean.change(query, self.dataset.provenance.dt)
            scaled = self.scaling.query(query)
            covariance: dict[torch.nn.Module, torch.Tensor] = {}
            for j, process in enumerate(self.processes):
                kernel = process.covar_module
                if kernel not in covariance:  # outputs may share theirs
                    covariance[kernel] = kernel(scaled, process.inputs).to_dense()
                f = process.mean_module(scaled) + covariance[kernel] @ query.new_tensor(
                    self.alpha[j]
                )
                mean[:, j] += f * self.scaling.target_std[j] + self.scaling.target_mean[j]
        return np.asarray(mean.numpy())

    @functools.cached_property
    def alpha(self) -> NDArray[np.float64]:
        """Solution of `(K + s²I) alpha = y - constant` for every output, (3, M), z-scored."""
        rows = []
        with torch.no_grad(), exact(), one_thread(len(self.inputs)):
            for process in self.processes:
                z = process.inputs
                K = process.covar_module(z).to_dense()
                K.diagonal().add_(process.likelihood.noise)
                y = process.train_targets - process.mean_module(z)
                rows.append(torch.cholesky_solve(y[:, None], torch.linalg.cholesky(K))[:, 0])
        return torch.stack(rows).numpy()

    @property
    def noise_variance(self) -> NDArray[np.float64]:
        """Variance (3,) of the noise of each output, in its units squared."""
        noise = [process.hyperparameters.noise for process in self.processes]
        return np.asarray(np.array(noise) * self.scaling.target_std**2)

    def predict(
        self, z: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Mean (n, 3), autograd Jacobian (n, 3, 6) and latent variance (n, 3), physical units.

        They are GPyTorch's own, by its own kernel: what a library's predictions are compared with.
        """
        firsts = range(0, max(len(z), 1), _BLOCK)
        blocks = [self._predict_block(z[first : first + _BLOCK]) for first in firsts]
        mean, jacobian, variance = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        return mean, jacobian, variance

    def _predict_block(
        self, z: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        query = torch.tensor(z, dtype=torch.float64, requires_grad=True)
        scaled = self.scaling.query(query)
        target_mean, target_std = self.scaling.target_mean, self.scaling.target_std
        mean, variance = np.empty((len(z), NY)), np.empty((len(z), NY))
        jacobian = np.empty((len(z), NY, NZ))
        known = self.mean.change(query, self.dataset.provenance.dt)
        with exact():
            for j, process in enumerate(self.processes):
                posterior = process.with_gpytorch_kernel()(scaled)
                f = posterior.mean * target_std[j] + target_mean[j] + known[:, j]
                # Row i of the mean depends on row i of the query only, so one backward pass of
                # the sum gives the gradients of all rows.
                (gradient,) = torch.autograd.grad(f.sum(), query, retain_graph=True)
                mean[:, j] = f.detach().numpy()
                variance[:, j] = posterior.variance.detach().numpy() * target_std[j] ** 2
                jacobian[:, j] = gradient.numpy()
        return mean, jacobian, variance
