"""Trials whose outcomes are stored in a folder, with libraries of the contenders' members."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from egp_service import _core
from egp_service._core import EgpError, Engine, Library, write_library_subset
from egp_service.control.toml_text import dumps
from egp_service.evaluation import baselines, fleet_roads
from egp_service.evaluation.batch import Batch
from egp_service.evaluation.contenders import ENSEMBLE, make
from egp_service.evaluation.departures import avoidable
from egp_service.evaluation.disturbances import GENTLE
from egp_service.evaluation.experiments import REPLAYED
from egp_service.evaluation.settling import resolution, settling_times
from egp_service.files import file_name, make_folder, write_text
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.course import build_path
from egp_service.simulation.plant import source_file
from egp_service.simulation.scenario import vehicle_parameters
from egp_service.workers import in_order, workers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from _typeshed import DataclassInstance

    from egp_service.evaluation.experiment import ClosedLoopExperiment, Trial
    from egp_service.simulation.closed_loop import Run
    from egp_service.simulation.scenario import Scenario

VEHICLE_FILE = "vehicle.toml"
"""File in the folder with the parameters of the library's vehicle."""
SHOWN_CONTENDERS = (ENSEMBLE, "pooled GP", "nominal single-track")

Result = TypeVar("Result", bound="DataclassInstance")


@dataclass(frozen=True, slots=True)
class Outcome:
    """A finished trial. Errors of an incomplete run are those up to its end."""

    experiment: str
    condition: str
    contender: str
    seed: int
    completed: bool
    reason: str
    time: float
    """Duration, s."""
    distance: float
    """Distance driven, m."""
    lap_times: tuple[float, ...]
    """Duration of each complete lap, s."""
    lateral_max: float
    """Largest lateral error, m."""
    lateral_rms: float
    """RMS of the lateral error, m."""
    speed_rms: float
    """RMS of the speed's error, m/s."""
    off_track: float
    """Time in which a side of the vehicle was beyond the track's edge, s."""
    settling: tuple[float, ...]
    """Settling time of the weights after each friction change under excitation, s."""
    resolution: float | None
    """Smallest standard deviation that a friction coefficient from one window can have, for the
    ensemble's friction steps."""
    avoidable: bool | None
    """Whether a replay that is told everything avoids the departure; None without a departure, if
    the replay does not tell, and in experiments whose departures are not replayed."""
    misses: int
    """Number of periods without a usable plan."""
    late: int
    """Number of periods whose step took longer than the period, on the shared machine."""
    step_ms: float
    """Median time of a step on the shared machine, ms."""


class Campaign:
    """Trials with a folder for the contenders' libraries and the outcomes so far."""

    def __init__(self, folder: Path, library: Path, plant: str | None = None) -> None:
        """Resume the campaign in `folder`, or start one with the members of `library`.

        `plant` is one's own simulator `module:Class` of the trials, which was loaded before.

        Raises:
            EgpError: if the folder belongs to another library.

        """
        make_folder(folder)
        # The processes of a cluster have other working directories.
        self._folder = folder.absolute()
        self._source = library
        loaded = Library.load(library)
        self._id = loaded.id
        self._defaults = Engine(str(library)).settings_toml
        if not _marked(folder / "library.sha256", self._id):
            raise EgpError(f"{folder} contains runs of another library: choose another --output")
        self.of_another_build = not _marked(folder / "program.sha256", _build())
        """Whether outcomes so far may come from another build of this program."""
        self.of_another_plant = plant is not None and not _marked(
            folder / f"{file_name(plant)}.sha256",
            _file_hash(source_file(plant)) or "without a file",
        )
        """Whether outcomes so far may come from another version of the simulator's file."""
        write_text(folder / VEHICLE_FILE, dumps(loaded.parameters.fields()))

    def runs(
        self, trials: Iterable[Trial], report: Callable[[Outcome], None]
    ) -> Batch[Trial, Outcome]:
        """All trials, each driven once."""
        return self.batch("runs", trials, run_trial, Outcome, report)

    def batch(
        self,
        name: str,
        trials: Iterable[Trial],
        work: Callable[[Trial], Result],
        kind: type[Result],
        report: Callable[[Result], None],
    ) -> Batch[Trial, Result]:
        """Trials for the function `work`, whose results of this `kind` go to `{name}.jsonl`."""
        wanted = [self._with_library(trial) for trial in trials]
        parts = {fingerprint(trial, self._identity(trial)): trial for trial in wanted}
        return Batch(self._folder / f"{name}.jsonl", parts, work, _reader(kind), report)

    def drives(
        self,
        experiments: Iterable[ClosedLoopExperiment],
        report: Callable[[int, int], None] = lambda _done, _total: None,
        *,
        jobs: int | None = None,
        cluster: str | None = None,
    ) -> dict[str, list[tuple[Trial, Run]]]:
        """Drive the trials to draw, by experiment.

        These are the ensemble at every condition and the others at one condition, for the first
        seed. `report(done, total)` is called after each drive.
        """
        shown = [
            trial
            for experiment in experiments
            for trial in experiment.trials([0])
            if trial.contender.name == ENSEMBLE
            or (trial.condition == experiment.compared and trial.contender.name in SHOWN_CONTENDERS)
        ]
        found: dict[str, list[tuple[Trial, Run]]] = {}
        with workers(jobs, cluster) as pool:
            runs = in_order(pool, drive_trial, [self._with_library(t) for t in shown])
            for done, (trial, run) in enumerate(zip(shown, runs, strict=True), 1):
                found.setdefault(trial.experiment, []).append((trial, run))
                report(done, len(shown))
        return found

    def disturbed_library(self, name: str) -> Path:
        """Path of the library of a vehicle with one of `disturbances.DISTURBED`."""
        return self._folder / "disturbed" / f"{file_name(name)}.safetensors"

    def _identity(self, trial: Trial) -> str:
        """Identify the trial's library and the default settings."""
        own = self._source_of(trial)
        return (self._id if own == self._source else _disturbed_id(own)) + self._defaults

    def _source_of(self, trial: Trial) -> Path:
        """Return the library that the members of the trial's contender are taken from.

        That of a disturbance must have been trained.
        """
        if not trial.contender.disturbed:
            return self._source
        path = self.disturbed_library(trial.condition.removesuffix(GENTLE))
        if not path.exists():
            raise EgpError(
                f"{path} is missing: egp evaluate --full -e {trial.experiment} trains it"
            )
        return path

    def _with_library(self, trial: Trial) -> Trial:
        """Return the trial with the library of its contender, writing it if necessary."""
        contender, scenario = trial.contender, trial.scenario
        members = list(contender.members)
        source = self._source_of(trial)
        name = "-".join(map(str, members))
        if contender.disturbed:
            # Such a library may be trained again in the same folder.
            name = f"{source.stem}-{_disturbed_id(source)[:16]}-{name}"
        is_baseline = contender.kind in baselines.KINDS
        number = scenario.vehicle if scenario.vehicle_file is None else None
        if is_baseline:
            name = f"{contender.kind}-{number or 'own'}-{name}"
        path = self._folder / "libraries" / f"{name}.safetensors"
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            if is_baseline:
                baselines.write(path, contender.kind, source, members, number)
            else:
                write_library_subset(source, path, members)
        control = {**scenario.control, **(contender.control or {})}
        speed = replace(scenario.speed, **(contender.speed or {}))
        scenario = replace(scenario, library=str(path), control=control, speed=speed)
        if is_baseline and contender.kind != "fitted":
            # The library is for the scenario's vehicle, so the gate has to be, too.
            scenario = replace(scenario, gate={})
        return replace(trial, scenario=scenario)


def _marked(file: Path, identity: str) -> bool:
    """Whether a file holds this identity; one that is missing, or empty, gets it."""
    if not file.exists() or not file.read_text(encoding="utf-8"):
        write_text(file, identity)
    return file.read_text(encoding="utf-8") == identity


def fingerprint(trial: Trial, library: str) -> str:
    """Hash everything on which a trial's outcome depends; `library` includes all settings."""
    track, vehicle = trial.scenario.track, _file_hash(trial.scenario.vehicle_file)
    track = replace(track, file=_file_hash(track.file))
    scenario = replace(trial.scenario, library=library, track=track, vehicle_file=vehicle).toml()
    text = json.dumps([*trial.key, trial.contender.kind, trial.contender.members, scenario])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _file_hash(path: str | Path | None) -> str | None:
    return None if path is None else hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _disturbed_id(path: Path) -> str:
    return _library_id(path, path.stat().st_mtime_ns)


@cache
def _library_id(path: Path, _changed: int) -> str:
    return Library.load(path).id


def _build() -> str:
    """Hash the compiled extension, which contains vehicle and controller, and the Python files."""
    sha = hashlib.sha256(Path(_core.__file__).read_bytes())
    package = Path(__file__).parents[1]
    for name in sorted(path.relative_to(package).as_posix() for path in package.rglob("*.py")):
        content = (package / name).read_bytes()
        sha.update(f"{name}\0{len(content)}\0".encode())
        sha.update(content)
    return sha.hexdigest()


def _reader(kind: type[Result]) -> Callable[[dict[str, Any]], Result]:
    """Return a function that creates results from their JSON fields.

    It raises `TypeError` for missing or further fields, and for values of another type.
    """
    types = {field.name: str(field.type) for field in fields(kind)}

    def read(values: dict[str, Any]) -> Result:
        for name, value in values.items():
            if not _is_of(value, types.get(name, "")):
                raise TypeError(f"{name} is {value!r}: expected {types.get(name)}")
        return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})

    return read


def _is_of(value: object, stated: str) -> bool:
    """Whether a value of JSON has the type of a field: text, numbers in a list, or one number."""
    if value is None:
        return "None" in stated
    if stated.startswith("tuple"):
        return isinstance(value, list)
    if stated == "str":
        return isinstance(value, str)
    return isinstance(value, int | float)


def run_trial(trial: Trial) -> Outcome:
    """Drive one trial in this process."""
    return _outcome(trial, drive_trial(trial))


def drive_trial(trial: Trial) -> Run:
    """Drive one trial with the library of its scenario and return the run."""
    belief = fleet_roads.reported(trial)
    return drive(trial.scenario, make(trial.contender, trial.scenario), lambda _: None, belief)


def _outcome(trial: Trial, run: Run) -> Outcome:
    summary = run.summary
    experiment, condition, contender, seed = trial.key
    resolved = experiment == "friction-step" and contender == ENSEMBLE
    avoided: bool | None = None
    if experiment in REPLAYED:
        avoided = avoidable(trial.contender, run, lambda: fleet_roads.reported(trial))
    return Outcome(
        experiment=experiment,
        condition=condition,
        contender=contender,
        seed=seed,
        completed=summary.ending.completed,
        reason=summary.ending.reason,
        time=summary.ending.time,
        distance=summary.ending.distance,
        lap_times=lap_times(trial.scenario, run),
        lateral_max=summary.lateral_error.max,
        lateral_rms=summary.lateral_error.rms,
        speed_rms=summary.speed_error.rms,
        off_track=off_track(trial.scenario, run),
        settling=tuple(settling_times(run)),
        resolution=resolution(run) if resolved else None,
        avoidable=avoided,
        misses=summary.periods - summary.solver_statuses.get("solved", 0),
        late=int(np.sum(run.trace.step_time > run.dt)),
        step_ms=summary.step_time_ms["p50"],
    )


def lap_times(scenario: Scenario, run: Run) -> tuple[float, ...]:
    """Seconds of each complete lap of a closed track."""
    path = build_path(scenario)
    if not path.closed:
        return ()
    trace, ending = run.trace, run.summary.ending
    laps = round(scenario.laps) if ending.completed else int(ending.distance // path.length)
    ends = np.interp(np.arange(1, laps + 1) * path.length, trace.distance, trace.time)
    return tuple(float(time) for time in np.diff(ends, prepend=0.0))


def off_track(scenario: Scenario, run: Run) -> float:
    """Seconds with a side of the vehicle beyond the track's edge."""
    path = build_path(scenario)
    distance = run.trace.distance
    s = np.mod(distance, path.length) if path.closed else np.clip(distance, 0.0, path.length)
    _, _, _, _, left, right, _ = path.sample(s)
    lateral = run.trace.lateral_error
    half = 0.5 * vehicle_parameters(scenario).width
    beyond = (lateral > left - half) | (-lateral > right - half)
    return float(np.sum(beyond) * run.dt)
