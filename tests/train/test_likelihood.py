"""Processes that share a kernel have the loss of GPyTorch, and each point is evaluated once."""

from __future__ import annotations

from itertools import pairwise
from typing import get_args

import gpytorch
import numpy as np
import pytest
import torch

from egp_service.training import gaussian_process
from egp_service.training.gaussian_process import (
    CORRECTIONS,
    Hyperparameters,
    OutputProcess,
    exact,
    fit,
    share_kernel,
    shared_loss,
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
def test_one_factorisation_gives_the_loss_and_gradients_of_gpytorch(kernel: KernelName) -> None:
    processes = sharing(kernel)
    models = gpytorch.models.IndependentModelList(*processes)
    with exact():
        models.train()
        own = shared_loss(processes)
        own.backward()  # type: ignore[no-untyped-call]
        gradients = [parameter.grad.clone() for parameter in models.parameters()]
        models.zero_grad()
        each = gpytorch.mlls.SumMarginalLogLikelihood(models.likelihood, models)
        theirs = -each(models(*models.train_inputs), models.train_targets)
        theirs.backward()
    assert own.item() == pytest.approx(theirs.item(), rel=1e-12)
    for gradient, parameter in zip(gradients, models.parameters(), strict=True):
        assert torch.allclose(gradient, parameter.grad, rtol=1e-9, atol=1e-12)


def test_a_fit_evaluates_no_point_twice_in_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    points = []

    def counted(processes: list[OutputProcess]) -> torch.Tensor:
        points.append([float(p.detach().sum()) for p in processes[0].parameters()])
        return shared_loss(processes)

    monkeypatch.setattr(gaussian_process, "shared_loss", counted)
    iterations: list[int] = []
    fit(sharing("rbf"), [START], 20, lambda _start, number, _loss: iterations.append(number))
    assert len(iterations) > 2
    assert iterations == list(range(1, len(iterations) + 1))
    assert all(one != other for one, other in pairwise(points))
