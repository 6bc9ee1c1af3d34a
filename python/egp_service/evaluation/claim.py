"""A claim about the controller, and what the outcomes say of it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim and whether the outcomes support it; `holds` is None if no outcome concerns it."""

    text: str
    holds: bool | None
    evidence: str
