"""Status line of a run in progress."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from rich.live import Live
from rich.text import Text

from egp_service.cli import signals
from egp_service.quantities import V_X

if TYPE_CHECKING:
    from rich.console import Console

    from egp_service.simulation.trace import Period

MODE_STYLES = {"normal": "green", "tail": "yellow", "stop": "bold red", "waiting": "cyan"}
BLOCKS = " ▁▂▃▄▅▆▇█"


class StatusLine:
    """A live line on a terminal; there is no output elsewhere."""

    def __init__(self, console: Console) -> None:
        """Create a line on `console`."""
        self._live = Live(console=console, refresh_per_second=10, transient=True)

    def __enter__(self) -> Self:
        """Show the line."""
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the line."""
        self._live.stop()

    def show(self, label: str, period: Period) -> None:
        """Show a period of the run called `label`; raise what a signal raised, if that was lost."""
        signals.check()
        truth, step = period.truth, period.step
        bars = "".join(BLOCKS[round(w * (len(BLOCKS) - 1))] for w in step.weights)
        line = Text.assemble(
            (f"{label}  ", "bold"),
            f"{truth.time:6.2f} s  {truth.distance:6.1f} m  {truth.x[V_X]:5.1f} m/s  ",
            f"lateral {truth.lateral_error:+.2f} m  μ {truth.friction:.2f}  weights ",
            (bars, "cyan"),
            f"  step {1e3 * step.timings.total:5.1f} ms  ",
            (step.mode, MODE_STYLES[step.mode]),
        )
        line.no_wrap, line.overflow = True, "ellipsis"
        self._live.update(line)
