"""The stories pass from a wheel of this source, without the source.

Dependencies are those of the tests here.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from pathlib import Path

from fresh import install, run_stories

ROOT = Path(__file__).parents[2]


def test_the_stories_pass_from_the_wheel(tmp_path: Path) -> None:
    # The extension is not compiled again: a wheel has what `maturin develop` builds.
    maturin = [sys.executable, "-m", "maturin", "build", "--release", "--locked"]
    command = [*maturin, "--interpreter", sys.executable, "--out", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    installed = Path(sysconfig.get_path("purelib"))
    python = install(wheel, tmp_path / "environment", dependencies=installed)
    run_stories(python, tmp_path / "work")
