"""Prediction error of members, pooled GP and ensembles: the paper's "Comparison with standard GP".

Five surfaces are sampled, A 0.3, B 0.6, T 0.7, C 0.8 and D 1.0. Members are trained on A to D, one
GP on A and D pooled; T stays unseen. An ensemble takes its weights from the transitions just before
the one it predicts. Members are tested on the kind of data they were trained on, from other seeds.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import torch

from egp_service._core import Library, solve_weights
from egp_service.data.experiment import Experiment
from egp_service.data.sampling import sample
from egp_service.evaluation.batch import Batch
from egp_service.evaluation.claims import POOLED
from egp_service.evaluation.window_noise import model_noise
from egp_service.quantities import NY, NZ
from egp_service.training.export import export
from egp_service.training.train import TrainingSettings, train

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset

SURFACES: Final = {"A": 0.3, "B": 0.6, "T": 0.7, "C": 0.8, "D": 1.0}
_DT: Final = 0.02
_KEEP: Final = 6  # transitions of a trajectory: five for the weights, one to predict
_SETTLE: Final = 2  # periods before them, in which the suspension comes to rest
_TEST_TRAJECTORIES: Final = 300
_NOMINAL: Final = 1.959964  # standard deviations around 95 %
# Of the quadratic prior over a window; small against one whitened squared error.
_PULL: Final = 1e-3
# Of the paper's prior, with which the previous transition alone gives the weights.
_PAPER_ALPHA: Final = 1e-5


@dataclasses.dataclass(frozen=True)
class PredictionSettings:
    """Size of the experiment."""

    seeds: int = 10
    transitions: int = 700
    """Training transitions of a member, as many as the paper's; the pooled GP has all of two."""
    iterations: int = 30


@dataclasses.dataclass(frozen=True)
class PredictionOutcome:
    """How well one predictor did on one test set, for one seed."""

    predictor: str
    tested_on: str
    window: int
    """Transitions behind the weights; 0 for a single GP."""
    seed: int
    rmse: list[float]
    """Of the changes of v_x, v_y (m/s) and omega (rad/s)."""
    coverage: list[float]
    """Share inside the 95 % interval: variance of eq. (3), members independent."""
    coverage_mixture: list[float]
    """The same for the mixture variance, disagreement included."""
    nlpd: list[float]
    """Negative log predictive density under the variance of eq. (3)."""
    nlpd_mixture: list[float]


@dataclasses.dataclass(frozen=True)
class SeedOutcomes:
    """What came of one seed."""

    outcomes: list[PredictionOutcome]

    @classmethod
    def read(cls, values: dict[str, Any]) -> SeedOutcomes:
        """Make it of what JSON leaves of it."""
        return cls([PredictionOutcome(**row) for row in values["outcomes"]])


def seeds(
    settings: PredictionSettings, folder: Path, report: Callable[[SeedOutcomes], None]
) -> Batch[tuple[PredictionSettings, int], SeedOutcomes]:
    """All seeds; what came of them goes to `prediction.jsonl`, whatever program it came from."""
    size = f"{settings.transitions}-{settings.iterations}"
    parts = {f"{size}-{seed}": (settings, seed) for seed in range(settings.seeds)}
    return Batch(folder / "prediction.jsonl", parts, run_seed, SeedOutcomes.read, report)


def run_seed(part: tuple[PredictionSettings, int]) -> SeedOutcomes:
    """Sample, train and test one seed, with this process's torch on one thread from now on.

    The bits of sums over several threads depend on how many there are.
    """
    settings, seed = part
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
    """Train A, B, C, D and the pooled GP; through the library file, as everything else."""
    count = -(-settings.transitions * 5 // 4)  # a fifth is held out
    data = {
        name: _sampled(mu, 1000 * seed + number, count, name, keep=1)
        for number, (name, mu) in enumerate(SURFACES.items())
        if name != "T"
    }
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
    both = [_relabelled(data[name]) for name in ("A", "D")]
    twice = dataclasses.replace(plan, max_points=2 * settings.transitions)
    members += train(both, twice)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "library.safetensors"
        export(path, members, plan, {})
        return Library.load(path)


def _sampled(friction: float, seed: int, count: int, label: str, *, keep: int) -> Dataset:
    """Keep the last transitions of `count` trajectories of the same length.

    Members learn from one of each: where several share hidden states and inputs, the likelihood
    prefers a process that tells trajectories apart to one that predicts others.
    """
    experiment = Experiment(friction=friction, label=label, seed=seed, dt=_DT)
    return sample(experiment, count, settle=_SETTLE + _KEEP - keep, keep=keep)


def _relabelled(dataset: Dataset) -> Dataset:
    """Call the surface by the pool's name; its friction is then nobody's."""
    middle = 0.5 * (SURFACES["A"] + SURFACES["D"])
    provenance = dataclasses.replace(dataset.provenance, surface=POOLED, friction=middle)
    return dataclasses.replace(dataset, provenance=provenance)


def _test_set(
    friction: float, seed: int, label: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Whole trajectories: inputs (n, _KEEP, 6) and changes (n, _KEEP, 3)."""
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
        rmse=_floats(np.sqrt(np.mean(error**2, axis=0))),
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
    """Weights (n, N) from the window before each prediction, starting from uniform.

    From one transition as the paper does, S = I and its L1 prior; from more whitened by the
    members' noise alone, as states are exact here, and with a weak quadratic prior.
    """
    n, window = z.shape[:2]
    flat = np.ascontiguousarray(z.reshape(-1, NZ))
    predicted = np.stack([library.predict(flat, m)[0] for m in members], axis=1)
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
                _PAPER_ALPHA if paper else _PULL,
            )
            for i in range(n)
        ]
    )


def _coverage(error: NDArray[np.float64], variance: NDArray[np.float64]) -> list[float]:
    inside = np.abs(error) <= _NOMINAL * np.sqrt(variance)
    return _floats(np.mean(inside, axis=0))


def _nlpd(error: NDArray[np.float64], variance: NDArray[np.float64]) -> list[float]:
    density = 0.5 * (np.log(2.0 * np.pi * variance) + error**2 / variance)
    return _floats(np.mean(density, axis=0))


def _floats(values: NDArray[np.float64]) -> list[float]:
    return [float(value) for value in values]
