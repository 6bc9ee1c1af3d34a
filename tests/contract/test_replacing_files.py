"""Files are replaced as a whole: links stay, and what is no regular file is left as it is."""

from __future__ import annotations

import os
import socket
import stat
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from egp_service import Controller, Plant, Recorder
from egp_service.cli.options import check_writable
from egp_service.control.recorded import read_recording
from egp_service.files import make_folder, replacing, write_text
from egp_service.shipped import DEMO_LIBRARY

if TYPE_CHECKING:
    from collections.abc import Callable


def record(path: Path) -> None:
    with Controller(DEMO_LIBRARY, gate=Plant().parameters.gate_limits()) as controller:
        Recorder(path, controller).close()


WRITERS: list[Callable[[Path], None]] = [lambda path: write_text(path, "new"), record]


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("deep", [False, True])
def test_where_a_link_leads_is_replaced(
    tmp_path: Path, write: Callable[[Path], None], *, deep: bool
) -> None:
    target = tmp_path / "runs" / "target"
    target.parent.mkdir()
    target.write_text("old")
    link = tmp_path / "link"
    link.symlink_to("second" if deep else target)
    (tmp_path / "second").symlink_to(target)
    write(link)
    assert link.is_symlink()
    assert target.read_bytes() != b"old"
    assert list(target.parent.iterdir()) == [target]


def test_where_a_link_leads_may_be_missing(tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "new" / "target")
    record(link)
    assert link.is_symlink()
    assert read_recording(tmp_path / "new" / "target").complete


@pytest.mark.parametrize("write", [*WRITERS, check_writable])
def test_what_is_no_regular_file_stays(tmp_path: Path, write: Callable[[Path], None]) -> None:
    pipe, named = tmp_path / "pipe", tmp_path / "socket"
    os.mkfifo(pipe)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(named))
    to_pipe = tmp_path / "link"
    to_pipe.symlink_to(pipe)
    kinds = {pipe: "a pipe", named: "a socket or a device", to_pipe: "a pipe"}
    for path, kind in kinds.items():
        expected = f"expected a regular file or a new name, got {kind}"
        with pytest.raises(OSError, match=expected) as found:
            write(path)
        assert found.value.filename == str(path)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert stat.S_ISSOCK(named.stat().st_mode)
    assert set(tmp_path.iterdir()) == {pipe, named, to_pipe}


def test_a_link_to_itself_is_an_error_that_names_it(tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(link)
    with pytest.raises(OSError, match="symbolic links") as found:
        write_text(link, "")
    assert found.value.filename == str(link)


def test_a_file_is_on_the_disk_before_it_replaces_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, synced = tmp_path / "a.txt", list[tuple[str, str]]()
    path.write_text("before")

    def sync(descriptor: int) -> None:
        of = Path(f"/proc/self/fd/{descriptor}").readlink()
        synced.append((of.name, path.read_text()))

    monkeypatch.setattr(os, "fsync", sync)
    write_text(path, "after")
    assert synced == [("a.txt", "before"), (tmp_path.name, "after")]


@pytest.mark.parametrize("inside", ["file", "file/folder"])
def test_a_file_in_the_place_of_a_folder_is_named(tmp_path: Path, inside: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match="this is no folder") as found:
        make_folder(tmp_path / inside)
    assert found.value.filename == str(tmp_path / "file")


def test_an_error_of_a_write_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with pytest.raises(OSError, match="No space") as found, replacing(path):
        raise OSError(28, "No space left on device")
    assert found.value.filename == str(path)
    # The text of an error without a number is kept.
    with pytest.raises(OSError, match="cannot write this"), replacing(path):
        raise OSError("cannot write this")
