"""Every setting with its default, unit and meaning, read from the document of the settings."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from egp_service._core import SETTINGS_DOCUMENT

if TYPE_CHECKING:
    from collections.abc import Iterator

_SECTION: Final = re.compile(r"^## (\d+)\. (.+)$")
_SUBSECTION: Final = re.compile(r"^### (.+)$")
# LaTeX of the document and the text for a terminal.
_MATH: Final = {
    r"\lVert": "‖",
    r"\rVert": "‖",
    r"\lvert": "|",
    r"\rvert": "|",
    r"\lambda": "λ",
    r"\alpha": "α",  # noqa: RUF001
    r"\omega": "ω",
    r"\delta": "δ",
    r"\dot": "d/dt ",
    r"\le": "≤",
    "^2": "²",
    "{": "",
    "}": "",
}


@dataclass(frozen=True, slots=True)
class Setting:
    """One row of the document."""

    number: int
    """Number of the section, by which the texts of `meaning` refer to it."""
    section: str
    group: str
    """Heading within the section; empty if there is none."""
    key: str
    default: str
    unit: str
    meaning: str


def read_settings_document() -> Iterator[Setting]:
    """Give the settings in the document's order."""
    number, section, group = 0, "", ""
    for line in SETTINGS_DOCUMENT.splitlines():
        if found := _SECTION.match(line):
            number, section, group = int(found[1]), found[2], ""
        elif found := _SUBSECTION.match(line):
            group = found[1].partition(",")[0]
        elif line.startswith("| `"):
            cells = line.strip().strip("|").split("|")
            key, default, unit, meaning, *_ = map(str.strip, cells)
            texts = map(_plain, (default, unit, meaning))
            yield Setting(number, section, group, key.strip("`"), *texts)


def _plain(text: str) -> str:
    """Remove the marks of Markdown and LaTeX."""

    def math(found: re.Match[str]) -> str:
        inner = found[1]
        for symbol, plain in _MATH.items():
            inner = inner.replace(symbol, plain)
        return inner

    text = re.sub(r"\$([^$]*)\$", math, text)
    text = re.sub(r"\[([^\]]*\.md)\]\([^)]*\)", r"docs/\1", text)
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).replace("`", "")
