"""Messages and keys of a fleet's map, as docs/map.md states them and not by the code under test."""

from __future__ import annotations

from egp_service.control.messages import message_class


def tile_key(vehicle: str, index: int, *, fleet: str = "depot", road: str = "ring") -> str:
    """Key to which a vehicle sends what it measured in a tile."""
    return f"egp/v1/map/{fleet}/{vehicle}/{road}/tile/{index}"


def tiles_key(vehicle: str, *, fleet: str = "depot", road: str = "ring") -> str:
    """Key on which a vehicle asks for all tiles."""
    return f"egp/v1/map/{fleet}/{vehicle}/{road}/tiles/0"


def changed_key(*, fleet: str = "depot", road: str = "ring") -> str:
    """Key on which the service publishes which tiles have new evidence."""
    return f"egp/v1/@map/{fleet}/{road}"


def changed(tiles: list[int]) -> bytes:
    """Bytes of a TilesChanged."""
    encoded: bytes = message_class("TilesChanged")(version=1, tiles=tiles).SerializeToString()
    return encoded


def evidence(tile: bytes, age: float) -> bytes:
    """Bytes of a TileEvidence of this age in s."""
    message = message_class("TileEvidence")(version=1, age_ms=round(1e3 * age), rows=tile)
    encoded: bytes = message.SerializeToString()
    return encoded


def no_tiles() -> bytes:
    """Bytes of a RoadTiles without tiles: nothing was reported yet."""
    encoded: bytes = message_class("RoadTiles")(version=1).SerializeToString()
    return encoded
