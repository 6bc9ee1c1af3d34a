"""Every program and command of the guides for users runs, in the order of the page.

Blocks with a title are files, `python` blocks of a page share their names, lines of `sh` blocks run
one after another, and those that end with `&` run until the page is done. Blocks marked `minutes`,
which train, run only if the environment variable `EGP_EVERY_COMMAND` is set.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from egp_service import shipped

DOCS = Path(__file__).parents[2] / "docs"
EVERY = "EGP_EVERY_COMMAND" in os.environ
BLOCK = re.compile(
    r'^```(\w+)(?: (minutes))?(?: title="([^"]+)")?\n(.*?)^```', re.MULTILINE | re.DOTALL
)
# Of these pages all blocks run in another test: tests/closed_loop, tests/contract/test_readme.py.
GUIDES = ["first-drive", "your-data", "your-car", "your-track", "client"]


def blocks(text: str) -> list[tuple[str, str, str]]:
    """Language, title and content of the blocks to run."""
    found = [block for block in BLOCK.findall(text) if EVERY or not block[1]]
    return [(language, title, content) for language, _, title, content in found]


def matching(word: str) -> list[str]:
    """Return the files that a pattern stands for, as in a shell; otherwise the word itself."""
    found = sorted(map(str, Path().glob(word))) if "*" in word else []
    return found or [word]


def run(line: str, running: list[subprocess.Popen[bytes]]) -> None:
    """Run one command of `egp`, in the background if it ends with an ampersand."""
    words = shlex.split(line.removesuffix("&"))
    assert words[0] == "egp", line
    expanded = [path for word in words[1:] for path in matching(word)]
    command = [sys.executable, "-m", "egp_service", *expanded]
    if line.endswith("&"):
        running.append(subprocess.Popen(command))
    else:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"


def wait_for(port: int) -> None:
    """Wait until somebody listens on the port."""
    deadline = time.monotonic() + 20.0
    while True:
        with socket.socket() as asked:
            if asked.connect_ex(("127.0.0.1", port)) == 0:
                return
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize("page", GUIDES)
def test_every_block_of_a_guide_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if page == "first-drive" and not EVERY:
        pytest.skip("a whole lap, which tests/closed_loop drives too: set EGP_EVERY_COMMAND=1")
    monkeypatch.chdir(tmp_path)
    shutil.copy(shipped.DEMO_LIBRARY, "library.safetensors")
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    running: list[subprocess.Popen[bytes]] = []
    names: dict[str, object] = {}
    found = blocks(text.replace("127.0.0.1:7447", f"127.0.0.1:{port}"))
    assert found
    try:
        for language, title, content in found:
            if title:
                Path(title).write_text(content, encoding="utf-8")
            elif language == "sh":
                for line in content.splitlines():
                    run(line, running)
                if running:
                    wait_for(port)
            else:
                assert language == "python"
                exec(content, names)  # noqa: S102
    finally:
        for process in running:
            process.terminate()
            process.wait(timeout=20)
