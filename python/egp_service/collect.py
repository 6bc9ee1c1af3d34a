"""Collecting a dataset of one surface on the plant: many runs in parallel, one result.

Runs on tracks show where vehicles usually are, random states what they should never do but might.
The result does not depend on the number of processes.
"""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING

from egp_service import EgpError
from egp_service.dataset import Dataset, merge
from egp_service.exploration import ExplorationSettings, explore
from egp_service.exploration_track import ExplorationTrack
from egp_service.sampling import SamplingBounds, sample
from egp_service.workers import workers

if TYPE_CHECKING:
    from collections.abc import Callable

    from egp_service.experiment import Experiment


@dataclasses.dataclass(frozen=True)
class CollectionSettings:
    """What is collected on one surface."""

    tracks: tuple[str, ...] = ("rounded-rectangle", "random")
    """Tracks of the runs, in turn; every second round in the other direction. "random" is another
    one each time."""
    runs: int = 6
    """Runs on tracks."""
    samples: int = 300
    """Vehicles put into random states."""
    exploration: ExplorationSettings = dataclasses.field(default_factory=ExplorationSettings)
    sampling: SamplingBounds = dataclasses.field(default_factory=SamplingBounds)

    def __post_init__(self) -> None:
        """Refuse an empty collection."""
        if self.runs < 0 or self.samples < 0 or self.runs + self.samples == 0:
            raise EgpError("nothing to collect: ask for runs, samples or both")
        if self.runs and not self.tracks:
            raise EgpError("runs need at least one track")


def collect(
    experiment: Experiment,
    settings: CollectionSettings,
    *,
    jobs: int | None = None,
    report: Callable[[int, int], None] = lambda _done, _total: None,
) -> Dataset:
    """Collect on one surface, in `jobs` processes (one per core by default).

    Run `i` has the seed `[experiment.seed, i]` in effect; `report(done, total)` follows the runs.

    Raises:
        EgpError: for an unknown vehicle or track, or when nothing could be recorded.

    """
    numbers = range(settings.runs)
    total = settings.runs + bool(settings.samples)
    parts: list[Dataset] = []
    if settings.samples:
        parts.append(sample(experiment, settings.samples, settings.sampling))
        report(len(parts), total)
    jobs = min(jobs or os.cpu_count() or 1, max(1, settings.runs))
    if jobs == 1:
        for number in numbers:
            parts.append(_run(experiment, settings, number))
            report(len(parts), total)
        return merge(parts)
    with workers(jobs) as pool:
        pending = [pool.submit(_run, experiment, settings, number) for number in numbers]
        for future in pending:
            parts.append(future.result())
            report(len(parts), total)
    return merge(parts)


def _run(experiment: Experiment, settings: CollectionSettings, number: int) -> Dataset:
    """Drive run `number`; its seed is far from those of other experiments."""
    count = len(settings.tracks)
    seed = 1_000_003 * (experiment.seed + 1) + number
    name, reverse = settings.tracks[number % count], number // count % 2 == 1
    track = ExplorationTrack(name, experiment.parameters, seed, reverse=reverse)
    return explore(dataclasses.replace(experiment, seed=seed), track, settings.exploration)
