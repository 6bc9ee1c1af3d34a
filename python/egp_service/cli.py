"""The command line, `egp`. Each command lives in its own module under `commands`."""

from __future__ import annotations

import sys

import click
import typer
from rich.console import Console

from egp_service._core import EgpError
from egp_service.commands.demo import demo
from egp_service.commands.drive import drive
from egp_service.commands.inspect import inspect
from egp_service.commands.serve import serve

HELP = """
Drive on roads of unknown friction: an ensemble of Gaussian processes inside an MPC.

A first look:
  egp demo

The chain, step by step:
  egp collect --friction 0.5 -o data/wet.parquet
  egp collect --friction 1.1 -o data/dry.parquet
  egp train data/*.parquet -o library.safetensors
  egp inspect library.safetensors
  egp drive --library library.safetensors

As a service for vehicles:
  egp serve library.safetensors --listen tcp/0.0.0.0:7447
"""
# Extras by a package that only they install.
EXTRAS = {
    "torch": "train",
    "gpytorch": "train",
    "botorch": "train",
    "polars": "train",
    "matplotlib": "viz",
}
REFUSED, INTERRUPTED = 1, 130

app = typer.Typer(
    name="egp",
    help=HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (inspect, serve, drive, demo):
    app.command(no_args_is_help=False)(command)


def main() -> None:
    """Run the command line; what goes wrong is one line and an exit code."""
    try:
        code = app(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except (click.Abort, KeyboardInterrupt):
        code = INTERRUPTED
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        code = _fail(f"{error.name} is not installed. Try: pip install 'egp-service[{extra}]'")
    except (EgpError, OSError) as error:
        code = _fail(str(error))
    sys.exit(code)


def _fail(message: str) -> int:
    Console(stderr=True, soft_wrap=True).print(f"[bold red]egp:[/] {message}", highlight=False)
    return REFUSED
