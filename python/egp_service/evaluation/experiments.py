"""The closed-loop experiments: their scenarios, conditions and contenders.

Numbers in titles are those of the paper's section "Multi-surface driving and generalization"; other
experiments are marked as beyond the paper. Each run is one `Trial`, which together with the
libraries determines it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError, Library, VehicleParameters
from egp_service.evaluation import disturbances, fleet_roads, hidden_ice, unknown_roads
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE, PAPER_WEIGHTS, Contender
from egp_service.evaluation.experiment import (
    CUSTOM_TRACK,
    LAP_ZONES,
    M05,
    M06,
    M09,
    M11,
    POOLED,
    TWO,
    ClosedLoopExperiment,
    on_surfaces,
)
from egp_service.simulation.course import build_path, build_profile
from egp_service.simulation.scenario import Measurement, Scenario, Speed, Track, Zone

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

# Members of the same two surfaces with constant means as in the paper.
CONSTANT_MEAN: Final = (5, 6)
FOUR: Final = (M05, M06, M09, M11)
NARROW: Final = "narrow-track"
AVOIDANCE: Final = "iso-3888-2"
REPLAYED: Final = (unknown_roads.FIRST, unknown_roads.LATER, fleet_roads.FLEET)
"""Experiments whose departures are replayed."""
# Suffix of conditions without measurement noise.
EXACT: Final = ", exact sensors"
HALF_WIDTH: Final = VehicleParameters.commonroad(1).width / 2  # m
LABELS: Final = ("μ 0.5", "μ 0.6", "μ 0.9", "μ 1.1", "pooled")


def contenders(members: Sequence[int]) -> tuple[Contender, ...]:
    """Return the ensemble of `members` and its baselines."""
    return (
        Contender(ENSEMBLE, "ensemble", tuple(members)),
        Contender(
            "paper's weights",
            "ensemble",
            tuple(members),
            {"weights": PAPER_WEIGHTS},
            variant=True,
        ),
        Contender("selection", "selection", tuple(members)),
        *(Contender(f"only {LABELS[m]}", "ensemble", (m,)) for m in members),
        Contender("pooled GP", "ensemble", (POOLED,)),
        Contender("nominal single-track", "single-track", tuple(members)),
        Contender("kinematic", "kinematic", tuple(members)),
        Contender(ORACLE, "oracle", tuple(members)),
    )


_ALL_OF_TWO: Final = (
    *contenders(TWO),
    Contender("constant mean", "ensemble", CONSTANT_MEAN, variant=True),
    Contender("fitted single-track", "fitted", TWO),
    Contender("forward Euler", "ensemble", TWO, {"operating": {"yaw_at": 0.0}}, variant=True),
)
_ALL_OF_FOUR: Final = contenders(FOUR)
_AVOIDING: Final = {ENSEMBLE, "pooled GP", "nominal single-track", "kinematic", ORACLE}


def _steady(track: Track, zones: Sequence[tuple[float, float]], speed: float) -> Scenario:
    """Return a scenario with a constant speed on all surfaces."""
    return replace(on_surfaces(track, zones, 1.0), speed=Speed(v_max=speed, constant=True))


def _varying_speed() -> ClosedLoopExperiment:
    return ClosedLoopExperiment(
        "varying-speed",
        "Track with varying speed (paper, experiment 2)",
        "At which fraction of the grip does each controller begin to fail?",
        tuple(
            (f"{grip:.0%} of grip", on_surfaces(CUSTOM_TRACK, LAP_ZONES, grip))
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
        (("14 m/s", on_surfaces(circuit, zones, 0.9, 14.0)),),
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


def _obstacle_avoidance(half_width: float = HALF_WIDTH) -> ClosedLoopExperiment:
    surfaces: dict[str, tuple[tuple[float, float], ...]] = {
        "μ 1.1": ((0.0, 1.1),),
        "μ 0.8": ((0.0, 0.8),),
        "μ 0.5": ((0.0, 0.5),),
        "μ 1.1 to 0.5": ((0.0, 1.1), (0.5, 0.5)),
    }
    course = Track("iso-3888-2", parameters={"lead_in": 25.0, "lead_out": 15.0})
    # The cones leave room for the car only; a wider margin would exclude all positions.
    control: dict[str, object] = {"soft": {"edge_margin": half_width}}
    return ClosedLoopExperiment(
        AVOIDANCE,
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
                on_surfaces(CUSTOM_TRACK, tuple(zip(starts, frictions, strict=True)), 0.9),
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
        (("90% of grip", on_surfaces(Track("random"), ((0.0, 1.0),), 0.9)),),
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
    plain = on_surfaces(CUSTOM_TRACK, base, 0.85)
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
                replace(on_surfaces(CUSTOM_TRACK, base, 0.75), zones=split),
            ),
            ("μ 0.35", on_surfaces(CUSTOM_TRACK, ((0.0, 0.35),), 0.85)),
            ("μ 1.3", on_surfaces(CUSTOM_TRACK, ((0.0, 1.3),), 0.85)),
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


def _narrow_track(half_width: float = HALF_WIDTH) -> ClosedLoopExperiment:
    size = {**CUSTOM_TRACK.parameters, "track_width": 2.0 * (half_width + 0.4)}
    track = Track("rounded-rectangle", parameters=size)

    def cautious(kappa: float) -> dict[str, object]:
        return {"soft": {"edge_margin": half_width, "caution": kappa}}

    return ClosedLoopExperiment(
        NARROW,
        "A track with 0.4 m to each side of the car (beyond the paper)",
        "Do edges that are tightened by the plan's standard deviations keep the car on the track?",
        tuple(
            (f"{grip:.0%} of grip", on_surfaces(track, LAP_ZONES, grip))
            for grip in (0.9, 0.95, 1.0)
        ),
        (
            Contender(ENSEMBLE, "ensemble", TWO, cautious(0.0)),
            *(
                Contender(f"caution {k:g}", "ensemble", TWO, cautious(k), variant=True)
                for k in (1.0, 2.0, 4.0)
            ),
            Contender(ORACLE, "oracle", TWO, cautious(0.0)),
        ),
        seeds=20,
        quick_seeds=1,
    )


def with_members(
    library: Path, experiments: Iterable[ClosedLoopExperiment], timed: Iterable[int] = ()
) -> list[ClosedLoopExperiment]:
    """Return the experiments without contenders whose members the library lacks.

    Only contenders with other members than those of the four surfaces are left out. `timed` are the
    members whose step is timed.

    Raises:
        EgpError: if the library lacks a member of a surface.

    """
    found = len(Library.load(library).members)
    most = max(found, len(FOUR))

    def needed(contender: Contender) -> int:
        return 0 if contender.disturbed else 1 + max(contender.members)

    kept = [
        replace(e, contenders=tuple(c for c in e.contenders if needed(c) <= most))
        for e in experiments
    ]
    wanted = max([1 + m for m in timed] + [needed(c) for e in kept for c in e.contenders] + [0])
    if wanted > found:
        noun = "member" if found == 1 else "members"
        raise EgpError(
            f"{library} has {found} {noun}, these experiments need {wanted}, which have the "
            "frictions 0.5, 0.6, 0.9 and 1.1 in this order: `egp train --mean single-track` makes "
            "them of a dataset of each, `egp evaluate --train` those of the built-in car"
        )
    return kept


def on_plant(
    experiment: ClosedLoopExperiment, plant: str, vehicle: VehicleParameters, file: Path
) -> ClosedLoopExperiment:
    """Return the experiment with one's own simulator `module:Class` in place of the vehicle.

    Gate, speeds and widths are those of `vehicle`, whose parameters are in the TOML file `file`.
    Conditions that such a simulator does not see are left out: those with another of the built-in
    vehicles, and those with roads whose sides differ.
    """
    if made := {NARROW: _narrow_track, AVOIDANCE: _obstacle_avoidance}.get(experiment.name):
        experiment = made(vehicle.width / 2)
    conditions = tuple(
        (condition, replace(scenario, plant=plant, vehicle_file=str(file)))
        for condition, scenario in experiment.conditions
        if scenario.vehicle == 1 and all(len(z.sides()) == 1 for z in scenario.zones)
    )
    return replace(experiment, conditions=conditions)


def on_track(
    experiment: ClosedLoopExperiment, file: Path, scale: float, *, closed: bool = True
) -> ClosedLoopExperiment:
    """Return the experiment on a track from a CSV file with lengths multiplied by `scale`.

    Raises:
        EgpError: if the file is not a track, or no speed can be planned for it.

    """
    track = Track("csv", str(file.resolve()), {"scale": scale}, None if closed else False)
    conditions = tuple(
        (f"{condition} on {file.stem}", replace(scenario, track=track))
        for condition, scenario in experiment.conditions
    )
    for _, scenario in conditions:  # reports an invalid file before the runs start
        build_profile(scenario, build_path(scenario, f"--track with --scale {scale:g}"))
    return replace(experiment, conditions=conditions)


EXPERIMENTS: Final = (
    _varying_speed(),
    _lane_change(),
    _four_members(),
    _random_roads(),
    _friction_step(),
    _unseen_track(),
    _hard_roads(),
    _narrow_track(),
    unknown_roads.first_lap(),
    unknown_roads.five_laps(),
    fleet_roads.first_lap_with_a_map(),
    disturbances.experiment(),
)
VARIANTS: Final = frozenset(c.name for e in EXPERIMENTS for c in e.contenders if c.variant)
"""Names of the contenders that are variants of the ensemble."""
# `entry_speed.find` turns each of its trials into a highest entry speed.
OBSTACLE_AVOIDANCE: Final = _obstacle_avoidance()
# `hidden_ice.run` drives its trials.
HIDDEN_ICE: Final = hidden_ice.experiment()
