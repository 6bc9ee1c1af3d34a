"""The bound of processes that share a kernel, and how often a fit evaluates a point."""

from __future__ import annotations

from itertools import pairwise
from typing import cast, get_args

import gpytorch
import numpy as np
import pytest
import torch

from egp_service.training import sparse
from egp_service.training.gaussian_process import (
    CORRECTIONS,
    Hyperparameters,
    OutputProcess,
    exact,
    fit,
    share_kernel,
)
from egp_service.training.kernel import KernelName

START = [Hyperparameters((3.0,) * 6, 0.15, 0.2, constant) for constant in (0.1, -0.2, 0.0)]


def sharing(kernel: KernelName) -> list[OutputProcess]:
    """Return three processes with targets of their own."""
    rng = np.random.default_rng(0)
    z = torch.tensor(rng.standard_normal((60, 6)))
    targets = [torch.sin(z[:, j]) + torch.tensor(rng.standard_normal(60)) for j in range(3)]
    processes = [OutputProcess(z, y, kernel, CORRECTIONS) for y in targets]
    share_kernel(processes)
    for process, start in zip(processes, START, strict=True):
        process.assign(start)
    return processes


@pytest.mark.parametrize("kernel", get_args(KernelName))
def test_with_all_points_inducing_the_bound_is_the_likelihood(kernel: KernelName) -> None:
    """The bound of Titsias is the exact likelihood if every transition is an inducing point."""
    processes = sharing(kernel)
    models = gpytorch.models.IndependentModelList(*processes)
    with exact():
        models.train()
        z = processes[0].inputs
        y = [cast("torch.Tensor", process.train_targets) for process in processes]
        own = sparse._bound(processes, z, y) / (3 * len(z))  # noqa: SLF001
        own.backward()  # type: ignore[no-untyped-call]
        gradients = [parameter.grad.clone() for parameter in models.parameters()]
        models.zero_grad()
        each = gpytorch.mlls.SumMarginalLogLikelihood(models.likelihood, models)
        theirs = each(models(*models.train_inputs), models.train_targets)
        theirs.backward()
    # The jitter of the sparse process is 1e-8 of the prior variance; measured 6e-9 and 4e-8.
    assert own.item() == pytest.approx(theirs.item(), rel=3e-8)
    for gradient, parameter in zip(gradients, models.parameters(), strict=True):
        assert torch.allclose(gradient, parameter.grad, rtol=1e-6, atol=1e-9)


def test_a_sparse_fit_goes_on_after_a_step_that_is_too_long() -> None:
    """A line search that rejects its first step is no end of the fit."""
    processes = sharing("matern52")
    z = processes[0].inputs
    y = [cast("torch.Tensor", process.train_targets) for process in processes]
    losses: list[float] = []
    sparse.fit_sparse(processes, z, y, 40, lambda _, loss: losses.append(loss))
    assert len(losses) == 40
    with exact():
        (-sparse._bound(processes, z, y) / (3 * len(z))).backward()  # type: ignore[no-untyped-call] # noqa: SLF001
    slopes = [parameter.grad for parameter in processes[0].parameters()]
    assert max(float(slope.abs().max()) for slope in slopes if slope is not None) < 1e-3


def test_a_fit_evaluates_no_point_twice_in_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    points = []
    (process, *_), likelihood = sharing("rbf"), gpytorch.mlls.ExactMarginalLogLikelihood

    class Counted(likelihood):  # type: ignore[misc, valid-type]
        def forward(self, *arguments: object) -> torch.Tensor:
            points.append([float(p.detach().sum()) for p in process.parameters()])
            found: torch.Tensor = super().forward(*arguments)
            return found

    monkeypatch.setattr(gpytorch.mlls, "ExactMarginalLogLikelihood", Counted)
    iterations: list[int] = []
    fit(process, START[:1], 20, lambda _start, number, _loss: iterations.append(number))
    assert len(iterations) > 2
    assert iterations == list(range(1, len(iterations) + 1))
    assert all(one != other for one, other in pairwise(points))
