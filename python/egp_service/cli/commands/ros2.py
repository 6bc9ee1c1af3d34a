"""`egp ros2`."""

import math
from contextlib import suppress
from enum import StrEnum
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from egp_service.cli.output import say
from egp_service.control.endpoints import ROS_ROUTER_ENDPOINT
from egp_service.shipped import DEMO_LIBRARY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from egp_service._core import VehicleParameters
    from egp_service.control.step import Step, StepController


class Origin(StrEnum):
    """Where the child frame of the odometry lies."""

    REAR_AXLE = "rear-axle"
    CENTRE = "centre"


def ros2(
    *,
    router: Annotated[
        str | None,
        typer.Option(
            help=f"Endpoint of rmw_zenoh's router. By default {ROS_ROUTER_ENDPOINT}, or with "
            "--zenoh the endpoints of its file."
        ),
    ] = None,
    domain: Annotated[int, typer.Option(min=0, max=232, help="ROS_DOMAIN_ID.")] = 0,
    node: Annotated[str, typer.Option(help="Name of the node.")] = "egp_controller",
    library: Annotated[
        Path, typer.Option("--library", "-l", help="Library of the vehicle.")
    ] = DEMO_LIBRARY,
    vehicle: Annotated[
        Path | None, typer.Option(help="File of the vehicle in place of the library's.")
    ] = None,
    settings: Annotated[
        Path | None, typer.Option(help="Settings of the control step (TOML).")
    ] = None,
    connect: Annotated[
        str | None, typer.Option(help="Endpoint of a service in place of this process.")
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            help="Name of the vehicle for --connect, unique in its fleet; FLEET/NAME if the fleet "
            "is not `default`."
        ),
    ] = None,
    key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Secret key of the vehicle for --connect.")
    ] = None,
    service_zenoh: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Configuration of zenoh (JSON5) for --connect."),
    ] = None,
    odometry: Annotated[
        str, typer.Option(help="Topic, nav_msgs/Odometry.")
    ] = "/localization/kinematic_state",
    path: Annotated[str, typer.Option(help="Topic, nav_msgs/Path.")] = "/planning/path",
    steering: Annotated[
        str | None, typer.Option(help="Topic, autoware_vehicle_msgs/SteeringReport.")
    ] = None,
    ackermann: Annotated[
        str, typer.Option(help="Topic, ackermann_msgs/AckermannDriveStamped; '' for none.")
    ] = "/drive",
    control: Annotated[
        str, typer.Option(help="Topic, autoware_control_msgs/Control; '' for none.")
    ] = "/control/command/control_cmd",
    child_frame: Annotated[
        Origin, typer.Option(help="Where the odometry's child frame lies.")
    ] = Origin.REAR_AXLE,
    friction: Annotated[
        float, typer.Option(min=0.01, max=2.0, help="Friction for which the speed is planned.")
    ] = 0.5,
    grip: Annotated[float, typer.Option(min=0.01, max=1.0, help="Used part of it.")] = 0.8,
    v_max: Annotated[float, typer.Option(min=0.1, max=100.0, help="Largest speed, m/s.")] = 10.0,
    silence: Annotated[
        float, typer.Option(min=0.02, max=2.0, help="Seconds without measurements before a stop.")
    ] = 0.2,
    seconds: Annotated[float | None, typer.Option(help="End after this time.")] = None,
    zenoh: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Configuration of zenoh (JSON5).")
    ] = None,
    autoware_parameters: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the settings that fit Autoware's MPC lateral controller, and end.",
        ),
    ] = None,
) -> None:
    """Drive a vehicle of ROS 2 through rmw_zenoh, without ROS on this machine.

    Odometry and path come in; commands go out in each period as Ackermann drive
    and as Autoware control. `ros2 topic list` shows the topics. Without odometry,
    or reports of --steering, for --silence seconds the vehicle is stopped until
    the command is started again. It stops at the end of an open path
    (docs/ros2.md).

    For example:
      ros2 run rmw_zenoh_cpp rmw_zenohd     (on the vehicle)
      egp ros2 --router tcp/vehicle:7447 --odometry /odom --path /plan
      egp ros2 --autoware-parameters lateral.param.yaml > settings.toml
    """
    from egp_service._core import EgpError, Library
    from egp_service.cli import signals

    if seconds is not None and not 0.0 < seconds < math.inf:
        raise EgpError(f"--seconds is {seconds}: expected a number above 0")
    loaded = Library.load(library)
    if autoware_parameters is not None:
        _write_settings(autoware_parameters, loaded.dt)
        return
    from egp_service.control.certificates import check_zenoh_file
    from egp_service.control.endpoints import check_endpoints, why_unreachable
    from egp_service.ros2.driving import Drive, Vehicle
    from egp_service.ros2.node import Node
    from egp_service.vehicle import read_vehicle

    topics = {"--odometry": odometry, "--path": path}
    if steering is not None:
        topics["--steering"] = steering
    commands = {"--ackermann": ackermann, "--control": control}
    _check_topics(topics | {option: topic for option, topic in commands.items() if topic})
    _check_controller(settings, name, key, in_process=connect is None and service_zenoh is None)
    car = loaded.parameters if vehicle is None else read_vehicle(vehicle)
    drive = Drive(
        vehicle=car,
        to_centre=car.l_r if child_frame is Origin.REAR_AXLE else 0.0,
        friction=friction,
        grip=grip,
        v_max=v_max,
        silence=silence,
        odometry=odometry,
        path=path,
        steering=steering,
        ackermann=ackermann or None,
        control=control or None,
    )
    console = Console(stderr=True, markup=False)
    if router is None and zenoh is None:
        router = ROS_ROUTER_ENDPOINT
    where = f"at the endpoints of {zenoh}" if router is None else router
    check_endpoints([] if router is None else [router])
    check_zenoh_file(zenoh)
    if router is not None and (reason := why_unreachable(router)):
        say(
            console,
            f"No program listens at {router} ({reason}); waiting for rmw_zenoh's router there",
        )
    with (
        _controller(library, settings, car, connect, name, key, service_zenoh) as controller,
        Node(node, domain, router, zenoh) as ros,
    ):
        driven = Vehicle(ros, controller, drive)
        shown = ""
        measured = "odometry" if steering is None else "odometry, steering angle"
        waiting = f"waiting for {measured} and path"

        def observe(step: "Step | None") -> None:
            nonlocal shown
            signals.check()
            mode = waiting if step is None else step.mode
            detail = "" if step is None or step.mode == "normal" else step.detail
            told = ": ".join(text for text in (mode, detail, driven.problem) if text)
            if told != shown:
                shown = told
                # The vehicle is driven on, whether or not the terminal is still there.
                with suppress(OSError):
                    typer.echo(told, err=True)

        console.print(f"Node {node} in domain {domain}, router {where}  (Ctrl-C ends it)")
        driven.run(observe, seconds)


def _check_topics(topics: "Mapping[str, str]") -> None:
    """Check the names of topics, and that no topic has messages of two types."""
    from egp_service._core import EgpError
    from egp_service.ros2.rmw_zenoh import check_topic

    for option, topic in topics.items():
        try:
            check_topic(topic)
        except EgpError as error:
            raise EgpError(f"{option}: {error}") from None
    for (first, topic), (second, other) in combinations(topics.items(), 2):
        if topic == other:
            raise EgpError(
                f"{first} and {second} are both {topic}: each needs a topic of its own, because "
                "their messages have different types"
            )


def _check_controller(
    settings: Path | None, name: str | None, key: Path | None, *, in_process: bool
) -> None:
    """Check that the options of the controller are used."""
    from egp_service.cli.options import check_unused

    if in_process:
        reason = "can be given with --connect or --service-zenoh only"
        check_unused({"--name": name, "--key": key}, reason)
    else:
        reason = "belongs to the service: egp serve --settings"
        check_unused({"--settings": settings}, reason)


def _controller(
    library: Path,
    settings: Path | None,
    car: "VehicleParameters",
    connect: str | None,
    name: str | None,
    key: Path | None,
    zenoh: Path | None,
) -> "StepController":
    from egp_service.cli.settings_file import read_settings
    from egp_service.control.controller import Controller

    if connect is None and zenoh is None:
        stated = {} if settings is None else read_settings(settings)
        return Controller(library, stated, gate=car.gate_limits())
    from egp_service.cli.backends import connected

    return connected(connect, car.gate_limits(), name, zenoh_file=zenoh, key_file=key)


def _write_settings(file: Path, dt: float) -> None:
    """Print settings as TOML, with what they come from and what is left out as comments."""
    from egp_service.control.toml_text import dumps
    from egp_service.ros2.autoware import map_parameters, read_parameters

    mapped = map_parameters(read_parameters(file), dt)
    lines = [f"# {setting}: {source}" for setting, source in mapped.sources.items()]
    lines += [f"# vehicle's file: {name} = {value:.4g}" for name, value in mapped.limits.items()]
    lines += [f"# not mapped: {name}, {why}" for name, why in mapped.ignored.items()]
    typer.echo("\n".join([*lines, dumps(mapped.settings)]), nl=False)
