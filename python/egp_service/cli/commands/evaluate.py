"""`egp evaluate`."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from egp_service.cli.options import NOT_COMPLETED, Cluster, Jobs, check_unused
from egp_service.cli.output import say
from egp_service.shipped import EVALUATION_LIBRARY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from egp_service.cli.evaluation_parts import Selection
    from egp_service.evaluation.campaign import Campaign
    from egp_service.evaluation.scaling import StepTime

_SHOWN = ("varying-speed", "unseen-track", "lane-change", "four-members")
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
        Path | None,
        typer.Option(help="Library instead of the shipped one, members in the same order."),
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
    closed: Annotated[
        bool, typer.Option("--closed/--open", help="Whether the track's end joins its start.")
    ] = True,
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

    With --plant your simulator drives, a class with reset(x),
    step(u, dt, friction) and state: `egp drive --help` says what these are, and
    docs/simulator.md has an example. The experiment prediction uses the built-in
    vehicle all the same; disturbances, another vehicle and roads whose sides
    differ are left out. Gate, speeds and baselines are those of the vehicle of
    --library, whose first members have the frictions 0.5, 0.6, 0.9 and 1.1. Runs
    are kept by the simulator's name: choose another --output after changing it.

    The same command resumes an interrupted evaluation. The exit status is 3 if
    no run completed. Requires the extras train and viz; with the extra paper,
    step-times includes the paper's stack.

    For example:
      egp evaluate --quick
      egp evaluate --full -o runs/full
      egp evaluate --full -e varying-speed -e random-roads
      egp evaluate -e unseen-track --track Interlagos_centerline.csv --scale 10
      egp evaluate -e unseen-track --plant my_simulator:Car
          --library my_library.safetensors
      egp evaluate --log data/oval.parquet --log data/road.parquet
          --vehicle car.toml
    """
    console = Console()
    if log:
        of_drives = {
            "--full": full, "--quick": quick, "--experiment": experiment, "--library": library,
            "--train": train, "--track": track, "--scale": scale != 1.0, "--plant": plant,
            "--open": not closed, "--jobs": jobs, "--cluster": cluster,
        }  # fmt: skip
        reason = "cannot be used with --log, which drives nothing: leave out either"
        check_unused(of_drives, reason)
        with console.status("Loading ..."):
            from egp_service.cli.logs import evaluate_on

        evaluate_on(console, log, vehicle, output)
        return
    with console.status("Loading ..."):
        from egp_service.cli.evaluation_parts import run

    chosen = _chosen(experiment)
    _check_options(track, vehicle, chosen, {"--scale": scale != 1.0, "--open": not closed}, {
        "--full and --quick": full and quick, "--train and --library": train and library,
        "--jobs and --cluster": jobs and cluster,
    })  # fmt: skip
    selection = _selection(console, chosen, track, scale, closed=closed, full=full)
    if plant is not None:
        selection = _on_plant(console, selection, plant, experiment, library, output)
    source = _train(console, output, jobs, cluster) if train else library or EVALUATION_LIBRARY
    selection = _with_members(console, selection, source)
    campaign = _campaign(console, selection, output, source, plant, jobs, cluster)
    results = run(console, campaign, selection, output, jobs=jobs, cluster=cluster)
    _write(console, campaign, selection, output, source, plant, results, jobs, cluster)


def _selection(
    console: Console,
    chosen: list[str],
    track: Path | None,
    scale: float,
    *,
    closed: bool,
    full: bool,
) -> "Selection":
    """Give what is evaluated; errors if nothing of what was chosen is run without --full."""
    from egp_service._core import EgpError
    from egp_service.cli.evaluation_parts import Selection
    from egp_service.evaluation import disturbances, experiments

    every = experiments.EXPERIMENTS
    driven = [e for e in every if e.name in chosen and (full or e.quick_seeds)]
    if track:
        on_track = partial(experiments.on_track, file=track, scale=scale, closed=closed)
        driven = [on_track(e) if e.name == "unseen-track" else e for e in driven]
    if disturbances.NAME in chosen and not full:
        told = "disturbances trains six libraries and is driven with --full only"
        if set(chosen) == {disturbances.NAME}:
            raise EgpError(f"{told}: add --full")
        console.print(f"{told}.")
    apart = [
        e for e in (experiments.OBSTACLE_AVOIDANCE, experiments.HIDDEN_ICE) if e.name in chosen
    ]
    return Selection(full, chosen, driven, apart)


def _with_members(console: Console, selection: "Selection", source: Path) -> "Selection":
    """Leave out controllers whose members the library lacks, and say which."""
    from dataclasses import replace

    from egp_service.evaluation.experiments import FOUR, with_members

    timed = FOUR if "step-times" in selection.chosen else ()
    every = [*selection.driven, *selection.apart]
    kept = with_members(source, every, timed)
    found = {c.name for e in kept for c in e.contenders}
    missing = dict.fromkeys(c.name for e in every for c in e.contenders if c.name not in found)
    if missing:
        say(console, f"Left out, as {source} lacks their members: {', '.join(missing)}.")
    count = len(selection.driven)
    return replace(selection, driven=kept[:count], apart=kept[count:])


def _campaign(
    console: Console,
    selection: "Selection",
    output: Path,
    source: Path,
    plant: str | None,
    jobs: int | None,
    cluster: str | None,
) -> "Campaign":
    """Resume the campaign of the folder or begin one, with the libraries that it needs."""
    from egp_service.evaluation import disturbances
    from egp_service.evaluation.campaign import Campaign

    campaign = Campaign(output, source, plant)
    for what, other in (
        ("build", campaign.of_another_build),
        (f"version of the file of {plant}", campaign.of_another_plant),
    ):
        if other:
            kept = f"{output} contains runs of another {what}, which are kept."
            say(console, kept, f"Choose another --output to drive all runs with this {what}.")
    if disturbances.NAME in {e.name for e in selection.driven}:
        _train_disturbed(console, campaign, jobs, cluster)
    return campaign


def _write(
    console: Console,
    campaign: "Campaign",
    selection: "Selection",
    output: Path,
    source: Path,
    plant: str | None,
    results: "dict[str, list[Any]]",
    jobs: int | None,
    cluster: str | None,
) -> None:
    import shlex
    import sys

    from egp_service.cli.evaluation_parts import advising
    from egp_service.cli.progress import counted
    from egp_service.cli.tables import headline_table
    from egp_service.evaluation.experiments import HIDDEN_ICE, OBSTACLE_AVOIDANCE
    from egp_service.evaluation.summary_report import HEADLINE, headline, why_lost, write_report

    ice = results.get(HIDDEN_ICE.name, [])
    with advising(console, "The same command goes on with the report of the finished runs."):
        timed = "step-times" in selection.chosen
        times = _step_times(console, source, plant, output, full=selection.full) if timed else []
        shown = [e for e in selection.driven if e.name in _SHOWN]
        with counted(console, "driving the runs of the pictures", "runs") as driven_so_far:
            drives = campaign.drives(shown, driven_so_far, jobs=jobs, cluster=cluster)
        with console.status("Drawing ..."):
            seeds = results.get("predictions", [])
            report = write_report(
                output,
                shlex.join(["egp", *sys.argv[1:]]),
                source,
                plant=plant,
                outcomes=results["runs"],
                predictions=[outcome for seed in seeds for outcome in seed.outcomes],
                speeds=results.get(OBSTACLE_AVOIDANCE.name, []),
                ice=ice,
                times=times,
                drives=drives,
            )
    if rows := headline(results["runs"]):
        console.print(headline_table(HEADLINE, rows))
    driven = [*results["runs"], *ice]
    say(console, *why_lost(driven), f"Look at {report}")
    if driven and not any(outcome.completed for outcome in driven):
        raise typer.Exit(NOT_COMPLETED)


def _check_options(
    track: Path | None,
    vehicle: Path | None,
    chosen: list[str],
    of_track: "Mapping[str, object]",
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
    for name, given in of_track.items():
        if given and not track:
            raise EgpError(f"{name} requires --track: give both")


def _on_plant(
    console: Console,
    selection: "Selection",
    plant: str,
    named: list[str] | None,
    library: Path | None,
    output: Path,
) -> "Selection":
    """Let a simulator drive the experiments, and say which conditions it cannot.

    Gate and speeds are those of the library's vehicle, as the campaign's file states it.

    Raises:
        EgpError: if one of the experiments named needs our simulator.

    """
    from dataclasses import replace

    from egp_service._core import EgpError, Library
    from egp_service.evaluation import disturbances
    from egp_service.evaluation.campaign import VEHICLE_FILE
    from egp_service.evaluation.experiments import on_plant
    from egp_service.simulation.plant import load_simulator

    if disturbances.NAME in (named or []):
        raise EgpError(
            f"{disturbances.NAME} changes the built-in vehicle, which {plant} replaces: run it "
            "without --plant"
        )
    load_simulator(plant)  # reports a class that cannot be made before the runs start
    used = Library.load(library or EVALUATION_LIBRARY)
    vehicle, file = used.parameters, output.absolute() / VEHICLE_FILE
    if library is None:
        told = f"Gate, speeds and baselines are those of {used.vehicle}, {vehicle.mass:g} kg"
        say(console, f"{told}. If {plant} is another vehicle, state its library with --library.")
    driven = []
    for experiment in (e for e in selection.driven if e.name != disturbances.NAME):
        own = on_plant(experiment, plant, vehicle, file)
        kept = {name for name, _ in own.conditions}
        if left := [name for name, _ in experiment.conditions if name not in kept]:
            told = f"{experiment.name} without the conditions that {plant} does not see: "
            say(console, told + ", ".join(left))
        driven.append(own)
    apart = [on_plant(e, plant, vehicle, file) for e in selection.apart]
    return replace(selection, driven=driven, apart=apart)


def _chosen(experiment: list[str] | None) -> list[str]:
    from egp_service._core import EgpError
    from egp_service.evaluation.experiments import EXPERIMENTS, HIDDEN_ICE, OBSTACLE_AVOIDANCE

    apart = [HIDDEN_ICE.name, OBSTACLE_AVOIDANCE.name]
    known = ["prediction", *(e.name for e in EXPERIMENTS), *apart, "step-times"]
    for name in experiment or []:
        if name not in known:
            raise EgpError(f"no experiment {name!r}; known: {', '.join(known)}")
    return experiment or known


def _train(console: Console, output: Path, jobs: int | None, cluster: str | None) -> Path:
    from egp_service._core import EgpError
    from egp_service.cli.progress import collecting, fitting
    from egp_service.evaluation.library import make
    from egp_service.training.recipe import Displays

    path = output / "library.safetensors"
    if not path.exists():
        if (output / "library.sha256").exists():
            raise EgpError(
                f"{output} contains runs of a library that was not trained there: choose another "
                "--output, or leave out --train"
            )
        output.mkdir(parents=True, exist_ok=True)
        displays = Displays(lambda: collecting(console), lambda: fitting(console))
        make(path, displays, jobs=jobs, cluster=cluster)
    return path


def _train_disturbed(
    console: Console, campaign: "Campaign", jobs: int | None, cluster: str | None
) -> None:
    from egp_service.cli.progress import collecting, fitting
    from egp_service.evaluation.disturbances import DISTURBED
    from egp_service.evaluation.library import make_disturbed
    from egp_service.training.recipe import Displays

    displays = Displays(lambda: collecting(console), lambda: fitting(console))
    for name, disturbances in DISTURBED.items():
        path = campaign.disturbed_library(name)
        if not path.exists():
            say(console, f"Training the library of a vehicle with: {name}")
            make_disturbed(path, disturbances, displays, jobs=jobs, cluster=cluster)


def _step_times(
    console: Console, library: Path, plant: str | None, output: Path, *, full: bool
) -> "list[StepTime]":
    from egp_service.evaluation import scaling
    from egp_service.evaluation.campaign import VEHICLE_FILE
    from egp_service.evaluation.experiment import CUSTOM_TRACK
    from egp_service.simulation.scenario import Scenario, Zone

    file = None if plant is None else str(output / VEHICLE_FILE)
    zones = (Zone(0.0, 0.8),)
    scenario = Scenario("step-times", CUSTOM_TRACK, zones, plant=plant, vehicle_file=file)
    with console.status("Timing the control step ..."):
        members = scaling.MEMBERS if full else _QUICK_MEMBERS
        periods = 200 if full else 60
        return scaling.measure(library, scenario, periods=periods, members=members)
