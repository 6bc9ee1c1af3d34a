"""A process with few points that uses all transitions.

The few hundred transitions that a member keeps do not average the noise of a log. Here the
member's inputs are the inducing points of Titsias' variational approximation (2009), which is
fitted to all transitions. The member's targets are then chosen such that the exact process with
these points and targets has the mean of the approximation, so that a library holds and predicts it
like any other process. Such targets are averages, and it does not matter how noisy the chosen
transitions were.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import torch

from egp_service._core import EgpError
from egp_service.training.gaussian_process import OutputProcess, exact

if TYPE_CHECKING:
    from collections.abc import Callable

_JITTER: Final = 1e-8  # of the prior variance, on the covariance of the inducing points


def fit_sparse(
    process: OutputProcess,
    z: torch.Tensor,
    y: torch.Tensor,
    iterations: int,
    report: Callable[[int, float], None],
) -> None:
    """Fit the hyperparameters of a process to z-scored z (n, 6) and y (n,) by L-BFGS.

    The inputs of `process` are the inducing points. `report` gets the iteration and the negative
    bound on the log marginal likelihood per transition, which is minimised.

    Raises:
        EgpError: if the bound is not finite.

    """
    parameters = list(process.parameters())
    optimiser = torch.optim.LBFGS(
        parameters, max_iter=1, history_size=10, line_search_fn="strong_wolfe"
    )
    found: tuple[torch.Tensor, torch.Tensor] | None = None

    def negative_bound() -> torch.Tensor:
        nonlocal found
        # Each step begins where the line search of the step before ended, whose loss and gradients
        # are still there.
        point = torch.cat([parameter.detach().flatten() for parameter in parameters])
        if found is not None and torch.equal(point, found[0]):
            return found[1]
        optimiser.zero_grad()
        loss = -_bound(process, z, y)[0] / len(y)
        loss.backward()  # type: ignore[no-untyped-call]
        found = point, loss
        return loss

    with exact():
        for iteration in range(iterations):
            step = optimiser.step(negative_bound)  # type: ignore[no-untyped-call]
            loss = float(step.detach())
            report(iteration, loss)
            if not math.isfinite(loss):
                raise EgpError(
                    "the likelihood of a sparse process is not finite; look for constant or "
                    "duplicate columns in the data"
                )


def posterior_mean(process: OutputProcess, z: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Mean (n,) of the approximation at z (n, 6) given z and the z-scored targets y (n,)."""
    with torch.no_grad(), exact():
        _, alpha = _bound(process, z, y)
        K = process.covar_module(z, process.inputs).to_dense()
        mean: torch.Tensor = process.mean_module(z) + K @ alpha
    return mean


def average_targets(process: OutputProcess, z: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Targets (M,) at the inputs of `process` that give it the mean of the approximation.

    With `alpha` such that this mean is `constant + k(z, Z) alpha`, the targets are
    `constant + (K + s² I) alpha`.
    """
    with torch.no_grad(), exact():
        _, alpha = _bound(process, z, y)
        K = process.covar_module(process.inputs).to_dense()
        K.diagonal().add_(process.likelihood.noise)
        targets: torch.Tensor = process.mean_module(process.inputs) + K @ alpha
    return targets


def _bound(
    process: OutputProcess, z: torch.Tensor, y: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Titsias' lower bound on the log marginal likelihood, and the weights alpha (M,).

    With `A = L⁻¹ K_mn / s`, `K_mm = L Lᵀ` and `B = I + A Aᵀ`, as in Titsias (2009), eq. (9).
    """
    inducing, noise = process.inputs, process.likelihood.noise[0]
    prior = process.covar_module.outputscale
    K = process.covar_module(inducing).to_dense()
    eye = torch.eye(len(inducing), dtype=K.dtype, device=K.device)
    L = torch.linalg.cholesky(K + _JITTER * prior * eye)
    A = torch.linalg.solve_triangular(
        L, process.covar_module(inducing, z).to_dense() / noise.sqrt(), upper=False
    )
    LB = torch.linalg.cholesky(eye + A @ A.T)
    rest = (y - process.mean_module(z)) / noise.sqrt()
    c = torch.linalg.solve_triangular(LB, (A @ rest)[:, None], upper=False)
    bound = 0.5 * (
        (c * c).sum()
        - rest @ rest
        - len(y) * torch.log(2.0 * torch.pi * noise)
        - 2.0 * LB.diagonal().log().sum()
        - len(y) * prior / noise
        + (A * A).sum()
    )
    inner = torch.linalg.solve_triangular(LB.T, c, upper=True)
    return bound, torch.linalg.solve_triangular(L.T, inner, upper=True)[:, 0]
