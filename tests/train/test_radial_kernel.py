"""The kernels of the training have the values and gradients of GPyTorch's."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

import pytest
import torch

from egp_service.training.kernel import KernelName, gpytorch_kernel
from egp_service.training.radial_kernel import RadialKernel

if TYPE_CHECKING:
    from gpytorch.kernels import Kernel


def pairs() -> tuple[torch.Tensor, torch.Tensor]:
    """Points in six dimensions, of which some are close to one another and two are equal."""
    generator = torch.Generator().manual_seed(0)
    a = torch.randn(40, 6, dtype=torch.float64, generator=generator)
    b = torch.cat([a[:1], a[1:10] + 1e-3, 3.0 * a[10:30]])
    return a.requires_grad_(), b.requires_grad_()


def gradients(kernel: Kernel, *, diag: bool, batch: bool) -> tuple[torch.Tensor, ...]:
    """Return the values and their gradients by the points and the raw lengthscales."""
    a, b = pairs()
    if diag:
        a = a[: len(b)].detach().requires_grad_()
    kernel.double().lengthscale = torch.tensor([0.3, 0.5, 1.0, 2.0, 10.0, 1000.0])
    one, other = (torch.stack([a, 2.0 * a]), b) if batch else (a, b)
    values = kernel(one, other, diag=True) if diag else kernel(one, other).to_dense()
    weights = torch.linspace(0.5, 2.0, values.numel(), dtype=torch.float64).reshape(values.shape)
    found = torch.autograd.grad((weights * values).sum(), [a, b, *kernel.parameters()])
    return (values.detach(), *found)


@pytest.mark.parametrize("batch", [False, True], ids=["one", "batch"])
@pytest.mark.parametrize("diag", [False, True], ids=["all pairs", "diagonal"])
@pytest.mark.parametrize("name", get_args(KernelName))
def test_values_and_gradients_are_those_of_gpytorch(
    name: KernelName, *, diag: bool, batch: bool
) -> None:
    ours = gradients(RadialKernel(name, ard_num_dims=6), diag=diag, batch=batch)
    theirs = gradients(gpytorch_kernel(name, ard_num_dims=6), diag=diag, batch=batch)
    for x, y in zip(ours, theirs, strict=True):
        # They differ by rounding; measured 8e-14.
        torch.testing.assert_close(x, y, rtol=1e-12, atol=1e-12)
