"""Status line of a run in progress."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.live import Live
from rich.text import Text

from egp_service.cli import signals
from egp_service.quantities import V_X

if TYPE_CHECKING:
    from rich.console import Console

    from egp_service.simulation.trace import Period

MODE_STYLES = {"normal": "green", "tail": "yellow", "stop": "bold red", "waiting": "cyan"}
BLOCKS = " ▁▂▃▄▅▆▇█"
GAP = "  "


class StatusLine(Live):
    """A live line on a terminal; there is no output elsewhere."""

    def __init__(self, console: Console) -> None:
        """Create a line on `console`, which is there within the context of this object."""
        super().__init__(console=console, refresh_per_second=10, transient=True)

    def show(self, label: str, period: Period) -> None:
        """Show a period of the run called `label`; raise what a signal raised, if that was lost."""
        signals.check()
        self.update(status_text(label, period, self.console.width))


def status_text(label: str, period: Period, columns: int) -> Text:
    """Return what fits of a period into this number of columns, the most important things first."""
    truth, step = period.truth, period.step
    bars = "".join(BLOCKS[round(w * (len(BLOCKS) - 1))] for w in step.weights)
    parts = (
        (f"{step.mode:6}", MODE_STYLES[step.mode]),
        (f"{truth.time:5.1f} s", ""),
        (f"{truth.distance:4.0f} m", ""),
        (f"{truth.x[V_X]:4.1f} m/s", ""),
        (f"lateral {truth.lateral_error:+.2f} m", ""),
        (f"μ {truth.friction:.2f}", ""),
        (bars, "cyan"),  # the weights
        (label, "bold"),
        (f"step {1e3 * step.timings.total:3.0f} ms", ""),
    )
    line = Text(no_wrap=True)
    for part, style in parts:
        gap = GAP if line else ""
        if line.cell_len + cell_len(gap + part) <= columns:
            line.append(gap).append(part, style)
    return line
