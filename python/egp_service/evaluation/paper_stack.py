"""The paper's control step: GPyTorch autograd for the members, CVXPY with OSQP for both QPs.

Library file and request are those of this system's step. For a fair comparison the implementation
is efficient: all queries of a member are one batch in GPyTorch, Jacobians take one backward pass
per output, both problems are DPP-parametrised so that CVXPY canonicalises them once, OSQP starts
from its last solution, and predictions that the client carries are not computed again.
Requires the [train] and [paper] extras.
"""

from __future__ import annotations

import json
import struct
import time
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cvxpy as cp
import numpy as np
import torch

from egp_service.evaluation.paper_mpc import Mpc
from egp_service.evaluation.window_noise import WindowNoise
from egp_service.quantities import (
    DELTA,
    GP_STATE,
    MOTION,
    NU,
    NX,
    NY,
    OMEGA,
    P_X,
    P_Y,
    POSITION,
    PSI,
    V_X,
    V_Y,
    gp_input,
)
from egp_service.training import prior_mean
from egp_service.training.kernel import gpytorch_kernel

with warnings.catch_warnings():  # linear_operator uses torch.jit.script when it is imported
    warnings.filterwarnings("ignore", ".torch.jit.script. is ", FutureWarning)
    import gpytorch

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from egp_service._core import Library, Request

    Array = NDArray[np.float64]


def read_tensors(path: Path) -> dict[str, Array]:
    """Tensors of a library file (safetensors: header length, JSON header, data)."""
    raw = path.read_bytes()
    (length,) = struct.unpack("<Q", raw[:8])
    header = json.loads(raw[8 : 8 + length])
    data = memoryview(raw)[8 + length :]
    return {
        name: np.frombuffer(data[slice(*entry["data_offsets"])], "<f8").reshape(entry["shape"])
        for name, entry in header.items()
        if name != "__metadata__"
    }


class ExactGP(gpytorch.models.ExactGP):  # type: ignore[misc]
    """Outputs of one member that share the library's kernel, with constant means."""

    def __init__(self, kernel: str, x: torch.Tensor, y: torch.Tensor, likelihood: Any) -> None:  # noqa: ANN401
        """Take scaled inputs (n, 6) and a batch of scaled outputs (b, n)."""
        super().__init__(x, y, likelihood)
        self.mean_module = gpytorch.means.ConstantMean(batch_shape=y.shape[:-1])
        self.covar_module = gpytorch.kernels.ScaleKernel(
            gpytorch_kernel(kernel, ard_num_dims=x.shape[-1])
        )

    def forward(self, x: torch.Tensor) -> Any:  # noqa: ANN401
        """Prior at `x`."""
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


class Member:
    """One surface's three GPs with their prior mean; mean and Jacobian by autograd."""

    def __init__(self, library: Library, tensors: dict[str, Array], index: int) -> None:
        """Take member `index` of a library, with the tensors of its file."""

        def tensor(name: str) -> torch.Tensor:
            return torch.from_numpy(tensors[f"members.{index}.{name}"].copy())

        self.input_mean, self.input_std = tensor("input_mean"), tensor("input_std")
        self.target_mean, self.target_std = tensor("target_mean"), tensor("target_std")
        vehicle = [f"members.{index}.{name}" for name in ("single_track", "resistance")]
        known = [found for name in vehicle if (found := tensors.get(name)) is not None]
        self._vehicle = torch.from_numpy(np.concatenate(known)) if known else None
        self._dt, self._steps = library.dt, library.members[index].euler_steps
        inputs = tensor("inputs")
        x = (inputs - self.input_mean) / self.input_std
        y = (tensor("targets") - self._known(inputs) - self.target_mean) / self.target_std
        lengthscales, outputscale = tensor("lengthscales"), tensor("outputscale")
        noise, constant = tensor("noise"), tensor("constant")
        # Outputs that share a kernel are one batch, for which the kernel is evaluated once.
        hyper = torch.cat([lengthscales, outputscale[:, None], noise[:, None]], dim=1)
        together = [[0, 1, 2]] if bool((hyper == hyper[0]).all()) else [[0], [1], [2]]
        self.gps = []
        for outputs in together:
            likelihood = gpytorch.likelihoods.GaussianLikelihood(
                noise_constraint=gpytorch.constraints.Positive()
            ).double()
            likelihood.noise = noise[outputs[0]]
            gp = ExactGP(library.kernel, x, y[:, outputs].T.contiguous(), likelihood).double()
            gp.covar_module.base_kernel.lengthscale = lengthscales[outputs[0]]
            gp.covar_module.outputscale = outputscale[outputs[0]]
            gp.mean_module.constant.data = constant[outputs]
            gp.eval()
            for parameter in gp.parameters():
                parameter.requires_grad_(requires_grad=False)
            self.gps.append((outputs, gp))

    def _known(self, z: torch.Tensor) -> torch.Tensor:
        """Return the prior mean (n, 3)."""
        if self._vehicle is None:
            return torch.zeros(len(z), NY, dtype=z.dtype)
        return prior_mean.change(z, self._vehicle, self._dt, self._steps)

    def _means(self, query: torch.Tensor, outputs: Sequence[int]) -> torch.Tensor:
        """Differentiable mean of some outputs at (n, 6): (outputs, n)."""
        scaled = (query - self.input_mean) / self.input_std
        learned: dict[int, torch.Tensor] = {}
        for together, gp in self.gps:
            if set(together) & set(outputs):
                learned |= dict(zip(together, gp(scaled).mean, strict=True))
        known = self._known(query)
        return torch.stack(
            [learned[o] * self.target_std[o] + self.target_mean[o] + known[:, o] for o in outputs]
        )

    def mean(self, z: Array) -> Array:
        """Mean at `z` (n, 6): (n, 3)."""
        with torch.no_grad(), gpytorch.settings.skip_posterior_variances():
            return np.asarray(self._means(torch.from_numpy(z), range(NY)).T)

    def mean_jacobian(self, z: Array, outputs: Sequence[int] = range(NY)) -> tuple[Array, Array]:
        """Mean (n, 3) and Jacobian (n, 3, 6); the sum over queries gives each query's gradient."""
        query = torch.from_numpy(z).requires_grad_()
        with gpytorch.settings.skip_posterior_variances():
            means = self._means(query, outputs)
            gradients = [
                torch.autograd.grad(mean.sum(), query, retain_graph=True)[0] for mean in means
            ]
        return means.detach().T.numpy(), torch.stack(gradients, 1).numpy()

    def vehicle_jacobian(self, z: Array) -> Array:
        """Jacobian (n, 3, 6) of the prior mean; without one, that of the mean."""
        if self._vehicle is None:
            return self.mean_jacobian(z)[1]
        query = torch.from_numpy(z).requires_grad_()
        changes = self._known(query).T
        gradients = [
            torch.autograd.grad(change.sum(), query, retain_graph=True)[0] for change in changes
        ]
        return np.asarray(torch.stack(gradients, 1))


@dataclass
class Phases:
    """Seconds spent in each part of one step."""

    weights: float
    linearise: float
    mpc: float

    @property
    def total(self) -> float:
        """Total time."""
        return self.weights + self.linearise + self.mpc


@dataclass
class PaperStep:
    """Result of one step."""

    plan_x: Array
    plan_u: Array
    weights: Array
    phases: Phases


class Weights:
    """Eq. (6) with a quadratic prior, DPP-parametrised."""

    def __init__(self, members: int, window: int, strength: float) -> None:
        """Build the problem for (K, 3, N) predictions."""
        self.f, self.y = cp.Parameter((window * NY, members)), cp.Parameter(window * NY)
        self.previous, self.w = cp.Parameter(members), cp.Variable(members)
        objective = cp.sum_squares(self.y - self.f @ self.w)
        objective += strength * cp.sum_squares(self.w - self.previous)
        self.problem = cp.Problem(cp.Minimize(objective), [self.w >= 0, cp.sum(self.w) == 1])

    def solve(self, f: Array, y: Array, previous: Array) -> Array:
        """Return the weights for predictions `f (K*3, N)` and measurements `y (K*3,)`."""
        self.f.value, self.y.value, self.previous.value = f, y, previous
        self.problem.solve(solver=cp.OSQP, warm_start=True)
        return np.asarray(self.w.value)


class PaperStack:
    """The paper's step for one library and the settings of this system's step."""

    def __init__(
        self,
        path: Path,
        library: Library,
        settings: dict[str, Any],
        *,
        vehicle_slopes: bool = False,
    ) -> None:
        """Build the stack for the library at `path`.

        The paper linearises the ensemble. With `vehicle_slopes` the slopes are those of this
        system's step, the prior means', so that the plans of both can be compared.
        """
        self.vehicle_slopes = vehicle_slopes
        tensors, dt = read_tensors(path), library.dt
        count = len(library.members)
        self.members = [Member(library, tensors, n) for n in range(count)]
        self.dt, self.mass = dt, settings["mass"]
        self.window, self.horizon = settings["weights"]["window"], settings["horizon"]
        self.noise = WindowNoise(library.members, settings)
        self.weights = Weights(count, self.window, settings["weights"]["prior"]["lambda"])
        self.mpc = Mpc(self.horizon, dt, settings)
        self.margin = settings["soft"]["edge_margin"]
        self.yaw_at = settings["operating"]["yaw_at"]
        stated = settings["soft"].get("slip")
        self.slips = np.array(
            [
                member.slip_bound if stated is None else stated * member.friction
                for member in library.members
            ]
        )

    def step(self, request: Request) -> PaperStep:
        """Compute one step from a request with a full window and a plan."""
        begun = time.perf_counter()
        new = len(request.history_z) - len(request.history_f)
        rows = np.stack([member.mean(request.history_z[:new]) for member in self.members], axis=1)
        f = np.concatenate([rows, request.history_f])
        errors = request.history_y - np.einsum("kno,n->ko", f, request.weights)
        root = self.noise.whitening(self.noise.likeliest(errors), self.window)
        w = self.weights.solve(
            np.einsum("okj,jno->kon", root, f).reshape(self.window * NY, -1),
            np.einsum("okj,jo->ko", root, request.history_y).ravel(),
            request.weights,
        )
        w = np.maximum(w, 0.0) / np.maximum(w, 0.0).sum()
        weighed = time.perf_counter()
        x, u = self._operating(request)
        dynamics = self._linearise(x, u, w)
        linearised = time.perf_counter()
        reference = request.reference.copy()
        reference[:, PSI] = np.unwrap(np.concatenate([[request.x[PSI]], reference[:, PSI]]))[1:]
        edges = np.maximum(request.widths[1:] - self.margin, 0.0)
        scaled = request.u_prev / [self.mass, 1.0]
        plan_x, plan_u = self.mpc.solve(
            dynamics,
            x0=request.x,
            u_prev=scaled,
            reference=reference,
            edges=edges,
            operating=x,
            slip=float(w @ self.slips),
        )
        planned = time.perf_counter()
        phases = Phases(weighed - begun, linearised - weighed, planned - linearised)
        return PaperStep(plan_x, plan_u * [self.mass, 1.0], w, phases)

    def _operating(self, request: Request) -> tuple[Array, Array]:
        """Shift the previous plan to now, holding its last force and steering angle."""
        shift = request.plan_shift
        held = np.array([[request.plan_u[-1, 0], 0.0]])
        u = np.concatenate([request.plan_u[shift:], np.repeat(held, shift, axis=0)])
        x = np.concatenate([request.x[None], request.plan_x[shift + 1 :]])
        last = x[-1]
        for _ in range(shift):
            last = last.copy()
            yaw = last[PSI] + self.yaw_at * self.dt * last[OMEGA]
            last[POSITION] += self.dt * last[V_X] * np.array([np.cos(yaw), np.sin(yaw)])
            last[PSI] += self.dt * last[OMEGA]
            x = np.concatenate([x, last[None]])
        return x, u

    def _linearise(self, x: Array, u: Array, w: Array) -> tuple[Array, Array, Array]:
        """Blend the tangents, eqs. (15)-(17), for scaled inputs; positions follow `yaw_at`."""
        z = gp_input(x[:-1], u)
        if self.vehicle_slopes:
            parts = [(member.mean(z), member.vehicle_jacobian(z)) for member in self.members]
        else:
            parts = [member.mean_jacobian(z) for member in self.members]
        mean = sum(wn * m for wn, (m, _) in zip(w, parts, strict=True))
        jacobian = sum(wn * j for wn, (_, j) in zip(w, parts, strict=True))
        dt, states = self.dt, x[:-1]
        ahead = self.yaw_at * dt
        yaw = states[:, PSI] + ahead * states[:, OMEGA]
        sin, cos = np.sin(yaw), np.cos(yaw)
        v_x, v_y = states[:, V_X], states[:, V_Y]
        a = np.tile(np.eye(NX), (len(z), 1, 1))
        a[:, P_X, V_X], a[:, P_X, V_Y] = dt * cos, -dt * sin
        a[:, P_X, PSI] = -dt * (v_x * sin + v_y * cos)
        a[:, P_Y, V_X], a[:, P_Y, V_Y] = dt * sin, dt * cos
        a[:, P_Y, PSI] = dt * (v_x * cos - v_y * sin)
        a[:, P_X, OMEGA], a[:, P_Y, OMEGA] = ahead * a[:, P_X, PSI], ahead * a[:, P_Y, PSI]
        a[:, PSI, OMEGA] = dt
        b = np.zeros((len(z), NX, NU))
        b[:, DELTA, 1] = dt
        for o, row in enumerate(MOTION):
            for d, column in enumerate(GP_STATE):
                a[:, row, column] += jacobian[:, o, d]
            b[:, row] = jacobian[:, o, len(GP_STATE) :]
        following = states.copy()
        following[:, P_X] += dt * (v_x * cos - v_y * sin)
        following[:, P_Y] += dt * (v_x * sin + v_y * cos)
        following[:, PSI] += dt * states[:, OMEGA]
        following[:, DELTA] += dt * u[:, 1]
        following[:, MOTION] += mean
        c = following - np.einsum("tij,tj->ti", a, states) - np.einsum("tij,tj->ti", b, u)
        b[:, :, 0] *= self.mass
        return a, b, c
