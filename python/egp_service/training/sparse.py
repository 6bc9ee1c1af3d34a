"""A process with few points that uses all transitions.

The few hundred transitions that a member keeps do not average the noise of a log, nor what states
that are not measured do to a simulated vehicle. Here the member's inputs are the inducing points of
Titsias' variational approximation ("Variational Learning of Inducing Variables in Sparse Gaussian
Processes", 2009), which is fitted to all transitions. The member's targets are then chosen such
that the exact process with these points and targets has the mean of the approximation, so that a
library holds and predicts it like any other process. Such targets are averages, and it does not
matter how noisy the chosen transitions were.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import torch

from egp_service._core import EgpError
from egp_service.training.gaussian_process import OutputProcess, exact

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

FITTED: Final = 3000
"""Transitions to which the hyperparameters of a member are fitted, drawn at random."""
_JITTER: Final = 1e-8  # of the prior variance, on the covariance of the inducing points
# Evaluations of the bound that a line search may need. Without `max_eval` torch allows only one for
# each iteration, and where the first step is too long the fit stays where it is from then on.
_LINE_SEARCH: Final = 25
_BLOCK: Final = 4096  # transitions whose covariances with the inducing points are held at a time


def fit_sparse(
    processes: Sequence[OutputProcess],
    z: torch.Tensor,
    y: Sequence[torch.Tensor],
    iterations: int,
    report: Callable[[int, float], None],
) -> None:
    """Fit the hyperparameters of processes to z-scored z (n, 6) and their targets (n,) by L-BFGS.

    The processes share inputs, kernel and noise, as in `share_kernel`; their inputs are the
    inducing points. `report` gets the iteration and the negative bound on the log marginal
    likelihood, for each transition and process, which is minimised.

    If the data contain nothing for the process to learn, the bound is flat towards infinite
    lengthscales and a vanishing scale, where the covariance cannot be factorised. The fit then ends
    at the hyperparameters where the step began that led there.

    Raises:
        EgpError: if the bound at the start is not finite.

    """
    # Each parameter once, also if processes share it.
    parameters = list(dict.fromkeys(p for process in processes for p in process.parameters()))
    optimiser = torch.optim.LBFGS(
        parameters,
        max_iter=1,
        max_eval=1 + _LINE_SEARCH,
        history_size=10,
        line_search_fn="strong_wolfe",
    )
    found: tuple[torch.Tensor, torch.Tensor] | None = None
    # Where the last step began whose bound there is finite.
    good: torch.Tensor | None = None
    begins = True

    def negative_bound() -> torch.Tensor:
        nonlocal found, good, begins
        # Each step begins where the line search of the step before ended, whose loss and gradients
        # are still there.
        point = torch.cat([parameter.detach().flatten() for parameter in parameters])
        if found is None or not torch.equal(point, found[0]):
            optimiser.zero_grad()
            loss = -_bound(processes, z, y) / (len(processes) * len(z))
            loss.backward()  # type: ignore[no-untyped-call]
            found = point, loss
        if begins and torch.isfinite(found[1]):
            good, begins = point, False
        return found[1]

    with exact():
        for iteration in range(iterations):
            begins = True
            try:
                step = optimiser.step(negative_bound)  # type: ignore[no-untyped-call]
                loss = float(step.detach())
            except torch.linalg.LinAlgError:  # type: ignore[attr-defined]
                loss = math.nan
            if math.isfinite(loss):
                report(iteration, loss)
                continue
            if good is None:
                raise EgpError(
                    "the likelihood of a sparse process is not finite; look for constant or "
                    "duplicate columns in the data"
                )
            torch.nn.utils.vector_to_parameters(good, parameters)
            return


class PosteriorMean:
    """The mean of the approximation at transitions, for any targets of theirs."""

    def __init__(self, process: OutputProcess, z: torch.Tensor) -> None:
        """Prepare the mean at z (n, 6) with M inducing points; holds M n numbers."""
        with torch.no_grad(), exact():
            self._prior: torch.Tensor = process.mean_module(z)
            self._noise = process.likelihood.noise[0]
            self._A = _whitened(process, _factor(process), z)
            self._LB = _factor_of_one_and(self._A @ self._A.T / self._noise)

    def given(self, y: torch.Tensor) -> torch.Tensor:
        """Return the mean (n,) given z-scored targets y (n,), `m + Aᵀ B⁻¹ A (y - m) / s²`."""
        with torch.no_grad():
            rest = (self._A @ (y - self._prior))[:, None] / self._noise
            inner = torch.cholesky_solve(rest, self._LB)[:, 0]
            mean: torch.Tensor = self._prior + self._A.T @ inner
        return mean


def average_targets(
    processes: Sequence[OutputProcess], z: torch.Tensor, y: Sequence[torch.Tensor]
) -> list[torch.Tensor]:
    """Targets (M,) at the inputs of each process that give it the mean of its approximation.

    The processes share inputs, kernel and noise; `y` has the targets (n,) of each at z (n, 6). A
    mean is `constant + k(z, Z) alpha` with `alpha = L⁻ᵀ B⁻¹ A (y - m) / s²`, and the targets are
    `constant + (K + s² I) alpha`. The sums over the transitions are computed block by block, so
    that the memory does not grow with a log.
    """
    first = processes[0]
    with torch.no_grad(), exact():
        L, noise = _factor(first), first.likelihood.noise[0]
        square = torch.zeros_like(L)
        sums = [L.new_zeros(len(L), 1) for _ in processes]
        for block in range(0, len(z), _BLOCK):
            rows = slice(block, block + _BLOCK)
            A = _whitened(first, L, z[rows])
            square += A @ A.T / noise
            for process, targets, total in zip(processes, y, sums, strict=True):
                rest = targets[rows] - process.mean_module(z[rows])
                total.add_((A @ rest)[:, None] / noise)
        LB = _factor_of_one_and(square)
        K = first.covar_module(first.inputs).to_dense()
        K.diagonal().add_(first.likelihood.noise)
        found = []
        for process, total in zip(processes, sums, strict=True):
            inner = torch.cholesky_solve(total, LB)
            alpha = torch.linalg.solve_triangular(L.T, inner, upper=True)[:, 0]
            found.append(process.mean_module(process.inputs) + K @ alpha)
    return found


def _factor(process: OutputProcess) -> torch.Tensor:
    """Cholesky factor L of the covariance of the inducing points."""
    K = process.covar_module(process.inputs).to_dense()
    prior = process.covar_module.outputscale
    eye = torch.eye(len(K), dtype=K.dtype)
    factor: torch.Tensor = torch.linalg.cholesky(K + _JITTER * prior * eye)
    return factor


def _whitened(process: OutputProcess, L: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
    """Return `A = L⁻¹ K_mn` (M, n), with K_mn between the inducing points and z."""
    across = process.covar_module(process.inputs, z).to_dense()
    A: torch.Tensor = torch.linalg.solve_triangular(L, across, upper=False)
    return A


def _factor_of_one_and(square: torch.Tensor) -> torch.Tensor:
    """Cholesky factor of `B = I + A Aᵀ / s²`, given the second term (M, M)."""
    eye = torch.eye(len(square), dtype=square.dtype)
    factor: torch.Tensor = torch.linalg.cholesky(eye + square)
    return factor


def _bound(
    processes: Sequence[OutputProcess], z: torch.Tensor, y: Sequence[torch.Tensor]
) -> torch.Tensor:
    """Titsias' lower bound on the log marginal likelihood (eq. 9), summed over the processes.

    The matrix to invert is `B = I + A Aᵀ / s²`, with A as `_whitened` returns it. The processes
    share it.
    """
    first = processes[0]
    noise, prior = first.likelihood.noise[0], first.covar_module.outputscale
    A = _whitened(first, _factor(first), z)
    square = A @ A.T / noise
    LB = _factor_of_one_and(square)

    def bound(process: OutputProcess, targets: torch.Tensor) -> torch.Tensor:
        rest = targets - process.mean_module(z)
        c = torch.linalg.solve_triangular(LB, (A @ rest)[:, None] / noise, upper=False)
        found: torch.Tensor = 0.5 * (
            (c * c).sum()
            - rest @ rest / noise
            - len(z) * torch.log(2.0 * torch.pi * noise)
            - 2.0 * LB.diagonal().log().sum()
            - len(z) * prior / noise
            + square.trace()
        )
        return found

    bounds = [bound(process, targets) for process, targets in zip(processes, y, strict=True)]
    return torch.stack(bounds).sum()
