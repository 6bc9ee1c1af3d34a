"""The choice of a member's kind by what it predicts on held-out blocks.

A member's kind is what its processes are added to, and whether it has any. Kinds are trained on
four of five blocks of the training data and compared on the fifth by the likelihood of
`open_loop.skill`: heavy-tailed, over one period and rollouts up to 2 s, in all outputs. The best
one is trained again on all blocks, with the noise that its errors on the fifth had. The fifth
is not held out of everything: before kinds are compared, the parameters of the vehicle are fitted
to all blocks (`vehicle_fit`), which favours kinds with a vehicle. Processes, constants and scales
are those of the four blocks.

A model with more parameters is taken only where it predicts better, with one exception: outside its
data only a single-track vehicle predicts slides. The best kind with one is therefore preferred if
it is better than no change, unless another kind is better than it by `MARGIN` or more.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError
from egp_service.quantities import GP_INPUT, NY
from egp_service.training.average_member import ITERATIONS, average_member, widening_on
from egp_service.training.exact_member import spread
from egp_service.training.open_loop import NO_CHANGE, skill
from egp_service.training.prior_mean import PriorMean

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.training.train import TrainingSettings
    from egp_service.training.trained import TrainedMember
    from egp_service.training.vehicle_fit import FittedVehicle

KINDS: Final = (
    NO_CHANGE,
    "constant",
    "constant + GPs",
    "kinematic",
    "kinematic + GPs",
    "single-track",
    "single-track + GPs",
)
"""Kinds of members, the simplest first."""
_FITTED: Final = tuple(kind for kind in KINDS if kind.endswith(" + GPs"))
_FIT: Final = NY * ITERATIONS
BUDGET: Final = (len(_FITTED) + 1) * _FIT
"""Largest number of iterations of a choice: the kinds with processes, and the best kind again."""
MARGIN: Final = 0.25
"""Nats per error by which another kind must be better than the best single-track vehicle. On two
drives of the simulated car, with exact states and with the sensors of `data.sensors`, such a
vehicle with processes was the best kind, by 0.18 and 0.14; on a log of an oval another one was
better by 0.02."""
_HELD_OUT_EVERY: Final = 5  # blocks from one that is held out to the next one


def best_member(
    part: tuple[Dataset, Dataset],
    fitted: FittedVehicle,
    settings: TrainingSettings,
    rng: np.random.Generator,
    report: Callable[[str, float, int], None],
) -> TrainedMember:
    """Train a member of the kind that predicts held-out blocks of the training data best.

    Blocks are trajectories; `part` has training and validation data. `fitted` is the vehicle whose
    body a kinematic vehicle has, too. `report` gets the stage, the loss and the number of
    iterations so far.

    Raises:
        EgpError: as `blocks_to_compare`, or if a fit fails.

    """
    inner = blocks_to_compare(part[0])
    seed = int(rng.integers(2**32))
    means = {
        NO_CHANGE: PriorMean(constant=False),
        "constant": PriorMean(),
        "kinematic": PriorMean(kinematic=fitted.values[:3]),
        "single-track": PriorMean(single_track=fitted.values, steps=fitted.steps),
    }

    def trained(
        kind: str,
        on: tuple[Dataset, Dataset],
        before: int,
        widening: NDArray[np.float64] | None = None,
    ) -> TrainedMember:
        def on_fit(stage: str, loss: float, done: int) -> None:
            report(f"{kind}: {stage}", loss, before + done)

        mean = means[kind.partition(" + ")[0]]
        again = np.random.default_rng(seed)
        on_processes = on_fit if kind in _FITTED else None
        return average_member(on, mean, settings, again, on_processes, widening=widening)

    before = {kind: number * _FIT for number, kind in enumerate(_FITTED)}
    candidates = {kind: trained(kind, inner, before.get(kind, 0)) for kind in KINDS}
    compared = skill(
        {kind: member.predict_mean for kind, member in candidates.items() if kind != NO_CHANGE},
        inner[1],
    )
    best = preferred(compared.likelihood)
    widening = widening_on(candidates[best])
    member = trained(best, part, len(_FITTED) * _FIT, widening)
    return dataclasses.replace(
        member, vehicle=fitted, kind=best, likelihoods=dict(compared.likelihood)
    )


def preferred(likelihoods: Mapping[str, float]) -> str:
    """Return the kind to take, given the held-out log likelihood of each kind in nats per error."""
    best = max(KINDS, key=lambda kind: likelihoods[kind])
    slides = [kind for kind in KINDS if kind.startswith("single-track")]
    vehicle = max(slides, key=lambda kind: likelihoods[kind])
    return vehicle if likelihoods[vehicle] > max(likelihoods[best] - MARGIN, 0.0) else best


def blocks_to_compare(data: Dataset) -> tuple[Dataset, Dataset]:
    """Split training data by `hold_out` and check that kinds can be compared on the result.

    Raises:
        EgpError: as `hold_out`, if an input is constant in the data to train on, or if no held-out
            transition counts in a comparison.

    """
    rest, held = hold_out(data)
    spread(rest.z, GP_INPUT, data.provenance.surface)
    if not skill({}, held).durations:
        raise EgpError(
            f"surface {data.provenance.surface}: models are compared on a held-out trajectory with "
            f"transitions above {data.least_speed:.3g} m/s, and there is none beside those to train"
            " on. Record more driving above this speed, or train without a comparison (`egp train "
            "--mean single-track`)"
        )
    return rest, held


def hold_out(data: Dataset) -> tuple[Dataset, Dataset]:
    """Split off every fifth trajectory, and at least the last one.

    If none of these has a transition that counts, the last one that has is split off in their
    place, unless it is the only one.

    Raises:
        EgpError: if there are fewer than two trajectories.

    """
    numbers = np.unique(data.trajectory)
    if len(numbers) < 2:  # noqa: PLR2004
        raise EgpError(
            f"surface {data.provenance.surface} has one trajectory of {len(data)} transitions left "
            "to train on: models are compared on another one, which is held out. A log starts a "
            "new trajectory every 10 s: record more than 20 s (`egp train --mean single-track` "
            "needs less)"
        )
    every = _HELD_OUT_EVERY
    held = numbers[every - 1 :: every] if len(numbers) >= every else numbers[-1:]
    out = np.isin(data.trajectory, held)
    moving = np.unique(data.trajectory[data.counts])
    if len(moving) > 1 and not np.isin(moving, held).any():
        out = data.trajectory == moving[-1]
    return data.select(~out), data.select(out)
