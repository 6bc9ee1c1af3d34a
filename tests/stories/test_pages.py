"""Every program and command of the documents runs, in the order of the page.

Blocks with a title are files, `python` blocks of a page share their names, and lines of `sh` blocks
run one after another; those that end with `&` run until the page is done. Blocks marked `minutes`,
and the whole lap of the first drive, run only if the environment variable `EGP_EVERY_COMMAND` is
set. What a page assumes to be there is made by a function of `tests/stories/page_inputs.py`.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

import page_inputs
import pytest

from egp_service import shipped
from egp_service.cli.options import NOT_COMPLETED
from egp_service.control.endpoints import free_port
from patience import ATTEMPTS

ROOT: Final = Path(__file__).parents[2]
DOCUMENTS: Final = {path.stem: path for path in [*ROOT.glob("docs/*.md"), ROOT / "README.md"]}
EVERY: Final = "EGP_EVERY_COMMAND" in os.environ
BLOCK: Final = re.compile(
    r'^ *```(\w*)(?: (minutes))?(?: title="([^"]+)")?\n(.*?)^ *```$', re.MULTILINE | re.DOTALL
)
# Languages of the blocks that are executed.
EXECUTED: Final = ("sh", "python", "toml")
# Of these pages all such blocks run here, but those of ELSEWHERE.
PAGES: Final = [
    *("client", "deploying", "first-drive", "logs", "map", "monitor", "README", "recordings"),
    *("python", "results", "security", "simulation", "simulator", "surfaces", "your-car"),
    *("your-data", "your-track"),
]
# Page and language of blocks without a title that another test executes.
ELSEWHERE: Final = {
    ("README", "python"): "contract/test_readme.py",
    ("simulator", "python"): "closed_loop/test_environment.py",
}
# Page and first words of the blocks marked `minutes`, and a test that runs their commands on less
# with the word of it that shows this.
MINUTES: Final = {
    ("README", "egp drive -s random --road"): ("closed_loop/test_unknown_friction.py", ".road"),
    ("deploying", "egp serve"): ("service/test_command_line.py", '"--replay"'),
    ("logs", "egp train"): ("evaluation/test_logs.py", '"--log"'),
    ("map", "egp map"): ("service/test_map.py", '"--fleet"'),
    ("simulation", "egp simulate --seeds"): ("stories/stories.py", '"--seeds=0..1"'),
    ("simulator", "egp evaluate"): ("closed_loop/test_own_plant.py", '"--plant"'),
    ("your-data", "egp vehicle fit"): ("train/test_vehicle_fit.py", '"fit"'),
    ("your-data", "egp collect -o suv-wet"): ("train/test_own_simulator.py", '"--plant"'),
    ("your-data", "egp drive"): ("closed_loop/test_start.py", "vehicle_file=str(file)"),
    ("your-data", "egp train --recipe"): ("train/test_data_commands.py", '"--recipe"'),
}
# Those that no test runs.
NOT_REPLACED: Final = {
    ("surfaces", "egp train --recipe"): "Trains for minutes, for tables that no test compares.",
}
# Blocks without a language are not executed. tests/contract/test_readme.py looks up the commands
# and options in them.
NOT_EXECUTED: Final = {
    "README": "The commands of make run the tests; columns of the log are left out.",
    "deploying": "Needs Docker, a cluster, the Collector of OpenTelemetry, or several machines; "
    "tests/service/test_fetch.py does without those.",
    "monitor": "Needs hosts with names; tests/service/test_certificates.py does the same here.",
    "recordings": "Installs a package and opens a window.",
    "reference": "Compiles; `make rust-test` does the same without opening a browser.",
    "ros2": "Needs ROS 2.",
    "security": "Needs hosts with names; tests/service/test_certificates.py does the same here.",
    "wire": "Is a formula.",
    "your-data": "Needs a bag of ROS; tests/train/test_recording.py imports one.",
}
# Ports that the pages name and the commands listen on unless told otherwise.
PORTS: Final = {"serve": 7447, "map": 7448, "router": 7449, "monitor": 7450}


def blocks(page: str) -> list[tuple[str, str, str, str]]:
    """Language, mark, title and content of all fenced blocks."""
    text = DOCUMENTS[page].read_text(encoding="utf-8")
    found = BLOCK.findall(text)
    assert len(re.findall(r"^ *```", text, re.MULTILINE)) == 2 * len(found), page
    return found


def expanded(word: str) -> list[str]:
    """Return the files that a pattern stands for, as in a shell; otherwise the word itself."""
    found = sorted(map(str, Path().glob(word))) if "*" in word else []
    return found or [word]


def wait_for(port: int, process: subprocess.Popen[bytes]) -> None:
    """Wait until the process listens on the port."""
    deadline = time.monotonic() + 60.0
    while True:
        with socket.socket() as asked:
            if asked.connect_ex(("127.0.0.1", port)) == 0:
                return
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)


def undo_late_drive() -> bool:
    """Remove the newest drive if answers came too late for it, as on a machine that stalls."""
    newest = max(Path().rglob("summary.json"), key=lambda file: file.stat().st_mtime, default=None)
    if newest is None:
        return False
    reason = json.loads(newest.read_text(encoding="utf-8"))["ending"]["reason"]
    if reason != "stopped by the gate: no answer came before the deadline":
        return False
    shutil.rmtree(newest.parent)
    return True


class Shell:
    """Runs the commands of a page, each default port being another one that is free."""

    def __init__(self) -> None:
        """Choose the ports."""
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self.ports = {port: free_port() for port in PORTS.values()}

    def with_ports(self, text: str) -> str:
        """Return a text with the chosen ports."""
        for port, chosen in self.ports.items():
            text = text.replace(f"127.0.0.1:{port}", f"127.0.0.1:{chosen}")
        return text

    def run(self, content: str) -> None:
        """Run the lines of a block, those with an ampersand in the background."""
        for line in content.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            background = words[-1] == "&"
            program, *arguments = (found for word in words for found in expanded(word))
            assert program in {"egp", "python"}, line
            command = [sys.executable, *(["-m", "egp_service"] if program == "egp" else [])]
            if background:
                self.start(command, arguments[:-1])
                continue
            for _ in range(ATTEMPTS):
                done = subprocess.run(
                    [*command, *arguments], capture_output=True, text=True, check=False
                )
                if done.returncode != NOT_COMPLETED or not undo_late_drive():
                    break
            assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"

    def start(self, command: list[str], arguments: list[str]) -> None:
        """Start a server in place of an earlier one of its kind, and wait until it listens."""
        name = arguments[0]
        port = self.ports[PORTS[name]]
        if not {"--listen", "--config"} & set(arguments):
            arguments = [*arguments, "--listen", f"tcp/127.0.0.1:{port}"]
        if name == "monitor":
            arguments += ["--port", "0"]
        self.stop(name)
        self.running[name] = subprocess.Popen([*command, *arguments])
        if (name, "--config" in arguments) != ("serve", True):  # which may be a router's client
            wait_for(port, self.running[name])

    def stop(self, *names: str) -> None:
        """Stop servers that run in the background, which must end with status 0."""
        for name in names:
            if (process := self.running.pop(name, None)) is not None:
                process.terminate()
                assert process.wait(timeout=20) == 0


@pytest.mark.parametrize("page", PAGES)
def test_every_block_of_a_page_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    shutil.copy(shipped.DEMO_LIBRARY, "library.safetensors")
    shell = Shell()
    names: dict[str, object] = page_inputs.make(page, shell.with_ports)
    try:
        for language, mark, title, content in blocks(page):
            if mark and not EVERY:
                continue
            text = shell.with_ports(content)
            if not EVERY:
                text = page_inputs.shortened(page, text)
            if title:
                Path(title).write_text(text, encoding="utf-8")
            elif (page, language) in ELSEWHERE or language not in EXECUTED:
                continue
            elif language == "sh":
                shell.run(text)
            else:
                assert language == "python"
                exec(text, names)  # noqa: S102
    finally:
        page_inputs.end(names)
        shell.stop(*PORTS)


@pytest.mark.parametrize("page", sorted(DOCUMENTS))
def test_every_block_is_executed_by_a_test(page: str) -> None:
    found = blocks(page)
    commands = "".join(content for language, _, _, content in found if language == "sh")
    marked = [content for _, mark, _, content in found if mark]
    keys = [key for key in MINUTES.keys() | NOT_REPLACED if key[0] == page]
    assert len(marked) == len(keys), "list each block marked `minutes` with the test in its place"
    for content in marked:
        (key,) = (key for key in keys if content.startswith(key[1]))
        if key in MINUTES:
            test, word = MINUTES[key]
            assert word in (ROOT / "tests" / test).read_text(encoding="utf-8"), test
    for language, _, title, content in found:
        if title:
            # A file that no command uses is executed by nothing.
            assert page in PAGES, title
            assert Path(title).stem in commands, title
        elif language in EXECUTED:
            assert page in PAGES or (page, language) in ELSEWHERE, content
            assert language != "toml", f"a file without a title: {content}"
        elif language != "math":
            assert not language, f"a language that no test executes: {language}"
            assert page in NOT_EXECUTED, content
    for (other, language), test in ELSEWHERE.items():
        if other == page:
            assert language in {block[0] for block in found}
            assert f"{page}.md" in (ROOT / "tests" / test).read_text(encoding="utf-8")
    assert (page in NOT_EXECUTED) == ("" in {block[0] for block in found})
