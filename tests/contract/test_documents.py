"""The documents name files that exist, and ARCHITECTURE.md names every file of the two flows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), ROOT / "rust/core/NOTATION.md"])
ARCHITECTURE = ROOT / "ARCHITECTURE.md"
# Paths in the documents start at the root, or at one of these folders where a section says so.
FOLDERS = ["", "rust/core/src", "python/egp_service"]
FILE = re.compile(r"`([\w./-]+\.(?:rs|py)|[\w./-]+/[\w.-]+\.(?:toml|proto|md))`")
# A name that the reader of a recipe chooses.
CHOSEN = re.compile(r"NAME|Name")
# Packages whose files the two flows pass through.
FLOWS = [
    *(
        f"rust/{crate}/src"
        for crate in ("parameters", "core", "wire", "driver", "gate", "engine", "trace", "service")
    ),
    "clients/vehicle/src",
    *(f"python/egp_service/{room}" for room in ("control", "data", "training", "simulation")),
]


def named_files(document: Path) -> set[str]:
    """Paths of files that a document names in backticks."""
    named = FILE.findall(document.read_text(encoding="utf-8"))
    return {path for path in named if not CHOSEN.search(path)}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_every_file_that_a_document_names_exists(document: Path) -> None:
    missing = {
        path
        for path in named_files(document)
        if not any((ROOT / folder / path).is_file() for folder in FOLDERS)
    }
    assert not missing


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_every_link_leads_to_a_file(document: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", document.read_text(encoding="utf-8"))
    own = [link for link in links if "://" not in link]
    assert not [link for link in own if not (document.parent / link).exists()]


@pytest.mark.parametrize("folder", FLOWS)
def test_the_architecture_names_every_file_of_the_flows(folder: str) -> None:
    named = named_files(ARCHITECTURE)
    found = {path for kind in ("*.rs", "*.py") for path in (ROOT / folder).rglob(kind)}
    assert found
    unnamed = {
        str(path.relative_to(ROOT))
        for path in found
        if path.name not in {"lib.rs", "__init__.py"}
        and not any(str(ROOT / top / name) == str(path) for top in FOLDERS for name in named)
    }
    assert not unnamed


def test_the_table_of_packages_is_complete() -> None:
    text = ARCHITECTURE.read_text(encoding="utf-8")
    _, _, table = text.partition("### Python packages")
    table, _, _ = table.partition("\n###")
    package = ROOT / "python" / "egp_service"
    rooms = {entry.parent.name for entry in package.glob("*/__init__.py")}
    modules = {entry.name for entry in package.glob("*.py")} - {"__init__.py", "__main__.py"}
    cells = re.findall(r"^\|((?: `[\w.]+`,?)+) \|", table, re.MULTILINE)
    assert {name for cell in cells for name in re.findall(r"`([\w.]+)`", cell)} == rooms | modules


@pytest.mark.parametrize("message", ["StepRecord", "PlantTruth"])
def test_the_document_of_recordings_names_every_field(message: str) -> None:
    proto = (ROOT / "rust/wire/proto/egp/v1/egp.proto").read_text(encoding="utf-8")
    (body,) = re.findall(rf"^message {message} \{{\n(.*?)^\}}", proto, re.MULTILINE | re.DOTALL)
    fields = re.findall(r"^  .*?(\w+) = \d+;", body, re.MULTILINE)
    assert len(fields) > 10
    document = (ROOT / "docs/recordings.md").read_text(encoding="utf-8")
    assert not [field for field in fields if f"`{field}`" not in document]


def test_the_wire_documents_name_every_field_and_code() -> None:
    proto = (ROOT / "rust/wire/proto/egp/v1/egp.proto").read_text(encoding="utf-8")
    documents = [ROOT / "docs/wire.md", ROOT / "docs/map.md"]
    document = "".join(path.read_text(encoding="utf-8") for path in documents)
    # These are for dashboards and recordings, whose readers have the schema.
    elsewhere = {"Load", "PlantTruth", "StepRecord"}
    messages = re.findall(r"^message (\w+) \{\n(.*?)^\}", proto, re.MULTILINE | re.DOTALL)
    assert {"StepRequest", "StepReply", "Error", "Ready"} < {name for name, _ in messages}
    clients = [body for name, body in messages if name not in elsewhere]
    fields = {f for body in clients for f in re.findall(r"^  .*?(\w+) = \d+;", body, re.MULTILINE)}
    codes = set(re.findall(r"\b((?:CODE|STATUS)_\w+) = \d+;", proto))
    assert {name for name in fields | codes if f"`{name}`" not in document} == set()
