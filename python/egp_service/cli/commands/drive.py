"""`egp drive`."""

import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from egp_service.cli.options import NOT_COMPLETED, RunsFolder, check_writable, fleet_and_name
from egp_service.cli.output import say

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from egp_service._core import RoadBelief
    from egp_service.control.step import StepController
    from egp_service.simulation.scenario import Scenario
    from egp_service.simulation.summary import Summary
    from egp_service.simulation.trace import Period


def drive(
    scenario: Annotated[
        str, typer.Option("--scenario", "-s", help="Name of a built-in scenario, or a TOML file.")
    ] = "rounded-rectangle",
    library: Annotated[
        Path | None,
        typer.Option(
            "--library",
            "-l",
            help="Library in place of the scenario's; built-in scenarios have a shipped one.",
        ),
    ] = None,
    *,
    in_process: Annotated[
        bool, typer.Option("--in-process", help="Compute in this process, not in a service.")
    ] = False,
    connect: Annotated[
        str | None, typer.Option(help="Endpoint of a running service, such as tcp/127.0.0.1:7447.")
    ] = None,
    zenoh: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Configuration of zenoh (JSON5) for --connect, --fleet and --monitor, with TLS "
            "and keys. Without --connect the service is at its endpoints, unless --in-process.",
        ),
    ] = None,
    plant: Annotated[
        str | None,
        typer.Option(metavar="MODULE:CLASS", help="Your simulator in place of the built-in car."),
    ] = None,
    key: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Secret key of the car for --connect, made by `egp keys`."
        ),
    ] = None,
    traces: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File to which the spans of the steps are appended, for --connect "
            "(docs/deploying.md).",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed in place of the scenario's.")] = None,
    road: Annotated[
        Path | None,
        typer.Option(
            help="File of what is known about the road's friction; read, then updated. It ages: "
            "after half an hour a third of its information is left."
        ),
    ] = None,
    fleet: Annotated[
        str | None,
        typer.Option(help="Endpoint of a map service (`egp map`), such as tcp/127.0.0.1:7448."),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Name of the car, unique in its fleet; FLEET/NAME if the fleet is not `default`.",
        ),
    ] = None,
    monitor: Annotated[
        str | None,
        typer.Option(help="Endpoint of a live page (`egp monitor`), such as tcp/127.0.0.1:7450."),
    ] = None,
    output: RunsFolder = Path("runs"),
    pictures: Annotated[bool, typer.Option(help="Draw pictures at the end.")] = True,
) -> None:
    """Drive a simulated car; results go to runs/<time>-<scenario>/.

    By default a service in its own process computes the control steps; see
    --in-process and --connect.

    A class for --plant takes no arguments and has reset(x), which puts the car
    into a state, step(u, dt, friction), which drives dt seconds, and state, the
    present one. A state is (p_x, p_y, v_x, psi, v_y, omega, delta) in m, m/s and
    rad, and u is (force in N, steering rate in rad/s). docs/simulator.md has an
    example, and `help(egp_service.simulation.plant.Simulator)` the same contract.

    For example:
      egp drive
      egp drive -s lane-change --library library.safetensors
      egp drive -s my-scenario.toml --in-process
      egp drive --plant my_simulator:Car
      egp drive -s random --road random.road    (and once more: faster)
      egp drive -s random --fleet tcp/127.0.0.1:7448 --vehicle car-2
      egp drive --monitor tcp/127.0.0.1:7450    (with `egp monitor` running)
    """
    from egp_service.cli.publication import publication
    from egp_service.cli.signals import naming_folder
    from egp_service.cli.status_line import StatusLine
    from egp_service.simulation.reference import load_belief, store_belief
    from egp_service.simulation.runs import new_folder, record_run

    if pictures:  # a missing package is an error before the drive
        from egp_service.simulation.report import draw_run
    console = Console()
    chosen = _chosen(scenario, library, plant, seed)
    _check_use(vehicle, connect, zenoh, fleet, monitor, in_process=in_process)
    _warn(console, chosen, seed)
    belief = load_belief(chosen, road)
    if road is not None:
        say(console, _road_age(road))
    with (
        _fleet_map(console, chosen, belief, fleet, vehicle, zenoh) as exchange,
        _controller(
            chosen,
            scenario,
            in_process=in_process,
            connect=connect,
            vehicle=vehicle,
            zenoh=zenoh,
            key=key,
            traces=traces,
        ) as controller,
        publication(
            chosen,
            controller,
            monitor,
            vehicle=vehicle,
            zenoh_file=zenoh,
            console=console,
        ) as publish,
    ):
        if connect or (zenoh and not in_process):
            _show_differences(console, chosen, controller)
        if road is not None:
            check_writable(road)
        folder = new_folder(output, chosen.name)
        try:
            with naming_folder(console, folder), StatusLine(console) as line:

                def observe(period: "Period") -> None:
                    line.show(chosen.name, period)
                    exchange()
                    publish(period)

                run = record_run(chosen, controller, folder, observe, belief)
        finally:
            if road is not None:
                store_belief(belief, road)
    with naming_folder(console, folder):
        _show(console, run.summary)
        if pictures:
            with console.status("Drawing ..."):
                draw_run(run, folder)
    console.print(f"Results in {folder}", markup=False)
    if not run.summary.ending.completed:
        raise typer.Exit(NOT_COMPLETED)


def _chosen(name: str, library: Path | None, plant: str | None, seed: int | None) -> "Scenario":
    """Return the scenario of a name or file with what the options state in place of its own.

    What would keep it from being driven is an error here, before the run has a folder.
    """
    from egp_service.simulation.course import build_path, build_profile
    from egp_service.simulation.plant import load_simulator
    from egp_service.simulation.scenario import check_scenario, load_scenario
    from egp_service.simulation.scenario_checks import check_seed, check_told

    chosen = load_scenario(name)
    if library is not None:
        chosen = replace(chosen, library=str(library.absolute()))
    if plant is not None:
        chosen = replace(chosen, plant=plant, plant_folder=None)
    if seed is not None:
        check_seed(seed, "--seed")
        chosen = replace(chosen, seed=seed)
    check_scenario(chosen, name)
    check_told(chosen, name)
    if chosen.plant is not None:
        load_simulator(chosen.plant, chosen.plant_folder)
    build_profile(chosen, build_path(chosen, name))
    return chosen


def _road_age(road: Path) -> str:
    """Say how old the evidence about the road is that a file holds."""
    if not road.exists():
        return f"{road} is new: nothing is known about the road yet"
    age = max(0.0, time.time() - road.stat().st_mtime)
    return f"{road} holds what earlier drives found; the last one ended {age:.0f} s ago"


def _warn(console: Console, scenario: "Scenario", seed: int | None) -> None:
    """Say what of a scenario, or of the seed in place of its own, is probably a mistake."""
    from egp_service.simulation.course import narrow_place, tight_place
    from egp_service.simulation.scenario import Measurement

    drawn = scenario.track.kind == "random" and "seed" not in scenario.track.parameters
    unused = (
        f"--seed has no effect: {scenario.name} has neither measurement noise nor a track that the "
        "seed determines"
        if seed is not None and not drawn and scenario.measurement == Measurement()
        else None
    )
    for warning in (narrow_place(scenario), tight_place(scenario), unused):
        if warning is not None:
            say(console, warning)


@contextmanager
def _controller(
    scenario: "Scenario",
    origin: str,
    *,
    in_process: bool,
    connect: str | None,
    vehicle: str | None,
    zenoh: Path | None,
    key: Path | None,
    traces: Path | None,
) -> "Iterator[StepController]":
    """Give the controller; an error of its gate names where the scenario comes from."""
    from egp_service._core import EgpError
    from egp_service.cli.backends import remote_controller, service_controller
    from egp_service.simulation.in_process import in_process_controller

    alone = connect is None and zenoh is None
    if in_process or alone:
        for option, value in (("--key", key), ("--traces", traces)):
            if value is not None:
                where = "with --in-process" if in_process else "without --connect or --zenoh"
                raise EgpError(f"{option} has no use {where}")
    controller: StepController
    with ExitStack() as stack:
        try:
            if in_process:
                controller = stack.enter_context(in_process_controller(scenario))
            elif alone:
                controller = stack.enter_context(service_controller(scenario))
            else:
                remote = remote_controller(
                    scenario, connect, vehicle, zenoh_file=zenoh, key_file=key, traces=traces
                )
                controller = stack.enter_context(remote)
        except EgpError as error:
            if scenario.gate and "gate" in str(error):
                error.add_note(f"in [gate] of {origin}")
            raise
        yield controller


def _check_use(
    vehicle: str | None,
    connect: str | None,
    zenoh: Path | None,
    fleet: str | None,
    monitor: str | None,
    *,
    in_process: bool,
) -> None:
    """Check that the car's name and the configuration of zenoh are used."""
    from egp_service._core import EgpError

    if in_process and connect is not None:
        raise EgpError("--in-process excludes --connect")
    if in_process and zenoh is not None and not (fleet or monitor):
        raise EgpError("--zenoh has no use with --in-process unless --fleet or --monitor is given")
    if vehicle is not None and not any((connect, zenoh, fleet, monitor)):
        raise EgpError("--vehicle has no use without --connect, --zenoh, --fleet or --monitor")


def _show_differences(console: Console, scenario: "Scenario", controller: "StepController") -> None:
    """Say what a service that was not started here has in place of the scenario's."""
    if controller.library_file is None:
        own = controller.library.hex()[:12]
        say(console, f"The service has library {own}…, not the scenario's ({scenario.library}).")
    if scenario.control:
        names = ", ".join(scenario.control)
        say(console, f"The service has its own settings, not the scenario's [control]: {names}.")


def _show(console: Console, summary: "Summary") -> None:
    from egp_service.cli.tables import misfit, no_plan, summary_table, why_ended

    console.print(summary_table([(summary.scenario, summary)]))
    for text in (why_ended(summary), no_plan(summary), misfit(summary)):
        if text is not None:
            say(console, text)


@contextmanager
def _fleet_map(
    console: Console,
    scenario: "Scenario",
    belief: "RoadBelief",
    endpoint: str | None,
    vehicle: str | None,
    zenoh: Path | None,
) -> "Iterator[Callable[[], None]]":
    """Give what to call in each period, and say at the end what the map contributed."""
    from egp_service._core import EgpError
    from egp_service.simulation.course import road_name
    from egp_service.simulation.scenario_checks import ScenarioError, why_unused

    if endpoint is None:
        yield lambda: None
        return
    if vehicle is None:
        raise EgpError("--fleet needs the car's name: give --vehicle")
    if reason := why_unused(scenario.speed):
        raise ScenarioError(f"{scenario.name}: --fleet has no effect while {reason}")
    from egp_service.cli.tables import map_summary
    from egp_service.control.fleet_map import FleetMap

    fleet, name = fleet_and_name(vehicle)
    with FleetMap(
        endpoint, belief, road=road_name(scenario), vehicle=name, fleet=fleet, zenoh_file=zenoh
    ) as shared:
        if not shared.fetch():
            console.print(
                f"No map service answers at {endpoint}; start one with `egp map`", markup=False
            )
        yield shared.exchange
    console.print(
        map_summary(shared.origins, belief.trust)
        if shared.answered
        else f"No map service has answered at {endpoint}, so that the fleet's map was not used",
        markup=False,
    )
    if shared.answered and shared.unsent:
        reason = "no longer answers" if shared.silent else "did not accept all evidence"
        console.print(
            f"The map service at {endpoint} {reason}: the evidence about {shared.unsent} tiles of "
            "128 m was not sent",
            markup=False,
        )
