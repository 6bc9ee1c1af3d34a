"""`docs/library.md` describes the file that the shipped library is."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import pytest

from egp_service import VehicleParameters, shipped

DOCUMENT = (Path(__file__).parents[2] / "docs/library.md").read_text(encoding="utf-8")
TENSORS = dict(re.findall(r"^\| `(\w+)` \| \[([\w, ]+)\] \|", DOCUMENT, re.MULTILINE))
_, _, METADATA = DOCUMENT.partition("## Metadata")
METADATA, _, VEHICLE = METADATA.partition("\n## Vehicle\n")
VEHICLE, _, _ = VEHICLE.partition("\n## ")


@pytest.fixture(scope="module")
def header() -> dict[str, Any]:
    """Read the shipped library's header by the description of the container."""
    data = shipped.DEMO_LIBRARY.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    parsed: dict[str, Any] = json.loads(data[8 : 8 + length])
    return parsed


def test_tensors_are_those_of_the_table(header: dict[str, Any]) -> None:
    metadata = json.loads(header["__metadata__"]["egp"])
    written = {}
    for index, member in enumerate(metadata["members"]):
        golden = header[f"members.{index}.golden_z"]["shape"][0]
        sizes = {"M": member["n"], "G": golden}
        # The simulated car has no resistance.
        for name, shape in (item for item in TENSORS.items() if item[0] != "resistance"):
            extents = [sizes.get(extent) or int(extent) for extent in shape.split(", ")]
            written[f"members.{index}.{name}"] = {"dtype": "F64", "shape": extents}
    found = {
        name: {"dtype": tensor["dtype"], "shape": tensor["shape"]}
        for name, tensor in header.items()
        if name != "__metadata__"
    }
    assert found == written


def test_metadata_keys_are_those_of_the_table(header: dict[str, Any]) -> None:
    metadata = json.loads(header["__metadata__"]["egp"])
    keys = set(re.findall(r"^\| `(\w+)` \|", METADATA, re.MULTILINE))
    assert keys - {"measurement_noise", "measurement_delay"} == set(
        metadata
    )  # simulated data have none
    (members,) = re.findall(r"^\| `members` \|(.*)\|$", METADATA, re.MULTILINE)
    for member in metadata["members"]:
        assert set(member) <= set(re.findall(r"`([\w-]+)`", members))
    assert f"`schema` | {metadata['schema']}." in METADATA
    parameters = re.findall(r"^\| `(\w+)` \| [^|]+ \| (\S+) to (\S+) \|", VEHICLE, re.MULTILINE)
    ranges = {name: (float(least), float(most)) for name, least, most in parameters}
    assert ranges == VehicleParameters.ranges()
    assert sorted(ranges) == sorted(metadata["parameters"])
    for signal in metadata["inputs"] + metadata["outputs"]:
        assert f"`{signal['name']}` {signal['unit']}" in METADATA
