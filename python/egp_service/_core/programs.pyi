"""Programs that the extension runs as commands of `egp`."""

from collections.abc import Sequence
from pathlib import Path

def run_load(arguments: Sequence[str]) -> int: ...
def run_simulation(library: Path, other: Path, arguments: Sequence[str]) -> int: ...
