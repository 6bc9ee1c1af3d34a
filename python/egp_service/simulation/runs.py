"""The folder of a run: complete scenario, recording, summary and pictures."""

from __future__ import annotations

import json
from datetime import datetime
from typing import TYPE_CHECKING

from egp_service.files import make_folder, write_text
from egp_service.simulation.closed_loop import Run, drive
from egp_service.simulation.layouts import write_layouts
from egp_service.simulation.recording import recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from egp_service._core import RoadBelief
    from egp_service.control.step import StepController
    from egp_service.simulation.scenario import Scenario
    from egp_service.simulation.trace import Period


def new_folder(root: Path, name: str) -> Path:
    """Create and return the new folder `root/<stamp>-<name>`; `root` is made if it is missing.

    Raises:
        OSError: naming the path, if there can be no folder, as where `root` is a file or a symbolic
            link that leads nowhere.

    """
    make_folder(root)
    stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    for count in range(1, 1000):
        folder = root / (f"{stamp}-{name}" if count == 1 else f"{stamp}-{name}-{count}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise FileExistsError(f"{root} already has a thousand runs of this second")


def record_run(
    scenario: Scenario,
    controller: StepController,
    folder: Path,
    observe: Callable[[Period], None],
    belief: RoadBelief | None = None,
) -> Run:
    """Drive the scenario and write `scenario.toml`, `run.mcap` and `summary.json` to `folder`.

    `foxglove.json` and `plotjuggler.xml`, also written there, are layouts for the recording.
    `belief` is what earlier runs found about the road, see `drive`.
    """
    write_text(folder / "scenario.toml", scenario.toml())
    write_layouts(folder, len(controller.members))
    with recording(folder / "run.mcap", scenario, controller) as record:

        def both(period: Period) -> None:
            record(period)
            observe(period)

        run = drive(scenario, controller, both, belief)
    write_text(
        folder / "summary.json", json.dumps(run.summary.as_json(), indent=2, allow_nan=False) + "\n"
    )
    return run
