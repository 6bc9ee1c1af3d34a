"""The weights, eq. (6), against OSQP and PIQP."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np
import osqp
import piqp
import pytest
from scipy import sparse

from egp_service import Controller
from egp_service._core import (
    EgpError,
    Engine,
    Library,
    decode_reply,
    decode_request,
    solve_weights,
)
from egp_service.evaluation.window_noise import WindowNoise
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.scenario import (
    Measurement,
    gate_settings,
    library_path,
    load_scenario,
    told_zones,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

TOLERANCE = 1e-5
LAP = told_zones(load_scenario("rounded-rectangle"))
LIBRARY = library_path(LAP)
LAMBDA = 100.0  # the default
NOISE = Measurement(0.02, 0.03, 0.002, 0.03, 0.005, 0.001)
LESS = Measurement(0.006, 0.009, 0.0006, 0.009, 0.0015, 0.0003)
Prior = Literal["quadratic", "l1"]


def by_others(f: Array, y: Array, previous: Array, prior: Prior, strength: float) -> list[Array]:
    """Solve with OSQP and PIQP; an L1 prior doubles the variables, with `|w - previous| <= t`."""
    n = len(previous)
    eye = np.eye(n)
    hessian: NDArray[np.floating]
    rows: NDArray[np.floating]
    if prior == "quadratic":
        hessian = 2 * (f.T @ f + strength * eye)
        linear = -2 * (f.T @ y + strength * previous)
        rows, bound = np.zeros((0, n)), np.zeros(0)
    else:
        hessian = np.kron(np.diag([1.0, 0.0]), 2 * f.T @ f)
        linear = np.r_[-2 * f.T @ y, np.full(n, strength)]
        rows, bound = np.kron([[1, -1], [-1, -1]], eye), np.r_[previous, -previous]
    size = len(linear)
    total = np.r_[np.ones(n), np.zeros(size - n)][None]
    least = np.r_[np.zeros(n), np.full(size - n, -np.inf)]
    scale = 1.0 / np.abs(hessian).max()
    p, q = sparse.csc_matrix(hessian * scale), linear * scale
    admm = osqp.OSQP()
    admm.setup(
        sparse.triu(p, format="csc"),
        q,
        sparse.csc_matrix(np.vstack([total, rows, np.eye(size)])),
        np.r_[1.0, np.full(len(bound), -np.inf), least],
        np.r_[1.0, bound, np.full(size, np.inf)],
        eps_abs=1e-11,
        eps_rel=1e-11,
        max_iter=1_000_000,
        polishing=True,
        verbose=False,
    )
    first = admm.solve(raise_error=False)
    assert first.info.status == "solved"
    ipm = piqp.SparseSolver()
    ipm.settings.eps_abs = ipm.settings.eps_rel = 1e-12
    ipm.settings.eps_duality_gap_abs = ipm.settings.eps_duality_gap_rel = 1e-12
    ipm.setup(
        p,
        q,
        sparse.csc_matrix(total),
        np.ones(1),
        sparse.csc_matrix(rows),
        np.full(len(bound), -np.inf),
        bound,
        least,
        np.full(size, np.inf),
    )
    assert ipm.solve() == piqp.PIQP_SOLVED
    return [first.x[:n], ipm.result.x[:n]]


@pytest.mark.parametrize("n", [2, 3, 8, 16])
@pytest.mark.parametrize(("prior", "strength"), [("quadratic", 20.0), ("l1", 1.0)])
@pytest.mark.parametrize("measurement", [None, np.array([0.03, 0.0, 0.005])])
def test_weights_agree_with_osqp_and_piqp(
    n: int, prior: Prior, strength: float, measurement: NDArray[np.float64] | None
) -> None:
    rng = np.random.default_rng(n)
    noise = np.array([0.01, 0.02, 0.005])
    # What a window of states with that noise has: white noise and the differences of another.
    state_noise = np.zeros(3) if measurement is None else measurement
    difference = np.diff(np.eye(11), axis=0)
    roots = [
        np.linalg.cholesky(q * np.eye(10) + r * difference @ difference.T)
        for q, r in zip(noise**2, state_noise**2, strict=True)
    ]
    for _ in range(20):
        predictions = rng.normal(size=(10, n, 3)) * 0.2
        truth, previous = rng.dirichlet(np.full(n, 0.5)), rng.dirichlet(np.ones(n))
        measured = np.einsum("knj,n->kj", predictions, truth) + rng.normal(size=(10, 3)) * noise
        w = solve_weights(
            predictions, measured, noise, previous, prior, strength, measurement_std=measurement
        )
        assert abs(w.sum() - 1) < 1e-12
        assert (w >= 0).all()
        f = np.vstack([np.linalg.solve(roots[o], predictions[:, :, o]) for o in range(3)])
        y = np.concatenate([np.linalg.solve(roots[o], measured[:, o]) for o in range(3)])
        for other in by_others(f, y, previous, prior, strength):
            np.testing.assert_allclose(w, other, rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("whiten", [True, False])
def test_the_evaluation_whitens_as_the_service_does(whiten: bool) -> None:  # noqa: FBT001
    engine = Engine(str(LIBRARY), f"[weights]\nwhiten = {str(whiten).lower()}")
    noise = WindowNoise(Library.load(LIBRARY).members, tomllib.loads(engine.settings_toml))
    taken = set()
    for sensors in (Measurement(), LESS, NOISE):
        for sent in recorded(sensors):
            reply, request = decode_reply(engine.step(sent)), decode_request(sent)
            predictions, measured = reply.history_f, request.history_y
            if not len(measured):
                continue
            errors = measured - np.einsum("kno,n->ko", predictions, request.weights)
            level = noise.likeliest(errors)
            taken.add(level)
            model, states = noise.levels[level]
            w = solve_weights(
                predictions, measured, model, request.weights, "quadratic", LAMBDA, states
            )
            root = noise.whitening(level, len(errors))
            f = np.vstack([root[o] @ predictions[:, :, o] for o in range(3)])
            y = np.concatenate([root[o] @ measured[:, o] for o in range(3)])
            # A window that does not tell the members apart leaves the weights.
            worst, best = np.max(np.sum((f.T - y) ** 2, axis=1)), np.sum((f @ w - y) ** 2)
            tells = worst - best >= 0.25 * 2.0 * 3.0 * max(1.0, best / len(y))
            expected = w if tells or not whiten else request.weights
            np.testing.assert_allclose(reply.weights, expected, rtol=0, atol=1e-9)
            slope = 2.0 * (f.T @ (f @ w - y) + LAMBDA * (w - request.weights))
            assert w @ (slope - slope.min()) < 1e-6 * max(1.0, np.abs(slope).max())
    assert taken == set(range(len(noise.levels))), taken


@cache
def recorded(sensors: Measurement) -> list[bytes]:
    requests: list[bytes] = []
    scenario = replace(LAP, measurement=sensors)
    with Controller(LIBRARY, gate=gate_settings(scenario)) as controller:
        drive(scenario, controller, lambda period: requests.append(period.step.request))
    return requests


def test_one_member_or_no_history_leaves_nothing_to_choose() -> None:
    noise = np.ones(3)
    one = solve_weights(np.ones((4, 1, 3)), np.zeros((4, 3)), noise, np.ones(1), "l1", 0.0)
    assert one == [1.0]
    previous = np.array([0.2, 0.5, 0.3])
    none = solve_weights(np.zeros((0, 3, 3)), np.zeros((0, 3)), noise, previous, "quadratic", 20.0)
    np.testing.assert_allclose(none, previous, rtol=0, atol=1e-15)


def test_what_makes_no_sense_is_refused() -> None:
    f, y, noise, w = np.ones((4, 2, 3)), np.ones((4, 3)), np.ones(3), np.array([0.5, 0.5])
    with pytest.raises(EgpError, match="predictions"):
        solve_weights(f[:3], y, noise, w, "l1", 1.0)
    with pytest.raises(EgpError, match="simplex"):
        solve_weights(f, y, noise, 2 * w, "l1", 1.0)
    with pytest.raises(EgpError, match="finite"):
        solve_weights(f * np.nan, y, noise, w, "l1", 1.0)
