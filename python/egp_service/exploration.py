"""Driving a track at rising speed with exploration noise, on one surface.

A run is a number of episodes. Each begins somewhere on the track with a moment that is not
recorded, in which suspension and tyres find their state: on the surface itself, or on a better one
from which the vehicle then arrives too fast. The fraction of grip that the speed asks for rises
from episode to episode, to beyond what the surface holds; an episode ends early when the vehicle
leaves the track or spins.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service import EgpError
from egp_service._core import Plant
from egp_service.dataset import Dataset
from egp_service.driver import Driver

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from egp_service.experiment import Experiment
    from egp_service.exploration_track import ExplorationTrack

_MIN_SPEED: Final = 1.0  # m/s; slower is standing


@dataclasses.dataclass(frozen=True)
class ExplorationSettings:
    """How a run explores."""

    episodes: int = 40
    """Episodes of a run."""
    seconds: float = 3.0
    """Recorded length of an episode, s."""
    warm_up: float = 0.8
    """Driving before recording begins, s."""
    grip: tuple[float, float] = (0.25, 1.1)
    """Fraction of the available grip that the speed profile uses, first and last episode."""
    arrivals: float = 0.25
    """Share of episodes that arrive from the better surface."""
    arrival_friction: float = 1.1
    """Friction coefficient of that surface."""
    reaction: tuple[float, float] = (0.0, 1.0)
    """Time after arriving until the driver slows down, s."""
    noise: tuple[float, float] = (0.0, 0.7)
    """Scale of the excitation, uniform over episodes; see `Driver`."""


def explore(
    experiment: Experiment, track: ExplorationTrack, settings: ExplorationSettings
) -> Dataset:
    """Drive one run.

    Raises:
        EgpError: when no episode survived its first periods.

    """
    rng = np.random.default_rng(experiment.seed)
    z, y, trajectory, step = [], [], [], []
    for episode in range(settings.episodes):
        states, inputs = _episode(experiment, track, settings, episode, rng)
        count = len(inputs)
        if count == 0:
            continue
        z.append(np.hstack([states[:-1, (2, 4, 5, 6)], inputs]))
        y.append(np.diff(states[:, (2, 4, 5)], axis=0))
        trajectory.append(np.full(count, episode, dtype=np.uint32))
        step.append(np.arange(count, dtype=np.uint32))
    if not z:
        raise EgpError(f"all {settings.episodes} episodes left the track at once: lower the grip")
    return Dataset(
        z=np.concatenate(z),
        y=np.concatenate(y),
        trajectory=np.concatenate(trajectory),
        step=np.concatenate(step),
        provenance=experiment.provenance("track"),
    )


def _episode(
    experiment: Experiment,
    track: ExplorationTrack,
    settings: ExplorationSettings,
    number: int,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Drive one episode: recorded states (n + 1, 7) and inputs (n, 2)."""
    low, high = settings.grip
    grip = low + (high - low) * (number + rng.uniform()) / settings.episodes
    arrives = rng.uniform() < settings.arrivals
    before = settings.arrival_friction if arrives else experiment.friction
    reaction = rng.uniform(*settings.reaction) if arrives else 0.0
    plant = Plant(experiment.vehicle)
    x = track.start(rng.uniform(0.0, track.length), before, grip)
    plant.reset(x[0], x[1], x[3], x[2], x[5], x[4], x[6])
    driver = Driver(
        rng, experiment.dt, experiment.mass, experiment.parameters, rng.uniform(*settings.noise)
    )

    def drive(seconds: float, surface: float, believed: Callable[[float], float]) -> bool:
        for k in range(round(seconds / experiment.dt)):
            x = plant.vehicle_state
            reference, on_track = track.look(x, believed(k * experiment.dt), grip, experiment.dt)
            if not on_track or x[2] < _MIN_SPEED:
                return False
            u = driver.input(x, reference)
            try:
                plant.step(u, experiment.dt, surface)
            except EgpError:  # it spun
                return False
            inputs.append(u)
            states.append(plant.vehicle_state)
        return True

    inputs: list[NDArray[np.float64]] = []
    states: list[NDArray[np.float64]] = []
    if not drive(settings.warm_up, before, lambda _: before):
        return np.empty((1, 7)), np.empty((0, 2))
    inputs, states = [], [plant.vehicle_state]
    drive(
        settings.seconds,
        experiment.friction,
        lambda t: before if t < reaction else experiment.friction,
    )
    return np.array(states), np.array(inputs).reshape(-1, 2)
