"""The parameters of Autoware's MPC lateral controller as settings of the control step.

Autoware weighs lateral error [m], heading error [rad], steering [rad], lateral jerk and steering
rate [rad/s] in one quadratic cost. Only ratios count, so that they are scaled: the lateral weight
becomes this controller's default, and the others keep their ratio to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeGuard

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from egp_service._core import EgpError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_LATERAL: Final = 60.0
# Periods; more cost time and brought nothing in experiments (docs/settings.md).
_LONGEST: Final = 100
_LARGEST: Final = 1e6  # of a parameter; larger ones could overflow
# Default weight of the force, which Autoware's lateral controller does not have.
_INPUT_FORCE: Final = 0.05

_HEADING: Final = "the vehicle slips in bends, so that its yaw is not the path's direction"
NOT_MAPPED: Final = {
    "mpc_weight_heading_error": _HEADING,
    "mpc_weight_heading_error_squared_vel": _HEADING,
    "mpc_weight_steering_input": "the plan weighs the steering rate, not the angle",
    "mpc_weight_steering_input_squared_vel": "the plan weighs the steering rate, not the angle",
    "mpc_weight_lat_jerk": "cost.rate weighs changes of the steering rate",
    "mpc_weight_steer_acc": "cost.rate weighs changes of the steering rate",
    "vehicle_model_type": "the library's vehicle and Gaussian processes predict",
    "vehicle_model_steer_tau": "the library's vehicle predicts",
    "qp_solver_type": "see the settings of the solver",
    "steering_lpf_cutoff_hz": "the command is not filtered",
    "input_delay": "train the library on the vehicle's log, which finds the delay",
}
"""Parameters that have no setting here, each with the reason."""


class AutowareError(EgpError):
    """A file that is not one of the parameters of Autoware's MPC lateral controller."""


@dataclass(frozen=True, slots=True)
class Mapped:
    """What became of Autoware's parameters."""

    settings: dict[str, object]
    """Settings of the control step, as `Controller` takes them."""
    limits: dict[str, float]
    """Fields of the vehicle's file that the parameters state."""
    sources: dict[str, str]
    """Setting or field, and the parameters that it comes from."""
    ignored: dict[str, str]
    """Parameters of the file without a setting here, and why."""


def read_parameters(path: Path) -> dict[str, object]:
    """Read `ros__parameters` of a file such as `lateral_controller_defaults.param.yaml`.

    Raises:
        AutowareError: if the file is no YAML, or has no such parameters.
        OSError: if the file cannot be read.

    """
    try:
        tree = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except (YAMLError, UnicodeDecodeError) as error:
        raise AutowareError(f"{path} is not YAML: {error}") from error
    nodes = tree.values() if isinstance(tree, dict) else ()
    for node in nodes:
        parameters = node.get("ros__parameters") if isinstance(node, dict) else None
        if isinstance(parameters, dict) and "mpc_prediction_horizon" in parameters:
            return parameters
    raise AutowareError(
        f"{path}: expected a node with `ros__parameters` and `mpc_prediction_horizon`; give the "
        "param.yaml of autoware_mpc_lateral_controller"
    )


def _is_number(value: object) -> TypeGuard[float]:
    """Whether a value of YAML is a number that a parameter can have, which NaN is not."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST


def map_parameters(parameters: Mapping[str, object], dt: float) -> Mapped:
    """Return the settings for a control period `dt` in s.

    horizon = N_aw dt_aw / dt periods, at most 100; cost.input = c w_steer_rate for the steering;
    cost.terminal = w_terminal / w_lateral; with c = cost.lateral / w_lateral.

    Raises:
        AutowareError: for a parameter that is no number, or is out of its range.

    """

    def number(name: str, default: float | None = None, *, least: float = 0.0) -> float:
        value = parameters.get(name, default)
        if not _is_number(value) or value < least:
            raise AutowareError(f"{name} = {value!r}: expected a number from {least:g} on")
        return float(value)

    lateral = number("mpc_weight_lat_error", least=1e-9)
    duration = number("mpc_prediction_horizon", least=1.0) * number("mpc_prediction_dt", least=1e-3)
    scale = _LATERAL / lateral
    terminal = number("mpc_weight_terminal_lat_error", lateral) / lateral
    cost: dict[str, object] = {"lateral": _LATERAL}
    sources = {
        "horizon": "mpc_prediction_horizon, mpc_prediction_dt",
        "cost.lateral": "mpc_weight_lat_error (sets the scale)",
    }
    if terminal > 0.0:
        cost["terminal"] = terminal
        sources["cost.terminal"] = "mpc_weight_terminal_lat_error"
    if (rate := number("mpc_weight_steer_rate", 0.0)) > 0.0:
        cost["input"] = [_INPUT_FORCE, scale * rate]
        sources["cost.input"] = "mpc_weight_steer_rate"
    horizon = min(_LONGEST, max(1, round(duration / dt)))
    limits: dict[str, float] = {}
    rates = parameters.get("steer_rate_lim_dps_list_by_velocity")
    if isinstance(rates, list) and rates:
        if not all(_is_number(rate) and rate > 0.0 for rate in rates):
            raise AutowareError(
                f"steer_rate_lim_dps_list_by_velocity = {rates!r}: expected positive numbers"
            )
        limits["steering_rate"] = math.radians(min(float(rate) for rate in rates))
        sources["steering_rate"] = "steer_rate_lim_dps_list_by_velocity (the lowest)"
    ignored = {name: why for name, why in NOT_MAPPED.items() if name in parameters}
    return Mapped({"horizon": horizon, "cost": cost}, limits, sources, ignored)
