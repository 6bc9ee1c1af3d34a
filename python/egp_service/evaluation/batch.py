"""Parallel work in parts; each result is a line of a file, so that interrupted work can resume."""

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
    """Parts of one kind with unique fingerprints."""

    log: Path
    """File of the results so far, one JSON object per line."""
    parts: Mapping[str, Part]
    work: Callable[[Part], Result]
    """Computes a part's result in another process; it and the parts must be picklable."""
    read: Callable[[dict[str, Any]], Result]
    """Creates a result from its fields; raises `TypeError` for those of another version, or damaged
    ones."""
    report: Callable[[Result], None]
    """Called with each result, first with those in the log."""

    def results(self) -> list[Result]:
        """Return the results of all parts in order; all parts must be finished."""
        known = self._known()
        return [known[mark] for mark in self.parts]

    def resume(self) -> list[str]:
        """Report the known results; return the fingerprints of the missing parts."""
        known = self._known()
        for mark in self.parts:
            if mark in known:
                self.report(known[mark])
        return [mark for mark in self.parts if mark not in known]

    def keep(self, mark: str, result: Result) -> None:
        """Append a result to the log and report it."""
        with self.log.open("a+b") as log:
            if log.tell():
                log.seek(-1, os.SEEK_END)
                if log.read() != b"\n":
                    log.write(b"\n")  # ends a line that an interruption left incomplete
            log.write(json.dumps({"trial": mark, "outcome": asdict(result)}).encode() + b"\n")
        self.report(result)

    def _known(self) -> dict[str, Result]:
        if not self.log.exists():
            return {}
        known = {}
        for line in self.log.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                entry = json.loads(line)
                known[entry["trial"]] = self.read(entry["outcome"])
            except (json.JSONDecodeError, AttributeError, KeyError, TypeError):
                continue
        return known


def finish(
    batches: Iterable[Batch[Any, Any]], jobs: int | None = None, cluster: str | None = None
) -> None:
    """Compute the missing parts of all batches in one pool, so that all processes stay busy.

    An exception of a part ends the computation and gets a note that names the part. Results of
    parts that were finished before are kept.

    Raises:
        EgpError: as for `workers`, and what a part raises.

    """
    missing = [(batch, mark) for batch in batches for mark in batch.resume()]
    if not missing:
        return
    with workers(jobs, cluster) as pool:
        pending = {
            pool.submit(batch.work, batch.parts[mark]): (batch, mark) for batch, mark in missing
        }
        try:
            for future in as_completed(pending):
                batch, mark = pending.pop(future)
                if failure := future.exception():
                    failure.add_note(f"in {batch.parts[mark]}")
                    raise failure
                batch.keep(mark, future.result())
        finally:
            # What was finished while another part failed.
            for future, (batch, mark) in pending.items():
                if future.done() and not future.cancelled() and not future.exception():
                    batch.keep(mark, future.result())
