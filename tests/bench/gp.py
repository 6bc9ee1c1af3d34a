"""Mean and Jacobian of a member of 700 points at the 20 queries of a horizon, by several programs.

Errors are against the textbook sums in extended precision, in standard deviations of the output
(for the Jacobian, a change of each input by its standard deviation).
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from circle import POINTS, make_members, write
from gp_numba import compiled
from phases import median
from rich.table import Table
from timing import clock, microseconds, percentiles

from egp_service._core import Library
from egp_service.evaluation.paper_stack import Member, read_tensors
from library_example import CENTRE, HALF_WIDTH

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray
    from rich.console import Console

    Array = NDArray[Any]
    Answer = tuple[Array, Array]

QUERIES = 20
ALL = (0, 1, 2)


@dataclass
class Row:
    """One program: seconds of a whole call, and its errors."""

    name: str
    outputs: int
    seconds: list[float]
    mean_error: float
    jacobian_error: float


class Textbook:
    """Sums over the training points, vectorised over queries, in the precision of `dtype`."""

    def __init__(self, path: Path, dtype: type = np.float64) -> None:
        """Take the first member's tensors."""
        tensors = read_tensors(path)
        names = ("inputs", "input_std", "lengthscales", "outputscale", "alpha", "constant")
        taken: list[Array] = [tensors[f"members.0.{name}"].astype(dtype) for name in names]
        self.x, std, lengthscales, self.prior, self.alpha, self.constant = taken
        self.lengths = lengthscales * std
        self.input_std = std
        self.target_mean: Array = tensors["members.0.target_mean"].astype(dtype)
        self.target_std: Array = tensors["members.0.target_std"].astype(dtype)

    def __call__(self, z: Array, outputs: Sequence[int] = ALL) -> Answer:
        """Mean (n, o) and Jacobian (n, o, 6); the moments of the weights spare (n, M, 6) arrays."""
        means, jacobians = [], []
        for o in outputs:
            a, b = z / self.lengths[o], self.x / self.lengths[o]
            squares = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2.0 * a @ b.T
            weights = self.prior[o] * np.exp(-0.5 * squares) * self.alpha[o]
            total = weights.sum(axis=1)
            means.append(self.target_mean[o] + self.target_std[o] * (self.constant[o] + total))
            slopes = (weights @ b - total[:, None] * a) / self.lengths[o]
            jacobians.append(self.target_std[o] * slopes)
        return np.stack(means, axis=1), np.stack(jacobians, axis=1)


def errors(book: Textbook, truth: Answer, answer: Answer, outputs: Sequence[int]) -> list[float]:
    """Return the worst error of the mean and of the Jacobian, in standard deviations."""
    scale = book.target_std[list(outputs)]
    mean, jacobian = (a - t[:, list(outputs)] for a, t in zip(answer, truth, strict=True))
    scaled = jacobian * book.input_std / scale[:, None]
    return [float(np.abs(mean / scale).max()), float(np.abs(scaled).max())]


def rivals(path: Path) -> dict[str, Callable[[Array, Sequence[int]], Answer]]:
    """Return the programs that take queries (n, 6) and outputs."""
    library, book = Library.load(path), Textbook(path)
    torch_member = Member(library, read_tensors(path), 0)

    def ours(z: Array, _: Sequence[int]) -> Answer:
        mean, jacobian, _variance = library.predict(z)
        return mean, jacobian

    found: dict[str, Callable[[Array, Sequence[int]], Answer]] = {
        "ours from Python, with variance": ours,
        "numpy": book,
        "GPyTorch, autograd": torch_member.mean_jacobian,
    }
    with_numba = compiled(book)
    if with_numba is not None:
        found["numba"] = with_numba
    return found


def compare(console: Console, picture: Path, repeats: int) -> None:
    """Measure, print and draw."""
    rng = np.random.default_rng(1)
    z = CENTRE + HALF_WIDTH * rng.uniform(-1.0, 1.0, (QUERIES, 6))
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "library.safetensors"
        write(path, make_members(1, lambda: None))
        book = Textbook(path)
        truth = Textbook(path, np.longdouble)(z)
        for name, program in rivals(path).items():
            for outputs in (ALL,) if name.startswith("ours") else ((0,), ALL):
                found = errors(book, truth, program(z, outputs), outputs)
                seconds = clock(partial(program, z, outputs), repeats)
                rows.append(Row(name, len(outputs), seconds, *found))
    ours = rows[0]
    single = median("gp/mean_jacobian/rbf 700")
    if single is None:
        console.print("ours: no numbers of criterion yet; run `cargo bench -p egp-bench` first")
    else:
        for count in (3, 1):  # the outputs cost the same
            seconds = [single[0] * QUERIES * count / 3 / 1e6]
            name = "ours (criterion's median)"
            rows.insert(0, Row(name, count, seconds, ours.mean_error, ours.jacobian_error))
    show(console, rows)
    if not any(row.name == "numba" for row in rows):
        console.print("numba is not installed and left out; `pip install numba` adds it")
    draw(rows, picture)
    console.print(f"picture: {picture}")


def show(console: Console, rows: list[Row]) -> None:
    """Print the table; ratios are to ours of as many outputs."""
    table = Table(title=f"Mean and Jacobian, {POINTS} points, {QUERIES} queries a call, us")
    for column in ("", "outputs", "p50", "p95", "p99", "a query", "ours x", "mean", "Jacobian"):
        table.add_column(column, justify="right" if column else "left")
    best = {row.outputs: percentiles(row.seconds)[0] for row in rows[::-1] if "ours" in row.name}
    for row in rows:
        p50 = percentiles(row.seconds)[0]
        spread = microseconds(row.seconds)
        table.add_row(
            row.name,
            str(row.outputs),
            *(spread if len(row.seconds) > 1 else [spread[0], "", ""]),
            f"{p50 / QUERIES:.1f}",
            f"{p50 / best[row.outputs]:.1f}x" if row.outputs in best else "",
            f"{row.mean_error:.0e}",
            f"{row.jacobian_error:.0e}",
        )
    console.print(table)


def draw(rows: list[Row], picture: Path) -> None:
    """Draw the median of each program, all outputs."""
    from matplotlib import pyplot as plt  # noqa: PLC0415

    shown = [row for row in rows if row.outputs == len(ALL)][::-1]
    figure, axes = plt.subplots(figsize=(6.5, 2.8), layout="constrained")
    times = [percentiles(row.seconds)[0] / QUERIES for row in shown]
    colours = ["tab:blue" if "ours" in row.name else "tab:grey" for row in shown]
    bars = axes.barh([row.name for row in shown], times, color=colours)
    axes.bar_label(bars, fmt="%.1f", padding=3)
    axes.set_xscale("log")
    axes.set_xlabel("three outputs, a query [us]: median")
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=150)
    plt.close(figure)
