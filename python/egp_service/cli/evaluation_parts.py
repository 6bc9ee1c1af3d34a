"""The parts of `egp evaluate` that run in parallel, with their progress."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from egp_service.cli.progress import counting
from egp_service.evaluation import hidden_ice, prediction
from egp_service.evaluation.batch import finish
from egp_service.evaluation.entry_speed import EntrySpeed, find
from egp_service.evaluation.experiments import HIDDEN_ICE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rich.console import Console
    from rich.progress import Progress

    from egp_service.evaluation.batch import Batch
    from egp_service.evaluation.campaign import Campaign, Outcome
    from egp_service.evaluation.experiment import ClosedLoopExperiment
    from egp_service.evaluation.prediction import SeedOutcomes

_QUICK_TRANSITIONS = 200
_QUICK_ITERATIONS = 20


@dataclass(frozen=True)
class Selection:
    """What is evaluated."""

    full: bool
    chosen: list[str]
    """Names of the experiments, also of those in which nothing drives."""
    driven: list[ClosedLoopExperiment]
    apart: list[ClosedLoopExperiment]
    """Experiments each of whose trials consists of several drives."""


@contextmanager
def advising(console: Console, advice: str) -> Iterator[None]:
    """Print the advice how to continue if an error or an interruption ends the work inside."""
    try:
        yield
    except BaseException as error:
        interrupted = "" if isinstance(error, Exception) else "Interrupted. "
        console.print(f"{interrupted}{advice}")
        raise


def run(
    console: Console,
    campaign: Campaign,
    selection: Selection,
    output: Path,
    *,
    jobs: int | None,
    cluster: str | None,
) -> dict[str, list[Any]]:
    """Run what is missing; give the results of predictions and runs, and of experiments apart."""
    full = selection.full
    parts: dict[str, Batch[Any, Any]] = {}
    with counting(console) as progress:
        if "prediction" in selection.chosen:
            parts["predictions"] = _predictions(progress, output, full=full)
        parts["runs"] = _runs(progress, campaign, selection.driven, full=full)
        for e in selection.apart:
            parts[e.name] = _apart(progress, campaign, e, full=full)
        with advising(progress.console, "The same command continues with the missing runs."):
            finish(list(parts.values()), jobs, cluster)
    return {name: part.results() for name, part in parts.items()}


def _predictions(progress: Progress, output: Path, *, full: bool) -> Batch[Any, SeedOutcomes]:
    quick = prediction.PredictionSettings(1, _QUICK_TRANSITIONS, _QUICK_ITERATIONS)
    settings = prediction.PredictionSettings() if full else quick
    task = progress.add_task("prediction: training and testing seeds", total=settings.seeds)
    return prediction.seeds(settings, output, lambda _: progress.advance(task))


def _runs(
    progress: Progress, campaign: Campaign, chosen: list[ClosedLoopExperiment], *, full: bool
) -> Batch[Any, Outcome]:
    trials = {e.name: list(e.trials(range(e.seeds if full else e.quick_seeds))) for e in chosen}
    lost = dict.fromkeys(trials, 0)
    tasks = {
        name: progress.add_task(name, start=False, total=len(own)) for name, own in trials.items()
    }

    def report(outcome: Outcome) -> None:
        name = outcome.experiment
        lost[name] += not outcome.completed
        progress.start_task(tasks[name])
        text = f"{name}: {lost[name]} not completed"
        progress.update(tasks[name], advance=1, description=text)

    return campaign.runs([trial for own in trials.values() for trial in own], report)


def _apart(
    progress: Progress, campaign: Campaign, experiment: ClosedLoopExperiment, *, full: bool
) -> Batch[Any, Any]:
    ice = experiment.name == HIDDEN_ICE.name
    quick = experiment.compared if ice else experiment.conditions[-1][0]
    seeds = range(experiment.seeds if full else experiment.quick_seeds)
    trials = [t for t in experiment.trials(seeds) if full or t.condition == quick]
    title = experiment.name if ice else f"{experiment.name}: bisecting entry speeds"
    task = progress.add_task(title, start=False, total=len(trials))

    def report(_: object) -> None:
        progress.start_task(task)
        progress.advance(task)

    if ice:
        name, kind = experiment.name, hidden_ice.IceOutcome
        return campaign.batch(name, trials, hidden_ice.run, kind, report)
    return campaign.batch("entry-speeds", trials, find, EntrySpeed, report)
