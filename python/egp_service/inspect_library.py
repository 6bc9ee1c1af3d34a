"""What is inside a library file: `egp inspect`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from rich import box
from rich.console import Console
from rich.table import Table

from egp_service._core import Library

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from egp_service._core import Member

INPUTS: Final = ("v_x m/s", "v_y m/s", "omega rad/s", "delta rad", "F_x N", "delta_dot rad/s")
BODY: Final = ("m kg", "l_f m", "l_r m", "k² m²", "h m", "D_x drive", "D_x brake")
AXLE: Final = ("e drive", "e brake", "D", "B", "C")
OUTPUTS: Final = ("dv_x m/s", "dv_y m/s", "domega rad/s")


def inspect(path: Path, console: Console | None = None) -> None:
    """Print surfaces, sizes, hyperparameters, envelopes and the identity of a library.

    Raises:
        LibraryError: when the file fails a check.
        OSError: when it cannot be read.

    """
    console = console or Console()
    library = Library.load(path)
    console.print(summary(path, library), members(library.members))
    for member in library.members:
        console.print(hyperparameters(member), envelope(member))
        if member.single_track is not None:
            console.print(*vehicle(member.label, member.single_track))


def summary(path: Path, library: Library) -> Table:
    """Return what holds for the whole library."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    rows = {
        "file": f"{path} ({path.stat().st_size / 1e6:.2f} MB)",
        "id": library.id,
        "dt": f"{library.dt:g} s",
        "kernel": library.kernel,
        "vehicle": library.vehicle,
        "parameters": ", ".join(f"{n} = {v:g}" for n, v in library.parameters.fields().items()),
        **library.provenance,
    }
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def members(members: Iterable[Member]) -> Table:
    """Return one row for each surface."""
    table = Table("member", "friction", "points", "dataset", title="Surfaces", box=box.SIMPLE_HEAD)
    for member in members:
        table.add_row(
            member.label, f"{member.friction:g}", str(member.n_points), member.dataset[:12]
        )
    return table


def hyperparameters(member: Member) -> Table:
    """Return one row for each output; a long lengthscale means an input that hardly matters.

    `scale` is the prior standard deviation, `noise` that of the measurement, in output units.
    """
    table = Table(
        "output",
        *(name.split()[0] for name in INPUTS),
        "scale",
        "noise",
        title=f"{member.label}: lengthscales (in standard deviations of the input)",
        box=box.SIMPLE_HEAD,
    )
    values = zip(
        OUTPUTS,
        member.lengthscales,
        member.outputscale,
        member.noise,
        member.noise_std,
        strict=True,
    )
    for output, lengthscales, outputscale, noise, noise_std in values:
        cells = (f"{length:.3g}" for length in lengthscales)
        scale = noise_std * math.sqrt(outputscale / noise)
        table.add_row(output, *cells, f"{scale:.2g}", f"{noise_std:.2g}")
    return table


def vehicle(label: str, parameters: NDArray[np.float64]) -> tuple[Table, Table]:
    """Return the single-track vehicle that the GPs correct: its body, and its axles' tyres."""
    title = f"{label}: the vehicle that the GPs correct"
    body = Table(*BODY, title=title, box=box.SIMPLE_HEAD)
    values = [f"{value:.4g}" for value in parameters]
    body.add_row(*values[: len(BODY)])
    axles = Table("", *AXLE, box=box.SIMPLE_HEAD)
    for number, name in enumerate(("front", "rear")):
        start = len(BODY) + number * len(AXLE)
        axles.add_row(name, *values[start : start + len(AXLE)])
    return body, axles


def envelope(member: Member) -> Table:
    """Return the range of the training inputs."""
    table = Table(
        "", *INPUTS, title=f"{member.label}: envelope of the training inputs", box=box.SIMPLE_HEAD
    )
    for name, bound in zip(("min", "max"), member.envelope, strict=True):
        table.add_row(name, *(f"{value:.4g}" for value in bound))
    return table
