"""The evaluation report: `report.html`, PNG and CSV files from outcomes."""

from __future__ import annotations

import csv
import io
from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.evaluation import (
    disturbances,
    figures,
    fleet_roads,
    hidden_ice,
    report_texts,
    unknown_roads,
)
from egp_service.evaluation.claims import POOLED, check
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE
from egp_service.evaluation.entry_speed import SLOWEST
from egp_service.evaluation.experiments import (
    EXPERIMENTS,
    HIDDEN_ICE,
    OBSTACLE_AVOIDANCE,
    REPLAYED,
    VARIANTS,
)
from egp_service.evaluation.html import (
    Section,
    claim_table,
    group_table,
    interval,
    page,
    plain_table,
)
from egp_service.evaluation.prediction import SURFACES
from egp_service.evaluation.scaling import PAPER
from egp_service.evaluation.statistics import grouped, median
from egp_service.files import file_name, write_text
from egp_service.simulation.report import draw_comparison, draw_errors, draw_weights

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from egp_service.evaluation.campaign import Outcome
    from egp_service.evaluation.entry_speed import EntrySpeed
    from egp_service.evaluation.experiment import Trial
    from egp_service.evaluation.hidden_ice import IceOutcome
    from egp_service.evaluation.prediction import PredictionOutcome
    from egp_service.evaluation.scaling import StepTime
    from egp_service.evaluation.statistics import Group, Interval
    from egp_service.simulation.closed_loop import Run


def write_report(
    folder: Path,
    command: str,
    library: Path,
    *,
    plant: str | None,
    outcomes: Sequence[Outcome],
    predictions: Sequence[PredictionOutcome],
    speeds: Sequence[EntrySpeed],
    ice: Sequence[IceOutcome],
    times: Sequence[StepTime],
    drives: dict[str, list[tuple[Trial, Run]]],
) -> Path:
    """Write report, figures and tables into `folder`.

    `library` and `plant`, one's own simulator, are those of the `command`. `drives` are runs to
    draw, by experiment. Figures and tables without data here, which an earlier report may have
    written, are left as they are.
    """
    _write_csv(folder / "runs.csv", [asdict(o) for o in outcomes])
    _write_csv(folder / "prediction.csv", [asdict(p) for p in predictions])
    _write_csv(folder / "entry-speeds.csv", [asdict(s) for s in speeds])
    _write_csv(folder / "hidden-ice.csv", [asdict(i) for i in ice])
    _write_csv(folder / "step-times.csv", [asdict(t) for t in times])
    groups = grouped(outcomes)
    sections = [
        Section(
            "Claims", report_texts.CLAIMS, tables=(claim_table(check(outcomes, predictions, ice)),)
        ),
        Section("Where this differs from the paper", report_texts.DIFFERENCES),
    ]
    if best := headline(outcomes):
        table = plain_table(HEADLINE, best)
        sections.append(Section("Best controllers", report_texts.BEST, tables=(table,)))
    if regret := _regret_section(groups):
        sections.append(regret)
    if predictions:
        sections.append(_prediction_section(folder, predictions))
    for experiment in EXPERIMENTS:
        own = [g for g in groups if g.experiment == experiment.name]
        if own:
            shown = drives.get(experiment.name, [])
            sections.append(_section(folder, experiment.name, own, outcomes, shown))
        if own and experiment.name == "friction-step":
            sections.append(_resolution_section(outcomes))
    if ice:
        table = plain_table(hidden_ice.HEADS, hidden_ice.rows(ice))
        sections.append(Section(HIDDEN_ICE.title, HIDDEN_ICE.question, tables=(table,)))
    if speeds:
        sections.append(_entry_speed_section(folder, speeds))
    if times:
        sections.append(_step_time_section(folder, times))
    report = folder / "report.html"
    write_text(
        report,
        page("Ensemble GP-MPC: evaluation", report_texts.about(command, library, plant), sections),
    )
    return report


HEADLINE: Final = ("experiment", "condition", ENSEMBLE, "best baseline", ORACLE)
"""Heads of the rows of `headline`."""
_REASONS: Final = 3
# The reference speeds that stand for the ensemble where it is the model of all controllers.
_STANDING: Final = (f"{unknown_roads.BELIEF}5%", fleet_roads.SECOND)


def headline(outcomes: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """Return rows `experiment, condition, ensemble, best baseline, oracle`."""
    groups = grouped(outcomes)
    rows: list[tuple[str, ...]] = []
    for name, condition in dict.fromkeys((g.experiment, g.condition) for g in groups):
        here = [g for g in groups if (g.experiment, g.condition) == (name, condition)]
        named = {g.contender: g for g in here}
        own = next((n for n in (ENSEMBLE, *_STANDING) if n in named), None)
        if own is None:
            continue
        timed = own != ENSEMBLE
        alike = {own, *VARIANTS, *fleet_roads.MAPS, ORACLE}
        others = [
            g
            for g in here
            if g.contender not in alike and not g.contender.startswith(unknown_roads.BELIEF)
        ]
        best = max(
            others,
            key=lambda g: (g.completed, -(g.time if timed else g.lateral_rms).value),
            default=None,
        )
        rows.append(
            (
                name,
                f"{condition}, {own}" if timed else condition,
                _cell(named.get(own), timed=timed),
                f"{_cell(best, timed=timed)} {best.contender}" if best else "-",
                _cell(named.get(ORACLE), timed=timed),
            )
        )
    return rows


def _cell(group: Group | None, *, timed: bool) -> str:
    if group is None:
        return "-"
    through = f"{group.completed}/{group.runs}"
    if timed:
        return f"{through}, {group.time.value:.1f} s" if group.completed else through
    return f"{through}, {group.lateral_rms.value:.3f} m"


def why_lost(outcomes: Sequence[Outcome | IceOutcome]) -> list[str]:
    """Return lines with the most frequent reasons of runs that did not complete."""
    lost = [o.reason for o in outcomes if not o.completed]
    if not lost:
        return []
    lines = [f"{len(lost)} of {len(outcomes)} runs did not complete. Most frequent reasons:"]
    for kind, count in Counter(reason.partition(":")[0] for reason in lost).most_common(_REASONS):
        first = next(reason for reason in lost if reason.startswith(kind)).partition(": ")[2]
        lines.append(f"- {count} of them: {kind}" + (f" (first: {first})" if first else ""))
    return lines


def _section(
    folder: Path,
    name: str,
    groups: Sequence[Group],
    outcomes: Sequence[Outcome],
    shown: Sequence[tuple[Trial, Run]],
) -> Section:
    experiment = next(e for e in EXPERIMENTS if e.name == name)
    text = experiment.question
    pictures = [figures.draw_completion(groups, folder / f"{name}.png")]
    tables = [group_table(groups)]
    if name == unknown_roads.FIRST:
        pictures.append(figures.draw_risk(groups, folder / "risk.png"))
    if rows := unknown_roads.lap_rows(groups, outcomes) if name == unknown_roads.LATER else []:
        laps = tuple(f"lap {lap + 1}" for lap in range(max(map(len, rows)) - 3))
        heads = ("lap time / oracle's", "completed", "all laps", *laps)
        tables.append(plain_table(heads, rows))
        text += report_texts.LAPS
    if name in REPLAYED:
        heads = ("reference speed", "departures", "avoidable", "came too fast")
        tables.append(plain_table(heads, unknown_roads.departure_rows(groups, name)))
        text += report_texts.DEPARTURES
    if name == disturbances.NAME:
        heads = (
            "lateral RMS, mm farther off",
            "without Gaussian processes",
            "with members of the undisturbed vehicle",
            "the latter, without a residual",
        )
        tables.append(plain_table(heads, disturbances.rows(outcomes)))
        text += report_texts.DISTURBANCES
    if name == "friction-step":
        pictures.append(figures.draw_settling(outcomes, folder / "settling.png"))
    if compared := [
        (trial.contender.name, run)
        for trial, run in shown
        if trial.condition.startswith(experiment.compared)
    ]:
        pictures.append(draw_comparison(compared, folder / f"{name}-drives.png"))
    for trial, run in shown:
        if trial.contender.name == ENSEMBLE:
            at = f"{name}, {trial.condition}"
            place = folder / "drives" / file_name(at)
            pictures += [
                draw_weights(run, place.with_suffix(".weights.png"), at),
                draw_errors(run, place.with_suffix(".errors.png"), at),
            ]
    settling = [
        t for o in outcomes if o.experiment == name and o.contender == ENSEMBLE for t in o.settling
    ]
    if settling and name != "friction-step":  # which has a claim for each condition
        text += (
            f" The ensemble's weights settled after {np.median(settling):.2f} s (median of "
            f"{len(settling)} friction changes under excitation; 90 % within "
            f"{np.percentile(settling, 90):.2f} s)."
        )
    return Section(experiment.title, text, tuple(pictures), tuple(tables))


def _resolution_section(outcomes: Sequence[Outcome]) -> Section:
    found: dict[str, list[float]] = {}
    for outcome in outcomes:
        if outcome.resolution is not None:
            found.setdefault(outcome.condition, []).append(outcome.resolution)
    rows = [(condition, f"{np.median(each):.2f}") for condition, each in found.items()]
    return Section(
        "Accuracy of the friction from one window",
        "Smallest standard deviation of an estimate of the friction from one window (Cramér-Rao "
        "bound, median over seeds). The noise is that of the sensors plus white noise of half of "
        "the members' training error, the smallest that the weights consider. The friction step "
        "is from 1.1 to 0.5. If the standard deviation exceeds a quarter of the step, the weights "
        "drift; a longer window would delay them instead.",
        tables=(plain_table(("condition", "standard deviation of μ"), rows),),
    )


def _regret_section(groups: Sequence[Group]) -> Section | None:
    """Compare the ensemble with the oracle, with a row for each condition that both drove."""
    oracle = {(g.experiment, g.condition): g for g in groups if g.contender == ORACLE}
    rows = [
        (
            f"{g.experiment}, {g.condition}",
            f"{g.completed}/{g.runs}",
            f"{best.completed}/{best.runs}",
            interval(g.regret, 2),
            interval(g.time_regret),
        )
        for g in groups
        if g.contender == ENSEMBLE and (best := oracle.get((g.experiment, g.condition)))
    ]
    if not rows:
        return None
    heads = ("condition", "completed", "oracle completed", "lateral RMS / oracle's")
    return Section(
        "Regret against the oracle",
        "Cost of estimating the friction: median ratios of the ensemble to the oracle, which "
        "interpolates the members at the true friction, over the seeds that both completed. Below "
        "1 the estimated weights are better than this interpolation. The tables below contain the "
        "ratios of every controller.",
        tables=(plain_table((*heads, "time / oracle's"), rows),),
    )


def _entry_speed_section(folder: Path, speeds: Sequence[EntrySpeed]) -> Section:
    surfaces = list(dict.fromkeys(s.condition for s in speeds))
    medians = {
        (contender, surface): median(
            [s.speed for s in speeds if (s.contender, s.condition) == (contender, surface)]
        )
        for contender in dict.fromkeys(s.contender for s in speeds)
        for surface in surfaces
    }

    def cell(found: Interval) -> str:
        if found.value < SLOWEST:
            return f"below {SLOWEST:g}"
        return found.text(".2f")

    rows = [
        (contender, *(cell(medians[contender, surface]) for surface in surfaces))
        for contender in dict.fromkeys(contender for contender, _ in medians)
    ]
    return Section(
        OBSTACLE_AVOIDANCE.title,
        OBSTACLE_AVOIDANCE.question,
        (figures.draw_entry_speeds(medians, folder / f"{OBSTACLE_AVOIDANCE.name}.png"),),
        (plain_table(("highest entry speed, m/s", *surfaces), rows),),
    )


def _step_time_section(folder: Path, times: Sequence[StepTime]) -> Section:
    text = "Both programs get the same requests and libraries of copies of the same members."
    if not any(t.program == PAPER for t in times):
        text += (
            " The paper's stack was not timed because its extras are missing; install them with "
            "<code>pip install 'egp-service[train,paper]'</code>."
        )
    rows = [(t.program, str(t.members), f"{t.p50_ms:.3f}", f"{t.p95_ms:.3f}") for t in times]
    return Section(
        "Computation time over the number of members (paper, experiment 6)",
        text,
        (figures.draw_scaling(times, folder / "step-times.png"),),
        (plain_table(("program", "members", "p50, ms", "p95, ms"), rows),),
    )


def _prediction_section(folder: Path, predictions: Sequence[PredictionOutcome]) -> Section:
    names = list(dict.fromkeys((p.predictor, p.tested_on, p.window) for p in predictions))
    rows = []
    for predictor, on, window in names:
        own = [
            p
            for p in predictions
            if (p.predictor, p.tested_on, p.window) == (predictor, on, window)
        ]
        columns = [
            np.array([getattr(p, name) for p in own])
            for name in ("rmse", "coverage", "coverage_mixture", "nlpd", "nlpd_mixture")
        ]
        rmse = " / ".join(_mean_and_deviation(errors) for errors in columns[0].T)
        rest = [" / ".join(f"{v:.2f}" for v in column.mean(0)) for column in columns[1:]]
        rows.append((predictor, on, str(window or "-"), rmse, *rest))
    frictions = ", ".join(f"{name} = {mu:g}" for name, mu in SURFACES.items())
    return Section(
        "Prediction error (paper, comparison with standard GP)",
        f"The letters are surfaces with the friction {frictions}. A predictor A is a GP trained "
        f"on surface A, {POOLED} one trained on both surfaces, and E(AD) the ensemble of the GPs A "
        "and D; K is the number of periods in the window of its weights. RMS errors of the changes "
        "of v_x, v_y (m/s) and ω (rad/s) over 20 ms, mean and standard deviation over seeds (with "
        "one seed the error alone); share inside the 95 % interval and negative log predictive "
        "density for the variance of eq. (3) and for the mixture variance.",
        (figures.draw_prediction(predictions, folder / "prediction.png"),),
        (
            plain_table(
                (
                    "predictor",
                    "on",
                    "K",
                    "RMS error",
                    "coverage (3)",
                    "coverage, mixture",
                    "NLPD (3)",
                    "NLPD, mixture",
                ),
                rows,
            ),
        ),
    )


def _mean_and_deviation(errors: NDArray[np.float64]) -> str:
    """Format the mean and the standard deviation of errors (n,) of n seeds; one error alone."""
    mean = f"{errors.mean():.4f}"
    return mean if len(errors) == 1 else f"{mean}±{errors.std(ddof=1):.4f}"


def _write_csv(path: Path, rows: Sequence[dict[str, object]]) -> None:
    if not rows:
        return  # An earlier report may have written the file, and no other file may hold its rows.
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {k: " ".join(map(str, v)) if isinstance(v, (tuple, list)) else v for k, v in row.items()}
        for row in rows
    )
    write_text(path, text.getvalue())
