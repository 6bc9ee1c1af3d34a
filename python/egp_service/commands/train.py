"""`egp train`."""

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console


def train(
    output: Annotated[Path, typer.Option("--output", "-o", help="Library file to write.")],
    data: Annotated[
        list[Path] | None, typer.Argument(help="Datasets; those of one surface are merged.")
    ] = None,
    recipe: Annotated[
        Path | None, typer.Option(help="Collect and train as a recipe says, instead of DATA.")
    ] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option(help="TOML file of the vehicle; needed unless the data are simulated."),
    ] = None,
    kernel: Annotated[
        Literal["rbf", "matern52"], typer.Option(help="Covariance function.")
    ] = "matern52",
    mean: Annotated[
        Literal["single-track", "constant"],
        typer.Option(help="What the GPs correct: a vehicle fitted to the surface, or a constant."),
    ] = "single-track",
    max_points: Annotated[int, typer.Option(help="Transitions a member keeps.")] = 400,
    restarts: Annotated[int, typer.Option(help="Further random starts of each fit.")] = 1,
    validation: Annotated[
        float, typer.Option(help="Share of the trajectories kept for validation.")
    ] = 0.2,
    seed: Annotated[int, typer.Option(help="Seed of split, subset and starts.")] = 0,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the validation matrix into this file.")
    ] = None,
) -> None:
    """Train a library: one member for each surface in the datasets.

    Prints the validation matrix, every member on every surface's held-out
    trajectories. Data beyond --max-points are thinned: half uniformly, half
    where the first fit knows least.

    The library says which vehicle it is for: controller, gate and speed
    profile take their defaults from there. The file of --vehicle states, in
    SI units: mass, yaw_inertia, l_f and l_r (centre of mass to the axles),
    width; a_min (negative), a_max, power (W/kg), a_slew, all per mass;
    steering_angle, steering_rate, steering_slew; peak_slip (of the front
    tyres, on friction 1); lateral_grip, braking_grip and driving_grip
    (reachable share of friction times gravity). `egp inspect` shows those of
    a library.

    For example:
      egp train data/*.parquet -o library.safetensors
      egp train data/*.parquet -o library.safetensors --vehicle car.toml
      egp train --recipe recipe.toml -o library.safetensors
    """
    from egp_service import EgpError
    from egp_service._core import Library
    from egp_service.dataset import Dataset
    from egp_service.export import export
    from egp_service.recipe import Displays, Recipe, follow, training_provenance
    from egp_service.training import TrainingSettings
    from egp_service.training import train as train_members
    from egp_service.training_progress import collecting, fitting
    from egp_service.validation import validate, validation_table
    from egp_service.vehicle import read_vehicle

    console = Console()
    if (recipe is None) == (not data):
        raise EgpError("expected datasets or --recipe, one of them")
    if recipe is not None:
        plan = Recipe.read(recipe)
        settings = plan.training
        displays = Displays(lambda: collecting(console), lambda: fitting(console))
        _, members = follow(plan, displays=displays)
    else:
        settings = TrainingSettings(
            kernel=kernel,
            mean=mean,
            max_points=max_points,
            restarts=restarts,
            validation_fraction=validation,
            seed=seed,
        )
        datasets = [Dataset.read(path) for path in data or []]
        with fitting(console) as report:
            members = train_members(datasets, settings, report)
    car = None if vehicle is None else read_vehicle(vehicle)
    export(output, members, settings, training_provenance(settings), car)
    library = Library.load(output)
    held_out = {member.dataset.provenance.surface: member.validation for member in members}
    matrix = validate(library, held_out)
    console.print(validation_table(matrix))
    if picture is not None:
        from egp_service.validation_report import draw_validation

        draw_validation(matrix, picture)
    console.print(f"{output}: {len(members)} members, id {library.id}")
