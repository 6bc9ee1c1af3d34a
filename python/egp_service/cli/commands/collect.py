"""`egp collect`."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer
from rich.console import Console

from egp_service.cli.options import Cluster, Jobs, check_outputs, check_unused, check_writable
from egp_service.cli.output import say

if TYPE_CHECKING:
    from egp_service.data.dataset import Dataset
    from egp_service.data.experiment import Experiment
    from egp_service.data.log_import import Column
    from egp_service.data.provenance import Provenance

Value = TypeVar("Value")

_RUNS = 6
_SAMPLES = 300
_STEADY = 300
_VEHICLE = "1"  # number of CommonRoad
_UNNAMED = "unnamed"  # vehicle of a log


def collect(
    output: Annotated[Path, typer.Option("--output", "-o", help="Parquet file to write.")],
    friction: Annotated[
        str,
        typer.Option(
            help="Friction coefficient, or dry, wet, snow or ice; for a log and with --plant its "
            "nominal value."
        ),
    ],
    surface: Annotated[
        str | None, typer.Option(help="Name of the surface; one name gives one member.")
    ] = None,
    dt: Annotated[float, typer.Option(help="Control period, s.")] = 0.02,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help=f"CommonRoad number of the simulated car, by default {_VEHICLE}; for a log, the "
            f"car's name, by default {_UNNAMED}, or TOML file; with --plant the TOML file."
        ),
    ] = None,
    plant: Annotated[
        str | None,
        typer.Option(
            help="Simulator of your own to drive, MODULE:CLASS as for `egp drive`, within the "
            "limits of the car of --vehicle FILE."
        ),
    ] = None,
    runs: Annotated[
        int, typer.Option(min=0, help="Number of runs on tracks, at increasing speed.")
    ] = _RUNS,
    samples: Annotated[
        int, typer.Option(min=0, help="Number of cars that start in random states.")
    ] = _SAMPLES,
    steady: Annotated[
        int,
        typer.Option(min=0, help="Number of cars that drive at constant force and steering angle."),
    ] = _STEADY,
    track: Annotated[
        list[str] | None, typer.Option(help="Track of the runs; repeat for more, used in turn.")
    ] = None,
    disturbance: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME=VALUE, what the simulated car has beyond a single track; repeat for more."
        ),
    ] = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    from_log: Annotated[
        list[Path] | None,
        typer.Option(help="Import this log: CSV, Parquet, MCAP or ROS bag; repeat for more."),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            help="Column of a log: QUANTITY=COLUMN:UNIT, for example v_x=speed:km/h. In MCAP files "
            "and ROS bags, COLUMN is TOPIC/FIELD.FIELD."
        ),
    ] = None,
    mass: Annotated[
        float | None, typer.Option(help="Mass in kg, for a log with a_x instead of F_x.")
    ] = None,
    *,
    accelerometer: Annotated[
        bool,
        typer.Option(
            "--accelerometer",
            help="a_x was measured and not commanded: add what the front tyres took of it in "
            "bends, which follows from the axle distances of --vehicle FILE.",
        ),
    ] = False,
    separator: Annotated[
        str,
        typer.Option(help="Separator of CSV columns; semicolons and tabs are found without it."),
    ] = ",",
    steering_ratio: Annotated[
        float,
        typer.Option(
            help="Steering wheel's angle over the road wheels', for a log with the former."
        ),
    ] = 1.0,
    picture: Annotated[
        Path | None, typer.Option(help="File for a figure of what the data cover.")
    ] = None,
) -> None:
    """Collect drive data of one surface into a dataset.

    Drives the simulated car, or with --plant your simulator, on tracks, at
    increasing speed and with exploration noise, from random states, and with
    steady inputs. With
    --samples 0 a simulator starts without slip only (docs/simulator.md
    describes simulators). With --from-log the command imports a log instead,
    which must contain time, v_x, v_y, omega, delta, and F_x or a_x. With columns
    for the road's grade (positive uphill) and bank (positive if the left side is
    the higher one), the data are those of a level road. Columns that
    contradict each other are errors: most wrong units and signs, swapped columns,
    stuck sensors. No other column tells the sign or unit of v_y, and not every
    swap is found: look at the ranges that are printed. Errors count the rows of a
    table from 0 behind the header. In MCAP files and ROS bags (extra ros2) the
    time is that of the messages' headers. The command prints what the data cover
    and what is too thin to train on.

    For example:
      egp collect -o data/wet.parquet --friction 0.5 --surface wet
      egp collect -o data/snow.parquet --friction snow
      egp collect -o data/loaded.parquet --friction 0.5
          --disturbance load=300 --disturbance load_y=0.6
      egp collect -o data/own.parquet --friction 0.8 --plant my_simulator:Car
          --vehicle car.toml
      egp collect -o data/ice.parquet --friction 0.2 --surface ice
          --from-log drive.csv --mass 1400 --column time=t:s
          --column v_x=speed:km/h --column v_y=lateral_speed:m/s
          --column omega=yaw_rate:deg/s --column delta=wheel_angle:deg
          --column a_x=accel:g
      egp collect -o data/wet.parquet --friction wet --from-log rosbag2_2026/
          --mass 1400 --column v_x=/odom/twist.twist.linear.x:m/s ...
    """
    from egp_service._core import EgpError, surface_friction
    from egp_service.cli.progress import collecting
    from egp_service.data import stated_mass
    from egp_service.data.collect import CollectionSettings
    from egp_service.data.collect import collect as collect_dataset
    from egp_service.data.experiment import parse_surface, tool
    from egp_service.data.provenance import Provenance

    console = Console(markup=False)
    if not dt > 0.0:
        raise EgpError(f"--dt must be positive, got {dt:g} s")
    _check_name(output)
    if vehicle is None:
        vehicle = _UNNAMED if from_log else _VEHICLE
    check_outputs([*(from_log or []), Path(vehicle)], output, picture)
    _check_picture(picture)
    of_simulation = {
        "--track": track,
        "--runs": runs != _RUNS,
        "--samples": samples != _SAMPLES,
        "--steady": steady != _STEADY,
        "--seed": seed,
        "--disturbance": disturbance,
        "--plant": plant,
        "--jobs": jobs,
        "--cluster": cluster,
    }
    of_log = {
        "--column": column,
        "--mass": mass is not None,
        "--accelerometer": accelerometer,
        "--separator": separator != ",",
        "--steering-ratio": steering_ratio != 1.0,
    }
    if from_log:
        reason = "can be given for simulated data only: leave out --from-log, or these options"
        check_unused(of_simulation, reason)
    else:
        check_unused(of_log, "can be given for logs only: name the log with --from-log")
    stated_mass.check_unit(mass, vehicle, is_file=_is_file(vehicle))
    road = parse_surface(friction)
    mu = surface_friction(road)
    label = surface or (road if isinstance(road, str) else f"mu {road:g}")
    if from_log:
        provenance = Provenance(dt, vehicle, label, mu, seed, "", tool())
        columns = _once("--column", map(_column, column or []))
        check_writable(output, picture)
        dataset = _import(
            console,
            from_log,
            columns,
            provenance,
            mass,
            separator,
            steering_ratio,
            accelerometer=accelerometer,
        )
    else:
        settings = CollectionSettings(runs=runs, samples=samples, steady=steady)
        if track:
            settings = dataclasses.replace(settings, tracks=tuple(track))
        disturbances = _once("--disturbance", map(_disturbance, disturbance or []))
        experiment = _experiment(plant, vehicle, road, label, seed, dt, disturbances)
        check_writable(output, picture)
        with collecting(console) as report:
            dataset = collect_dataset(
                experiment,
                settings,
                jobs=jobs,
                cluster=cluster,
                report=lambda done, total: report(label, done, total),
            )
    dataset.write(output)
    _show_coverage(console, dataset, label, picture)
    console.print(f"{output}: {len(dataset)} transitions of {dt:g} s on {label}")


def _experiment(
    plant: str | None,
    vehicle: str,
    road: float | str,
    label: str,
    seed: int,
    dt: float,
    disturbances: dict[str, float],
) -> "Experiment":
    """Describe what is driven: the simulated car `vehicle`, or `plant` with the car of its file."""
    from egp_service._core import EgpError, surface_friction
    from egp_service.data.experiment import Experiment, OwnExperiment
    from egp_service.simulation.one_surface import OneSurface
    from egp_service.vehicle import check_own_name, read_vehicle

    if plant is None:
        if not vehicle.isdecimal():
            raise EgpError(
                f"vehicle {vehicle}: expected a CommonRoad number such as 1; the TOML file of a "
                "car goes with --plant or --from-log"
            )
        return Experiment(road, label, seed, dt, int(vehicle), disturbances)
    check_unused({"--disturbance": disturbances}, "has no effect on a simulator of your own")
    if not _is_file(vehicle):
        raise EgpError(
            f"--plant {plant} needs the mass, axles and limits of its car: name the TOML file that "
            "describes it with --vehicle FILE.toml; `egp train --help` lists its lines"
        )
    check_own_name(Path(vehicle).stem)
    return OwnExperiment(
        surface_friction(road),
        label,
        seed,
        dt,
        name=Path(vehicle).stem,
        car=read_vehicle(vehicle),
        simulator=plant,
        make=OneSurface,
    )


def _check_name(output: Path) -> None:
    from egp_service._core import EgpError

    if output.is_dir():
        inside = output / "data.parquet"
        raise EgpError(f"{output} is a folder: name a dataset in it, such as {inside}")
    if output.suffix != ".parquet":
        raise EgpError(f"{output}: a dataset is a Parquet file; name it {output.stem}.parquet")


def _is_file(vehicle: str) -> bool:
    """Return whether --vehicle states a file, and not a name."""
    return vehicle.endswith(".toml")


def _check_picture(picture: Path | None) -> None:
    if picture is not None:
        from egp_service.simulation.report import check_picture

        check_picture(picture)


def _import(
    console: Console,
    logs: Sequence[Path],
    columns: "Mapping[str, Column]",
    provenance: "Provenance",
    mass: float | None,
    separator: str,
    steering_ratio: float,
    *,
    accelerometer: bool,
) -> "Dataset":
    """Import logs of one drive or more, and join them."""
    from egp_service._core import EgpError
    from egp_service.cli.progress import counted
    from egp_service.data import stated_mass
    from egp_service.data.dataset import merge
    from egp_service.data.log_import import import_log
    from egp_service.vehicle import check_own_name, read_vehicle

    wheelbase = front_share = None
    if _is_file(provenance.vehicle):
        file = Path(provenance.vehicle)
        car = read_vehicle(file)
        mass, wheelbase = stated_mass.of_car(mass, car.mass, file), car.l_f + car.l_r
        if accelerometer:
            front_share = car.l_r / wheelbase
        provenance = dataclasses.replace(provenance, vehicle=file.stem)
    elif "/" in provenance.vehicle or Path(provenance.vehicle).is_file():
        raise EgpError(
            f"--vehicle {provenance.vehicle}: expected the name of a car, or a TOML file that "
            "describes it and whose name ends in .toml"
        )
    elif accelerometer:
        raise EgpError(
            "--accelerometer needs the distances of the axles: name the vehicle's file with "
            "--vehicle FILE.toml"
        )
    check_own_name(provenance.vehicle)
    parts = []
    for log in logs:
        name = log.name or log.absolute().name  # of the folder in which the command runs
        try:
            with counted(console, f"reading {name}", "messages") as report:
                part = import_log(
                    log,
                    columns,
                    dataclasses.replace(provenance, method=f"log {name}"),
                    mass=mass,
                    wheelbase=wheelbase,
                    front_share=front_share,
                    separator=separator,
                    steering_ratio=steering_ratio,
                    report=report,
                )
        except EgpError as error:
            if str(error).startswith(f"{log}: "):
                raise
            raise EgpError(f"{log}: {error}") from error
        parts.append(part)
    return merge(parts)


def _show_coverage(console: Console, dataset: "Dataset", label: str, picture: Path | None) -> None:
    from egp_service.data.coverage import Coverage

    covered = Coverage.of(dataset)
    say(console, *covered.lines())
    if picture is not None:
        from egp_service.data.coverage_figure import draw_coverage

        draw_coverage(covered, label, picture)


def _once(option: str, pairs: Iterable[tuple[str, Value]]) -> dict[str, Value]:
    """Make a dictionary; errors if two values of a repeated option have one name."""
    from egp_service._core import EgpError

    found: dict[str, Value] = {}
    for name, value in pairs:
        if name in found:
            raise EgpError(f"{option} {name} is given twice: leave out one of them")
        found[name] = value
    return found


def _column(text: str) -> "tuple[str, Column]":
    """Read a quantity with its column and unit, for example `v_x=speed:km/h`."""
    from egp_service._core import EgpError
    from egp_service.data.log_import import Column

    quantity, equals, rest = text.partition("=")
    if not equals:
        raise EgpError(f"--column {text}: expected QUANTITY=COLUMN:UNIT")
    return quantity, Column.parse(rest)


def _disturbance(text: str) -> tuple[str, float]:
    """Read a name and a value, for example `load=300`."""
    from egp_service._core import EgpError

    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError as error:
        raise EgpError(
            f"--disturbance {text}: expected NAME=VALUE, for example load=300"
        ) from error
