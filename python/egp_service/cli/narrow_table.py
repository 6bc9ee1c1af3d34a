"""Tables that stay readable in a terminal of fewer than 80 columns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from rich.padding import Padding
from rich.table import Table

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

_COLUMNS: Final = 80


class NarrowTable(Table):
    """A table for 80 columns; a narrower terminal shows each row as a paragraph.

    The first cell of a row is the paragraph's heading, and the others follow their headers. Cells
    are text.
    """

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Give the table or its paragraphs, as wide as `options` allow."""
        if options.max_width >= _COLUMNS:
            yield from super().__rich_console__(console, options)
            return
        yield from (text for text in (self.title, "") if text is not None)
        heads = [" ".join(str(column.header).split()) for column in self.columns]
        for row in zip(*(column.cells for column in self.columns), strict=True):
            for number, (head, cell) in enumerate(zip(heads, map(str, row), strict=True)):
                if cell:
                    text = f"{head}: {cell}" if head and number else cell
                    yield Padding(text, (0, 0, 0, 2 if number else 0))
        yield from (text for text in ("", self.caption) if text is not None)
