"""How long the weights take to settle after the friction changed, and how well they can know it."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from egp_service._core import Engine, Library
from egp_service.control.toml_text import dumps
from egp_service.evaluation.window_noise import LEAST_MODEL_NOISE, covariance, model_noise
from egp_service.quantities import OMEGA, V_X, gp_input
from egp_service.simulation.scenario import library_path

if TYPE_CHECKING:
    from egp_service.simulation.closed_loop import Run

EXCITATION: Final = 1.8  # m/s² of lateral acceleration; without it measurements say nothing
_LOOK: Final = 2.0  # s after the change
_SETTLED_FROM: Final = 1.0  # s after the change: from here on the mean is the settled value
_BAND: Final = 0.25  # of the way from the value before to the settled one
# Of the friction's own step. Tyres far from their limit hardly tell surfaces apart: weights that
# move by less than this have not seen the step, and there is nothing to settle from.
_SMALLEST_WAY: Final = 0.25
_MIN_MEMBERS: Final = 2


def settling_times(run: Run) -> list[float]:
    """Seconds from each friction change until `sum w mu` stays near its later mean.

    Near means within a quarter of the way that it goes. Changes without lateral acceleration,
    without `_LOOK` seconds behind them, or that hardly move the weights do not count.
    """
    trace = run.trace
    if trace.weights.shape[1] < _MIN_MEMBERS:
        return []
    apparent = trace.weights @ run.frictions
    acceleration = np.abs(trace.x[:, V_X] * trace.x[:, OMEGA])
    look, settled = round(_LOOK / run.dt), round(_SETTLED_FROM / run.dt)
    times = []
    for change in np.flatnonzero(np.diff(trace.friction) != 0.0) + 1:
        after = slice(change, change + look)
        constant = np.all(trace.friction[after] == trace.friction[change])
        if change + look > len(trace) or not constant or acceleration[after].min() < EXCITATION:
            continue
        value = float(np.mean(apparent[change + settled : change + look]))
        way = abs(value - apparent[change - 1])
        step = abs(trace.friction[change] - trace.friction[change - 1])
        if not way > _SMALLEST_WAY * step:  # NaN before the first reply
            continue
        outside = np.flatnonzero(np.abs(apparent[after] - value) > _BAND * way)
        times.append(float((outside[-1] + 1) * run.dt) if len(outside) else 0.0)
    return times


def resolution(run: Run) -> float:
    """Find the standard deviation with which a window of measurements tells the friction.

    The Cramér-Rao bound of eq. (6) without a prior, median over the run: with d what two members'
    predictions of a window differ by and C the covariance of its errors, `|mu_1 - mu_0|` over
    `sqrt(dᵀ C⁻¹ d)`. No unbiased estimator does better with the same window if the sensors' noise
    is the run's and members err half as much as in training, the least that the weights consider.
    """
    scenario, trace = run.scenario, run.trace
    path = library_path(scenario)
    library = Library.load(path)
    settings = tomllib.loads(Engine(str(path), dumps(scenario.control)).settings_toml)
    sensors = scenario.measurement
    noise = covariance(
        LEAST_MODEL_NOISE * model_noise(library.members),
        np.array([sensors.v_x, sensors.v_y, sensors.omega]),
        settings["weights"]["window"],
    )
    root = np.linalg.inv(np.linalg.cholesky(noise))
    z = gp_input(trace.x, trace.u)
    first, second = (library.predict(z, member)[0] for member in range(2))
    windows = sliding_window_view(second - first, root.shape[-1], axis=0)
    information = np.sum(np.einsum("okj,noj->nok", root, windows) ** 2, axis=(1, 2))
    return float(np.ptp(run.frictions) / np.sqrt(np.median(information)))
