"""Exact Gaussian processes with ARD kernel and constant mean: fitting and hyperparameters.

All quantities are z-scored and in float64; systems are solved by Cholesky factorisation.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import warnings
from typing import TYPE_CHECKING, Final, cast

import numpy as np
import torch

from egp_service._core import EgpError
from egp_service.training.kernel import gpytorch_kernel

with warnings.catch_warnings():  # linear_operator uses torch.jit.script when it is imported
    warnings.filterwarnings("ignore", ".torch.jit.script. is ", FutureWarning)
    import gpytorch
    from botorch.models.gpytorch import GPyTorchModel
    from botorch.optim.closures import ForwardBackwardClosure, NdarrayOptimizationClosure
    from botorch.optim.fit import fit_gpytorch_mll_scipy
    from botorch.optim.utils import get_parameters_and_bounds
    from gpytorch import settings as gpytorch_settings

    from egp_service.training.radial_kernel import RadialKernel

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from botorch.optim.core import OptimizationResult
    from numpy.typing import NDArray

    from egp_service.training.kernel import KernelName


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Bounds of the hyperparameters in z-scored space."""

    noise: float
    """Smallest noise variance. States outside the seven measured ones (suspension, wheel speeds)
    change the outputs. Without a lower bound the likelihood neglects this for a few hundred points,
    and the intervals are too narrow (coverage 0.72 in slides)."""
    lengthscale: float
    """Smallest lengthscale."""
    outputscale: float
    """Largest prior variance."""

    def inside(self, values: Hyperparameters) -> Hyperparameters:
        """Return the values moved slightly inside the bounds."""
        low, high = 1.1 * self.lengthscale, 0.9 * MAX_LENGTHSCALE
        return Hyperparameters(
            lengthscales=tuple(min(max(length, low), high) for length in values.lengthscales),
            outputscale=min(values.outputscale, 0.9 * self.outputscale),
            noise=max(values.noise, 1.1 * self.noise),
            constant=values.constant,
        )


# An input with a lengthscale of 1000 standard deviations has no effect; beyond it the likelihood is
# flat and L-BFGS does not converge.
MAX_LENGTHSCALE: Final = 1e3
WHOLE_CHANGES: Final = Bounds(noise=1e-3, lengthscale=1e-2, outputscale=math.inf)
"""Bounds for processes that predict the whole change."""
CORRECTIONS: Final = Bounds(noise=0.1, lengthscale=1.0, outputscale=0.2)
"""Bounds for processes that correct a vehicle model, which must be smooth and small. These bounds
are usually active. With the bounds above, corrections would fit the effect of hidden states,
extrapolate far beyond the data and mislead the controller at the limit."""


@contextlib.contextmanager
def exact() -> Iterator[None]:
    """Disable all approximations of GPyTorch: conjugate gradients, Lanczos and caches."""
    with (
        gpytorch_settings.fast_computations(
            covar_root_decomposition=False, log_prob=False, solves=False
        ),
        gpytorch_settings.fast_pred_var(state=False),
        gpytorch_settings.max_cholesky_size(1_000_000),
    ):
        yield


@dataclasses.dataclass(frozen=True)
class Hyperparameters:
    """Hyperparameters of one output's process, in z-scored space; `noise` is a variance."""

    lengthscales: tuple[float, ...]
    outputscale: float
    noise: float
    constant: float


class OutputProcess(gpytorch.models.ExactGP, GPyTorchModel):  # type: ignore[misc]
    """`y = f(z) + e`, f ~ GP(constant, outputscale · k(z, z')), e ~ N(0, noise).

    `k` is the kernel of the given name with one lengthscale per input.
    """

    num_outputs = 1

    def __init__(
        self,
        z: torch.Tensor,
        y: torch.Tensor,
        kernel: KernelName,
        bounds: Bounds,
        *,
        make_kernel: Callable[..., gpytorch.kernels.Kernel] = RadialKernel,
    ) -> None:
        """Hold z-scored inputs (M, 6) and targets (M,) under default hyperparameters."""
        likelihood = gpytorch.likelihoods.GaussianLikelihood(
            noise_constraint=gpytorch.constraints.GreaterThan(bounds.noise)
        )
        super().__init__(z, y, likelihood)
        lengthscales = gpytorch.constraints.Interval(bounds.lengthscale, MAX_LENGTHSCALE)
        base = make_kernel(kernel, ard_num_dims=z.shape[-1], lengthscale_constraint=lengthscales)
        self.mean_module = gpytorch.means.ConstantMean()
        outputscale = (
            gpytorch.constraints.Positive()
            if math.isinf(bounds.outputscale)
            else gpytorch.constraints.Interval(0.0, bounds.outputscale)
        )
        self.covar_module = gpytorch.kernels.ScaleKernel(base, outputscale_constraint=outputscale)
        self._kernel: KernelName = kernel
        self._bounds = bounds
        self.to(z)

    def forward(self, z: torch.Tensor) -> gpytorch.distributions.MultivariateNormal:
        """Return the prior over f at z."""
        return gpytorch.distributions.MultivariateNormal(self.mean_module(z), self.covar_module(z))

    def with_gpytorch_kernel(self) -> OutputProcess:
        """Return the same process to predict with, by GPyTorch's kernel in place of ours."""
        same = OutputProcess(
            self.inputs,
            cast("torch.Tensor", self.train_targets),
            self._kernel,
            self._bounds,
            make_kernel=gpytorch_kernel,
        )
        same.load_state_dict(self.state_dict())
        same.eval()
        return same

    def replace_targets(self, y: torch.Tensor) -> None:
        """Predict from other z-scored targets (M,), under the same hyperparameters."""
        super().set_train_data(targets=y, strict=False)

    @property
    def inputs(self) -> torch.Tensor:
        """The z-scored training inputs (M, 6)."""
        return cast("tuple[torch.Tensor]", self.train_inputs)[0]

    @property
    def hyperparameters(self) -> Hyperparameters:
        """The present values, with constraints applied."""
        return Hyperparameters(
            lengthscales=tuple(self.covar_module.base_kernel.lengthscale.flatten().tolist()),
            outputscale=self.covar_module.outputscale.item(),
            noise=self.likelihood.noise.item(),
            constant=self.mean_module.constant.item(),
        )

    def assign(self, values: Hyperparameters) -> None:
        """Set all hyperparameters, moved slightly inside their bounds."""
        inside = self._bounds.inside(values)
        # As float64 tensors: GPyTorch reads a Python float as float32.
        lengthscales = torch.tensor(inside.lengthscales, dtype=torch.float64)
        self.covar_module.base_kernel.lengthscale = lengthscales
        self.covar_module.outputscale = torch.tensor(inside.outputscale, dtype=torch.float64)
        self.likelihood.noise = torch.tensor(inside.noise, dtype=torch.float64)
        self.mean_module.constant = torch.tensor(inside.constant, dtype=torch.float64)


def share_kernel(processes: Sequence[OutputProcess]) -> None:
    """Replace the kernel and the likelihood of all processes by those of the first.

    `assign` of one then changes all but the constants of the others. The processes must have equal
    inputs. One kernel halves the time of a prediction, and the errors of closed loops are alike.
    """
    for process in processes[1:]:
        process.covar_module = processes[0].covar_module
        process.likelihood = processes[0].likelihood


class _EachPointOnce(NdarrayOptimizationClosure):
    """Loss and gradient, which are computed once where L-BFGS-B and then botorch ask for them.

    After each iteration botorch's callback asks for the loss at the point that was evaluated last.
    """

    _last: tuple[NDArray[np.float64], tuple[NDArray[np.float64], NDArray[np.float64]]] | None = None

    def __call__(
        self, state: NDArray[np.float64] | None = None, **_: object
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        at = np.array(self.state if state is None else state)
        if self._last is None or not np.array_equal(at, self._last[0]):
            value, gradient = super().__call__(at)
            self._last = at, (value, gradient.copy())
        return self._last[1]


def fit(
    process: OutputProcess,
    starts: Sequence[Hyperparameters],
    max_iterations: int,
    report: Callable[[int, int, float], None],
) -> None:
    """Maximise the log marginal likelihood by L-BFGS-B; keep the best start.

    After each iteration `report` gets the numbers of the start and of its iteration, and the
    negative likelihood per transition.

    Raises:
        EgpError: if no start ends at a finite likelihood.

    """
    mll = gpytorch.mlls.ExactMarginalLogLikelihood(process.likelihood, process)
    parameters, _ = get_parameters_and_bounds(mll)

    def loss() -> torch.Tensor:
        found: torch.Tensor = -mll(process(process.inputs), process.train_targets)
        return found

    best_loss, best = math.inf, process.state_dict()
    with exact():
        for number, start in enumerate(starts):
            process.assign(start)
            mll.train()

            def on_step(
                _: dict[str, torch.Tensor], result: OptimizationResult, number: int = number
            ) -> None:
                report(number, result.step or 0, float(result.fval))

            once = _EachPointOnce(ForwardBackwardClosure(loss, parameters), parameters)
            result = fit_gpytorch_mll_scipy(
                mll,
                closure=once,  # type: ignore[arg-type] # what botorch would wrap it in
                options={"maxiter": max_iterations, "ftol": 1e-5},
                callback=on_step,
            )
            if result.fval < best_loss:
                best_loss = float(result.fval)
                best = {name: value.clone() for name, value in process.state_dict().items()}
    if not math.isfinite(best_loss):
        raise EgpError(
            "no start of the hyperparameter search reached a finite likelihood; "
            "look for constant or duplicate columns in the data"
        )
    process.load_state_dict(best)
    process.eval()
