"""What `egp replay` says."""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from egp_service._core import vector_instructions
from egp_service.control.replay import MATTERS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from egp_service.control.recorded import Recorded
    from egp_service.control.replay import Answer, Replay


def heading(path: Path, recorded: Recorded) -> str:
    """Say what was recorded."""
    about = recorded.about
    text = (
        f"{path}: {len(recorded.steps)} control steps with library {about['library'][:12]}… "
        f"({', '.join(recorded.members)}), {_recorded_by(recorded)}"
    )
    if recorded.missing:
        text += f"\n{recorded.missing}"
    return text


def _recorded_by(recorded: Recorded) -> str:
    """Name the version and the vector instructions, which recordings of other programs may lack."""
    program, instructions = (
        recorded.about.get(key, "not stated") for key in ("version", "vector_instructions")
    )
    return f"egp-service {program} with vector instructions {instructions}"


def outcome(
    recorded: Recorded, replay: Replay, used: Mapping[str, object], *, changed: bool
) -> list[str]:
    """Say whether the replies are the same, and where they first differ."""
    n = len(replay.same)
    lines = []
    if recorded.settings is None and not used:
        lines.append(
            "The recording does not hold the service's settings, so defaults are used; "
            "give the service's with --settings."
        )
    if replay.unanswered:
        lines.append(f"{replay.unanswered} requests had no reply and are left out.")
    if changed and recorded.settings is not None:
        before, after = _flat(recorded.settings), _flat(used)
        lines += [
            f"{key}: {before.get(key, 'not set')} → {value}"
            for key, value in after.items()
            if before.get(key) != value
        ]
    if replay.first_different is None:
        return [*lines, f"All {n} replies have the same bytes as recorded."]
    lines.append(f"{int((~replay.same).sum())} of {n} replies differ.")
    if not changed:
        lines.append(
            f"Recorded by {_recorded_by(recorded)}; this is {version('egp-service')} with "
            f"{vector_instructions()}."
        )
    lines.append(f"First difference: {_place(replay, replay.first_different)}")
    first = replay.first_that_matters
    if first is None:
        largest = 100.0 * float(replay.share.max())
        lines.append(
            f"No command differs by more than {100 * MATTERS:g} % of an actuator's range; "
            f"the largest difference is {largest:.2g} %."
        )
        return lines
    matter = int((replay.share > MATTERS).sum())
    lines.append(
        f"First difference of more than {100 * MATTERS:g} % of an actuator's range "
        f"(in {matter} steps): {_place(replay, first)}"
    )
    if lone := int(np.isinf(replay.share).sum()):
        lines.append(f"In {lone} steps only one of the two has a plan.")
    compared = np.where(np.isfinite(replay.share), replay.share, 0.0)
    if compared.any():
        lines.append(f"Largest difference: {_place(replay, int(np.argmax(compared)))}")
    return lines


def _place(replay: Replay, i: int) -> str:
    p_x, p_y, v_x, *_ = replay.x[i]
    return (
        f"step {i + 1} at {replay.time[i]:.2f} s, position ({p_x:.1f}, {p_y:.1f}) m, "
        f"{v_x:.1f} m/s\n  recorded: {_text(replay.recorded[i])}\n  replayed: "
        f"{_text(replay.now[i])}"
    )


def _text(answer: Answer) -> str:
    if not np.isfinite(answer.u).all():
        return answer.status
    weights = ", ".join(f"{weight:.2f}" for weight in answer.weights)
    return f"{answer.status}, {answer.u[0]:.0f} N, {answer.u[1]:+.4f} rad/s, weights ({weights})"


def _flat(table: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    values: dict[str, object] = {}
    for key, value in table.items():
        inner = (
            _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
        )
        values |= inner
    return values
