"""Installs a wheel into a fresh environment, and runs the stories there without the source.

    python tests/stories/fresh.py target/wheels/egp_service-*.whl

The package's own dependencies and those of the extras in `EXTRAS` come from PyPI. The others are
left out or too large: `train` has 1.3 GB, `view` 0.7 GB.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

EXTRAS = "data,viz,monitor,ros2,security"
STORIES = Path(__file__).with_name("stories.py")
# Variables of the environment that the stories keep; the last one is the number of BLAS's threads.
KEPT = ("PATH", "HOME", "OMP_NUM_THREADS")


def install(wheel: Path, folder: Path, *, dependencies: Path | None = None) -> Path:
    """Install a wheel into a new environment in a folder, and return its Python.

    Dependencies come from PyPI, or from the packages in the folder `dependencies`, of which
    editable ones are left out.
    """
    venv.create(folder, symlinks=True)
    python = folder / "bin/python"
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    pip += ["--python", str(python), "install"]
    if dependencies is None:
        subprocess.run([*pip, f"{wheel}[{EXTRAS}]", "pytest"], check=True)
    else:
        subprocess.run([*pip, "--no-deps", str(wheel)], check=True)
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        link = folder / "lib" / version / "site-packages/dependencies.pth"
        link.write_text(f"{dependencies}\n")
    return python


def run_stories(python: Path, folder: Path) -> None:
    """Run the stories in an empty folder; raises `CalledProcessError` if one fails."""
    folder.mkdir()
    shutil.copy(STORIES, folder)
    environment = {name: os.environ[name] for name in KEPT if name in os.environ}
    command = [str(python), "-m", "pytest", "-q", "--durations=0", "-p", "no:cacheprovider"]
    subprocess.run([*command, STORIES.name], cwd=folder, env=environment, check=True)


def main(wheel: Path) -> None:
    """Install the wheel with dependencies from PyPI, and run the stories."""
    with tempfile.TemporaryDirectory() as folder:
        python = install(wheel.resolve(), Path(folder, "environment"))
        run_stories(python, Path(folder, "work"))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(f"usage: python {sys.argv[0]} WHEEL")
    main(Path(sys.argv[1]))
