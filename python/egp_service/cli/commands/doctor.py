"""`egp doctor`."""

from pathlib import Path
from typing import Annotated

import typer


def doctor(
    library: Annotated[
        Path | None,
        typer.Argument(help="Library to check; by default the shipped one.", show_default=False),
    ] = None,
) -> None:
    """Check this machine and a library, and say what to do about what is wrong.

    Checked are processor and vector instructions, clock and timer, extras,
    ports, a zenoh session, and the library: that its numbers agree with its
    seal and its stored predictions, and the time of a control step within its
    period. The exit code is 1 if something fails; `warn` marks what works with
    restrictions.

    For example:
      egp doctor
      egp doctor library.safetensors
    """
    from rich import box
    from rich.console import Console
    from rich.markup import escape

    from egp_service.cli.checks import run_checks
    from egp_service.cli.narrow_table import NarrowTable

    colours = {"ok": "green", "warn": "yellow", "fail": "red"}
    table = NarrowTable(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("check", no_wrap=True)
    table.add_column("")
    table.add_column("found, and what to do", ratio=1)
    console = Console()
    results = run_checks(library)
    for check in results:
        advice = f"\n→ {check.advice}" if check.advice else ""
        text = escape(check.found + advice)
        table.add_row(check.name, f"[{colours[check.verdict]}]{check.verdict}[/]", text)
    console.print(table)
    if any(check.verdict == "fail" for check in results):
        raise typer.Exit(1)
