"""`egp evaluate`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from egp_service.cli.options import Cluster, Jobs, check_unused
from egp_service.shipped import EVALUATION_LIBRARY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.progress import Progress

    from egp_service.evaluation.batch import Batch
    from egp_service.evaluation.campaign import Campaign, Outcome
    from egp_service.evaluation.entry_speed import EntrySpeed
    from egp_service.evaluation.experiment import ClosedLoopExperiment
    from egp_service.evaluation.hidden_ice import IceOutcome
    from egp_service.evaluation.prediction import SeedOutcomes
    from egp_service.evaluation.scaling import StepTime

_SHOWN = ("varying-speed", "unseen-track", "lane-change", "four-members")
_QUICK_TRANSITIONS = 200
_QUICK_ITERATIONS = 20
_QUICK_MEMBERS = (1, 2, 4, 8)


def evaluate(
    *,
    full: Annotated[bool, typer.Option("--full", help="Run all seeds (hours).")] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="Run a few seeds (minutes), as without --full.")
    ] = False,
    experiment: Annotated[
        list[str] | None, typer.Option("--experiment", "-e", help="Experiment; repeat for more.")
    ] = None,
    library: Annotated[
        Path | None, typer.Option(help="Library instead of the shipped one, with the same members.")
    ] = None,
    train: Annotated[
        bool, typer.Option("--train", help="Train the library first, like the shipped one.")
    ] = False,
    track: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="Circuit for unseen-track: a raceline or centre line of F1TENTH or TUM.",
        ),
    ] = None,
    scale: Annotated[
        float, typer.Option(help="Scale of the track's lengths; 10 for tracks of 1:10 cars.")
    ] = 1.0,
    plant: Annotated[
        str | None,
        typer.Option(
            metavar="MODULE:CLASS", help="Your simulator of the vehicle, as for `egp drive`."
        ),
    ] = None,
    log: Annotated[
        list[Path] | None,
        typer.Option(
            help="Dataset of a log: predict its held-out blocks instead; repeat for more."
        ),
    ] = None,
    vehicle: Annotated[
        Path | None, typer.Option(help="TOML file of the vehicle, for --log.")
    ] = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder; outcomes in it are not run again.")
    ] = Path("runs/evaluation"),
) -> None:
    """Run the paper's experiments with baselines, and write report.html.

    Experiments: prediction, varying-speed, lane-change, four-members,
    random-roads, friction-step, unseen-track, hard-roads, narrow-track,
    unknown-roads, remembered-roads, fleet-roads, disturbances (with --full only),
    hidden-ice, iso-3888-2, step-times.

    With --log nothing drives: members are trained on four of five blocks of each
    log and predict the fifth, over one period and in rollouts, next to no change,
    linear models, the paper's GPs and a vehicle alone. The log is a dataset of
    `egp collect --from-log`; the pictures go to the output folder.

    With --plant all runs but those of disturbances are driven by your simulator,
    a class with reset(x), step(u, dt, friction) and state: `egp drive --help`
    says what these are, and docs/simulator.md has an example. Runs are kept by
    its name: choose another --output after changing it.

    The same command resumes an interrupted evaluation. Requires the extras train
    and viz; with the extra paper, step-times includes the paper's stack.

    For example:
      egp evaluate --quick
      egp evaluate --full -o runs/full
      egp evaluate --full -e varying-speed -e random-roads
      egp evaluate -e unseen-track --track Interlagos_centerline.csv --scale 10
      egp evaluate --plant my_simulator:Car --library my_library.safetensors
      egp evaluate --log data/oval.parquet --log data/road.parquet
          --vehicle car.toml
    """
    import shlex
    import sys

    from egp_service.cli.tables import headline_table
    from egp_service.evaluation import disturbances
    from egp_service.evaluation.batch import finish
    from egp_service.evaluation.campaign import Campaign, require_members
    from egp_service.evaluation.experiments import (
        EXPERIMENTS,
        HIDDEN_ICE,
        OBSTACLE_AVOIDANCE,
        on_track,
    )
    from egp_service.evaluation.summary_report import HEADLINE, headline, write_report

    console = Console()
    if log:
        _on_logs(console, log, vehicle, output, {
            "--full": full, "--quick": quick, "--experiment": experiment, "--library": library,
            "--train": train, "--track": track, "--scale": scale != 1.0, "--plant": plant,
            "--jobs": jobs, "--cluster": cluster,
        })  # fmt: skip
        return
    avoidance = OBSTACLE_AVOIDANCE.name
    known = ["prediction", *(e.name for e in EXPERIMENTS), HIDDEN_ICE.name, avoidance, "step-times"]
    chosen = _chosen(experiment, known)
    _check_options(track, scale, vehicle, chosen, {
        "--full and --quick": full and quick, "--train and --library": train and library,
    })  # fmt: skip
    driven = [
        on_track(e, track, scale) if track and e.name == "unseen-track" else e
        for e in EXPERIMENTS
        if e.name in chosen and (full or e.quick_seeds)
    ]
    apart = [e for e in (OBSTACLE_AVOIDANCE, HIDDEN_ICE) if e.name in chosen]
    if disturbances.NAME in chosen and not full:
        console.print("disturbances trains six libraries and is driven with --full only.")
    if plant is not None:
        driven, apart = _on_plant((driven, apart), plant, experiment)
    source = _train(console, output, cluster) if train else library or EVALUATION_LIBRARY
    require_members(source, [*driven, *apart])
    campaign = Campaign(output, source)
    if campaign.of_another_build:
        console.print(
            f"{output} contains runs of another build, which are kept.",
            "Choose another --output to drive all runs with this build.",
            sep="\n",
            markup=False,
            highlight=False,
        )
    if disturbances.NAME in {e.name for e in driven}:
        _train_disturbed(console, campaign, jobs, cluster)
    with _progress(console) as progress:
        predictions = _predictions(progress, output, full=full) if "prediction" in chosen else None
        runs = _runs(progress, campaign, driven, full=full)
        cones, patches = (
            next((e for e in apart if e.name == name), None)
            for name in (avoidance, HIDDEN_ICE.name)
        )
        speeds = _entry_speeds(progress, campaign, cones, full=full) if cones else None
        ice = _ice(progress, campaign, patches, full=full) if patches else None
        try:
            finish(
                [part for part in (predictions, runs, speeds, ice) if part is not None],
                jobs,
                cluster,
            )
        except KeyboardInterrupt:
            progress.console.print("Interrupted. The same command continues with the missing runs.")
            raise
    outcomes = runs.results()
    seeds = predictions.results() if predictions else []
    times = _step_times(console, source, full=full) if "step-times" in chosen else []
    with console.status("Drawing ..."):
        shown = campaign.drives([e for e in driven if e.name in _SHOWN], jobs=jobs, cluster=cluster)
        command = shlex.join(["egp", *sys.argv[1:]])
        report = write_report(
            output,
            command,
            outcomes=outcomes,
            predictions=[outcome for seed in seeds for outcome in seed.outcomes],
            speeds=speeds.results() if speeds else [],
            ice=ice.results() if ice else [],
            times=times,
            drives=shown,
        )
    if rows := headline(outcomes):
        console.print(headline_table(HEADLINE, rows))
    console.print(f"Look at {report}", markup=False, highlight=False)


def _on_logs(
    console: Console,
    logs: list[Path],
    vehicle: Path | None,
    output: Path,
    of_drives: "Mapping[str, object]",
) -> None:
    """Evaluate on logs; raises `EgpError` if an option of drives has a value."""
    from egp_service.cli.logs import evaluate_on

    check_unused(of_drives, "cannot be used with --log, which drives nothing: leave out either")
    evaluate_on(console, logs, vehicle, output)


def _check_options(
    track: Path | None,
    scale: float,
    vehicle: Path | None,
    chosen: list[str],
    both: "Mapping[str, object]",
) -> None:
    from egp_service._core import EgpError

    if vehicle is not None:
        raise EgpError("--vehicle is for --log: give both")
    for names, given in both.items():
        if given:
            raise EgpError(f"{names} exclude each other: give one of them")
    if track and "unseen-track" not in chosen:
        raise EgpError("--track is used by unseen-track: add -e unseen-track")
    if scale != 1.0 and not track:
        raise EgpError("--scale requires --track: give both")


def _on_plant(
    parts: "tuple[list[ClosedLoopExperiment], ...]", plant: str, named: list[str] | None
) -> "list[list[ClosedLoopExperiment]]":
    """Let a simulator drive the experiments; raises `EgpError` if one of those named needs ours."""
    from egp_service._core import EgpError
    from egp_service.evaluation import disturbances
    from egp_service.evaluation.experiments import on_plant
    from egp_service.simulation.plant import load_simulator

    if disturbances.NAME in (named or []):
        raise EgpError(
            f"{disturbances.NAME} changes the built-in vehicle, which {plant} replaces: run it "
            "without --plant"
        )
    load_simulator(plant)  # reports a class that cannot be made before the runs start
    return [[on_plant(e, plant) for e in part if e.name != disturbances.NAME] for part in parts]


def _chosen(experiment: list[str] | None, known: list[str]) -> list[str]:
    from egp_service._core import EgpError

    for name in experiment or []:
        if name not in known:
            raise EgpError(f"no experiment {name!r}; known: {', '.join(known)}")
    return experiment or known


def _train(console: Console, output: Path, cluster: str | None) -> Path:
    from egp_service.cli.progress import collecting, fitting
    from egp_service.evaluation.library import make, write
    from egp_service.training.recipe import Displays

    path = output / "library.safetensors"
    if not path.exists():
        output.mkdir(parents=True, exist_ok=True)
        displays = Displays(lambda: collecting(console), lambda: fitting(console))
        write(path, make(displays, cluster=cluster))
    return path


def _train_disturbed(
    console: Console, campaign: "Campaign", jobs: int | None, cluster: str | None
) -> None:
    from egp_service.cli.progress import collecting, fitting
    from egp_service.evaluation.disturbances import DISTURBED
    from egp_service.evaluation.disturbed_library import train
    from egp_service.training.recipe import Displays

    displays = Displays(lambda: collecting(console), lambda: fitting(console))
    for name, disturbances in DISTURBED.items():
        path = campaign.disturbed_library(name)
        if not path.exists():
            console.print(f"Training the library of a vehicle with: {name}", highlight=False)
            train(path, disturbances, displays, jobs=jobs, cluster=cluster)


def _predictions(progress: "Progress", output: Path, *, full: bool) -> "Batch[Any, SeedOutcomes]":
    from egp_service.evaluation.prediction import PredictionSettings, SeedOutcomes, seeds

    settings = (
        PredictionSettings()
        if full
        else PredictionSettings(1, _QUICK_TRANSITIONS, _QUICK_ITERATIONS)
    )
    task = progress.add_task("prediction: training and testing seeds", total=settings.seeds)

    def report(_: SeedOutcomes) -> None:
        progress.advance(task)

    return seeds(settings, output, report)


def _runs(
    progress: "Progress", campaign: "Campaign", chosen: "list[ClosedLoopExperiment]", *, full: bool
) -> "Batch[Any, Outcome]":
    trials = {e.name: list(e.trials(range(e.seeds if full else e.quick_seeds))) for e in chosen}
    lost = dict.fromkeys(trials, 0)
    tasks = {
        name: progress.add_task(name, start=False, total=len(own)) for name, own in trials.items()
    }

    def report(outcome: "Outcome") -> None:
        name = outcome.experiment
        lost[name] += not outcome.completed
        progress.start_task(tasks[name])
        text = f"{name}: {lost[name]} not completed"
        progress.update(tasks[name], advance=1, description=text)

    return campaign.runs([trial for own in trials.values() for trial in own], report)


def _entry_speeds(
    progress: "Progress", campaign: "Campaign", cones: "ClosedLoopExperiment", *, full: bool
) -> "Batch[Any, EntrySpeed]":
    from egp_service.evaluation.entry_speed import EntrySpeed, find

    last = cones.conditions[-1][0]
    seeds = range(cones.seeds if full else cones.quick_seeds)
    trials = [t for t in cones.trials(seeds) if full or t.condition == last]
    name = f"{cones.name}: bisecting entry speeds"
    task = progress.add_task(name, start=False, total=len(trials))

    def report(_: EntrySpeed) -> None:
        progress.start_task(task)
        progress.advance(task)

    return campaign.batch("entry-speeds", trials, find, EntrySpeed, report)


def _ice(
    progress: "Progress", campaign: "Campaign", patches: "ClosedLoopExperiment", *, full: bool
) -> "Batch[Any, IceOutcome]":
    from egp_service.evaluation import hidden_ice

    seeds = range(patches.seeds if full else patches.quick_seeds)
    trials = [t for t in patches.trials(seeds) if full or t.condition == patches.compared]
    task = progress.add_task(patches.name, start=False, total=len(trials))

    def report(_: "IceOutcome") -> None:
        progress.start_task(task)
        progress.advance(task)

    return campaign.batch(patches.name, trials, hidden_ice.run, hidden_ice.IceOutcome, report)


def _step_times(console: Console, library: Path, *, full: bool) -> "list[StepTime]":
    from egp_service.evaluation import scaling
    from egp_service.evaluation.experiment import CUSTOM_TRACK
    from egp_service.simulation.scenario import Scenario, Zone

    scenario = Scenario("step-times", CUSTOM_TRACK, (Zone(0.0, 0.8),))
    with console.status("Timing the control step ..."):
        members = scaling.MEMBERS if full else _QUICK_MEMBERS
        periods = 200 if full else 60
        return scaling.measure(library, scenario, periods=periods, members=members)


def _progress(console: Console) -> "Progress":
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )
