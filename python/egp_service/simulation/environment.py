"""A gymnasium environment of the scenarios, for controllers that are learned."""

from __future__ import annotations

import os
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import gymnasium as gym
import numpy as np

from egp_service._core import InvalidArgumentError, VehicleLostError
from egp_service.quantities import DELTA, NU, NX, OMEGA, POSITION, PSI, V_X, V_Y
from egp_service.simulation.course import build_path, build_profile, start_state
from egp_service.simulation.plant import make_plant, measurement_noise
from egp_service.simulation.scenario import (
    Scenario,
    check_scenario,
    leave_distance,
    load_scenario,
    vehicle_parameters,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from egp_service._core import Path

Observation = np.ndarray[tuple[int], np.dtype[np.float64]]

# m, where a full-size vehicle observes the curvature
_AHEAD: Final = np.array([0.0, 5.0, 10.0, 20.0, 40.0])
_PATIENCE: Final = 4.0  # times of the planned lap, after which an episode ends


class TrackEnvironment(gym.Env[Observation, Observation]):
    """The vehicle of a scenario on its track; an episode ends with the last lap or off the road.

    * An action is `[a, r]` in [-1, 1]²: `a` is the force as a share of the largest one for drive
      (`a > 0`) or braking, and `r` the steering rate as a share of the largest one, positive to the
      left.
    * An observation has 11 numbers: lateral error in m (positive to the left of the path), heading
      error in rad, `v_x`, `v_y` in m/s, `omega` in rad/s, `delta` in rad, and the path's curvature
      in 1/m at the vehicle and 5, 10, 20 and 40 m ahead, times the vehicle's
      `VehicleParameters.scale`. It is that of the measured state, which has the noise of the
      scenario's `measurement`. The friction is not observed.
    * The reward is the progress along the path in m.
    * `info` has the true state `x` (7,), its arc length `s` in m and the `friction` under the
      vehicle.

    Actions reach the wheels after the scenario's `actuator_delay`, counted in periods of `dt`. What
    concerns the controller of a closed loop has no effect here: `control`, `gate`, and in `speed`
    the keys `knows`, `risk`, `friction` and `preview` (docs/simulator.md). `library` has an effect
    only with `speed.tyres = true`, where the speed at the start depends on the members' tyres.

    Gymnasium makes it by its name, too, also several at once, and imports this module for it:

    >>> import gymnasium
    >>> name = "egp_service.simulation.environment:egp/Track-v0"
    >>> environments = gymnasium.make_vec(name, num_envs=2, scenario="random", dt=0.02)
    >>> observations, _ = environments.reset(seed=3)
    >>> observations.shape
    (2, 11)
    """

    def __init__(
        self, scenario: Scenario | str | os.PathLike[str] = "random", dt: float = 0.02
    ) -> None:
        """Drive a scenario, given by itself or by its name or file, with actions every `dt` s.

        Raises:
            InvalidArgumentError: unless `dt` is positive and finite.
            EgpError: if the scenario or its track cannot be made, or the file of the library that
                `speed.tyres = true` needs is no library.
            OSError: if the file of this library cannot be read.

        """
        if not 0.0 < dt < np.inf:
            raise InvalidArgumentError(f"expected a positive number of seconds for dt, got {dt}")
        if not isinstance(scenario, Scenario):
            scenario = load_scenario(os.fspath(scenario))
        self._scenario = scenario
        check_scenario(self._scenario, self._scenario.name)
        self._dt = dt
        car = vehicle_parameters(self._scenario)
        self._force = car.mass * np.array([-car.a_min, car.a_max])
        self._steering = car.steering_rate
        self._ahead = car.scale * _AHEAD
        self._leave = leave_distance(self._scenario)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float64)
        size = 6 + len(_AHEAD)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self._start(self._scenario)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the vehicle on the start of the path, at the speed planned for the true friction.

        `seed` replaces the scenario's seed: it makes the measurement noise, and a random track
        unless the scenario's `track.parameters` state a seed. The same seed makes the same episode,
        and the same ones after it. Without `seed`, the first episode has the scenario's own seed,
        and each later one a seed that is drawn from `np_random`. `options` has no effect. Returns
        the observation and a dictionary of information, as `step` does.

        Raises:
            EgpError: if the track of the seed cannot be made.

        """
        if seed is None and self._np_random is None:
            seed = self._scenario.seed
        super().reset(seed=seed, options=options)
        drawn = int(self.np_random.integers(1 << 63)) if seed is None else seed
        self._start(replace(self._scenario, seed=drawn))
        return self._observe(self._plant.state)

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive one period with the action (2,), which is limited to [-1, 1]².

        Returns the observation (11,), the reward, which is the progress along the path in m,
        whether the episode ended because the vehicle completed its laps, left the road or spun,
        whether it ended because it took too long, and a dictionary of information.

        Raises:
            InvalidArgumentError: unless the action has the shape (2,) and is finite; the period is
                then not driven.

        """
        try:
            shares = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError):
            shares = np.array(np.nan)
        if shares.shape != (NU,) or not np.isfinite(shares).all():
            raise InvalidArgumentError(
                f"expected an action of shape ({NU},) with finite numbers, got {action!r}"
            )
        share, rate = np.clip(shares, -1.0, 1.0)
        u = np.array([share * self._force[int(share > 0.0)], rate * self._steering])
        before, x, spun = self._distance, self._plant.state, False
        self._pending.append(u)
        try:
            self._plant.drive(self._pending.popleft(), self._dt, self._s)
            x = self._plant.state
        except VehicleLostError:
            spun = True  # the state before the loss is observed
        self._time += self._dt
        observation, info = self._observe(x)
        left = spun or abs(self._lateral) > self._leave
        ended = left or self._distance >= self._goal
        return observation, self._distance - before, ended, self._time > self._limit, info

    def _start(self, scenario: Scenario) -> None:
        self._path: Path = build_path(scenario)
        self._plant = make_plant(scenario, self._path)
        self._noise = measurement_noise(scenario.measurement)
        self._random = np.random.default_rng(scenario.seed)
        # Inputs that have not yet reached the wheels.
        self._pending = deque([np.zeros(NU)] * scenario.actuator_delay)
        profile = build_profile(scenario, self._path)
        laps = scenario.laps if self._path.closed else 1.0
        self._goal = laps * self._path.length
        self._limit = _PATIENCE * laps * profile.lap_time
        self._s, self._distance, self._time = 0.0, 0.0, 0.0
        v_start = scenario.speed.v_start
        speed = float(profile.speed(np.zeros(1))[0]) if v_start is None else v_start
        self._plant.reset(start_state(scenario, self._path, speed))

    def _observe(self, x: NDArray[np.float64]) -> tuple[Observation, dict[str, Any]]:
        """Return observation and info of a true state (7,), and update the driven distance."""
        measured = x + self._noise * self._random.standard_normal(NX)
        seen = self._path.project(measured[POSITION], self._s)
        projection = self._path.project(x[POSITION], self._s)
        advanced = projection.s - self._s
        if self._path.closed:
            advanced -= self._path.length * round(advanced / self._path.length)
        self._distance += advanced
        self._s, self._lateral = projection.s, projection.lateral
        heading = (measured[PSI] - seen.yaw + np.pi) % (2.0 * np.pi) - np.pi
        curvature = self._path.sample(seen.s + self._ahead)[3]
        motion = measured[[V_X, V_Y, OMEGA, DELTA]]
        observation = np.array([seen.lateral, heading, *motion, *curvature])
        return observation, {"x": x, "s": self._s, "friction": projection.friction}


gym.register("egp/Track-v0", f"{__name__}:{TrackEnvironment.__name__}")
