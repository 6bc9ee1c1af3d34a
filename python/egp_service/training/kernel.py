"""The kernels that a library may have: their names, and the kernels of GPyTorch."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    import gpytorch

KernelName = Literal["rbf", "matern52"]


def gpytorch_kernel(name: str, **options: Any) -> gpytorch.kernels.Kernel:  # noqa: ANN401
    """Return the kernel of a `KernelName` with GPyTorch's `options`, which all kernels have."""
    from gpytorch.kernels import MaternKernel, RBFKernel

    kernels = {"rbf": RBFKernel, "matern52": partial(MaternKernel, nu=2.5)}
    return kernels[name](**options)
