"""Training on a known law: accuracy, determinism, subset, split, errors."""

from __future__ import annotations

import dataclasses
import json
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
import pytest
import torch
from surfaces import NOISE, TOY, provenance, surface
from threadpoolctl import threadpool_limits

from egp_service import EgpError
from egp_service._core import Library
from egp_service.data.alignment import Delays
from egp_service.data.dataset import Dataset
from egp_service.training.euler import euler_steps
from egp_service.training.export import export
from egp_service.training.kernel import KernelName
from egp_service.training.prior_mean import PriorMean
from egp_service.training.train import FitProgress, TrainingSettings, split, train
from egp_service.training.validation import rollout_error, validate
from egp_service.training.validation_report import draw_validation
from egp_service.training.vehicle_fit import fit_vehicle

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from egp_service.training.trained import TrainedMember

# The law of `surfaces` is no vehicle's.
SETTINGS = TrainingSettings(
    kernel="rbf", mean="constant", max_points=80, first_points=60, restarts=0, max_iterations=40
)


@pytest.fixture(scope="module")
def members() -> list[TrainedMember]:
    return train([surface(1.1), surface(0.5)], SETTINGS)


@pytest.fixture(scope="module")
def library_path(members: list[TrainedMember], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("library") / "toy.safetensors"
    export(path, members, SETTINGS, {"source": "test"}, TOY)
    return path


def test_beats_a_linear_fit_on_unseen_data(members: list[TrainedMember]) -> None:
    # Members come ordered by friction.
    for friction, member in zip((0.5, 1.1), members, strict=True):
        unseen = surface(friction, seed=7)
        mean, _, _ = member.predict(unseen.z)
        ones = np.ones((len(member.dataset), 1))
        line = np.linalg.lstsq(np.hstack([member.dataset.z, ones]), member.dataset.y, rcond=None)[0]
        linear = np.hstack([unseen.z, np.ones((len(unseen), 1))]) @ line
        ours = np.sqrt(np.mean((mean - unseen.y) ** 2, axis=0))
        theirs = np.sqrt(np.mean((linear - unseen.y) ** 2, axis=0))
        assert np.all(ours < 0.6 * theirs)


@pytest.mark.parametrize("kernel", get_args(KernelName))
def test_same_seed_same_bytes(tmp_path: Path, kernel: KernelName) -> None:
    settings = dataclasses.replace(SETTINGS, kernel=kernel, max_iterations=10, restarts=1)
    for name in ("first", "second"):
        export(tmp_path / name, train([surface()], settings), settings, {}, TOY)
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()
    other = dataclasses.replace(settings, seed=1)
    export(tmp_path / "other", train([surface()], other), other, {}, TOY)
    assert (tmp_path / "first").read_bytes() != (tmp_path / "other").read_bytes()


def test_the_number_of_threads_does_not_change_a_bit(tmp_path: Path) -> None:
    settings = dataclasses.replace(SETTINGS, max_points=400, max_iterations=5)
    before = torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            members = train([surface()], settings)
            with threadpool_limits(threads, user_api="blas"):
                export(tmp_path / str(threads), members, settings, {}, TOY)
    finally:
        torch.set_num_threads(before)
    assert (tmp_path / "1").read_bytes() == (tmp_path / "2").read_bytes()


def test_library_predicts_what_gpytorch_does(
    members: list[TrainedMember], library_path: Path
) -> None:
    library = Library.load(library_path)
    z = surface(0.8, seed=9).z
    for index, member in enumerate(members):
        for ours, theirs in zip(library.predict(z, index), member.predict(z), strict=True):
            # Rounding in GPyTorch's distances, relative to the largest value; measured 3e-13.
            np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


# Drive and braking differ everywhere. The last two are rolling resistance and drag.
VEHICLE = np.array(
    [
        *(1200.0, 0.9, 1.5, 1.6, 0.5, 0.5, 0.8),
        *(1.9, 1.2, 0.9, 15.0, 1.6),
        *(0.6, 1.1, 1.0, 20.0, 1.3),
        *(0.2, 6e-4),
    ]
)


# The same vehicle on ice: the grips, which are also those of the axles, and the slip of the peaks.
ON_ICE = VEHICLE.copy()
ON_ICE[[5, 6, 9, 14]] = 0.04, 0.08, 0.09, 0.09
ON_ICE[[7, 8, 12, 13]] *= 12.0
ON_ICE[[10, 15]] = 6.0, 7.0


@pytest.mark.parametrize("simulated", [False, True])
@pytest.mark.parametrize("known", [VEHICLE, ON_ICE], ids=["road", "ice"])
def test_the_vehicle_is_found_again(known: NDArray[np.float64], *, simulated: bool) -> None:
    # A simulated car has no resistance, and none is fitted.
    known = known[: len(known) - 2 * simulated]
    rng = np.random.default_rng(0)
    bounds = np.array([8.0, 0.6, 0.5, 0.1, 6000.0, 0.3])
    z = np.array([15.0, *np.zeros(5)]) + bounds * rng.uniform(-1.0, 1.0, (2000, 6))
    y = PriorMean(known, euler_steps(known, 0.05)).predict(z, 0.05)
    data = dataclasses.replace(
        surface(),
        z=z,
        y=y,
        trajectory=np.arange(2000, dtype=np.uint32),
        step=np.zeros(2000, dtype=np.uint32),
        provenance=provenance(vehicle="commonroad-2" if simulated else "own car"),
    )
    (found,) = fit_vehicle([data], None, [rng])
    assert len(found.values) == len(known)
    error = PriorMean(found.values, found.steps).predict(z, 0.05) - y
    if not simulated:
        assert found.parameters[-1].value == pytest.approx(known[-1], rel=0.02)
        # Rolling resistance and a slope slow alike: their sum is found, and the slope is no result.
        error -= error.mean(axis=0)
    assert np.all(np.abs(error).max(axis=0) < 1e-3 * y.std(axis=0))


def test_a_force_from_the_acceleration_contains_the_resistance() -> None:
    stated = dataclasses.replace(surface(), provenance=provenance(force_from_a_x=True))
    (found,) = fit_vehicle([stated], None, [np.random.default_rng(0)])
    assert not {"c_0", "c_2"} & {parameter.name for parameter in found.parameters}


def test_a_library_with_a_vehicle_predicts_what_gpytorch_does(tmp_path: Path) -> None:
    settings = dataclasses.replace(SETTINGS, mean="single-track", max_iterations=10)
    (member,) = train([surface()], settings)
    export(tmp_path / "vehicle", [member], settings, {}, TOY)
    fitted = member.mean
    assert fitted.single_track is not None

    def with_vehicle(parameters: NDArray[np.float64]) -> TrainedMember:
        mean = fitted._replace(single_track=parameters)
        known, vehicle = (each.predict(member.inputs, 0.05) for each in (fitted, mean))
        return dataclasses.replace(member, mean=mean, targets=member.targets - known + vehicle)

    # Another vehicle whose drive and braking differ everywhere, which the fit may not show.
    other, without = with_vehicle(VEHICLE), with_vehicle(VEHICLE[:17])
    export(tmp_path / "other", [other], settings, {}, TOY)
    export(tmp_path / "free", [without], settings, {}, TOY)
    z = surface(0.8, seed=9).z
    assert (z[:, 4] > 0.0).any()
    assert (z[:, 4] < 0.0).any()
    for name, trained in (("vehicle", member), ("other", other), ("free", without)):
        library = Library.load(tmp_path / name)
        assert library.members[0].euler_steps == fitted.steps > 1
        read = library.members[0]
        assert read.single_track is not None
        assert read.resistance is not None
        own = [read.single_track, read.resistance][: 1 if name == "free" else 2]
        np.testing.assert_array_equal(np.concatenate(own), trained.mean.single_track)
        assert name != "free" or not read.resistance.any()
        for ours, theirs in zip(library.predict(z), trained.predict(z), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


def test_one_kernel_serves_all_outputs_of_a_vehicle(tmp_path: Path, library_path: Path) -> None:
    settings = dataclasses.replace(SETTINGS, mean="single-track", max_iterations=10)
    export(tmp_path / "vehicle", train([surface()], settings), settings, {}, TOY)
    vehicle, constants = (
        Library.load(path).members[0] for path in (tmp_path / "vehicle", library_path)
    )
    for values in (vehicle.lengthscales, vehicle.outputscale, vehicle.noise):
        assert len(np.unique(values, axis=0)) == 1
    for values in (constants.lengthscales, constants.outputscale, constants.noise):
        assert len(np.unique(values, axis=0)) == 3


def test_library_says_where_it_comes_from(members: list[TrainedMember], library_path: Path) -> None:
    library = Library.load(library_path)
    assert library.dt == 0.05
    assert library.vehicle == "toy"
    assert library.parameters == TOY
    assert [member.label for member in library.members] == ["mu 0.5", "mu 1.1"]
    for ours, member in zip(library.members, members, strict=True):
        assert ours.dataset == member.dataset.digest()
        assert ours.n_points == SETTINGS.max_points
        np.testing.assert_array_equal(ours.envelope[0], member.dataset.z.min(axis=0))


def test_a_library_states_the_noise_of_the_logs_it_was_trained_on(
    members: list[TrainedMember], library_path: Path, tmp_path: Path
) -> None:
    assert (
        Library.load(library_path).measurement_noise is None
    )  # its states are no consecutive ones
    n, noise = 400, np.array([0.02, 0.01, 0.001])
    rng = np.random.default_rng(0)

    def log(vehicle: str) -> Dataset:
        states = np.sin(0.02 * np.arange(n + 1))[:, None] + [15.0, 0.0, 0.0]
        states += noise * rng.standard_normal(states.shape)
        z = np.hstack([states[:-1], 1e-6 * rng.standard_normal((n, 3))])
        index = np.arange(n, dtype=np.uint32)
        about = provenance(vehicle=vehicle)
        return Dataset(z, np.diff(states, axis=0), np.zeros_like(index), index, about)

    def stated(*logs: Dataset) -> NDArray[np.float64] | None:
        path = tmp_path / "logged.safetensors"
        pairs = zip(members, logs, strict=False)
        logged = [dataclasses.replace(member, dataset=data) for member, data in pairs]
        export(path, logged, SETTINGS, {}, TOY)
        return Library.load(path).measurement_noise

    quick = log("toy")
    found = stated(quick)
    assert found is not None
    np.testing.assert_allclose(found, noise, rtol=0.2)
    # A log of slow driving does not tell its noise.
    about = provenance(1.1, vehicle="toy")
    slow = dataclasses.replace(quick, z=quick.z * [0.1, 1, 1, 1, 1, 1], provenance=about)
    np.testing.assert_array_equal(stated(quick, slow), found)
    assert stated(slow) is None
    for delays, told in ((None, None), (Delays(0.0, -1.0), None), (Delays(0.05, 0.05), 0.05)):
        path = tmp_path / "late.safetensors"
        export(path, [dataclasses.replace(members[0], delays=delays)], SETTINGS, {}, TOY)
        assert Library.load(path).measurement_delay == told
    assert stated(log("commonroad-2")) is None


def test_matrix_is_best_on_the_diagonal(
    members: list[TrainedMember],
    library_path: Path,
    tmp_path: Path,
    interrupted_pictures: Callable[[], None],
) -> None:
    held_out = {member.dataset.provenance.surface: member.validation for member in members}
    matrix = validate(Library.load(library_path), held_out)
    for i in range(2):
        own, other = matrix[i][i], matrix[i][1 - i]
        assert (own.member, own.surface) == (own.surface, own.member)
        assert np.all(own.nlpd[:2] < other.nlpd[:2])
        assert np.all(own.rmse[:2] < other.rmse[:2])
        assert np.all(own.rmse > 0.9 * NOISE)
        assert np.all(own.coverage > 0.85)
    picture = tmp_path / "matrix.png"
    draw_validation(matrix, picture)
    drawn = picture.read_bytes()
    assert drawn.startswith(b"\x89PNG")
    interrupted_pictures()
    with pytest.raises(KeyboardInterrupt):
        draw_validation(matrix, picture)
    assert picture.read_bytes() == drawn


def test_matrix_refuses_another_period(library_path: Path) -> None:
    other = dataclasses.replace(surface(), provenance=provenance(dt=0.1))
    with pytest.raises(EgpError, match=r"dt 0\.1 s, the library 0\.05 s"):
        validate(Library.load(library_path), {"other": other})


def test_rollout_needs_unbroken_trajectories(library_path: Path) -> None:
    library = Library.load(library_path)
    broken = dataclasses.replace(surface(), step=(2 * surface().step).astype(np.uint32))
    assert np.isnan(rollout_error(library, 0, broken, 5)).all()
    # One period is what the RMSE measures, up to the choice of rows.
    once = rollout_error(library, 0, surface(), 1)
    mean, _, _ = library.predict(surface().z[::5], 0)
    expected = np.sqrt(np.mean((mean - surface().y[::5]) ** 2, axis=0))
    np.testing.assert_allclose(once, expected)


def test_split_keeps_trajectories_whole() -> None:
    training, validation = split(surface(), 0.2, np.random.default_rng(0))
    assert len(np.unique(validation.trajectory)) == 6
    assert not set(training.trajectory) & set(validation.trajectory)
    assert len(training) + len(validation) == len(surface())
    one = surface().select(surface().trajectory == 0)
    with pytest.raises(EgpError, match="has one trajectory"):
        split(one, 0.2, np.random.default_rng(0))


def test_members_hold_the_subset_without_validation_data(members: list[TrainedMember]) -> None:
    for member in members:
        assert len(np.unique(member.inputs, axis=0)) == SETTINGS.max_points
        kept = {row.tobytes() for row in member.inputs}
        assert kept <= {row.tobytes() for row in member.dataset.z}
        assert not kept & {row.tobytes() for row in member.validation.z}


# Two of each output, one of all together, and one of each output for three kinds.
@pytest.mark.parametrize(("mean", "fits"), [("constant", 6), ("single-track", 1), ("best", 9)])
def test_progress_reaches_every_fit(
    mean: Literal["constant", "single-track", "best"], fits: int
) -> None:
    seen: list[FitProgress] = []
    settings = dataclasses.replace(SETTINGS, mean=mean, max_points=20, max_iterations=5)
    train([surface()], settings, seen.append, vehicle=TOY)
    assert len({step.stage for step in seen}) == fits
    assert all(0 < step.done <= step.total for step in seen)
    assert [step.done for step in seen] == sorted(step.done for step in seen)
    assert all(np.isfinite(step.loss) for step in seen)


def test_refuses_what_cannot_be_one_library() -> None:
    wet = surface()
    slow = dataclasses.replace(surface(1.1), provenance=provenance(1.1, dt=0.1))
    with pytest.raises(EgpError, match="one library has one dt and one vehicle"):
        train([wet, slow], SETTINGS)
    namesake = dataclasses.replace(surface(1.1), provenance=provenance(1.1, surface="mu 0.5"))
    with pytest.raises(EgpError, match="share a surface label"):
        train([wet, namesake], SETTINGS)
    with pytest.raises(EgpError, match="no datasets"):
        train([], SETTINGS)


def test_counts_of_numpy_become_whole_numbers() -> None:
    settings = TrainingSettings(max_points=np.int64(40))  # type: ignore[arg-type]
    assert json.dumps(dataclasses.asdict(settings))


def test_a_row_that_no_vehicle_has_is_named() -> None:
    data = surface()
    y = data.y.copy()
    y[:, 1] = 1e6
    with pytest.raises(EgpError, match=r"d_v_y is 1e\+06 in a row"):
        train([dataclasses.replace(data, y=y)], SETTINGS)


@pytest.mark.parametrize("mean", ["constant", "single-track"])
def test_refuses_data_that_teach_nothing(mean: Literal["constant", "single-track"]) -> None:
    settings = dataclasses.replace(SETTINGS, mean=mean)
    z = surface().z.copy()
    z[:, 3] = 0.1
    straight: Dataset = dataclasses.replace(surface(), z=z)
    with pytest.raises(EgpError, match="delta never changes"):
        train([straight], settings)
    y = surface().y.copy()
    y[:, 1] = 0.0
    with pytest.raises(EgpError, match="d_v_y never changes"):
        train([dataclasses.replace(surface(), y=y)], settings)


@pytest.mark.parametrize("mean", ["constant", "single-track", "best"])
def test_a_log_without_a_measured_sideslip_is_an_error_before_the_delays_are_searched(
    mean: Literal["constant", "single-track", "best"], monkeypatch: pytest.MonkeyPatch
) -> None:
    def find(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr("egp_service.training.train.find_delays", find)
    blind = dataclasses.replace(
        surface(), z=surface().z * [1, 0, 1, 1, 1, 1], y=surface().y * [1, 0, 1]
    )
    with pytest.raises(EgpError, match=r"surface mu 0\.5: v_y never changes"):
        train([surface(1.1), blind], dataclasses.replace(SETTINGS, mean=mean))


@pytest.mark.parametrize(
    "changes",
    [
        {"kernel": "cosine"},
        {"mean": "zero"},
        {"max_points": 3},
        {"max_points": 5001},
        {"max_points": 151, "mean": "best"},
        {"restarts": -1},
        {"validation_fraction": 1.0},
        {"seed": -1},
        {"seed": 0.5},
        {"first_points": 40.0},
        {"max_iterations": float("nan")},
    ],
)
def test_refuses_bad_settings(changes: dict[str, object]) -> None:
    with pytest.raises(EgpError, match=next(iter(changes))):
        TrainingSettings(**changes)  # type: ignore[arg-type]
