"""The import rules of the Rust workspace: who may depend on whom, and who may name what."""

from __future__ import annotations

import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# A crate may depend only on the workspace crates listed here. Dev-dependencies count too, but for
# benchmarks and tests of the clients, which drive the real service.
# The numbers that describe a vehicle are no crate's own.
VEHICLE = "egp-parameters"
ALLOWED = {
    VEHICLE: set(),
    "egp-core": {VEHICLE},
    "egp-wire": {VEHICLE},
    "egp-gate": {VEHICLE},
    "egp-plant": {VEHICLE},
    "egp-path": {VEHICLE},
    "egp-map": {VEHICLE},
    "egp-engine": {"egp-core", "egp-wire"},
    "egp-trace": set(),
    "egp-session": set(),
    "egp-service": {"egp-core", "egp-engine", "egp-map", "egp-session", "egp-trace", "egp-wire"},
    "egp-driver": {VEHICLE, "egp-map", "egp-wire", "egp-gate"},
    "egp-simulate": {
        "egp-core",
        "egp-driver",
        "egp-engine",
        "egp-gate",
        "egp-path",
        "egp-plant",
        "egp-service",
        "egp-wire",
    },
    "egp-vehicle": {
        VEHICLE,
        "egp-driver",
        "egp-gate",
        "egp-map",
        "egp-session",
        "egp-trace",
        "egp-wire",
    },
    "egp-simulator": {"egp-path", "egp-plant", "egp-vehicle"},
    "egp-load": {"egp-wire", "egp-vehicle", "egp-simulator"},
    "egp-testing": {VEHICLE, "egp-core", "egp-map", "egp-path", "egp-wire"},
    "egp-interleavings": {"egp-core", "egp-engine", "egp-testing", "egp-trace", "egp-wire"},
    "egp-bench": set(),
    "egp-python": {
        VEHICLE,
        "egp-core",
        "egp-wire",
        "egp-gate",
        "egp-plant",
        "egp-path",
        "egp-map",
        "egp-driver",
        "egp-engine",
        "egp-service",
        "egp-session",
        "egp-simulate",
        "egp-vehicle",
        "egp-load",
    },
}

# Libraries that are named in one file of a crate only, so that replacing them is one edit.
ONE_FILE = {
    "rust/core/src": ["clarabel", "safetensors"],
    "rust/python/src": ["numpy"],
    "rust/session/src": ["zenoh"],
    "rust/service/src": ["zenoh", "hyper"],
    "clients/vehicle/src": ["zenoh"],
    "clients/load/src": ["zenoh"],
}


def workspace_dependencies() -> dict[str, set[str]]:
    """Return the normal and build dependencies between workspace crates, as cargo resolves them."""
    output = subprocess.run(
        ["cargo", "metadata", "--format-version", "1", "--no-deps", "--locked"],  # noqa: S607
        cwd=ROOT,
        check=True,
        capture_output=True,
    ).stdout
    packages = json.loads(output)["packages"]
    names = {package["name"] for package in packages}
    return {
        package["name"]: {
            dependency["name"]
            for dependency in package["dependencies"]
            if dependency["kind"] != "dev" and dependency["name"] in names
        }
        for package in packages
    }


def test_crates_depend_on_what_the_design_says() -> None:
    actual = workspace_dependencies()
    assert set(actual) == set(ALLOWED), "a new crate needs its rule here"
    for crate, dependencies in actual.items():
        assert dependencies == ALLOWED[crate], crate


@pytest.mark.parametrize(
    ("folder", "library"), [(folder, name) for folder, names in ONE_FILE.items() for name in names]
)
def test_a_library_is_named_in_one_file(folder: str, library: str) -> None:
    named = re.compile(rf"(?<!self::)\b{library}::")
    text = re.compile(r'"(?:[^"\\]|\\.)*"|//.*')  # such as the filter of a log
    files = sorted(
        str(path.relative_to(ROOT))
        for path in (ROOT / folder).rglob("*.rs")
        if named.search(text.sub("", path.read_text()))
    )
    assert len(files) == 1, f"{library} is named in {files}"


def test_what_threads_share_comes_from_one_file() -> None:
    """Files that run under chosen interleavings of threads name no lock and no thread."""
    folder = ROOT / "rust/interleavings/src"
    hosted = re.findall(r'#\[path = "([^"]+)"\]', (folder / "lib.rs").read_text())
    assert len(hosted) > 1
    own = re.compile(r"\bstd::(?:sync|thread)\b(?!::available_parallelism)")
    for name in hosted:
        code, _, _ = (folder / name).read_text().partition("#[cfg(test)]")
        assert not own.search(code), f"{name} must use crate::sync"


def test_the_architecture_says_the_same() -> None:
    rows = re.findall(
        r"^\| `([\w/]+)` \(`(egp-[\w-]+)`\) \|[^|]*\|([^|]*)\|$",
        (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    members = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["members"]
    assert {folder for folder, _, _ in rows} == set(members)
    written = {
        crate: {f"egp-{name}" for name in re.findall(r"`(\w+)`", imports)}
        for _, crate, imports in rows
    }
    assert written == ALLOWED
