"""Members for noisy data: sparse processes, the choice of a member's kind, and skill."""

from __future__ import annotations

import dataclasses
import itertools
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from scipy import stats
from scipy.optimize import minimize_scalar
from surfaces import TOY, provenance, surface

from egp_service import EgpError
from egp_service._core import Library
from egp_service.cli.tables import kind_sentence, skill_warnings
from egp_service.data.dataset import Dataset
from egp_service.training import sparse
from egp_service.training.average_member import average_member
from egp_service.training.choice import KINDS, MARGIN, hold_out, preferred
from egp_service.training.euler import euler_steps
from egp_service.training.exact_member import START
from egp_service.training.export import export
from egp_service.training.gaussian_process import WHOLE_CHANGES, OutputProcess, exact
from egp_service.training.open_loop import (
    LINEAR,
    NO_CHANGE,
    linear,
    rollout,
    skill,
    starts,
    student_loss,
    student_scale,
)
from egp_service.training.prior_mean import PriorMean
from egp_service.training.sparse import PosteriorMean, average_targets, fit_sparse
from egp_service.training.train import TrainingSettings, split, train, train_parts
from egp_service.training.trained import Scaling
from egp_service.training.validation import member_skill

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

SETTINGS = TrainingSettings(mean="best", restarts=0, max_iterations=10, first_points=60)
FEW_POINTS = dataclasses.replace(SETTINGS, max_points=40)
DT = 0.05


def wandering(noise: float, seed: int = 0) -> Dataset:
    """Drive a car that answers to no input; its measured states carry white noise."""
    rng = np.random.default_rng(seed)
    trajectories, steps = 25, 60
    n = trajectories * (steps + 1)
    states = np.array([15.0, 0.0, 0.0]) + noise * rng.standard_normal((n, 3))
    last = np.arange(n) % (steps + 1) == steps
    others = np.array([0.1, 2000.0, 0.2]) * rng.standard_normal((n, 3))
    return Dataset(
        z=np.hstack([states, others])[~last],
        y=np.roll(states, -1, axis=0)[~last] - states[~last],
        trajectory=np.repeat(np.arange(trajectories, dtype=np.uint32), steps),
        step=np.tile(np.arange(steps, dtype=np.uint32), trajectories),
        provenance=provenance(),
    )


def test_with_all_points_the_sparse_process_is_the_exact_one() -> None:
    rng = np.random.default_rng(0)
    z = torch.tensor(rng.standard_normal((40, 6)))
    y = torch.sin(z[:, 0]) + 0.1 * torch.tensor(rng.standard_normal(40))
    process = OutputProcess(z, y, "matern52", WHOLE_CHANGES)
    process.assign(START)
    process.eval()
    with torch.no_grad(), exact():
        mean = process(z[:30]).mean
    # The jitter on the inducing points; measured 2e-7.
    np.testing.assert_allclose(PosteriorMean(process, z).given(y)[:30], mean, atol=1e-5)
    (targets,) = average_targets([process], z, [y])
    np.testing.assert_allclose(targets, y, atol=1e-5)


def test_a_fit_ends_where_a_step_began_that_leads_to_no_covariance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(0)
    z = torch.tensor(rng.standard_normal((60, 6)))
    y = torch.sin(z[:, 0]) + 0.1 * torch.tensor(rng.standard_normal(60))
    bound = sparse._bound  # noqa: SLF001

    def fitted(calls: float) -> tuple[list[float], float]:
        """Fit until the bound cannot be computed any more, after so many computations."""
        process = OutputProcess(z[:20], y[:20], "matern52", WHOLE_CHANGES)
        process.assign(START)
        process.train()
        losses: list[float] = []
        count = itertools.count()

        def failing(*arguments: Any) -> torch.Tensor:  # noqa: ANN401
            if next(count) >= calls:
                raise torch.linalg.LinAlgError  # type: ignore[attr-defined]
            return bound(*arguments)

        with monkeypatch.context() as patch:
            patch.setattr(sparse, "_bound", failing)
            fit_sparse([process], z, [y], 10, lambda _, loss: losses.append(loss))
        with torch.no_grad(), exact():
            return losses, float(-bound([process], z, [y]) / len(y))

    every, last = fitted(np.inf)
    assert last < every[0]
    losses, found = fitted(6)
    assert 1 <= len(losses) < len(every)
    assert found == pytest.approx(every[len(losses)], abs=1e-12)
    with pytest.raises(EgpError, match="constant or"):
        fitted(0)


def test_few_points_with_average_targets_predict_what_all_transitions_say() -> None:
    rng = np.random.default_rng(0)
    data = dataclasses.replace(surface(), y=surface().y + 0.05 * rng.standard_normal((600, 3)))
    member = average_member((data, data), PriorMean(), SETTINGS, rng, lambda *_: None)
    truth = surface(seed=5)
    error = np.sqrt(np.mean((member.predict_mean(truth.z) - truth.y) ** 2, axis=0))
    # Noise of 0.05 in each transition; 600 of them leave less than half of it.
    assert np.all(error < 0.025)
    np.testing.assert_allclose(member.predict(truth.z)[0], member.predict_mean(truth.z), atol=1e-9)


def test_predictions_at_many_inputs_need_memory_for_blocks_of_them_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data, rng = surface(), np.random.default_rng(0)
    member = average_member((data, data), PriorMean(), FEW_POINTS, rng, lambda *_: None)
    sizes: list[int] = []
    predict = OutputProcess.__call__

    def counted(process: OutputProcess, z: torch.Tensor) -> object:
        sizes.append(len(z))
        return predict(process, z)

    monkeypatch.setattr(OutputProcess, "__call__", counted)
    z = surface(seed=9, trajectories=110).z  # 2200 inputs
    together = member.predict(z)
    # GPyTorch keeps the square of this number of values for each output.
    assert max(sizes) == 1000
    parts = zip(*(member.predict(z[k : k + 550]) for k in range(0, 2200, 550)), strict=True)
    for ours, theirs in zip(together, parts, strict=True):
        apart = np.concatenate(theirs)
        # Rounding in GPyTorch's distances, relative to the largest value; measured 1e-12.
        np.testing.assert_allclose(ours, apart, rtol=0.0, atol=1e-9 * np.abs(apart).max())


def test_outliers_have_a_bounded_influence() -> None:
    rng = np.random.default_rng(0)
    spoiled = surface()
    y = spoiled.y.copy()
    y[rng.permutation(len(y))[:12]] += 3.0
    spoiled = dataclasses.replace(spoiled, y=y)
    truth = surface(seed=5)
    errors = []
    for data in (surface(), spoiled):
        again = np.random.default_rng(1)
        member = average_member((data, data), PriorMean(), SETTINGS, again, lambda *_: None)
        errors.append(np.sqrt(np.mean((member.predict_mean(truth.z) - truth.y) ** 2, axis=0)))
    # Their mean alone is 0.06; the errors are 0.02 without them.
    assert np.all(errors[1] < errors[0] + 0.03)


def test_a_log_of_noise_is_answered_by_no_change_or_little(tmp_path: Path) -> None:
    data = wandering(0.01)
    (member,) = train([data], FEW_POINTS, vehicle=TOY)
    assert member.likelihoods[NO_CHANGE] == 0.0
    # Three kinds with processes predict the noise alike, with three seeds to 0.02 nats, and of them
    # the single-track vehicle is preferred. A vehicle alone would answer to the inputs.
    assert member.kind == "single-track + GPs"
    export(tmp_path / "library", [member], FEW_POINTS, {}, TOY)
    library = Library.load(tmp_path / "library")
    compared = member_skill(library, 0, member)
    ours, without = compared.rms["mu 0.5"], compared.rms[NO_CHANGE]
    # Five trajectories of 3 s have too few rollouts of 1 and 2 s to compare. Predicting the return
    # to the mean of white noise divides the error by the square root of two; measured 0.73.
    assert np.all(ours[:3] < 0.85 * without[:3])
    assert "kind" in library.provenance["members"]


def test_a_vehicle_is_preferred_unless_another_kind_is_clearly_better() -> None:
    likelihoods = dict.fromkeys(KINDS, 0.0) | {"constant + GPs": 1.0, "single-track": 0.5}
    assert preferred(likelihoods) == "constant + GPs"
    assert preferred(likelihoods | {"single-track + GPs": 1.01 - MARGIN}) == "single-track + GPs"
    # What is lost by it is said.
    close = likelihoods | {"single-track + GPs": 0.9}
    said = kind_sentence("dry", preferred(close), close)
    assert "single-track + GPs is chosen" in said
    assert "constant + GPs predicts held-out blocks better, by 0.100 nats" in said
    said = kind_sentence("dry", preferred(likelihoods), likelihoods)
    assert said == "dry: constant + GPs predicts held-out blocks best"
    # A vehicle without skill is not preferred to no change.
    assert preferred(dict.fromkeys(KINDS, -0.1) | {NO_CHANGE: 0.0}) == NO_CHANGE


def test_a_vehicle_is_chosen_for_its_own_drive(tmp_path: Path) -> None:
    car = np.array(
        [TOY.mass, TOY.l_f, TOY.l_r, 1.6, 0.5, 0.5, 0.8, *(1.2, 1.2, 0.9, 15.0, 1.5) * 2]
    )
    rng = np.random.default_rng(0)
    z = wandering(0.0).z.copy()
    z[:, :3] += [3.0, 0.5, 0.3] * rng.standard_normal((len(z), 3))
    y = PriorMean(car, euler_steps(car, DT)).predict(z, DT) + 0.001 * rng.standard_normal(
        (len(z), 3)
    )
    data = dataclasses.replace(wandering(0.0), z=z, y=y, step=np.zeros(len(z), dtype=np.uint32))
    (member,) = train([data], FEW_POINTS, vehicle=TOY)
    assert member.kind.startswith("single-track")
    export(tmp_path / "library", [member], FEW_POINTS, {}, TOY)
    assert Library.load(tmp_path / "library").members[0].single_track is not None


def test_a_linear_law_is_found_and_rolled_out_exactly() -> None:
    data = wandering(0.01)
    weights = np.random.default_rng(1).standard_normal((6, 3)) * 1e-3
    state, z, y = np.array([15.0, 0.0, 0.0]), data.z.copy(), data.y.copy()
    for k in range(len(z)):
        z[k, :3] = state
        y[k] = z[k] @ weights * [1e-3, 1.0, 1.0] / 2.0
        state = state + y[k]
    data = dataclasses.replace(
        data,
        z=z,
        y=y,
        trajectory=np.zeros(len(z), dtype=np.uint32),
        step=np.arange(len(z), dtype=np.uint32),
    )
    law = linear(data, (1.2, 1.4))
    np.testing.assert_allclose(law(z), y, atol=1e-9)
    start = starts(data, 20, 5)
    np.testing.assert_allclose(rollout(law, data, start, 20), 0.0, atol=1e-7)
    compared = skill({LINEAR: law}, data)
    assert compared.durations == (0.05, 0.2, 0.5, 1.0, 2.0)
    assert compared.likelihood[LINEAR] > 5.0
    np.testing.assert_allclose(
        compared.rms[NO_CHANGE][0], np.sqrt(np.mean(y**2, axis=0)), rtol=1e-12
    )


def test_warnings_name_where_there_is_no_skill() -> None:
    data = wandering(0.01)
    compared = skill({"ours": lambda z: np.tile([0.0, 0.0, 0.1], (len(z), 1))}, data)
    warnings = skill_warnings("dry", "ours", compared)
    assert len(warnings) == len(compared.durations)
    assert all("no skill in omega" in warning for warning in warnings)
    slow = dataclasses.replace(data, z=data.z * [0.1, 1, 1, 1, 1, 1])
    (warning,) = skill_warnings("dry", "ours", skill({"ours": lambda z: z[:, :3]}, slow))
    assert "no transitions above 5 m/s" in warning


@pytest.mark.parametrize("freedom", [3.0, 30.0])
def test_the_scale_is_that_of_students_distribution(freedom: float) -> None:
    rng = np.random.default_rng(0)
    errors = np.array([1.0, 0.1, 10.0]) * rng.standard_t(freedom, (20000, 3))
    scale = student_scale(errors)
    np.testing.assert_allclose(scale / scale[0], [1.0, 0.1, 10.0], rtol=0.03)
    assert 0.8 < scale[0] < 1.2
    spoiled = errors.copy()
    spoiled[:100] = 1e3
    assert np.all(student_scale(spoiled)[:2] < 1.1 * scale[:2])


def test_losses_are_those_of_students_distribution_at_its_best_scale() -> None:
    rng = np.random.default_rng(1)
    peaked = rng.standard_normal(20000) * np.where(rng.random(20000) < 0.85, 0.45, 1.6)
    even = rng.uniform(-0.935, 0.935, 20000)
    found = student_loss(np.column_stack([peaked, even, 3.0 * even]))

    def least(errors: NDArray[np.float64]) -> float:
        def loss(log_scale: float) -> float:
            return -float(stats.t.logpdf(errors, 4.0, scale=np.exp(log_scale)).mean())

        return float(minimize_scalar(loss, bounds=(-3.0, 3.0), method="bounded").fun)

    assert found[0] - found[1] == pytest.approx(least(peaked) - least(even), abs=1e-6)
    assert found[2] - found[1] == pytest.approx(np.log(3.0), abs=1e-6)
    # The scale alone would prefer the other one.
    assert found[1] < found[0]
    scale = student_scale(np.column_stack([peaked, even, even]))
    assert scale[0] < scale[1]


def test_blocks_are_whole_and_spread() -> None:
    rest, held = hold_out(surface())
    assert np.unique(held.trajectory).tolist() == [4, 9, 14, 19, 24, 29]
    assert len(rest) + len(held) == len(surface())
    first, _ = split(surface(trajectories=4), 0.3, np.random.default_rng(0))
    assert len(np.unique(hold_out(first)[1].trajectory)) == 1


def slow_but_in(trajectories: list[int]) -> Dataset:
    """Return ten trajectories, of which those that are not listed are below 5 m/s."""
    data = surface(trajectories=10)
    slow = ~np.isin(data.trajectory, trajectories)
    return dataclasses.replace(data, z=np.where(slow[:, None], [0.15, 1, 1, 1, 1, 1], 1) * data.z)


@pytest.mark.parametrize(
    ("moving", "held"),
    [
        ([4], [4, 9]),
        ([0, 1, 9], [4, 9]),
        ([0, 2, 7], [7]),  # none of the usual ones moves
        ([2], [4, 9]),  # what is left to train on would not move
        ([], [4, 9]),
    ],
)
def test_a_trajectory_that_moves_is_held_out(moving: list[int], held: list[int]) -> None:
    assert np.unique(hold_out(slow_but_in(moving))[1].trajectory).tolist() == held


def constant_inside(data: Dataset) -> Dataset:
    """Return data whose steering rate changes in the trajectories only that are held out."""
    out = np.isin(data.trajectory, hold_out(data)[1].trajectory)
    return dataclasses.replace(data, z=np.where(out[:, None], 1, [1, 1, 1, 1, 1, 0]) * data.z)


@pytest.mark.parametrize(
    ("second", "complaint"),
    [
        (slow_but_in([2]), r"surface mu 0\.5: models are compared .* above 5 m/s"),
        (surface(trajectories=1), r"surface mu 0\.5 has one trajectory"),
        (constant_inside(surface(trajectories=10)), r"surface mu 0\.5: delta_dot never changes"),
    ],
)
def test_data_that_allow_no_choice_are_an_error_before_training(
    second: Dataset, complaint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fit(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr("egp_service.training.train.fit_vehicle", fit)
    parts = [(surface(1.1), surface(1.1)), (second, second)]
    rngs = [np.random.default_rng(number) for number in range(2)]
    with pytest.raises(EgpError, match=complaint):
        train_parts(parts, SETTINGS, vehicle=TOY, rngs=rngs)


def test_a_log_too_short_for_a_choice_is_an_error_that_says_how_long_it_must_be() -> None:
    # A log of 10 to 20 s has two trajectories, of which one is held out for validation.
    with pytest.raises(EgpError, match=r"one trajectory .* more than 20 s .*--mean single-track"):
        train([surface(trajectories=2)], SETTINGS, vehicle=TOY)


def test_a_graphics_card_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    values = np.random.default_rng(0).standard_normal((9, 6))
    scaling = Scaling.of(values, np.zeros(3), np.ones(3))
    scaled = scaling.inputs(values), scaling.targets(values[:, :3])
    assert {tensor.device.type for tensor in scaled} == {"cpu"}
