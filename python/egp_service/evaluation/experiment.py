"""A closed-loop experiment: scenarios, contenders and seeds, and what its trials have in common."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.simulation.scenario import Measurement, Scenario, Speed, Track, Zone

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from egp_service.evaluation.contenders import Contender

# Members of the evaluation library, by friction.
M05, M06, M09, M11, POOLED = 0, 1, 2, 3, 4
TWO: Final = (M05, M11)
# A survey-grade satellite receiver with a good inertial unit and a steering encoder.
NOISE: Final = Measurement(position=0.02, v_x=0.03, psi=0.002, v_y=0.03, omega=0.005, delta=0.001)
CUSTOM_TRACK: Final = Track(
    "rounded-rectangle",
    parameters={"length": 140.0, "width": 80.0, "radius": 20.0, "transition": 12.0},
)
LAP_ZONES: Final = ((0.0, 0.5), (0.33, 1.1), (0.65, 0.8))
"""Starts and frictions of three surfaces on a lap of the custom track."""
FASTEST: Final = 25.0
_ZONE_JITTER: Final = 0.02  # largest shift of zones as a share of the path's length


def jittered(scenario: Scenario, frictions: tuple[float, float] = (0.5, 1.1)) -> Scenario:
    """Shift zone borders randomly, or draw new zones in a range of frictions on a random track."""
    rng = np.random.default_rng([scenario.seed, 7])
    if scenario.track.kind == "random":
        count = int(rng.integers(3, 7))
        borders = np.sort(rng.uniform(0.05, 0.95, count - 1))
        starts = (0.0, *(float(border) for border in borders))
        drawn = rng.uniform(*frictions, count)
        zones = tuple(Zone(s, float(mu)) for s, mu in zip(starts, drawn, strict=True))
        return replace(scenario, zones=zones)
    shift = float(rng.uniform(-_ZONE_JITTER, _ZONE_JITTER))
    first, *others = scenario.zones
    moved = (replace(zone, start=zone.start + shift) for zone in others)
    return replace(scenario, zones=(first, *moved))


@dataclass(frozen=True, slots=True)
class Trial:
    """One run: a contender in a scenario."""

    experiment: str
    condition: str
    contender: Contender
    scenario: Scenario
    """Scenario with the run's seed; its library is set when the run starts."""

    @property
    def key(self) -> tuple[str, str, str, int]:
        """Unique key of the trial."""
        return self.experiment, self.condition, self.contender.name, self.scenario.seed

    def __str__(self) -> str:
        """Name the trial for messages."""
        *names, seed = self.key
        return f"{', '.join(map(str, names))}, seed {seed}"


@dataclass(frozen=True, slots=True)
class ClosedLoopExperiment:
    """One experiment: all contenders at all conditions, for any seeds."""

    name: str
    title: str
    question: str
    conditions: tuple[tuple[str, Scenario], ...]
    contenders: tuple[Contender, ...]
    seeds: int
    quick_seeds: int
    road: Callable[[Scenario], Scenario] = jittered
    """Gives the zones for the scenario's seed."""

    @property
    def compared(self) -> str:
        """The condition whose drives are drawn side by side: the second, or the only one."""
        return self.conditions[min(1, len(self.conditions) - 1)][0]

    def trials(self, seeds: Iterable[int]) -> Iterator[Trial]:
        """Yield every contender at every condition for each seed."""
        for seed in seeds:
            for condition, scenario in self.conditions:
                # All contenders have the same road and noise for the same seed.
                driven = self.road(replace(scenario, seed=seed))
                for contender in self.contenders:
                    yield Trial(self.name, condition, contender, driven)


def on_surfaces(
    track: Track, zones: Sequence[tuple[float, float]], grip: float, v_max: float = FASTEST
) -> Scenario:
    """Return a scenario with a speed profile that uses the fraction `grip` of the friction."""
    return Scenario(
        name="evaluation",
        track=track,
        zones=tuple(Zone(start, friction) for start, friction in zones),
        speed=Speed(grip=grip, v_max=v_max),
        measurement=NOISE,
    )
