"""`egp drive`."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from egp_service.control.step import StepController
    from egp_service.simulation.scenario import Scenario

NOT_COMPLETED = 3


def drive(
    scenario: Annotated[
        str, typer.Option("--scenario", "-s", help="Name of a built-in scenario, or a TOML file.")
    ] = "rounded-rectangle",
    library: Annotated[
        Path | None, typer.Option("--library", "-l", help="Library in place of the scenario's.")
    ] = None,
    *,
    in_process: Annotated[
        bool, typer.Option("--in-process", help="Compute in this process, not in a service.")
    ] = False,
    connect: Annotated[
        str | None, typer.Option(help="Endpoint of a running service, such as tcp/127.0.0.1:7447.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed in place of the scenario's.")] = None,
    road: Annotated[
        Path | None,
        typer.Option(help="File of what is known about the road's friction; read, then updated."),
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the runs.")] = Path(
        "runs"
    ),
    pictures: Annotated[bool, typer.Option(help="Draw pictures at the end.")] = True,
) -> None:
    """Drive a simulated car; results go to runs/<time>-<scenario>/.

    By default a service in its own process computes the control steps; see
    --in-process and --connect.

    For example:
      egp drive
      egp drive -s lane-change --library library.safetensors
      egp drive -s my-scenario.toml --in-process
      egp drive -s random --road random.road    (and once more: faster)
    """
    from functools import partial

    from egp_service.cli.status_line import StatusLine
    from egp_service.cli.tables import summary_table
    from egp_service.simulation.reference import load_belief, store_belief
    from egp_service.simulation.runs import new_folder, record_run
    from egp_service.simulation.scenario import load_scenario

    console = Console()
    chosen = load_scenario(scenario)
    if library is not None:
        chosen = replace(chosen, library=str(library))
    if seed is not None:
        chosen = replace(chosen, seed=seed)
    belief = load_belief(chosen, road)
    with _controller(chosen, in_process=in_process, connect=connect) as controller:
        folder = new_folder(output, chosen.name)
        with StatusLine(console) as line:
            run = record_run(chosen, controller, folder, partial(line.show, chosen.name), belief)
    if road is not None:
        store_belief(belief, road)
    console.print(summary_table([(chosen.name, run.summary)]))
    if pictures:
        from egp_service.simulation.report import draw_run

        draw_run(run, folder)
    console.print(f"Results in {folder}")
    if not run.summary.ending.completed:
        raise typer.Exit(NOT_COMPLETED)


def _controller(
    scenario: "Scenario", *, in_process: bool, connect: str | None
) -> "AbstractContextManager[StepController]":
    from egp_service.cli.backends import remote_controller, service_controller
    from egp_service.simulation.in_process import in_process_controller

    if in_process:
        return in_process_controller(scenario)
    return service_controller(scenario) if connect is None else remote_controller(scenario, connect)
