"""Work in parts, in parallel; every finished part is a line in a file, to go on from later."""

from __future__ import annotations

import json
import os
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from egp_service.workers import workers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    from _typeshed import DataclassInstance

Part = TypeVar("Part")
Result = TypeVar("Result", bound="DataclassInstance")


@dataclass(frozen=True)
class Batch(Generic[Part, Result]):
    """Parts of one kind, by fingerprints that tell them from all others."""

    log: Path
    """Results so far, a JSON object on each line."""
    parts: Mapping[str, Part]
    work: Callable[[Part], Result]
    """Done in another process, so it and the parts have to be picklable."""
    read: Callable[[dict[str, Any]], Result]
    """Makes a result of its fields; raises `KeyError` or `TypeError` of another version's."""
    report: Callable[[Result], None]
    """Follows the results, first those that are in the log."""

    def results(self) -> list[Result]:
        """Give the results of all parts in their order, once they are finished."""
        known = self._known()
        return [known[mark] for mark in self.parts]

    def resume(self) -> list[str]:
        """Report what is known; gives the fingerprints of what is not."""
        known = self._known()
        for mark in self.parts:
            if mark in known:
                self.report(known[mark])
        return [mark for mark in self.parts if mark not in known]

    def keep(self, mark: str, result: Result) -> None:
        """Write down and report a result."""
        with self.log.open("a+b") as log:
            if log.tell():
                log.seek(-1, os.SEEK_END)
                if log.read() != b"\n":
                    log.write(b"\n")  # after the line that an interruption tore
            log.write(json.dumps({"trial": mark, "outcome": asdict(result)}).encode() + b"\n")
        self.report(result)

    def _known(self) -> dict[str, Result]:
        if not self.log.exists():
            return {}
        known = {}
        for line in self.log.read_text(encoding="utf-8").splitlines():
            try:
                entry = json.loads(line)
                known[entry["trial"]] = self.read(entry["outcome"])
            except (json.JSONDecodeError, KeyError, TypeError):
                continue
        return known


def finish(
    batches: Iterable[Batch[Any, Any]], jobs: int | None = None, cluster: str | None = None
) -> None:
    """Do what is missing of all batches in one go, so that no process waits at the end of each."""
    missing = [(batch, mark) for batch in batches for mark in batch.resume()]
    if not missing:
        return
    with workers(jobs, cluster) as pool:
        pending = {
            pool.submit(batch.work, batch.parts[mark]): (batch, mark) for batch, mark in missing
        }
        for future in as_completed(pending):
            batch, mark = pending[future]
            batch.keep(mark, future.result())
