"""On-policy data: laps of the ensemble controller over alternating surfaces.

Members need data of the states that the MPC visits, including those after a change to a surface
with lower friction, and not only of the states of one driver (dataset aggregation; Ross, Gordon and
Bagnell, 2011). Each lap has its own track, zones and speed; its transitions are added to the data
of their surface.
"""

from __future__ import annotations

import dataclasses
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError
from egp_service.data.dataset import Dataset
from egp_service.data.exploration import STANDING
from egp_service.quantities import MOTION, V_X, gp_input
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import (
    Disturbances,
    Measurement,
    Scenario,
    Speed,
    Track,
    Zone,
)
from egp_service.workers import in_order, workers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from egp_service.data.experiment import Experiment

_TRACKS: Final = ("rounded-rectangle", "random", "l-shape", "random")
# Length of the rounded rectangle, m; long straights allow speeds that need hard braking.
_LENGTH: Final = (80.0, 240.0)
_FIRST_SEED: Final = 10_000  # gives tracks and noise that no other run has
# Measurement noise, which varies the inputs; the recorded states are the true ones.
_NOISE: Final = Measurement(position=0.02, v_x=0.03, psi=0.002, v_y=0.03, omega=0.005, delta=0.001)
# Without the proximal term plans alternate between drive and braking at the end of the grip, which
# excites the tyres.
_EXCITING: Final[dict[str, object]] = {"cost": {"proximal": 0.0}}
_LEAVE: Final = 4.0  # m from the path; slides beyond the edge are recorded
_TRAJECTORY: Final = 100  # transitions of a trajectory, the unit of the validation split


@dataclasses.dataclass(frozen=True)
class OnPolicySettings:
    """Settings of on-policy collection."""

    rounds: int = 0
    """Number of rounds; each drives laps and trains again."""
    laps: int = 24
    """Number of laps of a round."""
    grip: tuple[float, float] = (0.75, 1.0)
    """Fraction of the available grip that the speed profile uses, first and last lap."""

    def __post_init__(self) -> None:
        """Check the ranges of the settings."""
        for name, count, least in (("rounds", self.rounds, 0), ("laps", self.laps, 1)):
            if count < least:
                raise EgpError(f"{name} is {count}: expected a number of at least {least}")
        if not all(0.0 < grip <= 1.0 for grip in self.grip):
            raise EgpError(
                f"grip is {list(self.grip)}: expected two fractions above 0 and at most 1"
            )


def distinct_surfaces(experiments: Sequence[Experiment]) -> list[Experiment]:
    """Return one experiment of each surface on which laps are driven.

    Experiments of the same label and friction, which differ in their seeds, have the same surface.

    Raises:
        EgpError: if two surfaces have the same friction coefficient, by which their data are told
            apart, or different vehicles or disturbances, of which a lap over all surfaces has one.

    """
    first = experiments[0]
    for other in experiments:
        if (other.vehicle, other.disturbances) != (first.vehicle, first.disturbances):
            raise EgpError(
                "on-policy laps are driven with one vehicle over all surfaces, but "
                f"{other.label!r} has another vehicle or other disturbances than {first.label!r}: "
                "state both at the top of the recipe, or leave out [on_policy]"
            )
    surfaces: dict[tuple[str, float | str], Experiment] = {}
    for experiment in experiments:
        surfaces.setdefault((experiment.label, experiment.friction), experiment)
    if len({surface.mu for surface in surfaces.values()}) < len(surfaces):
        named = ", ".join(f"{label!r} (friction {friction})" for label, friction in surfaces)
        raise EgpError(
            "on-policy laps tell surfaces apart by their friction coefficient, but two of "
            f"{named} have the same one: change it, or leave out [on_policy]"
        )
    return list(surfaces.values())


def drive_laps(
    library: Path,
    surfaces: Sequence[Experiment],
    settings: OnPolicySettings,
    round_number: int = 0,
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    report: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Dataset]:
    """Drive the laps of a round with `library`; return a dataset for each driven surface.

    Raises:
        EgpError: as `distinct_surfaces`, or if no lap gave data.

    """
    surfaces = distinct_surfaces(surfaces)
    grips = np.linspace(*settings.grip, settings.laps)
    first = _FIRST_SEED + round_number * settings.laps
    scenarios = [_scenario(surfaces, first + lap, float(grip)) for lap, grip in enumerate(grips)]
    # The machines of a cluster need not have the file.
    work = partial(_drive, library.read_bytes())
    driven: list[_Driven] = []
    with workers(jobs, cluster) as pool:
        for done, lap in enumerate(in_order(pool, work, scenarios), start=1):
            driven.append(lap)
            report(done, settings.laps)
    datasets = [_on_surface(driven, surface) for surface in surfaces]
    found = [dataset for dataset in datasets if dataset is not None]
    if not found:
        raise EgpError(f"no lap with {library} gave data: the vehicle leaves the road at the start")
    return found


@dataclasses.dataclass(frozen=True)
class _Driven:
    """A lap: states (n, 7), inputs (n, 2), friction (n,)."""

    x: NDArray[np.float64]
    u: NDArray[np.float64]
    friction: NDArray[np.float64]


def _scenario(surfaces: Sequence[Experiment], seed: int, grip: float) -> Scenario:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 7))
    starts = [0.0, *np.sort(rng.uniform(0.05, 0.95, count - 1)).tolist()]
    order = rng.permutation(len(surfaces))
    zones = tuple(_zone(start, surfaces[order[i % len(order)]]) for i, start in enumerate(starts))
    kind = _TRACKS[seed % len(_TRACKS)]
    measures = {"length": float(rng.uniform(*_LENGTH))} if kind == "rounded-rectangle" else {}
    return Scenario(
        name="on-policy",
        track=Track(kind, parameters=measures),
        zones=zones,
        vehicle=surfaces[0].vehicle,
        seed=seed,
        leave_distance=_LEAVE,
        control=_EXCITING,
        speed=Speed(grip=grip, v_max=25.0),
        measurement=_NOISE,
        disturbances=Disturbances(**surfaces[0].disturbances),
    )


def _zone(start: float, surface: Experiment) -> Zone:
    if isinstance(surface.friction, str):
        return Zone(start, surface=surface.friction)
    return Zone(start, surface.friction)


def _drive(library: bytes, scenario: Scenario) -> _Driven:
    """Drive the scenario with a library of these bytes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "library.safetensors"
        file.write_bytes(library)
        scenario = dataclasses.replace(scenario, library=str(file))
        trace = drive(scenario, in_process_controller(scenario), lambda _: None).trace
    return _Driven(trace.x, trace.u, trace.friction)


def _on_surface(laps: Sequence[_Driven], surface: Experiment) -> Dataset | None:
    """Return all transitions that start and end on the surface, in pieces of `_TRAJECTORY`.

    A vehicle that has lost a surface's grip may stand until its lap ends. No slip angle describes
    its forces, so that such transitions would distort the tyres and the yaw inertia of a fit.
    """
    z, y, trajectory, step = [], [], [], []
    pieces = 0
    for lap in laps:
        on = (lap.friction == surface.mu) & (lap.x[:, V_X] >= STANDING)
        rows = np.flatnonzero(on[:-1] & on[1:])
        if len(rows) == 0:
            continue
        z.append(gp_input(lap.x[rows], lap.u[rows]))
        y.append((lap.x[rows + 1] - lap.x[rows])[:, MOTION])
        stretch = np.cumsum(np.concatenate([[0], np.diff(rows) > 1]))
        begin = np.flatnonzero(np.diff(stretch, prepend=-1))[stretch]
        position = np.arange(len(rows)) - begin
        _, piece = np.unique(
            np.column_stack([stretch, position // _TRAJECTORY]), axis=0, return_inverse=True
        )
        trajectory.append((pieces + piece).astype(np.uint32))
        step.append((position % _TRAJECTORY).astype(np.uint32))
        pieces += int(piece.max()) + 1
    if not z:
        return None
    return Dataset(
        z=np.concatenate(z),
        y=np.concatenate(y),
        trajectory=np.concatenate(trajectory),
        step=np.concatenate(step),
        provenance=surface.provenance("closed loop"),
    )
