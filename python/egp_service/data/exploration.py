"""Data collection on a track at increasing speed with exploration noise, on one surface.

A run consists of episodes. Each starts at a random point of the track with a warm-up that is not
recorded, in which suspension and tyres reach their state. The warm-up is on the surface itself or
on a surface with higher friction, from which the vehicle then arrives too fast. The fraction of
grip that the reference speed needs increases from episode to episode beyond the friction of the
surface. An episode ends early if the vehicle leaves the track or spins.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError, VehicleLostError
from egp_service.data.dataset import Dataset
from egp_service.data.driver import Driver
from egp_service.data.experiment import check_range
from egp_service.quantities import MOTION, NU, NX, V_X, gp_input

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from egp_service.data.experiment import Experiment, SimulatedVehicle
    from egp_service.data.exploration_track import ExplorationTrack

STANDING: Final = 1.0
"""Vehicles slower than this count as standing, m/s."""


@dataclasses.dataclass(frozen=True)
class ExplorationSettings:
    """Settings of a run."""

    episodes: int = 40
    """Number of episodes of a run."""
    seconds: float = 3.0
    """Recorded length of an episode, s."""
    warm_up: float = 0.8
    """Duration of driving before recording, s."""
    grip: tuple[float, float] = (0.25, 1.1)
    """Fraction of the available grip that the speed profile uses, first and last episode."""
    arrivals: float = 0.25
    """Share of episodes that arrive from the surface with higher friction."""
    arrival_friction: float = 1.1
    """Friction coefficient of that surface."""
    reaction: tuple[float, float] = (0.0, 1.0)
    """Time after arriving until the driver slows down, s."""
    noise: tuple[float, float] = (0.0, 0.7)
    """Scale of the excitation, uniform over episodes; see `Driver`."""

    def __post_init__(self) -> None:
        """Check the ranges of the values."""
        check_range("episodes", self.episodes, 1, 100_000)
        check_range("seconds", self.seconds, 0.1, 3600.0)
        check_range("warm_up", self.warm_up, 0.0, 60.0)
        check_range("grip", self.grip, 0.01, 3.0, ordered=False)
        check_range("arrivals", self.arrivals, 0.0, 1.0)
        check_range("arrival_friction", self.arrival_friction, 0.01, 3.0)
        check_range("reaction", self.reaction, 0.0, 60.0)
        check_range("noise", self.noise, 0.0, 10.0)


def explore(
    experiment: Experiment, track: ExplorationTrack, settings: ExplorationSettings
) -> Dataset:
    """Drive one run; errors if every episode ended in its first periods."""
    rng = np.random.default_rng(experiment.seed)
    vehicle = experiment.simulated()
    z, y, trajectory, step = [], [], [], []
    for episode in range(settings.episodes):
        states, inputs = _episode(experiment, vehicle, track, settings, number=episode, rng=rng)
        count = len(inputs)
        if count == 0:
            continue
        z.append(gp_input(states[:-1], inputs))
        y.append(np.diff(states[:, MOTION], axis=0))
        trajectory.append(np.full(count, episode, dtype=np.uint32))
        step.append(np.arange(count, dtype=np.uint32))
    if not z:
        raise EgpError(
            f"all {settings.episodes} episodes left the track at their start: lower the grip"
        )
    return Dataset(
        z=np.concatenate(z),
        y=np.concatenate(y),
        trajectory=np.concatenate(trajectory),
        step=np.concatenate(step),
        provenance=experiment.provenance("track"),
    )


def _episode(
    experiment: Experiment,
    vehicle: SimulatedVehicle,
    track: ExplorationTrack,
    settings: ExplorationSettings,
    *,
    number: int,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Drive one episode; return the recorded states (n + 1, 7) and inputs (n, 2)."""
    low, high = settings.grip
    grip = low + (high - low) * (number + rng.uniform()) / settings.episodes
    arrives = rng.uniform() < settings.arrivals
    surface_before = settings.arrival_friction if arrives else experiment.friction
    before = settings.arrival_friction if arrives else experiment.mu
    reaction = rng.uniform(*settings.reaction) if arrives else 0.0
    vehicle.reset(track.start(rng.uniform(0.0, track.length), before, grip))
    noise = rng.uniform(*settings.noise)
    driver = Driver(
        rng,
        experiment.dt,
        experiment.mass,
        experiment.parameters,
        noise,
        experiment.mu,
        experiment.wheelbase,
    )

    def drive(seconds: float, surface: float | str, believed: Callable[[float], float]) -> bool:
        for k in range(round(seconds / experiment.dt)):
            x = vehicle.state
            reference, on_track = track.look(x, believed(k * experiment.dt), grip, experiment.dt)
            if not on_track or x[V_X] < STANDING:
                return False
            u = driver.input(x, reference)
            try:
                vehicle.step(u, experiment.dt, surface)
            except VehicleLostError:
                return False
            inputs.append(u)
            states.append(vehicle.state)
        return True

    inputs: list[NDArray[np.float64]] = []
    states: list[NDArray[np.float64]] = []
    if not drive(settings.warm_up, surface_before, lambda _: before):
        return np.empty((1, NX)), np.empty((0, NU))
    inputs, states = [], [vehicle.state]
    drive(
        settings.seconds,
        experiment.friction,
        lambda t: before if t < reaction else experiment.mu,
    )
    return np.array(states), np.array(inputs).reshape(-1, NU)
