"""Count the instructions of one warm control step with callgrind and compare them with the budget.

Times differ from run to run and from machine to machine; instruction counts hardly do. So this is
what a test can check: `instructions.toml` holds the budget, and a step that takes more fails. The
example `rust/core/examples/instructions.rs` is the step that is counted; loading the library and
warming up are not in the count.

    python tests/bench/instructions.py             # check; skipped without valgrind
    python tests/bench/instructions.py --update    # after an intended change: store what is counted

To see where the instructions go: `callgrind_annotate target/instructions.callgrind`.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
BUDGET = Path(__file__).with_suffix(".toml")
TARGET = ROOT / "target"


def run(*command: str | Path) -> str:
    """Run a program in the repository's root and return all it prints."""
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    output = done.stdout + done.stderr
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))} failed:\n{output}")
    return output


def count(cargo: str, valgrind: str) -> tuple[str, int]:
    """Build the example, run its step under callgrind; return the tier and the count."""
    example = ("--package", "egp-core", "--example", "instructions", "--features", "baseline-qp")
    run(cargo, "build", "--release", "--locked", "--quiet", *example)
    program, library = TARGET / "release/examples/instructions", TARGET / "instructions.library"
    run(program, "write", library)
    output = run(
        valgrind,
        "--tool=callgrind",
        "--toggle-collect=*counted_step*",
        f"--callgrind-out-file={TARGET / 'instructions.callgrind'}",
        program,
        library,
    )
    tier, collected = re.search(r"tier (\w+)", output), re.search(r"Collected : (\d+)", output)
    if tier is None or collected is None or int(collected[1]) == 0:
        sys.exit(f"callgrind counted nothing; is `counted_step` still a function?\n{output}")
    return tier[1], int(collected[1])


def main() -> None:
    """Count, compare or update."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--update", action="store_true", help="store the count as the new budget")
    options = parser.parse_args()
    cargo, valgrind = shutil.which("cargo"), shutil.which("valgrind")
    if cargo is None or valgrind is None:
        print("SKIPPED: instructions are not counted; to count them, install cargo and valgrind")
        return
    tier, counted = count(cargo, valgrind)
    text = BUDGET.read_text()
    if options.update:
        BUDGET.write_text(re.sub(rf"(?m)^{tier} = \d+$", f"{tier} = {counted}", text))
    settings = tomllib.loads(BUDGET.read_text())
    budget = settings["step"].get(tier)
    if budget is None:
        print(
            f"SKIPPED: {counted} instructions, but no budget for {tier}; add one to {BUDGET.name}"
        )
        return
    change = counted / budget - 1.0
    print(f"one step, {tier}: {counted} instructions, budget {budget} ({change:+.1%})")
    if change > settings["slack"]:
        sys.exit(
            f"more than {settings['slack']:.0%} over the budget. If it buys something, run "
            "`python tests/bench/instructions.py --update` and say in the commit what."
        )
    if change < -settings["slack"]:
        print("well below the budget: run with --update, so that it stays so")


if __name__ == "__main__":
    main()
