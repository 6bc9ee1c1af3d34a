"""Campaigns: outcomes are kept, gone on from, and put together honestly."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service._core import write_library_subset
from egp_service.cli import app
from egp_service.evaluation import html
from egp_service.evaluation.batch import finish
from egp_service.evaluation.campaign import (
    Campaign,
    Outcome,
    drive_trial,
    off_track,
)
from egp_service.evaluation.claims import POOLED, check
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE, Contender, interpolated_weights
from egp_service.evaluation.entry_speed import RESOLUTION, SLOWEST, highest
from egp_service.evaluation.experiment import NOISE, Trial
from egp_service.evaluation.experiments import EXPERIMENTS, OBSTACLE_AVOIDANCE, with_members
from egp_service.evaluation.prediction import PredictionOutcome
from egp_service.evaluation.settling import settling_times
from egp_service.evaluation.statistics import Interval, grouped, mean, median, wilson
from egp_service.shipped import EVALUATION_LIBRARY as SHIPPED
from egp_service.simulation.scenario import (
    Scenario,
    Speed,
    Track,
    Zone,
    library_path,
    load_scenario,
)
from outcome_example import OUTCOME

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

BEND = Scenario(
    name="bend",
    track=Track("circle", parameters={"radius": 30.0}),
    zones=(Zone(0.0, 1.1), Zone(0.4, 0.5)),
    speed=Speed(v_max=10.8, constant=True),
    measurement=NOISE,
    laps=0.8,
)
KINDS = {
    ENSEMBLE: Contender(ENSEMBLE, "ensemble", (0, 3)),
    "kinematic": Contender("kinematic", "kinematic", (0, 3)),
    "nominal single-track": Contender("nominal single-track", "single-track", (0, 3)),
    "selection": Contender("selection", "selection", (0, 3)),
    ORACLE: Contender(ORACLE, "oracle", (0, 3)),
}


def outcome(
    contender: str, seed: int, *, completed: bool = True, rms: float = 0.1, time: float = 30.0
) -> Outcome:
    return replace(
        OUTCOME,
        contender=contender,
        seed=seed,
        completed=completed,
        reason="completed" if completed else "left the road",
        time=time,
        lap_times=(time,),
        lateral_max=3 * rms,
        lateral_rms=rms,
        settling=(0.2,),
    )


def run_all(folder: Path, trials: list[Trial], report: Callable[[Outcome], None]) -> list[Outcome]:
    batch = Campaign(folder, SHIPPED).runs(trials, report)
    finish([batch], 2)
    return batch.results()


def test_every_contender_drives_and_is_not_run_twice(tmp_path: Path) -> None:
    trials = [Trial("bend", "10.8 m/s", contender, BEND) for contender in KINDS.values()]
    finished: list[Outcome] = []
    first = run_all(tmp_path, trials, finished.append)
    assert sorted(o.contender for o in finished) == sorted(KINDS)
    assert [o.contender for o in first] == list(KINDS)
    assert all(o.completed and o.lateral_max < 1.0 for o in first), first
    # A torn last line is what an interrupted campaign leaves; its trial is run again.
    log = tmp_path / "runs.jsonl"
    log.write_text(log.read_text(encoding="utf-8")[:-40], encoding="utf-8")
    again: list[Outcome] = []
    second = run_all(tmp_path, trials, again.append)
    # The known ones are reported first, as they were.
    assert {o.contender: o for o in again[:-1]} == {o.contender: o for o in finished[:-1]}
    assert again[-1].contender == finished[-1].contender
    # Lines that another program wrote, or a disk damaged, are left out.
    entry = json.loads(log.read_text(encoding="utf-8").splitlines()[0])
    entry["outcome"]["time"] = "abc"
    other = {"trial": "x", "outcome": [1]}
    with log.open("ab") as lines:
        lines.write(
            b"\n".join([b"\xff\xfe", *(json.dumps(e).encode() for e in (entry, other)), b""])
        )
    third = run_all(tmp_path, trials, lambda _: None)
    assert third == second
    # Times are the machine's.
    untimed = [replace(o, step_ms=0.0, late=0) for o in second]
    assert untimed == [replace(o, step_ms=0.0, late=0) for o in first]


def test_a_folder_belongs_to_one_library(tmp_path: Path) -> None:
    Campaign(tmp_path, SHIPPED)
    other = tmp_path / "other.safetensors"
    write_library_subset(SHIPPED, other, [0, 1])
    with pytest.raises(EgpError, match="another library"):
        Campaign(tmp_path, other)


def test_an_identity_is_written_again_only_if_it_is_empty(tmp_path: Path) -> None:
    Campaign(tmp_path, SHIPPED)
    library, program = (tmp_path / name for name in ("library.sha256", "program.sha256"))
    identity, written = library.read_text(), program.stat().st_mtime_ns
    library.write_text("")  # as a full disk left it
    Campaign(tmp_path, SHIPPED)
    assert library.read_text() == identity
    assert program.stat().st_mtime_ns == written


def test_a_changed_python_file_is_another_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "package" / "evaluation" / "campaign.py"
    source.parent.mkdir(parents=True)
    source.write_text("", encoding="utf-8")
    monkeypatch.setattr("egp_service.evaluation.campaign.__file__", str(source))
    found = [Campaign(tmp_path / "runs", SHIPPED).of_another_build for _ in range(2)]
    source.with_name("other.py").write_text("", encoding="utf-8")
    added = Campaign(tmp_path / "runs", SHIPPED).of_another_build
    source.with_name("other.py").unlink()
    source.write_text("changed = True\n", encoding="utf-8")
    changed = Campaign(tmp_path / "runs", SHIPPED).of_another_build
    assert [*found, added, changed] == [False, False, True, True]


def test_runs_of_another_build_are_told(tmp_path: Path) -> None:
    assert not Campaign(tmp_path, SHIPPED).of_another_build
    assert not Campaign(tmp_path, SHIPPED).of_another_build
    (tmp_path / "program.sha256").write_text("0" * 64, encoding="utf-8")
    for _ in range(2):
        assert Campaign(tmp_path, SHIPPED).of_another_build


def test_a_library_without_all_members_is_refused(tmp_path: Path) -> None:
    library = library_path(load_scenario("rounded-rectangle"))
    write_library_subset(library, tmp_path / "one.safetensors", [0])
    with pytest.raises(EgpError, match=r"one\.safetensors has 1 member, these experiments need 4"):
        with_members(tmp_path / "one.safetensors", EXPERIMENTS)
    with pytest.raises(EgpError, match="2 members, these experiments need 4"):
        with_members(library, EXPERIMENTS)
    assert with_members(SHIPPED, EXPERIMENTS) == list(EXPERIMENTS)
    assert with_members(library, []) == []
    command = ["evaluate", "-e", "step-times", "--library", str(library), "-o", str(tmp_path / "o")]
    assert "2 members, these experiments need 4" in str(CliRunner().invoke(app, command).exception)
    assert not (tmp_path / "o").exists()


def test_libraries_of_runs_have_the_same_path_in_every_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    trial = Trial("bend", "10.8 m/s", KINDS[ENSEMBLE], BEND)
    (own,) = Campaign(Path("runs"), SHIPPED).runs([trial], lambda _: None).parts.values()
    assert own.scenario.library == str(tmp_path / "runs/libraries/0-3.safetensors")


def test_a_vehicle_that_is_pushed_to_an_edge_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "two.safetensors"
    write_library_subset(SHIPPED, path, [0, 3])
    (narrow,) = (e for e in EXPERIMENTS if e.name == "narrow-track")
    (trial,) = (
        t for t in narrow.trials([5]) if (t.condition, t.contender.name) == ("95% of grip", ORACLE)
    )
    scenario = replace(
        trial.scenario, library=str(path), control=dict(trial.contender.control or {})
    )
    run = drive_trial(replace(trial, scenario=scenario))
    # With the penalty of the edges in the proximal term, plans were held and it was 1.7 m off.
    assert run.summary.lateral_error.max < 0.4


def test_weights_settle_after_a_friction_step(tmp_path: Path) -> None:
    path = tmp_path / "two.safetensors"
    write_library_subset(SHIPPED, path, [0, 3])
    run = drive_trial(Trial("bend", "", KINDS[ENSEMBLE], replace(BEND, library=str(path))))
    times = settling_times(run)
    assert len(times) == 1
    assert 0.0 < times[0] <= 2.0  # noise may throw them out again; 2 s is as far as it looks
    step = int(np.argmax(run.trace.friction == 0.5))
    arrived = np.argmax(run.trace.weights[step:, 0] > 0.75)
    assert 0 < arrived * run.dt < 0.6
    before = run.trace.weights[run.trace.friction == 1.1]
    assert np.median(before[:, 1]) > 0.8
    assert np.median(run.trace.weights[-50:, 0]) > 0.8


def test_every_trial_has_its_own_key_and_roads_do_not_depend_on_the_contender() -> None:
    for experiment in EXPERIMENTS:
        trials = list(experiment.trials(range(2)))
        assert len({trial.key for trial in trials}) == len(trials)
        roads: dict[tuple[str, int], Scenario] = {}
        for trial in trials:
            road = roads.setdefault((trial.condition, trial.scenario.seed), trial.scenario)
            assert road == trial.scenario


def test_groups_compare_with_the_oracle_seed_by_seed() -> None:
    outcomes = [outcome(ENSEMBLE, s, rms=0.11 + 0.01 * s, time=30.6) for s in range(4)]
    outcomes += [outcome(ORACLE, s, rms=0.1 + 0.01 * s, completed=s != 3) for s in range(4)]
    ensemble, oracle = grouped(outcomes)
    assert (ensemble.completed, oracle.completed) == (4, 3)
    assert ensemble.regret.value == pytest.approx(0.12 / 0.11)
    assert ensemble.time_regret.value == pytest.approx(1.02)
    assert ensemble.time == Interval(30.6, 30.6, 30.6)
    assert oracle.regret.value == oracle.time_regret.value == 1.0


@pytest.mark.parametrize("limit", [6.9, 7.0, 12.3, 22.6])
def test_the_highest_speed_is_bisected(limit: float) -> None:
    tried: list[float] = []

    def survives(speed: float) -> bool:
        tried.append(speed)
        return speed <= limit

    found = highest(survives)
    assert found == (0.0 if limit < SLOWEST else min(22.5, RESOLUTION * (limit // RESOLUTION)))
    assert len(tried) == 6


def test_a_faster_car_touches_the_cones(tmp_path: Path) -> None:
    trial = next(OBSTACLE_AVOIDANCE.trials([0]))
    path = tmp_path / "two.safetensors"
    write_library_subset(SHIPPED, path, [0, 3])
    outside = {}
    for speed in (9.0, 24.0):
        scenario = replace(
            trial.scenario, library=str(path), speed=Speed(v_max=speed, constant=True)
        )
        outside[speed] = off_track(scenario, drive_trial(replace(trial, scenario=scenario)))
    assert outside[9.0] == 0.0 < outside[24.0]


def test_a_failed_run_breaks_the_claim() -> None:
    good = [outcome(ENSEMBLE, s) for s in range(20)]
    bad = [*good[:-1], outcome(ENSEMBLE, 19, completed=False)]
    assert all(claim.holds for claim in check(good, []))
    assert not check(bad, [])[0].holds


def test_a_road_that_only_the_oracle_completes_breaks_the_claim_about_errors() -> None:
    easy = [outcome(name, seed) for name in (ENSEMBLE, ORACLE) for seed in range(3)]

    def claimed(*through: str) -> tuple[bool | None, str]:
        hard = [
            replace(outcome(name, seed, completed=name in through), condition="hard")
            for name in (ENSEMBLE, ORACLE)
            for seed in range(3)
        ]
        (claim,) = (claim for claim in check([*easy, *hard], []) if "RMS" in claim.text)
        return claim.holds, claim.evidence

    worst = "worst median ratio 1.00 (varying-speed, 90% of grip)"
    assert claimed(ENSEMBLE, ORACLE) == (True, worst)
    assert claimed(ORACLE) == (False, "worst median ratio inf (varying-speed, hard)")
    # Where the oracle completes nothing there is nothing to compare with.
    assert claimed() == claimed(ENSEMBLE) == (True, worst)


def test_lost_vehicles_count_in_the_claim_about_errors() -> None:
    told = [outcome(ORACLE, seed) for seed in range(20)]
    own = [outcome(ENSEMBLE, seed, completed=seed == 0) for seed in range(20)]
    (claim,) = (claim for claim in check([*told, *own], []) if "RMS" in claim.text)
    assert claim.holds is False
    assert "ratio inf" in claim.evidence


def test_weights_that_never_move_break_the_claim_about_settling() -> None:
    still = [
        replace(
            outcome(ENSEMBLE, seed),
            experiment="friction-step",
            condition="3 m/s² lateral",
            settling=(),
        )
        for seed in range(3)
    ]
    assert [claim.holds for claim in check(still, []) if "settle" in claim.text] == [False]


def test_the_interval_of_settling_times_is_over_the_runs_and_not_over_their_changes() -> None:
    times = [0.1, 0.2, 0.6]
    runs = [replace(OUTCOME, seed=seed, settling=(t,) * 9) for seed, t in enumerate(times)]
    (group,) = grouped([*runs, replace(OUTCOME, seed=3, settling=())])
    assert group.settling == median(times)
    (alone,) = grouped(runs[:1])
    assert alone.settling.text(".1f") == "0.1"


def test_the_order_of_the_means_may_differ_from_that_of_one_seed() -> None:
    errors = {("E(AD)", POOLED): 1.0, (POOLED, POOLED): 2.0, ("A", "D"): 3.0, ("D", "A"): 3.0}
    errors |= {("E(AD)", "T"): 3.0, ("E(ABD)", "T"): 2.0, ("E(ABCD)", "T"): 1.0}

    def predictions(swapped: int, errors: dict[tuple[str, str], float]) -> list[PredictionOutcome]:
        none = [0.0, 0.0, 0.0]
        return [
            PredictionOutcome(
                predictor,
                on,
                int(predictor.startswith("E")),
                seed,
                [2.5 if seed < swapped and predictor == "E(AD)" and on == POOLED else error] * 3,
                *[none] * 4,
            )
            for seed in range(10)
            for (predictor, on), error in errors.items()
        ]

    holds = [[c.holds for c in check([], predictions(swapped, errors))] for swapped in (0, 1, 9)]
    # Ensemble below pooled in every seed and in the mean, then more members alike.
    assert holds == [[True] * 4, [False, True, True, True], [False, False, True, True]]
    # On the union of both surfaces errors of 1 and of 2.5 or 3 have an RMS of 1.9 or 2.2.
    for worse, holds_on_union in ((2.5, False), (3.0, True)):
        wrong = errors | {("A", "D"): 1.0, ("D", "A"): worse}
        assert check([], predictions(0, wrong))[0].holds == holds_on_union


def test_intervals() -> None:
    share = wilson(10, 10)  # (n / (n + z²), 1), closed form at the end
    assert share.low == pytest.approx(10 / (10 + 1.959964**2))
    assert share.high == pytest.approx(1.0)
    assert math.isnan(median([]).value)
    assert mean([0.0, 0.0, 0.0, 4.0]).value == 1.0
    interval = median(np.arange(101.0))
    assert interval.low < interval.value == 50.0 < interval.high


# As `expanded` states; the percentiles of 2.5 and 97.5 % cover the mean of five in 0.84.
@pytest.mark.parametrize(
    ("statistic", "count", "cover"),
    [(mean, 3, 0.75), (mean, 5, 0.92), (mean, 10, 0.95), (median, 5, 0.93), (median, 10, 0.96)],
)
def test_intervals_of_few_values_cover_what_is_stated(
    statistic: Callable[[NDArray[np.float64]], Interval], count: int, cover: float
) -> None:
    samples = np.random.default_rng(count).standard_normal((1000, count))
    found = [statistic(sample) for sample in samples]
    inside = np.mean([one.low <= 0.0 <= one.high for one in found])
    # Standard errors of 1000 samples: at most 0.014, and 0.009 from five values on.
    assert inside == pytest.approx(cover, abs=0.03)


def test_one_value_has_no_interval() -> None:
    one = mean([0.25])
    assert one.value == median([0.25]).value == 0.25
    assert math.isnan(one.low)
    assert math.isnan(one.high)
    assert one.text("+.1f") == "+0.2"
    assert mean([0.5, 0.5]).text(".1f", " to ") == "0.5 (0.5 to 0.5)"
    assert html.interval(one) == "0.250"


def test_the_best_caution_is_said_to_be_the_best_of_several() -> None:
    times = {ENSEMBLE: 0.5, "caution 1": 0.05, "caution 2": 0.2}
    runs = [
        replace(outcome(name, 0), experiment="narrow-track", off_track=time)
        for name, time in times.items()
    ]
    (claim,) = (claim for claim in check(runs, []) if "narrow" in claim.text)
    assert claim.holds
    assert "0.05 s with caution 1, the best of 2 by the same runs" in claim.evidence


@pytest.mark.parametrize(
    ("friction", "expected"), [(0.4, [1, 0]), (0.8, [0.5, 0.5]), (1.1, [0, 1]), (1.3, [0, 1])]
)
def test_the_oracle_interpolates(friction: float, expected: list[float]) -> None:
    assert interpolated_weights(np.array([0.5, 1.1]), friction) == pytest.approx(expected)
    swapped = interpolated_weights(np.array([1.1, 0.5]), friction)
    assert swapped == pytest.approx(expected[::-1])
    assert interpolated_weights(np.array([0.7]), friction) == pytest.approx([1.0])
