"""Importing one room of the Python package loads only the libraries that this room needs."""

from __future__ import annotations

import json
import pkgutil
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import egp_service
from egp_service import _core

# Libraries that take long to import or come with an extra.
WATCHED = {
    "botorch", "cvxpy", "gpytorch", "gymnasium", "loky", "matplotlib", "mcap", "osqp", "polars",
    "ray", "rerun", "rich", "rosbags", "ruamel", "scipy", "starlette", "torch", "typer", "uvicorn",
    "xxhash", "zenoh",
}  # fmt: skip
TABLES = {"scipy", "polars", "loky"}
TRAINING = {"torch", "gpytorch", "botorch"} | TABLES
TERMINAL = {"rich", "typer"}
LIBRARIES = "libraries of training"
# What each room may load. A module in a line of its own is an exception in its room.
MAY_LOAD = {
    "egp_service": set(),
    "egp_service.quantities": set(),
    "egp_service.callbacks": set(),
    "egp_service.files": set(),
    "egp_service.optimal_control": set(),
    "egp_service.shipped": set(),
    "egp_service.vehicle": set(),
    "egp_service.workers": {"loky"},
    "egp_service.zenoh_threads": set(),
    "egp_service.control": set(),
    "egp_service.control.client": {"zenoh"},
    "egp_service.control.fleet_map": {"zenoh"},
    "egp_service.control.network": {"zenoh"},
    "egp_service.control.router": {"zenoh"},
    "egp_service.control.session": {"zenoh"},
    "egp_service.control.recorder": {"mcap"},
    "egp_service.control.recorded": {"mcap"},
    "egp_service.control.replay": {"mcap"},
    "egp_service.control.status": {"zenoh"},
    "egp_service.monitor": {"zenoh", "starlette", "uvicorn"},
    "egp_service.view": {"mcap", "rerun"},
    "egp_service.ros2": {"rosbags", "ruamel", "xxhash", "zenoh"},
    "egp_service.simulation": {"mcap"},
    "egp_service.simulation.environment": {"gymnasium", "mcap"},
    "egp_service.simulation.report": {"matplotlib"},
    "egp_service.simulation.replay_report": {"matplotlib", "mcap"},
    "egp_service.simulation.load_figure": {"matplotlib"},
    "egp_service.data": {"polars", "loky", "mcap"},
    "egp_service.data.coverage_figure": {"polars", "loky", "matplotlib"},
    "egp_service.training": TRAINING | {"mcap"},
    "egp_service.training.validation_report": {"matplotlib"},
    "egp_service.evaluation": TRAINING | {"mcap", "matplotlib", "cvxpy", "osqp"},
    "egp_service.evaluation.campaign": TABLES | {"mcap"},
    "egp_service.cli": TERMINAL,
    "egp_service.cli.backends": TERMINAL | {"zenoh"},
    "egp_service.cli.credentials": TERMINAL | {"zenoh"},
    "egp_service.cli.publication": TERMINAL | {"zenoh", "mcap"},
    "egp_service.cli.demo": TERMINAL | {"zenoh", "mcap"},
    "egp_service.cli.checks": TERMINAL | {"zenoh"},
    "egp_service.cli.replay_text": TERMINAL | {"mcap"},
    "egp_service.cli.logs": TERMINAL | TRAINING | {"matplotlib"},
    "egp_service.cli.evaluation_parts": TERMINAL | TABLES,
}

# Each room is imported in a process that is forked from the one of its parent, so that what several
# rooms load is loaded once.
LOAD = """
import importlib, json, os, sys

def load(rule):
    for name in MODULES[rule]:
        importlib.import_module(name)
    loaded = sorted({name.partition(".")[0] for name in sys.modules})
    print(json.dumps([rule, loaded]), flush=True)
    for child in CHILDREN.get(rule, []):
        pid = os.fork()
        if pid == 0:
            load(child)
            os._exit(0)
        if os.waitpid(pid, 0)[1] != 0:
            sys.exit(f"{child} cannot be imported")

MODULES, CHILDREN = json.loads(sys.argv[1])
load("egp_service")
"""


@cache
def loaded() -> dict[str, set[str]]:
    """Import the rooms in a fresh interpreter and forks: the watched libraries that each loads."""
    tree = json.dumps([MODULES | {LIBRARIES: sorted(TRAINING)}, children()])
    done = subprocess.run(
        [sys.executable, "-c", LOAD, tree], check=False, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    return {rule: WATCHED & set(names) for rule, names in found}


def children() -> dict[str, list[str]]:
    """Name the rooms that are imported after each one and that may load all that this one may.

    Most rooms are thus not the first one that is imported; `lint-imports` finds cycles of rooms.
    The libraries of training, which take seconds, are a room of this tree.
    """
    found: dict[str, list[str]] = {}
    may_load = MAY_LOAD | {LIBRARIES: TRAINING}
    first, *others = sorted(may_load, key=lambda rule: len(may_load[rule]))
    earlier = [first]
    for rule in others:
        fitting = [other for other in earlier if may_load[other] <= may_load[rule]]
        # Of those that may load most the last one, after which most is imported.
        parent = max(reversed(fitting), key=lambda other: len(may_load[other]))
        found.setdefault(parent, []).append(rule)
        earlier.append(rule)
    return found


def rule_of(module: str) -> str:
    """Find the most specific line of `MAY_LOAD` for a module."""
    while module not in MAY_LOAD:
        module = module.rpartition(".")[0]
    return module


def modules_by_rule() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {"egp_service": ["egp_service"]}
    for module in pkgutil.walk_packages(egp_service.__path__, "egp_service."):
        if module.name not in {"egp_service.__main__", "egp_service._core"}:
            found.setdefault(rule_of(module.name), []).append(module.name)
    return found


MODULES = modules_by_rule()


def test_every_room_has_its_own_rule() -> None:
    assert set(MODULES) == set(MAY_LOAD)
    assert MODULES["egp_service"] == ["egp_service"], "a new room needs its rule here"


@pytest.mark.parametrize("rule", MODULES)
def test_a_room_loads_only_what_it_needs(rule: str) -> None:
    assert loaded()[rule] <= MAY_LOAD[rule]


def test_the_extension_has_what_the_package_uses_and_the_rest_is_marked_as_for_tests() -> None:
    package = Path(egp_service.__file__).parent
    product = "".join(file.read_text(encoding="utf-8") for file in package.rglob("*.py"))
    assert "_core.testing" not in product
    core = package / "_core"
    defined = {
        file.stem: re.findall(r"(?m)^(?:class |def )?(\w+)[(:]", file.read_text(encoding="utf-8"))
        for file in core.glob("*.pyi")
    }
    marked = set(defined.pop("testing"))
    # What a function or a class of a stub mentions, such as the type of a result, is used, too.
    stubs = "".join((core / f"{stem}.pyi").read_text(encoding="utf-8") for stem in defined)
    for name in {name for names in defined.values() for name in names}:
        assert re.search(rf"\b{name}\b", product) or len(re.findall(rf"\b{name}\b", stubs)) > 1
    assert len(marked) > 5
    assert not [name for name in marked if hasattr(_core, name)]


@pytest.mark.parametrize("name", egp_service.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(egp_service, name).__name__ == name
    assert name in dir(egp_service)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        getattr(egp_service, "nonsense")  # noqa: B009 - mypy would see a missing attribute


def test_the_shipped_files_need_no_import_of_their_own() -> None:
    told = "import egp_service; print(egp_service.shipped.DEMO_LIBRARY.is_file())"
    output = subprocess.check_output([sys.executable, "-c", told], text=True)
    assert output == "True\n"
