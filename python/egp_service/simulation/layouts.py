"""Layouts for Foxglove and PlotJuggler, written beside the recording of a run."""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree as ET

from egp_service.files import write_text

if TYPE_CHECKING:
    from pathlib import Path

_PACKAGE = resources.files("egp_service.simulation")
_WEIGHTS: Final = ".//DockArea[@name='Weights of the members']/plot"
_COLOURS: Final = ("#1f2937", "#c2410c", "#4ba3c7", "#6a994e", "#7c3aed", "#b45309")


def write_layouts(folder: Path, members: int) -> None:
    """Write `foxglove.json` and `plotjuggler.xml` for `run.mcap` of a library with so many members.

    PlotJuggler warns of each curve that a recording lacks, so its layout names just the weights
    that there are; Foxglove's names four.
    """
    foxglove = (_PACKAGE / "foxglove.json").read_text(encoding="utf-8")
    write_text(folder / "foxglove.json", foxglove)
    root = ET.fromstring((_PACKAGE / "plotjuggler.xml").read_text(encoding="utf-8"))  # noqa: S314 - ours
    for plot in root.iterfind(_WEIGHTS):
        for i in range(members):
            colour = _COLOURS[i % len(_COLOURS)]
            ET.SubElement(plot, "curve", name=f"/step/weights[{i}]", color=colour)
    ET.indent(root, " ")
    text = ET.tostring(root, encoding="utf-8", xml_declaration=True).decode()
    write_text(folder / "plotjuggler.xml", text + "\n")
