"""Settling time of the weights after friction changes, and the bound on their accuracy."""

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

EXCITATION: Final = 1.8  # m/s² of lateral acceleration; with less, friction is not observable
_DURATION: Final = 2.0  # s after the change that are evaluated
_SETTLED_FROM: Final = 1.0  # s after the change; the mean from here on is the settled value
_BAND: Final = 0.25  # of the difference between the previous and the settled value
# Smallest change of the weighted friction, as a share of the true step. Far from the tyres' limit
# surfaces are hardly distinguishable, and weights that change less have not detected the step.
_MIN_CHANGE: Final = 0.25
_MIN_MEMBERS: Final = 2


def settling_times(run: Run) -> list[float]:
    """Seconds from each friction change until `sum w mu` stays near its later mean.

    Near means within a quarter of its total change. Friction changes are left out if the lateral
    acceleration is too small, if fewer than `_DURATION` seconds follow them, or if the weights
    hardly change.
    """
    trace = run.trace
    if trace.weights.shape[1] < _MIN_MEMBERS:
        return []
    apparent = trace.weights @ run.frictions
    acceleration = np.abs(trace.x[:, V_X] * trace.x[:, OMEGA])
    duration, settled = round(_DURATION / run.dt), round(_SETTLED_FROM / run.dt)
    times = []
    for change in np.flatnonzero(np.diff(trace.friction) != 0.0) + 1:
        after = slice(change, change + duration)
        constant = np.all(trace.friction[after] == trace.friction[change])
        if change + duration > len(trace) or not constant or acceleration[after].min() < EXCITATION:
            continue
        value = float(np.mean(apparent[change + settled : change + duration]))
        difference = abs(value - apparent[change - 1])
        step = abs(trace.friction[change] - trace.friction[change - 1])
        if not difference > _MIN_CHANGE * step:  # NaN before the first reply
            continue
        outside = np.flatnonzero(np.abs(apparent[after] - value) > _BAND * difference)
        times.append(float((outside[-1] + 1) * run.dt) if len(outside) else 0.0)
    return times


def resolution(run: Run) -> float:
    """Return the smallest standard deviation of a friction estimate from one window.

    This is the Cramér-Rao bound of eq. (6) without a prior, `|mu_1 - mu_0| / sqrt(dᵀ C⁻¹ d)`, as a
    median over the run. d is the difference of two members' predictions of a window and C the
    covariance of its errors. C contains the noise of the run's sensors and half of the members'
    training error, the smallest that the weights consider. No unbiased estimator from the same
    window has a smaller standard deviation.
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
    first, second = (library.predict_mean(z, member) for member in range(2))
    windows = sliding_window_view(second - first, root.shape[-1], axis=0)
    information = np.sum(np.einsum("okj,noj->nok", root, windows) ** 2, axis=(1, 2))
    return float(np.ptp(run.frictions) / np.sqrt(np.median(information)))
