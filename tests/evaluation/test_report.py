"""What the report says about outcomes, and how its page looks in a browser."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service._core import Library
from egp_service.evaluation.claims import POOLED, check
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE
from egp_service.evaluation.experiments import EXPERIMENTS
from egp_service.evaluation.figures import draw_scaling
from egp_service.evaluation.fleet_roads import ALONE, FLEET, SECOND, WRONG
from egp_service.evaluation.multiple_comparisons import holm
from egp_service.evaluation.prediction import PredictionOutcome
from egp_service.evaluation.scaling import StepTime
from egp_service.evaluation.summary_report import HEADLINE, headline, why_lost, write_report
from egp_service.evaluation.unknown_roads import ASSUMED, BELIEF, FIRST
from egp_service.shipped import EVALUATION_LIBRARY as SHIPPED
from outcome_example import OUTCOME

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from playwright.sync_api import Browser

    from egp_service.evaluation.campaign import Outcome

WIDTH = 1280
BASELINE = "fitted single-track"
ERRORS = {
    ENSEMBLE: 0.025,
    "selection": 0.042,
    BASELINE: 0.022,
    "forward Euler": 0.001,
    ORACLE: 0.02,
}


def outcome(experiment: str, contender: str, error: float, seed: int = 0) -> Outcome:
    return replace(
        OUTCOME,
        experiment=experiment,
        condition="95% of grip",
        contender=contender,
        seed=seed,
        time=21.125,
        lap_times=(21.125,),
        lateral_max=3.0 * error,
        lateral_rms=error,
    )


def report_of(outcomes: list[Outcome], folder: Path) -> Path:
    return write_report(
        folder,
        "egp evaluate",
        SHIPPED,
        plant=None,
        outcomes=outcomes,
        predictions=[],
        speeds=[],
        ice=[],
        times=[],
        drives={},
    )


@pytest.fixture
def outcomes() -> list[Outcome]:
    return [
        outcome("varying-speed", name, error, seed)
        for name, error in ERRORS.items()
        for seed in range(3)
    ]


def test_terminal_and_report_have_the_same_best_baseline(
    outcomes: list[Outcome], tmp_path: Path
) -> None:
    (row,) = headline(outcomes)
    assert dict(zip(HEADLINE, row, strict=True))["best baseline"] == f"3/3, 0.022 m {BASELINE}"
    report = report_of(outcomes, tmp_path).read_text(encoding="utf-8")
    cells = "".join(f"<td>{cell}</td>" for cell in row)
    assert f"<tr>{cells}</tr>" in report
    # Runs of several laps, or of a part of a road, have no single lap time.
    assert "<th>time, s</th>" in report
    assert "lap time" not in report


@pytest.mark.parametrize(
    ("experiment", "best"),
    [
        ("varying-speed", "fitted single-track"),
        ("narrow-track", None),
        ("disturbances", "fitted single-track, undisturbed data"),
    ],
)
def test_variants_of_the_ensemble_are_no_baselines(experiment: str, best: str | None) -> None:
    (chosen,) = (e for e in EXPERIMENTS if e.name == experiment)
    # Among the baselines the last one is the closest; variants are closer than all of them.
    found = [
        outcome(experiment, c.name, 0.001 if c.variant else 0.1 / (1 + number))
        for number, c in enumerate(chosen.contenders)
    ]
    assert any(c.variant for c in chosen.contenders)
    (row,) = headline(found)
    cell = dict(zip(HEADLINE, row, strict=True))["best baseline"]
    assert cell == "-" if best is None else cell.endswith(f" m {best}")


def test_a_variant_that_is_closer_breaks_the_claim_about_other_controllers(
    outcomes: list[Outcome],
) -> None:
    def claimed(found: list[Outcome]) -> tuple[bool | None, str]:
        (claim,) = (c for c in check(found, []) if c.text.startswith("No other controller but"))
        return claim.holds, claim.evidence

    outcomes = [replace(one, seed=one.seed + 3 * n) for one in outcomes for n in range(4)]
    where = "varying-speed, 95% of grip"
    broken = (
        False,
        f"{where}: {BASELINE} by 3.0 mm; {where}: forward Euler by 24.0 mm",
    )
    assert claimed(outcomes) == broken
    far = [one for one in outcomes if one.contender in {ENSEMBLE, "selection", ORACLE}]
    assert claimed(far) == (True, "in none")
    # Of three seeds even three gains have a probability of an eighth.
    undecided = (None, "too few seeds that both completed")
    assert claimed([one for one in outcomes if one.seed < 3]) == undecided
    # Errors that differ more between seeds than between controllers are compared seed by seed.
    spread = [replace(one, lateral_rms=one.lateral_rms + 0.1 * one.seed) for one in outcomes]
    assert claimed(spread) == broken
    # A controller that loses a vehicle is not better where it drives closer.
    fast = [
        replace(one, completed=False) if one.contender != ENSEMBLE and one.seed == 0 else one
        for one in outcomes
    ]
    assert claimed(fast) == (True, "in none")
    lost = [
        replace(one, completed=False) if one.contender == ENSEMBLE and one.seed == 0 else one
        for one in outcomes
        if one.contender in {ENSEMBLE, "selection"}
    ]
    assert claimed(lost) == (False, f"{where}: selection")


def test_controllers_that_are_equal_break_the_claim_in_few_campaigns() -> None:
    def holds(campaign: int) -> bool:
        noise = np.random.default_rng(campaign).normal(0.02, 0.002, (9, 20))
        found = [
            outcome("varying-speed", ENSEMBLE if number == 0 else f"other {number}", error, seed)
            for number, errors in enumerate(noise)
            for seed, error in enumerate(errors)
        ]
        (claim,) = (c for c in check(found, []) if c.text.startswith("No other controller but"))
        assert claim.holds is not None
        return claim.holds

    assert sum(holds(campaign) for campaign in range(40)) >= 36


@pytest.mark.parametrize(
    ("p_values", "rejected"),
    [
        ([], []),
        ([0.05], [True]),
        ([0.04, 0.03], [False, False]),
        ([0.04, 0.02], [True, True]),
        ([0.2, 0.001, 0.03], [False, True, False]),
    ],
)
def test_holms_procedure_ends_at_the_first_value_above_its_level(
    p_values: list[float], rejected: list[bool]
) -> None:
    assert holm(p_values) == rejected


def test_errors_of_predictions_have_the_deviation_of_a_sample_of_seeds(tmp_path: Path) -> None:
    def report(*errors: float) -> str:
        none = [0.0] * 3
        predictions = [
            PredictionOutcome(name, on, int(name[0] == "E"), seed, [error] * 3, *[none] * 4)
            for seed, error in enumerate(errors)
            for name, on in (
                *(("A", "A"), ("D", "D"), ("A", "D"), ("D", "A"), (POOLED, POOLED)),
                *(("E(AD)", POOLED), ("E(AD)", "T"), ("E(ABD)", "T"), ("E(ABCD)", "T")),
            )
        ]
        return write_report(
            tmp_path,
            "egp evaluate",
            SHIPPED,
            plant=None,
            outcomes=[],
            predictions=predictions,
            speeds=[],
            ice=[],
            times=[],
            drives={},
        ).read_text(encoding="utf-8")

    assert "<td>0.1500±0.0707 / 0.1500±0.0707 / 0.1500±0.0707</td>" in report(0.1, 0.2)
    assert "<td>0.1000 / 0.1000 / 0.1000</td>" in report(0.1)


def test_a_picture_is_whole_or_as_before(
    tmp_path: Path, interrupted_pictures: Callable[[], None]
) -> None:
    path = tmp_path / "step-times.png"
    times = [StepTime("egp", members, 0.1, 0.2) for members in (1, 2)]
    drawn = draw_scaling(times, path).read_bytes()
    interrupted_pictures()
    with pytest.raises(KeyboardInterrupt):
        draw_scaling(times, path)
    assert path.read_bytes() == drawn


def test_a_claim_without_data_neither_holds_nor_fails(tmp_path: Path) -> None:
    still = [outcome("friction-step", ENSEMBLE, 0.02)]
    settling = [claim for claim in check(still, []) if "settle" in claim.text]
    assert [claim.holds for claim in settling] == [None] * len(settling)
    report = report_of(still, tmp_path).read_text(encoding="utf-8")
    assert "<td>no data</td>" in report  # the time after a change of friction
    moved = [replace(one, settling=(3.0,)) for one in still]
    settling = [claim for claim in check(moved, []) if "settle" in claim.text]
    assert not any(claim.holds for claim in settling)


def test_the_page_is_not_wider_than_a_small_screen(
    outcomes: list[Outcome], browser: Browser, tmp_path: Path
) -> None:
    # The widest names and figures of the evaluation.
    outcomes += [
        replace(one, contender="nominal single-track", lateral_max=12.345, off_track=15.25)
        for one in outcomes[:3]
    ]
    report = report_of(outcomes, tmp_path)
    page = browser.new_page(viewport={"width": WIDTH, "height": 900})
    page.goto(report.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") == WIDTH
    heights = page.evaluate(
        "[...document.querySelectorAll('table.numbers td')].map(cell => cell.clientHeight)"
    )
    assert len(heights) > 10 * len(ERRORS)
    assert max(heights) < 30, "a cell has two lines"
    page.get_by_role("link", name="Best controllers").click()
    assert page.evaluate("location.hash") == "#section-2"
    page.close()


def test_a_report_leaves_what_it_does_not_contain(outcomes: list[Outcome], tmp_path: Path) -> None:
    def report(times: list[StepTime], runs: list[Outcome]) -> None:
        write_report(
            tmp_path,
            "egp evaluate",
            SHIPPED,
            plant=None,
            outcomes=runs,
            predictions=[],
            speeds=[],
            ice=[],
            times=times,
            drives={},
        )

    report([StepTime("egp", members, 0.1, 0.2) for members in (1, 2)], [])
    kept = {file.name: file.read_bytes() for file in tmp_path.glob("step-times.*")}
    assert sorted(kept) == ["step-times.csv", "step-times.png"]
    report([], outcomes)
    runs = (tmp_path / "runs.csv").read_bytes()
    assert {file.name: file.read_bytes() for file in tmp_path.glob("step-times.*")} == kept
    report([], [])
    assert (tmp_path / "runs.csv").read_bytes() == runs


def test_the_report_says_what_a_simulator_of_ones_own_does_not_drive(tmp_path: Path) -> None:
    def about(plant: str | None) -> str:
        report = write_report(
            tmp_path,
            "egp evaluate",
            SHIPPED,
            plant=plant,
            outcomes=[],
            predictions=[],
            speeds=[],
            ice=[],
            times=[],
            drives={},
        )
        return " ".join(report.read_text(encoding="utf-8").split())

    own = about("a:B")
    assert "All runs use the simulator <code>a:B</code>, except those of <i>prediction</i>" in own
    assert "the simulator <code>" not in about(None)


def test_the_report_names_library_vehicle_and_members(tmp_path: Path) -> None:
    report = " ".join(report_of([], tmp_path).read_text(encoding="utf-8").split())
    library = Library.load(SHIPPED)
    told = f"<code>{SHIPPED}</code> (SHA-256 {library.id}) of the vehicle <i>commonroad-1</i> of "
    assert f"{told}1225.89 kg, with the members <i>mu 0.5</i>, <i>mu 0.6</i>," in report


def test_reference_speeds_have_a_row_with_their_times() -> None:
    def driven(experiment: str, times: Mapping[str, float | None]) -> list[Outcome]:
        return [
            replace(
                outcome(experiment, name, 0.02),
                condition="first lap",
                completed=time is not None,
                time=time or 1.0,
            )
            for name, time in times.items()
        ]

    times = {ORACLE: 50.0, f"{BELIEF}3%": 61.0, f"{BELIEF}5%": 60.0}
    sources = {f"{ASSUMED}0.3": 90.0, f"{ASSUMED}0.4": 80.04, f"{ASSUMED}0.6": None}
    maps = {ORACLE: 50.0, ALONE: 60.0, SECOND: 55.0, WRONG: 51.0}
    assert headline([*driven(FIRST, {**times, **sources}), *driven(FLEET, maps)]) == [
        (
            FIRST,
            "first lap, found, risk 5%",
            "1/1, 60.0 s",
            "1/1, 80.0 s assumed 0.4",
            "1/1, 50.0 s",
        ),
        (FLEET, "first lap, map of one car", "1/1, 55.0 s", "1/1, 60.0 s no map", "1/1, 50.0 s"),
    ]
    lost: dict[str, float | None] = dict.fromkeys((ORACLE, f"{BELIEF}5%"))
    (row,) = headline(driven(FIRST, lost))
    assert row[2:] == ("0/1", "-", "0/1")


def test_reasons_of_lost_runs_are_told_by_their_number(outcomes: list[Outcome]) -> None:
    assert not why_lost(outcomes)
    beside = [f"more than 3 m beside the path: {error} m" for error in ("+3.02", "-3.10")]
    reasons = ["took too long", *beside, "lost control: a:B", "stopped by the gate: no plan"]
    lost = [replace(OUTCOME, completed=False, reason=reason) for reason in reasons]
    assert why_lost([*outcomes, *lost]) == [
        "5 of 20 runs did not complete. Most frequent reasons:",
        "- 2 of them: more than 3 m beside the path (first: +3.02 m)",
        "- 1 of them: took too long",
        "- 1 of them: lost control (first: a:B)",
    ]
