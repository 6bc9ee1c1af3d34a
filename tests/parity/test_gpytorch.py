"""Predictions of a library against GPyTorch's exact GPs, among the data and far outside."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, get_args

import gpytorch
import numpy as np
import pytest
import torch

from egp_service._core import Library, MemberData, VehicleParameters, write_library
from egp_service.training.kernel import KernelName
from library_example import CENTRE, HALF_WIDTH, change

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

# Of the output's standard deviation, Jacobians for z-scored inputs; measured 4e-12.
MEAN_TOLERANCE = 1e-9
# Of the output's variance; measured 2e-13.
VARIANCE_TOLERANCE = 1e-8

KERNELS = {
    "rbf": gpytorch.kernels.RBFKernel,
    "matern52": functools.partial(gpytorch.kernels.MaternKernel, nu=2.5),
}


class ExactGp(gpytorch.models.ExactGP):  # type: ignore[misc]
    """Constant mean, scaled ARD kernel, Gaussian noise."""

    def __init__(self, x: torch.Tensor, y: torch.Tensor, kernel: str) -> None:
        """Build on z-scored data; hyperparameters are set afterwards."""
        super().__init__(x, y, gpytorch.likelihoods.GaussianLikelihood())
        self.mean_module = gpytorch.means.ConstantMean()
        base = KERNELS[kernel](ard_num_dims=6)
        self.covar_module = gpytorch.kernels.ScaleKernel(base)
        self.double()

    def forward(self, x: torch.Tensor) -> gpytorch.distributions.MultivariateNormal:
        """Return the prior at `x`."""
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


@dataclasses.dataclass
class Oracle:
    """Three GPyTorch models with scalers: one member."""

    z_mean: Array
    z_std: Array
    y_mean: Array
    y_std: Array
    models: list[ExactGp]

    def predict(self, z: Array) -> tuple[Array, Array, Array]:
        """Return mean, autograd Jacobian and latent variance in physical units."""
        columns = []
        with (
            gpytorch.settings.max_cholesky_size(10_000),
            gpytorch.settings.fast_pred_var(state=False),
        ):
            for model, shift, scale in zip(self.models, self.y_mean, self.y_std, strict=True):
                query = torch.tensor((z - self.z_mean) / self.z_std, requires_grad=True)
                latent = model(query)
                (gradient,) = torch.autograd.grad(latent.mean.sum(), query)
                columns.append(
                    (
                        shift + scale * latent.mean.detach().numpy(),
                        scale * gradient.numpy() / self.z_std,
                        scale**2 * latent.variance.detach().numpy(),
                    )
                )
        mean, jacobian, variance = zip(*columns, strict=True)
        return np.stack(mean, 1), np.stack(jacobian, 1), np.stack(variance, 1)


def build(kernel: str, n: int, seed: int) -> tuple[Oracle, MemberData]:
    """Return random data under random hyperparameters, as GPyTorch models and as a member."""
    rng = np.random.default_rng(seed)
    inputs = CENTRE + HALF_WIDTH * rng.uniform(-1.0, 1.0, (n, 6))
    targets = change(inputs, 0.8) + rng.normal(0.0, 0.003, (n, 3))
    z_mean, z_std = inputs.mean(axis=0), inputs.std(axis=0)
    y_mean, y_std = targets.mean(axis=0), targets.std(axis=0)
    x, y = (inputs - z_mean) / z_std, (targets - y_mean) / y_std
    lengthscales = rng.uniform(0.7, 6.0, (3, 6))
    outputscale, noise = rng.uniform(0.5, 3.0, 3), np.array([1e-3, 3e-4, 1e-2])
    constant = rng.normal(0.0, 0.3, 3)
    models, alpha = [], []
    for o in range(3):
        model = ExactGp(torch.tensor(x), torch.tensor(y[:, o]), kernel)
        model.covar_module.base_kernel.lengthscale = torch.tensor(lengthscales[o])
        model.covar_module.outputscale = torch.tensor(outputscale[o])
        model.likelihood.noise = torch.tensor(noise[o])
        model.mean_module.constant = torch.tensor(constant[o])
        model.eval()
        models.append(model)
        with torch.no_grad():
            # Constraints round the values that were set, so the values of the model are used.
            lengthscales[o] = model.covar_module.base_kernel.lengthscale.numpy()
            outputscale[o], noise[o] = (
                model.covar_module.outputscale.item(),
                model.likelihood.noise.item(),
            )
            constant[o] = model.mean_module.constant.item()
            covariance = model.covar_module(model.train_inputs[0]).to_dense()
            covariance += noise[o] * torch.eye(n, dtype=torch.float64)
            residual = (model.train_targets - constant[o]).unsqueeze(-1)
            factor = torch.linalg.cholesky(covariance)
            alpha.append(torch.cholesky_solve(residual, factor).squeeze(-1).numpy())
    oracle = Oracle(z_mean, z_std, y_mean, y_std, models)
    golden_z = queries(rng, x)[::10] * z_std + z_mean
    golden_mean, golden_jacobian, golden_variance = oracle.predict(golden_z)
    member = MemberData(
        label="random",
        friction=0.8,
        dataset="none",
        inputs=inputs,
        targets=targets,
        input_mean=z_mean,
        input_std=z_std,
        target_mean=y_mean,
        target_std=y_std,
        lengthscales=lengthscales,
        outputscale=outputscale,
        noise=noise,
        constant=constant,
        alpha=np.stack(alpha),
        envelope=np.stack([inputs.min(axis=0), inputs.max(axis=0)]),
        golden_z=golden_z,
        golden_mean=golden_mean,
        golden_jacobian=golden_jacobian,
        golden_variance=golden_variance,
    )
    return oracle, member


def queries(rng: np.random.Generator, x: Array) -> Array:
    """Return z-scored points: among the data, beside single points, at the edge, 10 std away."""
    direction = rng.normal(size=(20, 6))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.concatenate(
        [
            rng.uniform(x.min(), x.max(), (40, 6)),
            x[:20] + rng.normal(0.0, 1e-3, (20, 6)),
            3.0 * direction,
            10.0 * direction,
        ]
    )


@pytest.mark.parametrize("kernel", get_args(KernelName))
@pytest.mark.parametrize("n", [200, 700])
def test_predictions_match_gpytorch(tmp_path: Path, kernel: str, n: int) -> None:
    oracle, member = build(kernel, n, seed=n)
    path = tmp_path / "library.safetensors"
    write_library(
        path,
        dt=0.05,
        kernel=kernel,
        vehicle="commonroad-1",
        parameters=VehicleParameters.commonroad(1),
        members=[member],
        provenance={},
    )
    library = Library.load(path)
    x = np.asarray(oracle.models[0].train_inputs[0])
    z = queries(np.random.default_rng(1), x) * oracle.z_std + oracle.z_mean

    mean, jacobian, variance = library.predict(z)
    expected_mean, expected_jacobian, expected_variance = oracle.predict(z)

    y_std = oracle.y_std
    assert np.abs((mean - expected_mean) / y_std).max() < MEAN_TOLERANCE
    scaled = (jacobian - expected_jacobian) * oracle.z_std / y_std[:, None]
    assert np.abs(scaled).max() < MEAN_TOLERANCE
    assert np.abs((variance - expected_variance) / y_std**2).max() < VARIANCE_TOLERANCE
    assert np.abs((expected_mean - oracle.y_mean) / y_std).max() > 1.0, "the data carry a signal"
