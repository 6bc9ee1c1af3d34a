"""Prediction error of members, pooled GP and ensembles: the paper's "Comparison with standard GP".

Five surfaces are sampled, A 0.3, B 0.6, T 0.7, C 0.8 and D 1.0. One member is trained on each of A
to D, and one GP on the pooled data of A and D; T is unseen. The weights of an ensemble come from
the transitions just before the predicted one. Test data are sampled as the training data, with
other seeds.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from egp_service._core import Library, solve_weights
from egp_service.data.experiment import Experiment
from egp_service.data.sampling import sample
from egp_service.evaluation.batch import Batch
from egp_service.evaluation.claims import POOLED
from egp_service.evaluation.window_noise import model_noise
from egp_service.quantities import NORMAL_95, NY, NZ

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset

SURFACES: Final = {"A": 0.3, "B": 0.6, "T": 0.7, "C": 0.8, "D": 1.0}
_DT: Final = 0.02
_KEEP: Final = 6  # transitions of a trajectory: five for the weights, one to predict
_SETTLE: Final = 2  # earlier periods, in which the suspension reaches equilibrium
_TEST_TRAJECTORIES: Final = 300
# Strength of the quadratic prior over a window; small compared with one whitened squared error.
_LAMBDA: Final = 1e-3
# Strength of the paper's prior; the previous transition then determines the weights.
_PAPER_ALPHA: Final = 1e-5


@dataclasses.dataclass(frozen=True)
class PredictionSettings:
    """Size of the experiment."""

    seeds: int = 10
    transitions: int = 700
    """Training transitions of a member, as in the paper; the pooled GP has twice as many."""
    iterations: int = 30


@dataclasses.dataclass(frozen=True)
class PredictionOutcome:
    """Errors of one predictor on one test set for one seed."""

    predictor: str
    tested_on: str
    window: int
    """Number of transitions from which the weights are estimated; 0 for a single GP."""
    seed: int
    rmse: list[float]
    """RMS errors of the changes of v_x, v_y (m/s) and omega (rad/s)."""
    coverage: list[float]
    """Share inside the 95 % interval with the variance of eq. (3), for independent members."""
    coverage_mixture: list[float]
    """Share inside the 95 % interval with the mixture variance, which includes disagreement."""
    nlpd: list[float]
    """Negative log predictive density under the variance of eq. (3)."""
    nlpd_mixture: list[float]


@dataclasses.dataclass(frozen=True)
class SeedOutcomes:
    """Outcomes of one seed."""

    outcomes: list[PredictionOutcome]

    @classmethod
    def read(cls, values: dict[str, Any]) -> SeedOutcomes:
        """Create the outcomes from their JSON fields."""
        return cls([PredictionOutcome(**row) for row in values["outcomes"]])


def seeds(
    settings: PredictionSettings, folder: Path, report: Callable[[SeedOutcomes], None]
) -> Batch[tuple[PredictionSettings, int], SeedOutcomes]:
    """All seeds; their outcomes go to `prediction.jsonl` and are kept across builds."""
    size = f"{settings.transitions}-{settings.iterations}"
    parts = {f"{size}-{seed}": (settings, seed) for seed in range(settings.seeds)}
    return Batch(folder / "prediction.jsonl", parts, run_seed, SeedOutcomes.read, report)


def run_seed(part: tuple[PredictionSettings, int]) -> SeedOutcomes:
    """Sample, train and test one seed; sets torch in this process to one thread.

    With several threads the bits of sums would depend on their number.
    """
    settings, seed = part
    import torch  # noqa: PLC0415 - takes seconds, and most evaluations train nothing

    torch.set_num_threads(1)
    library = _train(settings, seed)
    names = {member.label: number for number, member in enumerate(library.members)}
    tests = {
        name: _test_set(mu, 1000 * seed + 500 + number, name)
        for number, (name, mu) in enumerate(SURFACES.items())
    }
    tests[POOLED] = tuple(
        np.concatenate(parts) for parts in zip(tests["A"], tests["D"], strict=True)
    )  # type: ignore[assignment]
    single = [("A", "A"), ("A", "D"), ("D", "A"), ("D", "D"), (POOLED, POOLED)]
    outcomes = [
        _score(library, [names[predictor]], tests[on], 0, (predictor, on, seed))
        for predictor, on in single
    ]
    ensembles = [("AD", POOLED), ("AD", "T"), ("ABD", "T"), ("ABCD", "T")]
    outcomes += [
        _score(library, [names[m] for m in members], tests[on], window, (f"E({members})", on, seed))
        for members, on in ensembles
        for window in (1, _KEEP - 1)
    ]
    return SeedOutcomes(outcomes)


def _train(settings: PredictionSettings, seed: int) -> Library:
    """Train A, B, C, D and the pooled GP, and load them from a library file."""
    count = -(-settings.transitions * 5 // 4)  # a fifth is held out for validation
    data = {
        name: _sampled(mu, 1000 * seed + number, count, name, keep=1)
        for number, (name, mu) in enumerate(SURFACES.items())
        if name != "T"
    }
    from egp_service.training.export import export  # noqa: PLC0415 - as torch
    from egp_service.training.train import TrainingSettings, train  # noqa: PLC0415

    plan = TrainingSettings(
        kernel="rbf",
        mean="constant",
        max_points=settings.transitions,
        first_points=settings.transitions // 2,
        max_iterations=settings.iterations,
        restarts=0,
        seed=seed,
    )
    members = train(list(data.values()), plan)
    middle = 0.5 * (SURFACES["A"] + SURFACES["D"])
    both = [data[name].relabelled(POOLED, middle) for name in ("A", "D")]
    twice = dataclasses.replace(plan, max_points=2 * settings.transitions)
    members += train(both, twice)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "library.safetensors"
        export(path, members, plan, {})
        return Library.load(path)


def _sampled(friction: float, seed: int, count: int, label: str, *, keep: int) -> Dataset:
    """Keep the last transitions of `count` trajectories of the same length.

    Members are trained on one transition of each trajectory. Transitions of one trajectory share
    hidden states and inputs, for which the likelihood would favour a process that fits the known
    trajectories over one that predicts others.
    """
    experiment = Experiment(friction=friction, label=label, seed=seed, dt=_DT)
    return sample(experiment, count, settle=_SETTLE + _KEEP - keep, keep=keep)


def _test_set(
    friction: float, seed: int, label: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return whole trajectories: inputs (n, _KEEP, 6) and changes (n, _KEEP, 3)."""
    data = _sampled(friction, seed, _TEST_TRAJECTORIES, label, keep=_KEEP)
    return data.z.reshape(-1, _KEEP, NZ), data.y.reshape(-1, _KEEP, NY)


def _score(
    library: Library,
    members: Sequence[int],
    test: tuple[NDArray[np.float64], NDArray[np.float64]],
    window: int,
    name: tuple[str, str, int],
) -> PredictionOutcome:
    """Predict the last transition of every trajectory."""
    z, y = test
    n = len(z)
    last = np.ascontiguousarray(z[:, -1])
    predicted = [library.predict(last, m) for m in members]
    mean = np.stack([p[0] for p in predicted], axis=1)
    noise = np.array([library.members[m].noise_std ** 2 for m in members])
    variance = np.stack([p[2] for p in predicted], axis=1) + noise
    weights = np.ones((n, 1))
    if window:
        weights = _weights(library, members, z[:, -1 - window : -1], y[:, -1 - window : -1])
    w = weights[:, :, None]
    blended = np.sum(w * mean, axis=1)
    independent = np.sum(w**2 * variance, axis=1)
    mixture = np.sum(w * (variance + (mean - blended[:, None]) ** 2), axis=1)
    error = y[:, -1] - blended
    predictor, on, seed = name
    return PredictionOutcome(
        predictor=predictor,
        tested_on=on,
        window=window,
        seed=seed,
        rmse=np.sqrt(np.mean(error**2, axis=0)).tolist(),
        coverage=_coverage(error, independent),
        coverage_mixture=_coverage(error, mixture),
        nlpd=_nlpd(error, independent),
        nlpd_mixture=_nlpd(error, mixture),
    )


def _weights(
    library: Library,
    members: Sequence[int],
    z: NDArray[np.float64],
    y: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Weights (n, N) from the window before each prediction, with uniform previous weights.

    A window of one transition is treated as in the paper, with S = I and an L1 prior. Longer
    windows are whitened by the members' noise alone, as the states are exact, with a weak quadratic
    prior.
    """
    n, window = z.shape[:2]
    flat = np.ascontiguousarray(z.reshape(-1, NZ))
    predicted = np.stack([library.predict_mean(flat, m) for m in members], axis=1)
    predicted = predicted.reshape(n, window, len(members), NY)
    paper = window == 1
    noise = np.ones(3) if paper else model_noise([library.members[m] for m in members])
    uniform = np.full(len(members), 1.0 / len(members))
    return np.array(
        [
            solve_weights(
                np.ascontiguousarray(predicted[i]),
                np.ascontiguousarray(y[i]),
                noise,
                uniform,
                "l1" if paper else "quadratic",
                _PAPER_ALPHA if paper else _LAMBDA,
            )
            for i in range(n)
        ]
    )


def _coverage(error: NDArray[np.float64], variance: NDArray[np.float64]) -> list[float]:
    inside = np.abs(error) <= NORMAL_95 * np.sqrt(variance)
    shares: list[float] = inside.mean(axis=0).tolist()
    return shares


def _nlpd(error: NDArray[np.float64], variance: NDArray[np.float64]) -> list[float]:
    density = 0.5 * (np.log(2.0 * np.pi * variance) + error**2 / variance)
    means: list[float] = density.mean(axis=0).tolist()
    return means
