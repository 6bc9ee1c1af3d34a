"""What all tests share: threads, the order of files, and a browser if this machine has one."""

from __future__ import annotations

import importlib.util
import os
import shutil
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from playwright.sync_api import Browser

# Tests run on all cores side by side. Threads of BLAS and of torch in each of them would wait for
# one another; torch and numpy read this when they are imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Eight threads of zenoh receive in the process of the tests, also if its first session uses TLS. It
# is the default without TLS, but stated.
os.environ.setdefault("ZENOH_RUNTIME", "(rx: (worker_threads: 8), tx: (worker_threads: 1))")

# Files whose tests take longest. They come first, so that at the end all cores have work.
SLOW = (
    "tests/evaluation/test_quick.py",
    "tests/train/test_demo_library.py",
    "tests/evaluation/test_logs.py",
    "tests/train/test_choice.py",
)

# Files that wait for processes which compute. Beside the tests with deadlines, `make test` runs all
# others as idle tasks, which may get next to no processor time for minutes. When the last files
# run, those with deadlines have ended.
LAST = ("tests/evaluation/test_interruption.py",)

CHROMIUM = next(
    (
        found
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (found := shutil.which(name))
    ),
    None,
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: k for k, name in enumerate(SLOW)} | dict.fromkeys(LAST, len(SLOW) + 1)
    items.sort(key=lambda item: rank.get(item.nodeid.partition("::")[0], len(SLOW)))


@pytest.fixture
def interrupted_pictures(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """From the call on, Ctrl-C comes while matplotlib writes a picture."""

    def interrupted(_: object, path: Path, **_options: object) -> None:
        path.write_bytes(b"\x89PNG")
        raise KeyboardInterrupt

    return lambda: monkeypatch.setattr("matplotlib.figure.Figure.savefig", interrupted)


# As long as Playwright is open, asyncio counts its loop as running in this thread. So it is not
# open for the whole session.
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium found; on Debian `make browser` installs it")
    if importlib.util.find_spec("playwright") is None:
        pytest.skip("the package playwright is missing; `make lint` installs it")
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - it may be missing

    # Chromium's sandbox does not start for root, as in most containers.
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield found
        found.close()
