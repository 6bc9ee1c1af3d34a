"""`egp vehicle`."""

from pathlib import Path
from typing import Annotated

import typer

from egp_service._core import EgpError
from egp_service.cli.options import check_outputs, check_writable

_OUTPUT = Path("vehicle.toml")

vehicle = typer.Typer(no_args_is_help=True)


@vehicle.callback()
def group() -> None:
    """Make the file that describes a vehicle.

    For example: egp vehicle fit data/*.parquet -o vehicle.toml
    """


@vehicle.command()
def fit(
    data: Annotated[
        list[Path], typer.Argument(help="Datasets of `egp collect`.", show_default=False)
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help=f"TOML file to write; {_OUTPUT} if not stated."),
    ] = None,
    *,
    known: Annotated[
        Path | None,
        typer.Option(help="Complete file of a vehicle: expectation of the fit, and limits."),
    ] = None,
    width: Annotated[float | None, typer.Option(help="Width without mirrors, m.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the choice of transitions.")] = 0,
) -> None:
    """Fit a vehicle to logs, and write the file that describes it.

    Mass, axles, yaw inertia and tyres are fitted to the datasets of all
    surfaces, with 95 % intervals. These tell how well the data determine a
    value; the error of the single-track equations and delays of the sensors are
    not in them, and can be larger (docs/your-car.md): write mass, inertia and
    axles that you weighed or measured over the fitted values. Logs do not tell
    the limits of the actuators: the file has the largest values in the logs.
    Every line of the file says where its value comes from, and CHECK where to
    look at it.

    Mass, inertia and axles of --known are the expectation of the fit (standard
    deviations 3 %, 15 % and 2 %): the logs can move them. The limits of the
    actuators are taken from it as they are.

    With a_x and --mass instead of a measured force, the logs say nothing new
    about the mass: the fitted mass scales with the one that was given, and the
    lines of mass and yaw inertia have CHECK.

    The file is used by `egp collect --from-log --vehicle FILE` (mass and
    name), `egp train --vehicle FILE` (the library then states the vehicle,
    for `egp serve` and every controller), and `vehicle_file` of a scenario
    (gate and speeds of `egp drive`).

    For example:
      egp vehicle fit data/*.parquet -o vehicle.toml --width 1.82
      egp vehicle fit data/wet.parquet --known datasheet.toml
      egp train data/*.parquet --vehicle vehicle.toml -o library.safetensors
    """
    from rich.console import Console
    from rich.text import Text

    console = Console()
    with console.status("Loading ..."):
        from egp_service.cli.progress import working
        from egp_service.cli.tables import vehicle_table
        from egp_service.data.dataset import Dataset, merge
        from egp_service.files import write_text
        from egp_service.training.vehicle_file import vehicle_lines, vehicle_toml
        from egp_service.vehicle import read_vehicle

    if output is None:
        output = _OUTPUT
        if output.exists():
            raise EgpError(
                f"{output} exists: state -o {output} to replace it, or the name of another file"
            )
    check_outputs([*data, known], output)
    check_writable(output)
    surfaces: dict[str, list[Dataset]] = {}
    for path in data:
        dataset = Dataset.read(path)
        surfaces.setdefault(dataset.provenance.surface, []).append(dataset)
    before = None if known is None else read_vehicle(known)
    merged = [merge(parts) for parts in surfaces.values()]
    with working(console, "fitting the vehicle"):
        lines, fitted = vehicle_lines(merged, before, width, seed)
    write_text(output, vehicle_toml(lines))
    for label, found in zip(surfaces, fitted, strict=True):
        console.print(vehicle_table(label, found.summary()))
    for line in lines:
        if line.warning:
            name = Text(line.name, style="yellow")
            console.print(Text.assemble(name, f" = {line.value:g}: {line.warning}"))
    console.print(f"{output}: {len(lines)} parameters", markup=False)
