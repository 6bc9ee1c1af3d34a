"""`egp evaluate --log`: open-loop evaluation on logs, with tables and pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from egp_service._core import EgpError
from egp_service.cli.options import check_writable
from egp_service.cli.output import say
from egp_service.cli.progress import fitting, working
from egp_service.cli.tables import (
    MOTION_NAMES,
    delay_sentence,
    kind_sentence,
    skill_table,
    skill_warnings,
    vehicle_table,
)
from egp_service.data.dataset import Dataset
from egp_service.evaluation.log_figures import draw_log
from egp_service.evaluation.logs import LAST_CHANGE, OURS, LogOutcome, evaluate_logs
from egp_service.files import file_name, make_folder
from egp_service.training.recipe import Displays
from egp_service.training.train import TrainingSettings
from egp_service.vehicle import read_vehicle

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console


def evaluate_on(console: Console, logs: Sequence[Path], vehicle: Path | None, output: Path) -> None:
    """Evaluate the datasets `logs`, print tables, and draw one picture for each in `output`.

    Raises:
        EgpError: if a file is not readable, a picture cannot be written, or training fails.

    """
    datasets = [Dataset.read(path) for path in logs]
    car = None if vehicle is None else read_vehicle(vehicle)
    # Files that cannot be written are found before the minutes that training takes.
    make_folder(output)
    pictures = [output / f"{file_name(data.provenance.surface)}.png" for data in datasets]
    if len(set(pictures)) < len(pictures):
        raise EgpError(
            "the surfaces of two logs give the same name of a picture: import each with its own "
            "--surface"
        )
    check_writable(*pictures)
    outcomes = evaluate_logs(
        datasets,
        car,
        TrainingSettings(mean="best"),
        Displays(fitting=lambda: fitting(console)),
        lambda: working(console, "comparing predictions"),
    )
    for outcome, picture in zip(outcomes, pictures, strict=True):
        _show(console, outcome)
        with console.status("Drawing ..."):
            draw_log(outcome, picture)
        say(console, f"Look at {picture}")


def _show(console: Console, outcome: LogOutcome) -> None:
    found = outcome.channels
    for name, noise, correlation in zip(
        MOTION_NAMES, found.noise, found.autocorrelation, strict=True
    ):
        say(
            console,
            f"{outcome.name}: {name} has white noise of {noise:.4f}; "
            f"consecutive changes correlate by {correlation:+.2f}",
        )
    say(
        console,
        f"{outcome.name}: the yaw rate follows the steering by {found.steering_delay:.2f} s, the "
        f"change of v_x the force by {found.force_delay:.2f} s",
        delay_sentence(outcome.delays),
    )
    if outcome.member.vehicle is not None:
        console.print(vehicle_table(outcome.name, outcome.member.vehicle.summary()))
    console.print(skill_table(outcome.name, outcome.skill))
    member = outcome.member
    say(
        console,
        f"{LAST_CHANGE}, after one period: {_errors(outcome.last_change)}",
        f"member with the residual, after one period: {_errors(outcome.with_residual)}",
        f"inside the member's 95 % intervals: {_shares(outcome.coverage)}",
        f"with the residual: {_shares(outcome.residual_coverage)}",
        "settings of this residual for the control step:",
        outcome.residual.settings(),
        kind_sentence(outcome.name, member.kind, member.likelihoods),
    )
    for warning in skill_warnings(outcome.name, OURS, outcome.skill):
        say(console, warning, style="yellow")


def _errors(errors: NDArray[np.float64]) -> str:
    return ", ".join(f"{error:.4f}" for error in errors)


def _shares(shares: NDArray[np.float64]) -> str:
    return ", ".join(f"{100 * share:.1f} %" for share in shares)
