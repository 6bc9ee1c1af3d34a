"""`egp train`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from egp_service.cli.options import Cluster, Jobs, check_outputs, check_unused, check_writable
from egp_service.cli.output import say
from egp_service.training.kernel import KernelName

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service._core import Library
    from egp_service.training.train import TrainingSettings
    from egp_service.training.trained import TrainedMember
    from egp_service.training.validation import Cell

_MAX_POINTS = 400
_VALIDATION = 0.2


def train(
    output: Annotated[Path, typer.Option("--output", "-o", help="Library file to write.")],
    data: Annotated[
        list[Path] | None, typer.Argument(help="Datasets; datasets of one surface are merged.")
    ] = None,
    recipe: Annotated[
        Path | None, typer.Option(help="Recipe for collection and training, instead of DATA.")
    ] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option(help="TOML file of the vehicle; needed unless the data are simulated."),
    ] = None,
    kernel: Annotated[KernelName, typer.Option(help="Covariance function.")] = "matern52",
    mean: Annotated[
        Literal["single-track", "constant", "best"],
        typer.Option(help="Prior mean of the GPs; best tries vehicles and constants, also alone."),
    ] = "best",
    max_points: Annotated[
        int, typer.Option(help="Largest number of transitions of a member; with best at most 150.")
    ] = _MAX_POINTS,
    restarts: Annotated[
        int | None,
        typer.Option(help="Additional random starts of each fit, by default 1; with constant."),
    ] = None,
    validation: Annotated[
        float, typer.Option(help="Share of the trajectories for validation, between 0 and 1.")
    ] = _VALIDATION,
    seed: Annotated[int, typer.Option(min=0, help="Seed of split, selection and starts.")] = 0,
    jobs: Jobs = None,
    cluster: Cluster = None,
    picture: Annotated[
        Path | None, typer.Option(help="File for a figure of the validation matrix.")
    ] = None,
) -> None:
    """Train a library: one member for each surface in the datasets.

    Prints each member's fitted vehicle, with intervals and with what the data do
    not determine, and the validation matrix: every member on every surface's
    held-out trajectories. The members' vehicles share the body and differ in the
    tyres; the file of --vehicle also says what is known about the body.

    With --mean best, each member takes what predicts held-out blocks best: no
    change, a constant, a kinematic or a single-track vehicle, each alone or with
    GPs. A single-track vehicle that predicts better than no change is preferred
    to kinds that are better by less than 0.25 nats per error, because only it
    predicts slides outside the data; the command then says which kind is better,
    and by how much. The last tables compare each member with no change and with
    a linear model after one period and after rollouts; the command warns where
    there is no skill.

    Delays of a log are estimated, and its inputs are moved by them before
    training; the command says by how much. With best, training takes minutes for
    each member; single-track and constant, which try nothing else, are faster.

    With best and single-track, the targets of the GPs are averages over all
    transitions, at up to 150 and --max-points of them. With constant, these are
    the only ones that the GPs learn from. Of more transitions, half are selected
    uniformly and half by the variance of a first fit.

    The library states its vehicle, from which controller, gate and speed
    profile take their defaults. The file of --vehicle states, in SI units:
    mass, yaw_inertia, l_f and l_r (centre of mass to the axles), width; a_min
    (negative), a_max, power (W/kg), a_slew, all per mass; steering_angle,
    steering_rate, steering_slew; peak_slip (of the front tyres, on friction
    1); lateral_grip, braking_grip and driving_grip (reachable share of
    friction times gravity). `egp inspect` shows those of a library.

    A recipe (TOML) states what is collected and how it is trained
    (docs/your-data.md); demo-recipe.toml in the package's folder shipped made the
    demo's library.

    For example:
      egp train data/*.parquet -o library.safetensors
      egp train data/*.parquet -o library.safetensors --vehicle car.toml
      egp train --recipe recipe.toml -o library.safetensors
    """
    from egp_service._core import EgpError, Library
    from egp_service.cli.progress import collecting, fitting

    console = Console()
    with console.status("Loading ..."):
        from egp_service.data.dataset import Dataset
        from egp_service.training.export import export
        from egp_service.training.recipe import Displays, Recipe, follow, training_provenance
        from egp_service.training.train import train as train_members
        from egp_service.training.validation import validate
        from egp_service.vehicle import known_vehicle, read_vehicle

    # These checks come before the minutes that training takes: files that cannot be written, a
    # missing extra and, below, an unknown vehicle.
    check_writable(output, picture)
    check_outputs([*(data or []), recipe, vehicle], output, picture)
    if picture is not None:
        from egp_service.simulation.report import check_picture
        from egp_service.training.validation_report import draw_validation

        check_picture(picture)
    car = None if vehicle is None else read_vehicle(vehicle)
    if (recipe is None) == (not data):
        raise EgpError("expected either datasets or --recipe")
    if (cluster or jobs) and recipe is None:
        raise EgpError("--jobs and --cluster need a --recipe, whose data are collected in parallel")
    if recipe is not None:
        stated = {
            "--vehicle": vehicle,
            "--kernel": kernel != "matern52",
            "--mean": mean != "best",
            "--max-points": max_points != _MAX_POINTS,
            "--restarts": restarts is not None,
            "--validation": validation != _VALIDATION,
            "--seed": seed,
        }
        check_unused(stated, "cannot be used with --recipe: the recipe's file states it")
    elif mean != "constant":
        check_unused(
            {"--restarts": restarts is not None},
            f"cannot be used with --mean {mean}: add --mean constant",
        )
    if recipe is not None:
        plan = Recipe.read(recipe)
        settings = plan.training
        displays = Displays(lambda: collecting(console), lambda: fitting(console))
        _, members = follow(plan, jobs=jobs, cluster=cluster, displays=displays)
    else:
        settings = _settings(kernel, mean, max_points, restarts, validation, seed)
        datasets = [Dataset.read(path) for path in data or []]
        if car is None:
            known_vehicle(datasets[0].provenance.vehicle)
        with fitting(console) as report:
            members = train_members(datasets, settings, report, vehicle=car)
    export(output, members, settings, training_provenance(settings), car)
    library = Library.load(output)
    held_out = {member.dataset.provenance.surface: member.validation for member in members}
    matrix = validate(library, held_out)
    _show(console, library, members, matrix)
    if picture is not None:
        draw_validation(matrix, picture)
    noun = "member" if len(members) == 1 else "members"
    console.print(f"{output}: {len(members)} {noun}, id {library.id}", markup=False)


def _settings(
    kernel: KernelName,
    mean: Literal["single-track", "constant", "best"],
    max_points: int,
    restarts: int | None,
    validation: float,
    seed: int,
) -> "TrainingSettings":
    """Give the settings that the options state; a value out of its range is an error."""
    from egp_service._core import EgpError
    from egp_service.training.train import TrainingSettings

    if not 0.0 < validation < 1.0:
        raise EgpError(f"--validation is {validation:g}: expected a share between 0 and 1")
    if restarts is not None and restarts < 0:
        raise EgpError(f"--restarts is {restarts}: expected 0 or more")
    return TrainingSettings(
        kernel=kernel,
        mean=mean,
        max_points=max_points,
        restarts=1 if restarts is None else restarts,
        validation_fraction=validation,
        seed=seed,
    )


def _show(
    console: Console,
    library: "Library",
    members: "Sequence[TrainedMember]",
    matrix: "list[list[Cell]]",
) -> None:
    """Print what training found about each member, and how each one predicts."""
    from egp_service.cli.tables import (
        calibration_warnings,
        delay_sentence,
        kind_sentence,
        prior_warnings,
        skill_table,
        skill_warnings,
        validation_table,
        vehicle_table,
    )
    from egp_service.training.validation import member_skill

    say(console, delay_sentence(members[0].delays))
    simulated = members[0].delays is None
    warnings = calibration_warnings(matrix, simulated=simulated)
    for member in members:
        if member.vehicle is not None:
            label, found = member.dataset.provenance.surface, member.vehicle.summary()
            console.print(vehicle_table(label, found))
            warnings += prior_warnings(label, found, simulated=simulated)
    console.print(validation_table(matrix))
    for warning in warnings:
        say(console, warning, style="yellow")
    for number, member in enumerate(members):
        label = member.dataset.provenance.surface
        if member.kind:
            say(console, kind_sentence(label, member.kind, member.likelihoods))
        compared = member_skill(library, number, member)
        console.print(skill_table(label, compared))
        for warning in skill_warnings(label, label, compared):
            say(console, warning, style="yellow")
