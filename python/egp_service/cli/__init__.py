"""The command line `egp`. Each command has its own module in `commands`."""

from __future__ import annotations

import sys
from importlib.metadata import version
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.text import Text

from egp_service._core import EgpError
from egp_service.cli import output, signals
from egp_service.cli.commands.collect import collect
from egp_service.cli.commands.demo import demo
from egp_service.cli.commands.doctor import doctor
from egp_service.cli.commands.drive import drive
from egp_service.cli.commands.evaluate import evaluate
from egp_service.cli.commands.fetch import fetch
from egp_service.cli.commands.inspect import inspect
from egp_service.cli.commands.keys import keys
from egp_service.cli.commands.load import load
from egp_service.cli.commands.map import keep_map
from egp_service.cli.commands.monitor import monitor
from egp_service.cli.commands.replay import replay
from egp_service.cli.commands.ros2 import ros2
from egp_service.cli.commands.router import router
from egp_service.cli.commands.serve import serve
from egp_service.cli.commands.settings import settings
from egp_service.cli.commands.sign import sign
from egp_service.cli.commands.simulate import simulate
from egp_service.cli.commands.train import train
from egp_service.cli.commands.vehicle import vehicle
from egp_service.cli.commands.view import view
from egp_service.cli.extras import EXTRAS
from egp_service.cli.programs import PASS_ON

HELP = """
Drive on roads of unknown friction: an ensemble of Gaussian processes inside an MPC.

Demo:
  egp demo

From data to driving:
  egp collect --friction 0.5 -o data/wet.parquet
  egp collect --friction 1.1 -o data/dry.parquet
  egp train data/*.parquet -o library.safetensors
  egp vehicle fit data/*.parquet    (a car of your own)
  egp inspect library.safetensors
  egp drive --library library.safetensors

The paper's experiments, with baselines:
  egp evaluate --quick

Repeat a recorded run, or see what other settings would have changed:
  egp replay runs/RUN/run.mcap

Look at a recorded run on a map and in curves:
  egp view runs/RUN/run.mcap

As a service for vehicles:
  egp serve library.safetensors --listen tcp/0.0.0.0:7447
  egp fetch SHA256 --connect tcp/10.0.0.5:7447 -o library.safetensors

Watch vehicles and replicas in the browser:
  egp monitor

Drive a vehicle of ROS 2 (rmw_zenoh), without ROS on this machine:
  egp ros2

What can be set, and whether this machine is fit:
  egp settings
  egp doctor

What faults of network and replicas do to vehicles:
  egp simulate --seeds 0..100

What a fleet knows about the friction of roads:
  egp map --folder roads
"""
FAILED = 1

app = typer.Typer(
    name="egp",
    help=HELP,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
for command in (
    collect,
    train,
    inspect,
    serve,
    fetch,
    keys,
    sign,
    router,
    drive,
    replay,
    view,
    demo,
    evaluate,
    settings,
    doctor,
    monitor,
    ros2,
):
    app.command(no_args_is_help=False)(command)
app.command("map")(keep_map)
app.add_typer(vehicle, name="vehicle")
app.command("load", context_settings=PASS_ON)(load)
app.command("simulate", context_settings=PASS_ON)(simulate)


def _show_version(asked: bool) -> None:  # noqa: FBT001 - typer's form of a callback
    if asked:
        typer.echo(f"egp-service {version('egp-service')}")
        raise typer.Exit


@app.callback()
def options(
    *,
    show: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Options of `egp` itself."""
    del show


def main() -> None:
    """Run the command line; errors give one line on stderr and an exit code.

    SIGTERM and SIGHUP end a command as an exception does, so that it stops its service and removes
    its temporary files. Servers end with status 0; `egp serve` and `egp map` drain before.
    """
    signals.install()
    output.install()
    output.show_own_warnings()
    try:
        app()
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        _fail(f"{error.name} is not installed; try `pip install 'egp-service[{extra}]'`")
    except EgpError as error:
        _fail(", ".join([str(error), *getattr(error, "__notes__", [])]))
    except OSError as error:
        _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except RuntimeError:
        # Python 3.11 turns the exception of a signal into this one in a few calls, such as
        # `__set_name__`.
        signals.check()
        raise


def _fail(message: str) -> NoReturn:
    console = Console(stderr=True, soft_wrap=True)
    console.print(Text.assemble(("egp: ", "bold red"), message))
    output.discard()
    sys.exit(FAILED)
