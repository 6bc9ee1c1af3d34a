"""Multipliers, cost and status of `solve_ocp`, and the problems of control steps."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest

from egp_service import Controller, Plant, shipped
from egp_service._core import RefusedError
from egp_service.optimal_control import OcpBounds, OcpResult, OcpWeights, solve_ocp
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import load_scenario
from ocp_problems import SOLVERS, arguments, problem

if TYPE_CHECKING:
    from egp_service import Step

BOUNDS = ("u_min", "u_max", "du_min", "du_max", "soft_lower", "soft_upper")


def by_name(bounds: OcpBounds) -> dict[str, Any]:
    return {name: getattr(bounds, name) for name in (*BOUNDS, "soft_normal", "penalty")}


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("factor", [1.0, -0.5])
def test_multipliers_are_derivatives_of_the_cost(
    solver: Literal["riccati", "clarabel"], factor: float
) -> None:
    p = problem(3, 12, 5)
    ends = np.sort([p["soft_lower"] * factor, p["soft_upper"] * factor], axis=0)
    p |= {
        "soft_normal": p["soft_normal"] * factor,
        "soft_lower": ends[0],
        "soft_upper": ends[1],
        "penalty": p["penalty"] / [abs(factor), factor**2],
    }
    *rest, bounds = arguments(p)

    def solve(changed: OcpBounds) -> OcpResult:
        stated: tuple[Any, ...] = (*rest, changed)
        return solve_ocp(*stated, solver=solver)

    result = solve(bounds)
    found = 0
    for name in BOUNDS:
        multipliers = getattr(result.multipliers, name)
        assert multipliers.min() > -1e-6
        t, j = np.unravel_index(np.argmax(multipliers), multipliers.shape)
        costs = []
        for step in (-1e-4, 1e-4):
            moved = getattr(bounds, name)
            moved[t, j] += step
            changed = OcpBounds(**by_name(bounds) | {name: moved})
            costs.append(solve(changed).cost)
        derivative = (costs[1] - costs[0]) / 2e-4
        sign = 1.0 if name.endswith(("min", "lower")) else -1.0
        assert sign * derivative == pytest.approx(multipliers[t, j], rel=0.02, abs=0.02)
        found += multipliers[t, j] > 1.0
    assert found >= 3, "bounds must be active"


def test_the_cost_is_that_of_the_formula() -> None:
    p = problem(1, 15, 5)
    p |= {"proximal": np.array([0.3, 2.0]), "planned": np.full((15, 2), 0.1)}
    result = solve_ocp(*arguments(p))
    x, u = result.x[1:], result.u
    error, change = x - p["reference"], np.diff(u, axis=0, prepend=p["u_prev"][None])
    rows = np.einsum("tji,ti->tj", p["soft_normal"], x)
    slack = np.maximum(0.0, np.maximum(p["soft_lower"] - rows, rows - p["soft_upper"]))
    cost = 0.5 * np.einsum("ti,tij,tj->", error, p["q"], error)
    cost += 0.5 * (p["r"] * u**2 + p["r_d"] * change**2).sum()
    cost += 0.5 * (p["proximal"] * (u - 0.1) ** 2).sum()
    cost += (p["penalty"][:, 0] * slack + 0.5 * p["penalty"][:, 1] * slack**2).sum()
    assert slack.max() > 1e-3
    assert result.cost == pytest.approx(cost, rel=1e-12)


def test_only_bounds_that_exclude_all_inputs_are_infeasible() -> None:
    p = problem(0, 10, 3)
    out_of_reach = p | {"u_prev": np.array([-60.0, 0.0])}
    for solver in SOLVERS:
        assert solve_ocp(*arguments(out_of_reach), solver=solver).status == "infeasible"
    # The dynamics grow by a factor of 7 in each of 20 periods, which no solver handles. All inputs
    # within the bounds are feasible.
    a = np.tile(np.eye(7), (20, 1, 1))
    a[:, 0, 2] = a[:, 1, 4] = a[:, 3, 5] = 0.1
    a[:, 1, 3], a[:, 4, 5] = 0.2, -0.2
    a[:, 4, 4] = a[:, 5, 5] = -7.0
    a[:, 4, 6] = a[:, 5, 6] = 8.0
    b = np.zeros((7, 2))
    b[2, 0] = b[6, 1] = 0.1
    weights = OcpWeights(q=np.diag([10, 60, 2, 10, 0, 0, 0.0]), r=[0.05, 2], r_d=[0.05, 10])
    bounds = OcpBounds(u_min=[-8, -0.4], u_max=[6, 0.4], du_min=[-6, -0.8], du_max=[6, 0.8])
    rest = np.zeros(7), [0, 0.5, 2, 0, 0.1, 0, 0], [0, 0], [0, 0, 2, 0, 0, 0, 0], weights, bounds
    for solver in SOLVERS:
        result = solve_ocp(a, b, *rest, solver=solver)
        assert result.status == "numerical_error"


def test_the_problem_of_a_step_has_its_plan() -> None:
    scenario = replace(load_scenario("rounded-rectangle"), laps=0.1)
    steps: list[Step] = []
    with in_process_controller(scenario) as controller:
        drive(scenario, controller, observe=lambda period: steps.append(period.step))
        mass = Plant().parameters.mass
        solved = [(step, step.plan_u) for step in steps if step.plan_u is not None][::10]
        assert len(solved) > 5
        for step, plan_u in solved:
            found = controller.problem(step.request)
            result = solve_ocp(*found)
            assert result.status == "solved"
            np.testing.assert_allclose(result.u, plan_u / [mass, 1.0], rtol=0, atol=1e-5)
            again = OcpWeights(
                **{n: getattr(found.weights, n) for n in ("q", "r", "r_d", "proximal", "planned")}
            )
            same = solve_ocp(*found[:6], again, OcpBounds(**by_name(found.bounds)))
            np.testing.assert_array_equal(same.u, result.u)


def test_the_problem_of_bytes_that_are_no_request_is_an_error() -> None:
    with (
        Controller(shipped.DEMO_LIBRARY, gate=Plant().parameters.gate_limits()) as controller,
        pytest.raises(RefusedError, match="malformed: not an egp"),
    ):
        controller.problem(b"garbage")
