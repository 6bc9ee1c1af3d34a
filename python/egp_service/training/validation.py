"""The validation matrix: prediction errors of each member of a library on each surface.

The predictions are those of the library file and of the code that the controller uses.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError
from egp_service.quantities import NORMAL_95, NY
from egp_service.training.open_loop import LINEAR, linear, rollout, skill, starts

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from egp_service._core import Library
    from egp_service.data.dataset import Dataset
    from egp_service.training.open_loop import Skill
    from egp_service.training.trained import TrainedMember

# Each variance needs a triangular solve; more rows than this change the third digit only.
_MAX_ROWS: Final = 3000
_VALIDATION_STRIDE: Final = 5  # rows from the start of a rollout to that of the next one


@dataclasses.dataclass(frozen=True, eq=False)
class Cell:
    """Errors of one member on one surface; arrays have one value per output."""

    member: str
    surface: str
    rmse: NDArray[np.float64]
    """Root mean square error over one period, output units."""
    nlpd: NDArray[np.float64]
    """Mean negative log predictive density, nats; lower is better."""
    coverage: NDArray[np.float64]
    """Share of outcomes inside the 95 % interval; ideally 0.95."""
    rollout: NDArray[np.float64]
    """Root mean square error of `[v_x, v_y, omega]` after a rollout of `ROLLOUT` seconds."""


ROLLOUT: Final = 1.0


def validate(library: Library, surfaces: Mapping[str, Dataset]) -> list[list[Cell]]:
    """Validate every member (rows) on every surface's held-out data (columns).

    Raises:
        EgpError: if a dataset's dt differs from the library's.

    """
    for name, dataset in surfaces.items():
        if dataset.provenance.dt != library.dt:
            raise EgpError(
                f"surface {name} has dt {dataset.provenance.dt:g} s, the library {library.dt:g} s"
            )
    return [
        [_cell(library, index, name, dataset) for name, dataset in surfaces.items()]
        for index in range(len(library.members))
    ]


def _cell(library: Library, index: int, surface: str, dataset: Dataset) -> Cell:
    member = library.members[index]
    rows = np.linspace(0, len(dataset) - 1, min(len(dataset), _MAX_ROWS)).astype(int)
    mean, _, variance = library.predict(dataset.z[rows], index)
    variance = variance + member.noise_std**2
    error = dataset.y[rows] - mean
    nlpd = 0.5 * (np.log(2.0 * np.pi * variance) + error**2 / variance)
    return Cell(
        member=member.label,
        surface=surface,
        rmse=np.sqrt(np.mean(error**2, axis=0)),
        nlpd=nlpd.mean(axis=0),
        coverage=np.mean(np.abs(error) < NORMAL_95 * np.sqrt(variance), axis=0),
        rollout=rollout_error(library, index, dataset, round(ROLLOUT / library.dt)),
    )


def rollout_error(
    library: Library, index: int, dataset: Dataset, periods: int
) -> NDArray[np.float64]:
    """Return the RMS error of `[v_x, v_y, omega]` after a rollout of `periods` periods.

    Inputs and steering angles are those of the data. Rollouts start at every fifth row with enough
    following rows of its trajectory; without such a row the result is NaN.
    """
    start = starts(dataset, periods, _VALIDATION_STRIDE)
    if len(start) == 0:
        return np.full(NY, np.nan)
    error = rollout(lambda z: library.predict_mean(z, index), dataset, start, periods)
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def member_skill(library: Library, index: int, member: TrainedMember) -> Skill:
    """Compare a member of the finished file with no change and with a linear model.

    The data are those that were held out of the training of `member`, the linear model is fitted to
    those that were not.
    """
    vehicle = library.parameters
    label = library.members[index].label
    return skill(
        {
            LINEAR: linear(member.dataset, (vehicle.l_f, vehicle.l_r)),
            label: lambda z: library.predict_mean(z, index),
        },
        member.validation,
    )
