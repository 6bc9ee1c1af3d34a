"""Collection of a dataset of one surface in simulation, in parallel processes.

Runs on tracks give the states of vehicles up to the limit, random states give unusual but possible
ones, and steady inputs give constant speeds and strong drive from a low speed.
The result does not depend on the number of processes.
"""

from __future__ import annotations

import dataclasses
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

from egp_service._core import EgpError, available_cores
from egp_service.data.dataset import Dataset, merge
from egp_service.data.experiment import SEEDS
from egp_service.data.exploration import ExplorationSettings, explore
from egp_service.data.exploration_track import ExplorationTrack, check_track
from egp_service.data.sampling import SamplingBounds, sample
from egp_service.data.steady import steady
from egp_service.workers import in_order, workers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from egp_service.data.experiment import Experiment


@dataclasses.dataclass(frozen=True)
class CollectionSettings:
    """Amount and kind of the data of one surface."""

    tracks: tuple[str, ...] = ("rounded-rectangle", "random")
    """Tracks of the runs, used in turn; every second round is in the opposite direction. "random"
    is a different track each time."""
    runs: int = 6
    """Number of runs on tracks."""
    samples: int = 300
    """Number of vehicles that start in random states."""
    steady: int = 300
    """Number of vehicles with steady inputs, at speeds up to that of `sampling.v_x`."""
    exploration: ExplorationSettings = dataclasses.field(default_factory=ExplorationSettings)
    sampling: SamplingBounds = dataclasses.field(default_factory=SamplingBounds)

    def __post_init__(self) -> None:
        """Check that something is collected."""
        for name in ("runs", "samples", "steady"):
            if (count := getattr(self, name)) < 0:
                raise EgpError(f"{name} is {count}: expected a number of at least 0")
        if self.runs + self.samples + self.steady == 0:
            raise EgpError("nothing to collect: ask for runs, samples or steady inputs")
        if self.runs and not self.tracks:
            raise EgpError("runs need at least one track")
        for name in self.tracks:
            check_track(name)


def collect(
    experiment: Experiment,
    settings: CollectionSettings,
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    report: Callable[[int, int], None] = lambda _done, _total: None,
) -> Dataset:
    """Collect on one surface, in the processes that `workers` gives for `jobs` and `cluster`.

    Run `i` has a seed derived from `experiment.seed` and `i`. `report(done, total)` is called
    before the first run and after each one.

    Raises:
        EgpError: if vehicle or track are unknown, or if nothing could be recorded.

    """
    numbers = range(settings.runs)
    total = settings.runs + bool(settings.samples) + bool(settings.steady)
    parts: list[Dataset] = []
    report(0, total)
    if settings.samples:
        parts.append(sample(experiment, settings.samples, settings.sampling))
        report(len(parts), total)
    if settings.steady:
        parts.append(steady(experiment, settings.steady, settings.sampling.v_x[1]))
        report(len(parts), total)
    run = partial(_run, experiment, settings)
    with ExitStack() as stack:
        if cluster is None and (jobs := min(jobs or available_cores(), settings.runs)) <= 1:
            runs: Iterable[Dataset] = map(run, numbers)
        else:
            runs = in_order(stack.enter_context(workers(jobs, cluster)), run, numbers)
        for part in runs:
            parts.append(part)
            report(len(parts), total)
    return merge(parts)


def _run(experiment: Experiment, settings: CollectionSettings, number: int) -> Dataset:
    """Drive run `number`, whose seed differs from those of other experiments."""
    count = len(settings.tracks)
    seed = (1_000_003 * (experiment.seed + 1) + number) % SEEDS
    name, reverse = settings.tracks[number % count], number // count % 2 == 1
    track = ExplorationTrack(
        name, experiment.parameters, seed, reverse=reverse, wheelbase=experiment.wheelbase
    )
    return explore(dataclasses.replace(experiment, seed=seed), track, settings.exploration)
