"""Display of a library file: `egp inspect`."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from egp_service._core import Library
from egp_service.cli.tables import narrow_table, vehicle_table
from egp_service.quantities import GP_INPUT, GP_OUTPUT

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from egp_service._core import Member

BODY: Final = ("m kg", "l_f m", "l_r m", "k² m²", "h m", "D_x drive", "D_x brake")
RESISTANCE: Final = ("c_0 m/s²", "c_2 1/m")
AXLE: Final = ("e drive", "e brake", "D", "B", "C")


def inspect(path: Path, console: Console | None = None) -> None:
    """Print surfaces, sizes, hyperparameters, envelopes and the identity of a library.

    Raises:
        LibraryError: if the file fails a check.
        OSError: if it cannot be read.

    """
    console = console or Console()
    library = Library.load(path)
    console.print(summary(path, library), members(library.members))
    for member in library.members:
        console.print(hyperparameters(member), envelope(member))
        for parameters in (member.single_track, member.kinematic):
            if parameters is not None:
                console.print(*vehicle(member.label, parameters, member.resistance))
    for label, fitted in _fitted(library).items():
        console.print(vehicle_table(label, fitted))


def _found(library: Library) -> dict[str, dict[str, dict[str, dict[str, float | bool]]]]:
    """Return what training wrote about each member; empty if there is nothing or other text."""
    try:
        found = json.loads(library.provenance.get("members", "{}"))
    except ValueError:
        return {}
    valid = isinstance(found, dict) and all(isinstance(own, dict) for own in found.values())
    return found if valid else {}


def _fitted(library: Library) -> dict[str, dict[str, dict[str, float | bool]]]:
    """Return the parameters of the members' fitted vehicles, of those members that have one."""
    wanted = {"value", "low", "high", "distance", "determined", "at_bound"}
    vehicles = {label: own["vehicle"] for label, own in _found(library).items() if "vehicle" in own}
    try:
        complete = all(wanted <= row.keys() for own in vehicles.values() for row in own.values())
    except AttributeError:
        return {}
    return vehicles if complete else {}


def _kinds(library: Library) -> dict[str, str]:
    """Return what else training wrote about each member: its kind and the likelihoods of all."""
    return {
        f"{label}, {name}": json.dumps(value, ensure_ascii=False).strip('"')
        for label, own in _found(library).items()
        for name, value in own.items()
        if name != "vehicle"
    }


def summary(path: Path, library: Library) -> Table:
    """Return the properties of the whole library."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    sensors = {}
    if library.measurement_noise is not None:
        sensors["measurement noise"] = ", ".join(f"{std:.2g}" for std in library.measurement_noise)
    if library.measurement_delay is not None:
        sensors["measurement delay"] = f"{library.measurement_delay:.3g} s"
    rows = {
        "file": f"{path} ({path.stat().st_size / 1e6:.2f} MB)",
        "id": library.id,
        "dt": f"{library.dt:g} s",
        "kernel": library.kernel,
        "vehicle": library.vehicle,
        "parameters": ", ".join(f"{n} = {v:g}" for n, v in library.parameters.fields().items()),
        **sensors,
        # The fitted vehicles are shown in tables of their own.
        **{name: text for name, text in library.provenance.items() if name != "members"},
        **_kinds(library),
    }
    for name, value in rows.items():
        table.add_row(escape(name), escape(value))
    return table


def members(members: Iterable[Member]) -> Table:
    """Return a table with a row for each surface."""
    heads = ("member", "friction", "slip bound rad", "points", "dataset")
    table = narrow_table(*heads, wrapped=("member",), title="Surfaces")
    for member in members:
        table.add_row(
            escape(member.label),
            f"{member.friction:g}",
            f"{member.slip_bound:.3f}",
            str(member.n_points),
            member.dataset[:12],
        )
    return table


def hyperparameters(member: Member) -> Table:
    """Return a table with a row for each output.

    Inputs with long lengthscales have little effect. `scale` is the prior standard deviation and
    `noise` that of the noise, in output units.
    """
    title = escape(f"{member.label}: lengthscales (in standard deviations of the input)")
    table = narrow_table("output", *GP_INPUT, "scale", "noise", title=title)
    values = zip(
        (f"{name} {unit}" for name, unit in GP_OUTPUT.items()),
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


def vehicle(
    label: str, parameters: NDArray[np.float64], resistance: NDArray[np.float64] | None
) -> tuple[Table, ...]:
    """Return tables of a member's vehicle: body and, of a single-track vehicle, axles.

    The body of a kinematic vehicle has only the first three of its parameters. A resistance of
    zeros is not shown.
    """
    values = [f"{value:.4g}" for value in parameters]
    heads, cells = [*BODY[: len(values)]], values[: len(BODY)]
    if resistance is not None and resistance.any():
        heads, cells = [*heads, *RESISTANCE], [*cells, *(f"{value:.3g}" for value in resistance)]
    body = narrow_table("", *heads, title=escape(f"{label}: the vehicle"))
    body.add_row("body", *cells)
    if len(values) <= len(BODY):
        return (body,)
    axles = narrow_table("", *AXLE)
    for number, name in enumerate(("front", "rear")):
        start = len(BODY) + number * len(AXLE)
        axles.add_row(name, *values[start : start + len(AXLE)])
    return body, axles


def envelope(member: Member) -> Table:
    """Return a table with the ranges of the training inputs."""
    heads = (f"{name} {unit}" for name, unit in GP_INPUT.items())
    title = escape(f"{member.label}: envelope of the training inputs")
    table = narrow_table("", *heads, title=title)
    for name, bound in zip(("min", "max"), member.envelope, strict=True):
        table.add_row(name, *(f"{value:.4g}" for value in bound))
    return table
