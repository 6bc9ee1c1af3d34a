"""Where a dataset comes from: period, vehicle, surface, and what made it."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

from egp_service._core import EgpError

_PERIODS: Final = (1e-3, 1.0)  # s, the shortest and the longest that a library may have
_LONGEST_LABEL: Final = 64  # characters of a surface's name


def _check_label(surface: str) -> None:
    """Check the name of a surface, which is also the label of a member of a library."""
    if not surface:
        raise EgpError("the surface label is empty: name the surface, for example 'wet'")
    if len(surface) > _LONGEST_LABEL:
        raise EgpError(
            f"the surface label {surface[:_LONGEST_LABEL]!r}… has {len(surface)} characters: "
            f"expected at most {_LONGEST_LABEL}"
        )
    if not surface.isprintable():
        raise EgpError(
            f"the surface label {surface!r} has a control character or one that is not UTF-8: "
            "expected one line of text, for example 'wet'"
        )


@dataclasses.dataclass(frozen=True)
class Provenance:
    """Origin of a dataset, stored as JSON in the Parquet key-value metadata.

    `friction` is the surface's nominal coefficient. It labels the member; training does not use it.
    `force_from_a_x` says that `F_x` is an assumed mass times an acceleration of a log, so that the
    data do not tell the mass; files of older versions do not state it.
    """

    dt: float
    vehicle: str
    surface: str
    friction: float
    seed: int
    method: str
    tool: str
    force_from_a_x: bool = False

    def __post_init__(self) -> None:
        """Check the ranges of the values."""
        if not (_PERIODS[0] <= self.dt <= _PERIODS[1]):
            raise EgpError(f"dt is {self.dt} s: expected a period of 0.001 to 1 s")
        if not (0.0 < self.friction <= 3.0):  # noqa: PLR2004 - as for surfaces
            raise EgpError(
                f"friction is {self.friction}: expected a coefficient above 0 and at most 3"
            )
        for name in ("vehicle", "surface", "method", "tool"):
            if not isinstance(value := getattr(self, name), str):
                raise EgpError(f"{name} is {value!r}: expected a text")
        _check_label(self.surface)

    def metadata(self) -> dict[str, Any]:
        """Return the fields for a file; `force_from_a_x` only if true, for older versions."""
        fields = dataclasses.asdict(self)
        if not self.force_from_a_x:
            del fields["force_from_a_x"]
        return fields
