"""A claim about the controller, and what the outcomes say of it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim and whether the outcomes support it; None if they do not have what it is about."""

    text: str
    holds: bool | None
    evidence: str
