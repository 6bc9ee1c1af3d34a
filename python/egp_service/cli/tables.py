"""Tables for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from rich import box
from rich.markup import escape

from egp_service.cli.narrow_table import NarrowTable
from egp_service.data.alignment import Delays
from egp_service.quantities import GP_OUTPUT, MOTION, STATE
from egp_service.training.open_loop import NO_CHANGE
from egp_service.training.validation import ROLLOUT

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.table import Table

    from egp_service.simulation.summary import Summary
    from egp_service.training.open_loop import Skill
    from egp_service.training.validation import Cell

_SYMBOLS: Final = (
    "m in kg; l_f, l_r, height h in m; k² = I_z / m in m²; D, B, C: peak, stiffness and shape of "
    "the front (f) and rear (r) tyres' lateral force; D_d, D_b: friction for drive and braking; e: "
    "how much these reduce the lateral force"
)
_RESISTANCE: Final = "; c_0: rolling resistance in m/s², c_2: drag in 1/m"
_INTERVALS: Final = (
    ". From prior: in standard deviations of the prior. The intervals tell how well the data "
    "determine these numbers; the error of the single-track equations is not in them "
    "(docs/your-car.md)."
)
_COVERED: Final = 0.8
"""Share of held-out data in the 95 % intervals below which a member is badly calibrated."""
_FAR: Final = 3.0
"""Standard deviations of the prior beyond which a fitted parameter is implausible."""
_MISFIT: Final = 1.0
"""Median misfit above which the members do not predict the vehicle. With no systematic error it is
0.79; docs/problem.md, section 8, has those of several vehicles."""
MOTION_NAMES: Final = tuple(list(STATE)[column] for column in MOTION)


def narrow_table(*heads: str, wrapped: Sequence[str] = (), title: str | None = None) -> Table:
    """Return an empty table for 80 columns, whose rows have no line breaks but in `wrapped`."""
    table = NarrowTable(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for head in heads:
        table.add_column(head, no_wrap=head not in wrapped)
    return table


def summary_table(rows: Sequence[tuple[str, Summary]]) -> Table:
    """Return a table with a row for each run: result, errors and times."""
    table = NarrowTable(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("run", overflow="fold")
    table.add_column("result", width=len("completed"))
    for header in (
        "time\ns",
        "lateral, m\nmax/RMS",
        "speed, m/s\nmean/error",
        "step, ms\np50/p99",
        "late",
    ):
        table.add_column(header, justify="right", no_wrap=True)
    for label, summary in rows:
        ending = summary.ending
        result = "[green]completed[/]"
        if not ending.completed:
            result = f"[red]{ending.reason.partition(':')[0]} after {ending.distance:.0f} m[/]"
        table.add_row(
            escape(label),
            result,
            f"{ending.time:.1f}",
            f"{summary.lateral_error.max:.2f}/{summary.lateral_error.rms:.2f}",
            f"{summary.mean_speed:.1f}/{summary.speed_error.rms:.2f}",
            "/".join(_milliseconds(summary.step_time_ms[name]) for name in ("p50", "p99")),
            f"{summary.deadline_misses}",
        )
    return table


def _milliseconds(time: float) -> str:
    """Return a time of less than 1 ms to the microsecond, and a longer one to 0.1 ms."""
    return f"{time:.3f}" if time < 1.0 else f"{time:.1f}"


def why_ended(summary: Summary) -> str | None:
    """Say what the table leaves out of the reason for an early end; `None` if it has all of it."""
    reason = summary.ending.reason
    return f"The run ended early. {reason[0].upper()}{reason[1:]}" if ":" in reason else None


def no_plan(summary: Summary) -> str | None:
    """Say why periods had no plan, with the most frequent reason; `None` if most had one."""
    missing = summary.periods - summary.solver_statuses.get("solved", 0)
    if 2 * missing <= summary.periods:
        return None
    reason = next(iter(summary.no_plan_reasons))
    return f"No plan in {missing} of {summary.periods} periods: {reason}"


def misfit(summary: Summary) -> str | None:
    """Say that the members do not predict the vehicle of a run; None if they do."""
    found = summary.friction
    if found is None or found.misfit is None or found.misfit <= _MISFIT:
        return None
    return (
        "The members of the library do not predict this drive: the median misfit is "
        f"{found.misfit:.1f}, and without a systematic error 0.8 (docs/problem.md, section 8). Do "
        "not trust the friction that was found; train a library for this vehicle, its load, its "
        "speeds and these surfaces"
    )


def validation_table(matrix: list[list[Cell]]) -> Table:
    """Return the matrix for the terminal, a row for each member, surface and output."""
    heads = ("member", "on surface", "output", "RMSE", "NLPD", "in 95 %", f"after {ROLLOUT:g} s")
    table = narrow_table(
        *heads, wrapped=heads[:2], title="Validation on held-out trajectories (m/s, rad/s)"
    )
    for row in matrix:
        for cell in row:
            names = (escape(cell.member), escape(cell.surface))
            for output, *values in zip(
                GP_OUTPUT, cell.rmse, cell.nlpd, cell.coverage, cell.rollout, strict=True
            ):
                rmse, nlpd, coverage, rollout = values
                table.add_row(
                    *names,
                    output,
                    f"{rmse:.4f}",
                    f"{nlpd:.2f}",
                    f"{coverage:.2f}",
                    f"{rollout:.3f}",
                    style="bold" if cell.member == cell.surface else "",
                )
                names = ("", "")
        table.add_section()
    return table


def headline_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Return a table of the best controllers, a row for each condition of an experiment."""
    table = narrow_table(*heads, wrapped=("condition", "best baseline"))
    for row in rows:
        table.add_row(*row)
    return table


def map_summary(origins: Mapping[str, float], trust: float | None) -> str:
    """Say whose evidence about the road was used, how old it is, and whether it fits the road."""
    if not origins or trust is None:
        return "The fleet's map has no evidence about this road yet"
    vehicles = ", ".join(f"{name} ({age:.0f} s ago)" for name, age in sorted(origins.items()))
    return f"The fleet's map has evidence of {vehicles}; it describes the road with {trust:.0%}"


def vehicle_table(label: str, parameters: Mapping[str, Mapping[str, float | bool]]) -> Table:
    """Return a table with a row for each parameter of a fitted vehicle, of `FittedVehicle.summary`.

    `from prior` is the distance from the vehicle file, or from vehicles in general, in standard
    deviations of the prior.
    """
    table = narrow_table(
        *("parameter", "value", "95 % interval", "from prior", ""),
        wrapped=("",),
        title=escape(f"{label}: the fitted vehicle"),
    )
    table.caption = _SYMBOLS + (_RESISTANCE if "c_0" in parameters else "") + _INTERVALS
    table.caption_justify = "left"
    for name, found in parameters.items():
        remarks = []
        if found.get("assumed"):
            remarks.append("not determined by the data: scales with the mass of the import")
        elif not found["determined"]:
            remarks.append("not determined by the data")
        if found["at_bound"]:
            remarks.append("[yellow]at the end of the range[/]")
        table.add_row(
            escape(name),
            f"{found['value']:.4g}",
            f"{found['low']:.4g} to {found['high']:.4g}",
            f"{found['distance']:+.1f}",
            ", ".join(remarks),
        )
    return table


def calibration_warnings(matrix: list[list[Cell]], *, simulated: bool) -> list[str]:
    """Return a sentence for each member whose intervals hold too little of its own surface."""
    units = "" if simulated else ", or check the units of the log"
    return [
        f"{cell.member}: the 95 % interval of {list(GP_OUTPUT)[int(cell.coverage.argmin())]} holds "
        f"{cell.coverage.min():.0%} of the held-out data: the intervals are too narrow; collect "
        f"more data{units}"
        for row in matrix
        for cell in row
        if cell.member == cell.surface and cell.coverage.min() < _COVERED
    ]


def prior_warnings(
    label: str, parameters: Mapping[str, Mapping[str, float | bool]], *, simulated: bool
) -> list[str]:
    """Return a sentence if parameters of `FittedVehicle.summary` are far from their priors."""
    far = {name: p["distance"] for name, p in parameters.items() if abs(p["distance"]) > _FAR}
    if not far:
        return []
    listed = ", ".join(f"{name} ({distance:+.1f})" for name, distance in far.items())
    if simulated:
        reason = "the simulated car is no single-track vehicle (docs/your-car.md)"
    elif far.keys() == {"h"}:
        reason = (
            "no file states the height of the centre of mass, whose prior is that of usual cars; "
            "part of it can be the error of the single-track equations (docs/your-car.md)"
        )
    else:
        reason = (
            "check the units of the log, and the vehicle's file; part of it can be the error of "
            "the single-track equations (docs/your-car.md)"
        )
    return [f"{label}: more than {_FAR:g} standard deviations from the prior: {listed}; {reason}"]


def skill_table(label: str, skill: Skill) -> Table:
    """Return a table with a row for each predictor and output, and a column for each duration.

    The predictors' errors are RMS values in m/s and rad/s; those above no change's are red.
    """
    table = narrow_table(
        *("predictor", "output", *(f"{duration:g} s" for duration in skill.durations)),
        "likelihood",
        wrapped=("predictor",),
        title=escape(f"{label}: errors on held-out data after"),
    )
    for name, errors in skill.rms.items():
        cells = (escape(name), f"{skill.likelihood[name]:+.2f}")
        for column, output in enumerate(MOTION_NAMES):
            values = [
                f"[red]{error:.4f}[/]" if error > least else f"{error:.4f}"
                for error, least in zip(
                    errors[:, column], skill.rms[NO_CHANGE][:, column], strict=True
                )
            ]
            table.add_row(cells[0], output, *values, cells[1])
            cells = ("", "")
    return table


def delay_sentence(delays: Delays | None) -> str:
    """Return a sentence that says by what inputs were moved before training; None: simulated."""
    if delays is None:
        return "the data are simulated: inputs are used as they are"
    if delays == Delays():
        return "no delay of the log is known: its inputs are used as they are"
    moved = (
        f"inputs are moved before training: steering by {delays.measurement:+.3f} s, because the "
        f"measured states are late, and the force by {delays.force:+.3f} s"
    )
    if delays.force_filter == 0.0:
        return moved
    return (
        f"{moved}; the force has passed a low-pass filter of {delays.force_filter:.2f} s, which is "
        "taken back. It was made from a measured acceleration: errors of v_x are not those of a "
        "prediction, and the mass is the one that the import assumed"
    )


def kind_sentence(label: str, kind: str, likelihoods: Mapping[str, float]) -> str:
    """Return a sentence about a member's kind, given the held-out likelihoods of all kinds.

    `likelihoods` are in nats per error. The sentence says which kind predicts best, and by how much
    better, if the chosen one is a single-track vehicle that was preferred for other reasons.
    """
    best = max(likelihoods, key=lambda name: likelihoods[name])
    behind = likelihoods[best] - likelihoods[kind]
    if behind <= 0.0:
        return f"{label}: {kind} predicts held-out blocks best"
    return (
        f"{label}: {kind} is chosen because it also predicts slides outside the data; {best} "
        f"predicts held-out blocks better, by {behind:.3f} nats per error"
    )


def skill_warnings(label: str, name: str, skill: Skill) -> list[str]:
    """Return a sentence for each output and duration in which a predictor is worse than no change.

    Without a duration, because the data have no transition that counts, one sentence says so.
    """
    if not skill.durations:
        least = f"{skill.least_speed:.3g} m/s"
        return [f"{label}: the held-out data have no transitions above {least} to compare on"]
    return [
        f"{label}: no skill in {output} after {duration:g} s: the error is {ours:.4f}, "
        f"that of no change {least:.4f}"
        for duration, own, without in zip(
            skill.durations, skill.rms[name], skill.rms[NO_CHANGE], strict=True
        )
        for output, ours, least in zip(MOTION_NAMES, own, without, strict=True)
        if ours > least
    ]
