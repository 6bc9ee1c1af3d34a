"""A browser for the tests of pages, if this machine has one."""

from __future__ import annotations

import importlib.util
import os
import shutil
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser

CHROMIUM = next(
    (
        found
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (found := shutil.which(name))
    ),
    None,
)


@pytest.fixture(scope="session")
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
