"""Count the instructions of a warm control step and of what a vehicle computes beside it.

Times differ from run to run and from machine to machine; instruction counts hardly do. So this is
what a test can check, with callgrind: `instructions.toml` holds the budgets, and a step or a plan
that takes more fails. The example `rust/core/examples/instructions.rs` is what is counted; loading
the library and warming up are not in the count.

Beside the step a vehicle that is told nothing about the road updates its belief, reads from it the
friction to plan for, plans the speed, and writes the friction into the request of the step. The
last line says by how much all this makes a period longer than the step alone.

    python tests/bench/instructions.py             # check; skipped without valgrind
    python tests/bench/instructions.py --update    # after an intended change: store what is counted

To see where the instructions go: `callgrind_annotate target/instructions.callgrind.PART`, whose
part is 1 for the step, 2 for the plan, and 3 for the plan with reports of other vehicles.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[2]
BUDGET = Path(__file__).with_suffix(".toml")
TARGET = ROOT / "target"
COUNTED = "instructions::counted"
PARTS = ("step", "plan", "plan with reports", "step with preview")


class Size(NamedTuple):
    """Points of each of two members, stages, and transitions from which weights are estimated."""

    points: int
    horizon: int
    window: int


# The budgets are those of the first; the second is as large as the step of the demo.
SIZES = (Size(700, 20, 10), Size(400, 40, 25))


def run(*command: str | Path) -> str:
    """Run a program in the repository's root and return all it prints."""
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    output = done.stdout + done.stderr
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))} failed:\n{output}")
    return output


def count(cargo: str, valgrind: str, size: Size) -> tuple[str, list[int]]:
    """Build the example and run it under callgrind; return the tier and the counts of `PARTS`."""
    # All crates that the tests are built of, so that nothing but the example is compiled.
    crates = ("--workspace", "--exclude", "egp-bench")
    built = ("--example", "instructions", *crates)
    run(cargo, "build", "--release", "--locked", "--quiet", *built)
    program, library = TARGET / "release/examples/instructions", TARGET / "instructions.library"
    run(program, "write", library, str(size.points))
    stored = TARGET / "instructions.callgrind"
    output = run(
        valgrind,
        "--tool=callgrind",
        f"--toggle-collect={COUNTED}",
        f"--dump-after={COUNTED}",
        f"--callgrind-out-file={stored}",
        program,
        library,
        str(size.horizon),
        str(size.window),
    )
    tier = re.search(r"tier (\w+)", output)
    parts = [TARGET / f"{stored.name}.{number}" for number in range(1, len(PARTS) + 1)]
    totals = [re.search(r"(?m)^totals: (\d+)$", part.read_text()) for part in parts]
    counts = [int(total[1]) for total in totals if total is not None]
    if tier is None or len(counts) < len(PARTS) or 0 in counts:
        sys.exit(f"callgrind counted nothing; is `counted` still a function?\n{output}")
    return tier[1], counts


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
    counts = {size: count(cargo, valgrind, size) for size in SIZES}
    tier, counted = counts[SIZES[0]]
    text = BUDGET.read_text()
    if options.update:
        for part, number in zip(PARTS, counted, strict=True):
            text = re.sub(rf'(?m)^(\["?{part}"?\]\n{tier} = )\d+$', rf"\g<1>{number}", text)
        BUDGET.write_text(text)
    settings = tomllib.loads(text)
    over = [
        part
        for part, number in zip(PARTS, counted, strict=True)
        if compare(part, tier, number, settings)
    ]
    for size, (_, (step, plan, reported, previewed)) in counts.items():
        print(
            f"{size.points} points, {size.horizon} stages: a period with belief, plan and preview "
            f"takes {(previewed + plan) / step:.2f} times the step alone, with reports "
            f"{(previewed + reported) / step:.2f} times"
        )
    if over:
        sys.exit(
            f"more than {settings['slack']:.0%} over the budget: {', '.join(over)}. If it buys "
            "something, run `python tests/bench/instructions.py --update` and say in the commit "
            "what."
        )


def compare(part: str, tier: str, counted: int, settings: dict[str, Any]) -> bool:
    """Print a count beside its budget; return whether it is over it."""
    budget = settings[part].get(tier)
    if budget is None:
        print(f"SKIPPED: {part}: {counted} instructions, no budget for {tier} in {BUDGET.name}")
        return False
    change = counted / budget - 1.0
    print(f"{part}, {tier}: {counted} instructions, budget {budget} ({change:+.1%})")
    if change < -settings["slack"]:
        print("well below the budget: run with --update, so that it stays so")
    return bool(change > settings["slack"])


if __name__ == "__main__":
    main()
