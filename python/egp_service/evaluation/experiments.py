"""The closed-loop experiments: their scenarios, conditions and contenders.

Numbers in titles are those of the paper's section "Multi-surface driving and generalization"; other
experiments are marked as beyond the paper. Each run is one `Trial`, which together with the
libraries determines it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import VehicleParameters
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE, PAPER_WEIGHTS, Contender
from egp_service.simulation.course import build_path
from egp_service.simulation.scenario import Measurement, Scenario, Speed, Track, Zone

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

# Members of the evaluation library, by friction.
M05, M06, M09, M11, POOLED = 0, 1, 2, 3, 4
TWO: Final = (M05, M11)
# Members of the same two surfaces with constant means as in the paper.
CONSTANT_MEAN: Final = (5, 6)
FOUR: Final = (M05, M06, M09, M11)
# A survey-grade satellite receiver with a good inertial unit and a steering encoder.
NOISE: Final = Measurement(position=0.02, v_x=0.03, psi=0.002, v_y=0.03, omega=0.005, delta=0.001)
# Suffix of conditions without measurement noise.
EXACT: Final = ", exact sensors"
FASTEST: Final = 25.0
HALF_WIDTH: Final = 0.837  # half of the vehicle's width, m
CUSTOM_TRACK: Final = Track(
    "rounded-rectangle",
    parameters={"length": 140.0, "width": 80.0, "radius": 20.0, "transition": 12.0},
)
# Sources of the reference speed's friction: what control steps found, one value everywhere, and the
# friction under the vehicle.
BELIEF: Final = "found, risk "
ASSUMED: Final = "assumed "
HERE: Final = "told here, "
RISKS: Final = (0.03, 0.05, 0.1, 0.2)
_ZONE_JITTER: Final = 0.02  # largest shift of zones as a share of the path's length


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
    frictions: tuple[float, float] = (0.5, 1.1)
    """Range of the frictions of random roads."""

    @property
    def compared(self) -> str:
        """The condition whose drives are drawn side by side: the second, or the only one."""
        return self.conditions[min(1, len(self.conditions) - 1)][0]

    def trials(self, seeds: Iterable[int]) -> Iterator[Trial]:
        """Yield every contender at every condition for each seed."""
        for seed in seeds:
            for condition, scenario in self.conditions:
                # All contenders have the same road and noise for the same seed.
                driven = _jittered(replace(scenario, seed=seed), seed, self.frictions)
                for contender in self.contenders:
                    yield Trial(self.name, condition, contender, driven)


def contenders(members: Sequence[int], labels: Sequence[str]) -> tuple[Contender, ...]:
    """Return the ensemble of `members` and its baselines."""
    return (
        Contender(ENSEMBLE, "ensemble", tuple(members)),
        Contender("paper's weights", "ensemble", tuple(members), {"weights": PAPER_WEIGHTS}),
        Contender("selection", "selection", tuple(members)),
        *(Contender(f"only {labels[m]}", "ensemble", (m,)) for m in members),
        Contender("pooled GP", "ensemble", (POOLED,)),
        Contender("nominal single-track", "single-track", tuple(members)),
        Contender("kinematic", "kinematic", tuple(members)),
        Contender(ORACLE, "oracle", tuple(members)),
    )


LABELS: Final = ("μ 0.5", "μ 0.6", "μ 0.9", "μ 1.1", "pooled")
# Variants of the ensemble with one part changed; they are not baselines.
VARIANTS: Final = ("paper's weights", "constant mean", "fitted single-track", "forward Euler")
_ALL_OF_TWO: Final = (
    *contenders(TWO, LABELS),
    Contender("constant mean", "ensemble", CONSTANT_MEAN),
    Contender("fitted single-track", "fitted", TWO),
    Contender("forward Euler", "ensemble", TWO, {"operating": {"yaw_at": 0.0}}),
)
_ALL_OF_FOUR: Final = contenders(FOUR, LABELS)
_AVOIDING: Final = {ENSEMBLE, "pooled GP", "nominal single-track", "kinematic", ORACLE}


def _scenario(
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


def _steady(track: Track, zones: Sequence[tuple[float, float]], speed: float) -> Scenario:
    """Return a scenario with a constant speed on all surfaces."""
    return replace(_scenario(track, zones, 1.0), speed=Speed(v_max=speed, constant=True))


def _varying_speed() -> ClosedLoopExperiment:
    zones = ((0.0, 0.5), (0.33, 1.1), (0.65, 0.8))
    return ClosedLoopExperiment(
        "varying-speed",
        "Track with varying speed (paper, experiment 2)",
        "At which fraction of the grip does each controller begin to fail?",
        tuple(
            (f"{grip:.0%} of grip", _scenario(CUSTOM_TRACK, zones, grip))
            for grip in (0.80, 0.90, 0.95, 1.00)
        ),
        _ALL_OF_TWO,
        seeds=20,
        quick_seeds=2,
    )


def _unseen_track() -> ClosedLoopExperiment:
    zones = ((0.0, 1.1), (0.15, 0.6), (0.32, 0.9), (0.5, 0.5), (0.68, 1.1), (0.84, 0.75))
    circuit = Track("circuit", parameters={"length": 1200.0, "min_radius": 24.0})
    return ClosedLoopExperiment(
        "unseen-track",
        "Unseen long circuit at 14 m/s (paper, experiment 3)",
        "Does the library generalise to a track without training data?",
        (("14 m/s", _scenario(circuit, zones, 0.9, 14.0)),),
        _ALL_OF_TWO,
        seeds=20,
        quick_seeds=1,
    )


def _lane_change() -> ClosedLoopExperiment:
    repeated = Track("lane-change", parameters={"length": 500.0, "offset": 2.75})
    zones = ((0.0, 1.1), (0.25, 0.7), (0.5, 0.5), (0.75, 1.1))
    return ClosedLoopExperiment(
        "lane-change",
        "Repeated lane changes at 15 m/s (paper, experiment 4)",
        "Changing lanes of 2.75 m over 500 m while the surface changes.",
        (("15 m/s", _steady(repeated, zones, 15.0)),),
        _ALL_OF_TWO,
        seeds=20,
        quick_seeds=2,
    )


def _obstacle_avoidance() -> ClosedLoopExperiment:
    surfaces: dict[str, tuple[tuple[float, float], ...]] = {
        "μ 1.1": ((0.0, 1.1),),
        "μ 0.8": ((0.0, 0.8),),
        "μ 0.5": ((0.0, 0.5),),
        "μ 1.1 to 0.5": ((0.0, 1.1), (0.5, 0.5)),
    }
    course = Track("iso-3888-2", parameters={"lead_in": 25.0, "lead_out": 15.0})
    # The cones leave room for the car only; a wider margin would exclude all positions.
    control: dict[str, object] = {"soft": {"edge_margin": HALF_WIDTH}}
    return ClosedLoopExperiment(
        "iso-3888-2",
        "Obstacle avoidance of ISO 3888-2 (paper, experiment 4)",
        "The highest entry speed at which each controller comes through without touching a cone, "
        "by bisection to 0.25 m/s: median over the seeds and its 95 % interval.",
        tuple(
            (surface, replace(_steady(course, zones, 10.0), control=control))
            for surface, zones in surfaces.items()
        ),
        tuple(c for c in _ALL_OF_TWO if c.name in _AVOIDING),
        seeds=10,
        quick_seeds=1,
    )


def _four_members() -> ClosedLoopExperiment:
    frictions = (1.1, 0.5, 0.8, 0.6, 1.0)
    # Middles of corners and of straights, as fractions of the lap.
    corners = (0.0, 0.20, 0.30, 0.70, 0.80)
    straights = (0.0, 0.245, 0.44, 0.56, 0.745)
    return ClosedLoopExperiment(
        "four-members",
        "Four members, five zones (paper, experiment 5)",
        "How fast do the weights follow, with and without excitation?",
        tuple(
            (
                f"changes {where}",
                _scenario(CUSTOM_TRACK, tuple(zip(starts, frictions, strict=True)), 0.9),
            )
            for where, starts in (("in corners", corners), ("on straights", straights))
        ),
        _ALL_OF_FOUR,
        seeds=20,
        quick_seeds=1,
    )


def _random_roads() -> ClosedLoopExperiment:
    return ClosedLoopExperiment(
        "random-roads",
        "Random tracks with random frictions (beyond the paper)",
        "A new track and a new friction map for every seed.",
        (("90% of grip", _scenario(Track("random"), ((0.0, 1.0),), 0.9)),),
        _ALL_OF_TWO,
        seeds=30,
        quick_seeds=2,
    )


def _hard_roads() -> ClosedLoopExperiment:
    base = ((0.0, 1.1), (0.33, 0.6), (0.65, 0.9))
    icy: list[tuple[float, float]] = []
    length = 399.0  # of the custom track, about
    for start, patch, around in (
        (0.05, 2.0, 1.1),
        (0.19, 5.0, 1.1),
        (0.45, 10.0, 1.1),
        (0.70, 5.0, 1.1),
    ):
        icy += [(start, 0.25), (start + patch / length, around)]
    plain = _scenario(CUSTOM_TRACK, base, 0.85)
    # The gate is that of vehicle 1, as the library is: the driver accepts no gate of another mass.
    other = replace(plain, vehicle=2, gate=VehicleParameters.commonroad(1).gate_limits())
    loud = Measurement(position=0.06, v_x=0.09, psi=0.006, v_y=0.09, omega=0.015, delta=0.003)
    # The speed is constant because a profile with the patches would brake for each of them.
    dry = _steady(CUSTOM_TRACK, ((0.0, 1.1), *icy), 11.0)
    # In the left turns of this lap the slippery right side has most of the load.
    split = (Zone(0.0, 1.1, right=0.5),)
    partly = (Zone(0.0, 1.1), Zone(0.33, 1.1, right=0.5), Zone(0.65, 0.8))
    return ClosedLoopExperiment(
        "hard-roads",
        "Conditions outside the training data (beyond the paper)",
        "Noise, delay, another car, ice, roads whose sides differ, and frictions outside the "
        "library's range.",
        (
            ("as the rest", plain),
            ("three times the noise", replace(plain, measurement=loud)),
            ("20 ms actuator delay", replace(plain, actuator_delay=1)),
            ("40 ms actuator delay", replace(plain, actuator_delay=2)),
            ("vehicle 2", other),
            ("patches of ice, 2-10 m", dry),
            ("split 1.1 | 0.5 for a third", replace(plain, zones=partly)),
            (
                "split 1.1 | 0.5, 75% of grip",
                replace(_scenario(CUSTOM_TRACK, base, 0.75), zones=split),
            ),
            ("μ 0.35", _scenario(CUSTOM_TRACK, ((0.0, 0.35),), 0.85)),
            ("μ 1.3", _scenario(CUSTOM_TRACK, ((0.0, 1.3),), 0.85)),
        ),
        _ALL_OF_TWO,
        seeds=5,
        quick_seeds=1,
    )


def _friction_step() -> ClosedLoopExperiment:
    circle = Track("circle", parameters={"radius": 50.0})
    zones = ((0.0, 1.1), (0.5, 0.5))
    conditions = [
        (
            f"{acceleration} m/s² lateral",
            _steady(circle, zones, float(np.sqrt(50.0 * acceleration))),
        )
        for acceleration in (1, 2, 3, 4)
    ]
    conditions += [
        (name + EXACT, replace(scenario, measurement=Measurement()))
        for name, scenario in conditions[1:]  # at 1 m/s² the friction is hardly observable
    ]
    return ClosedLoopExperiment(
        "friction-step",
        "Friction step under steady lateral acceleration (beyond the paper)",
        "On a circle of 50 m radius: how long until the weights have settled, with the noise of "
        "all other runs, and with exact sensors?",
        tuple(conditions),
        tuple(c for c in _ALL_OF_TWO if c.name in {ENSEMBLE, "paper's weights"}),
        seeds=20,
        quick_seeds=2,
    )


def _unknown_roads() -> ClosedLoopExperiment:
    base = _scenario(Track("random"), ((0.0, 1.0),), 0.9)
    return ClosedLoopExperiment(
        "unknown-roads",
        "Roads of unknown friction, first lap (beyond the paper)",
        "The reference speed is not told the friction: what does each source of it cost in time, "
        "and how many laps end beside the road? The oracle is told all zones.",
        (("first lap", replace(base, leave_distance=3.5)),),
        (
            Contender(ORACLE, "ensemble", TWO),
            *(
                Contender(f"{BELIEF}{risk:.0%}", "ensemble", TWO, speed=_believed(risk))
                for risk in RISKS
            ),
            *(
                Contender(
                    f"{ASSUMED}{mu:g}",
                    "ensemble",
                    TWO,
                    speed={"knows": "nothing", "friction": mu},
                )
                for mu in (0.3, 0.35, 0.4, 0.5, 0.6)
            ),
            *(
                Contender(
                    f"{HERE}{share:.0%} of it, at most {most:g}",
                    "ensemble",
                    TWO,
                    speed={"knows": "here", "friction": most, "grip": 0.9 * share},
                )
                for share, most in ((1.0, 1.1), (0.8, 1.1), (0.8, 0.5), (1.0, 0.4))
            ),
        ),
        seeds=30,
        quick_seeds=1,
        frictions=(0.25, 1.1),
    )


def _remembered_roads() -> ClosedLoopExperiment:
    base = _scenario(Track("random"), ((0.0, 1.0),), 0.9)
    return ClosedLoopExperiment(
        "remembered-roads",
        "Roads of unknown friction, five laps (beyond the paper)",
        "What the first lap found is remembered by place: how fast do the next laps become?",
        (("five laps", replace(base, leave_distance=3.5, laps=5.0)),),
        (
            Contender(ORACLE, "ensemble", TWO),
            *(
                Contender(f"{BELIEF}{risk:.0%}", "ensemble", TWO, speed=_believed(risk))
                for risk in RISKS[:3]
            ),
        ),
        seeds=20,
        quick_seeds=1,
        frictions=(0.25, 1.1),
    )


def _believed(risk: float) -> dict[str, object]:
    return {"knows": "nothing", "risk": risk}


def on_track(experiment: ClosedLoopExperiment, file: Path, scale: float) -> ClosedLoopExperiment:
    """Return the experiment on a track from a CSV file with lengths multiplied by `scale`.

    Raises `EgpError` if the file is not a track.
    """
    track = Track("csv", str(file.resolve()), {"scale": scale})
    conditions = tuple(
        (f"{condition} on {file.stem}", replace(scenario, track=track))
        for condition, scenario in experiment.conditions
    )
    for _, scenario in conditions:
        build_path(scenario)  # reports an invalid file before the runs start
    return replace(experiment, conditions=conditions)


def _jittered(scenario: Scenario, seed: int, frictions: tuple[float, float]) -> Scenario:
    """Shift zone borders randomly, or draw new zones on a random track."""
    rng = np.random.default_rng([seed, 7])
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


EXPERIMENTS: Final = (
    _varying_speed(),
    _lane_change(),
    _four_members(),
    _random_roads(),
    _friction_step(),
    _unseen_track(),
    _hard_roads(),
    _unknown_roads(),
    _remembered_roads(),
)
# `entry_speed.find` turns each of its trials into a highest entry speed.
OBSTACLE_AVOIDANCE: Final = _obstacle_avoidance()
