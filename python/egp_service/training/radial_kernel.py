"""The kernels of a library for training, faster than GPyTorch's.

A kernel is a radial profile `phi(r²)` of the scaled distance `r² = sum_d ((x_d - y_d) / l_d)²`.
Training evaluates it and its gradients thousands of times for all pairs of many points. GPyTorch
lets autograd follow each elementary operation on the pairs; here the distances and the gradients
are matrix products, and only the profile and its derivative are computed by pair.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import torch
from gpytorch.kernels import Kernel

if TYPE_CHECKING:
    from collections.abc import Callable

    from egp_service.training.kernel import KernelName


def _rbf(squared: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return `exp(-r²/2)` and its derivative by r²."""
    value = torch.exp(-0.5 * squared)
    return value, -0.5 * value


def _matern52(squared: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return `(1 + q + q²/3) exp(-q)` with `q = r sqrt(5)`, and its derivative by r²."""
    q = (5.0 * squared).sqrt_()
    decay = torch.exp(-q)
    value = q.square().div_(3.0).add_(q).add_(1.0).mul_(decay)
    return value, q.add_(1.0).mul_(decay).mul_(-5.0 / 6.0)


_PROFILES: Final[dict[KernelName, Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]]]] = {
    "rbf": _rbf,
    "matern52": _matern52,
}


class RadialKernel(Kernel):  # type: ignore[misc]
    """A kernel of a library with one lengthscale per input; its values are those of GPyTorch."""

    has_lengthscale = True

    def __init__(self, name: KernelName, **options: Any) -> None:  # noqa: ANN401
        """Take the options of `gpytorch.kernels.Kernel`."""
        super().__init__(**options)
        self._profile = _PROFILES[name]

    def forward(
        self,
        x1: torch.Tensor,
        x2: torch.Tensor,
        diag: bool = False,  # noqa: FBT001, FBT002 - GPyTorch's interface
        **_: object,
    ) -> torch.Tensor:
        """Return the covariances (..., n, m) of x1 (..., n, d) and x2 (..., m, d).

        With `diag` there are as many of both, and their pairs have the covariances (..., n).
        """
        a, b = x1 / self.lengthscale, x2 / self.lengthscale
        if diag:
            a, b = a[..., None, :], b[..., None, :]
        covariance: torch.Tensor = _Covariance.apply(a, b, self._profile)
        return covariance[..., 0, 0] if diag else covariance


class _Covariance(torch.autograd.Function):
    """Values of a profile for all pairs of a (..., n, d) and b (..., m, d); differentiable once."""

    @staticmethod
    def forward(
        ctx: Any,  # noqa: ANN401
        a: torch.Tensor,
        b: torch.Tensor,
        profile: Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]],
    ) -> torch.Tensor:
        """Compute `r² = |a|² + |b|² - 2 a·b` and the profile of it."""
        squared = (a @ b.mT).mul_(-2.0).add_(a.square().sum(-1, keepdim=True))
        squared.add_(b.square().sum(-1)[..., None, :]).clamp_(min=0.0)
        value, slope = profile(squared)
        ctx.save_for_backward(a, b, slope)
        return value

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, None]:  # noqa: ANN401
        """Return `sum_j w_ij (a_i - b_j)` and `sum_i w_ij (b_j - a_i)` with `w = 2 phi' g`."""
        a, b, slope = ctx.saved_tensors
        w = (gradient * slope).mul_(2.0)
        of_a = a * w.sum(-1, keepdim=True) - w @ b
        of_b = b * w.sum(-2)[..., None] - w.mT @ a
        return of_a.sum_to_size(a.shape), of_b.sum_to_size(b.shape), None
