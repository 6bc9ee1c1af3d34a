"""The quick evaluation runs from end to end, and bears out what docs/results.md says."""

from __future__ import annotations

import csv
import re
from math import inf
from statistics import median
from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from egp_service.cli import app
from egp_service.evaluation import experiments
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE
from egp_service.evaluation.experiment import NOISE
from egp_service.evaluation.experiments import EXACT
from egp_service.evaluation.scaling import OURS, PAPER
from egp_service.evaluation.unknown_roads import ASSUMED, BELIEF, FIRST, HERE, WEIGHTED
from fewer_contenders import others_once, with_contenders

if TYPE_CHECKING:
    from pathlib import Path

    from egp_service.evaluation.experiment import ClosedLoopExperiment

Rows = list[dict[str, str]]

# Those that the tests below read, and one of each other kind. The remaining ones drive the same
# code on more roads.
EXPERIMENTS = (
    "prediction",
    "varying-speed",
    "lane-change",
    "four-members",
    "friction-step",
    "unseen-track",
    "narrow-track",
    "unknown-roads",
    "hidden-ice",
    "iso-3888-2",
    "step-times",
)
# The contenders of some of them: those that the tests read, and one of each other kind. All
# contenders drive the lane changes and between the cones.
CONTENDERS = {
    "varying-speed": (ENSEMBLE, ORACLE),
    "four-members": (ENSEMBLE, ORACLE),
    "friction-step": (ENSEMBLE,),
    "unseen-track": (ENSEMBLE, ORACLE),
    "narrow-track": (ENSEMBLE, "caution 2"),
    FIRST: (
        ORACLE,
        f"{BELIEF}5%",
        f"{ASSUMED}0.4",
        f"{HERE}80% of it, at most 0.5",
        f"{WEIGHTED}80% of it",
    ),
    "hidden-ice": (f"{BELIEF}5%",),
}


def fewer(experiment: ClosedLoopExperiment) -> ClosedLoopExperiment:
    if experiment.name == "lane-change":
        return others_once(experiment)
    names = CONTENDERS.get(experiment.name)
    return with_contenders(experiment, *names) if names else experiment


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("evaluation")
    chosen = [option for name in EXPERIMENTS for option in ("-e", name)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiments, "EXPERIMENTS", tuple(map(fewer, experiments.EXPERIMENTS)))
        patch.setattr(experiments, "HIDDEN_ICE", fewer(experiments.HIDDEN_ICE))
        result = CliRunner().invoke(app, ["evaluate", "--quick", "-o", str(output), *chosen])
    assert result.exit_code == 0, result.output
    return output


@pytest.fixture(scope="module")
def runs(folder: Path) -> Rows:
    return list(csv.DictReader((folder / "runs.csv").read_text(encoding="utf-8").splitlines()))


def test_the_report_stands_alone(folder: Path) -> None:
    report = (folder / "report.html").read_text(encoding="utf-8")
    sources = re.findall(r'src="([^"]{0,30})', report)
    assert len(sources) > 10
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert '<a href="#section-0">Claims</a>' in report
    assert '<h2 id="section-0">Claims</h2>' in report
    # The paper's pictures of the ensemble, with changes in corners and on straights among them.
    for kind in ("weights", "errors"):
        for condition in ("changes-in-corners", "changes-on-straights"):
            assert (folder / "drives" / f"four-members-{condition}.{kind}.png").exists()
            assert f'alt="four-members-{condition}.{kind}"' in report
    assert "Accuracy of the friction from one window" in report


def test_the_ensemble_completes_the_papers_scenarios_up_to_nine_tenths_of_the_grip(
    runs: Rows,
) -> None:
    papers = {"varying-speed", "unseen-track", "lane-change", "four-members"}
    own = [
        row
        for row in runs
        if row["contender"] == ENSEMBLE
        and row["experiment"] in papers
        and row["condition"] not in {"95% of grip", "100% of grip"}
    ]
    assert {row["experiment"] for row in own} == papers
    lost = [row for row in own if row["completed"] != "True"]
    assert not lost, lost
    # Closer than positions are measured.
    assert max(float(row["lateral_rms"]) for row in own) < NOISE.position


def test_the_ensemble_stays_on_the_path_at_the_end_of_the_grip(runs: Rows) -> None:
    own = [
        float(row["lateral_rms"])
        for row in runs
        if (row["experiment"], row["condition"], row["contender"])
        == ("varying-speed", "100% of grip", ENSEMBLE)
    ]
    # Measured: 0.032 m. With the slopes of the processes in place of the vehicles' 0.07 m.
    assert own
    assert max(own) < 0.045


@pytest.mark.parametrize("sensors", ["", EXACT])
@pytest.mark.parametrize("acceleration", [2, 3, 4])
def test_the_ensemble_drives_over_steps_of_the_friction(
    runs: Rows, acceleration: int, sensors: str
) -> None:
    own = friction_steps(runs, acceleration, sensors)
    assert own
    lost = [row for row in own if row["completed"] != "True"]
    assert not lost, lost


@pytest.mark.parametrize("acceleration", [2, 3, 4])
def test_the_weights_settle_within_half_a_second_with_exact_sensors(
    runs: Rows, acceleration: int
) -> None:
    assert max(settling_times(runs, acceleration, EXACT), default=inf) <= 0.5


# What is not met with noise; the report says so, and how well the friction can be known at all.
UNSETTLED = pytest.mark.xfail(
    raises=AssertionError, reason="half a second of measurements says too little of the friction"
)


@pytest.mark.parametrize(
    "acceleration",
    [
        pytest.param(2, marks=UNSETTLED),
        pytest.param(
            3,
            marks=pytest.mark.xfail(
                reason="one of two seeds needs 0.52 s", raises=AssertionError, strict=True
            ),
        ),
        4,
    ],
)
def test_the_weights_settle_within_half_a_second(runs: Rows, acceleration: int) -> None:
    assert max(settling_times(runs, acceleration), default=inf) <= 0.5


def test_the_friction_is_known_the_better_the_faster_the_bend(runs: Rows) -> None:
    known = [
        median(float(row["resolution"]) for row in friction_steps(runs, acceleration))
        for acceleration in (1, 2, 3, 4)
    ]
    assert known == sorted(known, reverse=True)
    # All of a step of 0.6.
    assert known[3] < 0.06


@pytest.mark.xfail(
    reason="a window at 2 m/s² tells it to 0.138", raises=AssertionError, strict=True
)
def test_a_slow_bend_does_not_tell_the_friction_within_a_window(runs: Rows) -> None:
    rows = friction_steps(runs, 2)
    assert median(float(row["resolution"]) for row in rows) > 0.15


def friction_steps(runs: Rows, acceleration: int, sensors: str = "") -> Rows:
    """Choose the ensemble's runs."""
    return [
        row
        for row in runs
        if row["experiment"] == "friction-step"
        and row["contender"] == ENSEMBLE
        and row["condition"] == f"{acceleration} m/s² lateral{sensors}"
    ]


def settling_times(runs: Rows, acceleration: int, sensors: str = "") -> list[float]:
    """Find the ensemble's, of which every run has to have one unless it is slow and noisy."""
    own = [row["settling"].split() for row in friction_steps(runs, acceleration, sensors)]
    assert (acceleration < 3 and not sensors) or all(own)
    return [float(time) for settling in own for time in settling]


def test_the_ensemble_is_about_as_close_as_the_oracle(runs: Rows) -> None:
    errors = {
        who: {
            (row["condition"], row["seed"]): float(row["lateral_rms"])
            for row in runs
            if row["experiment"] == "varying-speed" and row["contender"] == who
        }
        for who in (ENSEMBLE, ORACLE)
    }
    gentle = [key for key in errors[ENSEMBLE] if key[0] in {"80% of grip", "90% of grip"}]
    assert gentle
    assert all(errors[ENSEMBLE][key] <= 1.2 * errors[ORACLE][key] for key in gentle), errors


def test_everyone_enters_the_lane_change_at_some_speed(folder: Path) -> None:
    rows = list(csv.DictReader((folder / "entry-speeds.csv").read_text("utf-8").splitlines()))
    assert {row["contender"] for row in rows} >= {ENSEMBLE, ORACLE, "kinematic"}
    assert all(float(row["speed"]) >= 10.0 for row in rows), rows


def test_a_step_takes_less_time_than_the_papers(folder: Path) -> None:
    rows = list(csv.DictReader((folder / "step-times.csv").read_text("utf-8").splitlines()))
    times = {(row["program"], int(row["members"])): float(row["p50_ms"]) for row in rows}
    for members in (1, 2, 4, 8):
        assert 10.0 * times[OURS, members] < times[PAPER, members]


def test_predictions_are_ordered_as_in_the_paper(folder: Path) -> None:
    rows = list(csv.DictReader((folder / "prediction.csv").read_text("utf-8").splitlines()))

    def error(predictor: str, on: str) -> list[float]:
        found = [
            row["rmse"]
            for row in rows
            if (row["predictor"], row["tested_on"]) == (predictor, on) and row["window"] in "01"
        ]
        assert len(found) == 1
        return [float(value) for value in found[0].split()]

    union = "A∪D"  # noqa: RUF001
    for output in range(3):
        assert error("A", "A")[output] < error("D", "A")[output]
        assert error("E(AD)", union)[output] < error(union, union)[output]
        two, four = error("E(AD)", "T")[output], error("E(ABCD)", "T")[output]
        assert four < two
