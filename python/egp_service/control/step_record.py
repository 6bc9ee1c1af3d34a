"""A control step as plain numbers, the message `StepRecord` of recordings and displays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from egp_service._core import InvalidArgumentError
from egp_service.control.messages import message_class
from egp_service.quantities import NX, STATE

if TYPE_CHECKING:
    from google.protobuf.message import Message
    from numpy.typing import ArrayLike, NDArray

    from egp_service.control.step import Step


def measured_state(x: ArrayLike) -> NDArray[np.float64]:
    """Return a measured state as an array (7,); `InvalidArgumentError` for anything else."""
    try:
        state = np.asarray(x, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError(f"expected numbers for x, got {x!r}: {error}") from error
    if state.shape != (NX,):
        raise InvalidArgumentError(f"x has shape {state.shape}: expected ({NX},)")
    return state


def step_record(step: Step, state: NDArray[np.float64], time: float) -> Message:
    """Return the plain numbers of a step.

    `state` is the measured state (7,), `time` the time since the start in s. Without a reply the
    friction is NaN.
    """
    found = step.friction
    mean, lower, upper, information = (
        (math.nan,) * 4
        if found is None
        else (found.mean, found.lower, found.upper, found.information)
    )
    return message_class("StepRecord")(
        time=time,
        **dict(zip(STATE, state.tolist(), strict=True)),
        force=float(step.u[0]),
        steering_rate=float(step.u[1]),
        mode=step.mode,
        status=step.status,
        detail=step.detail,
        limited=step.limited,
        lost=step.lost,
        weights=step.weights.tolist(),
        friction_mean=mean,
        friction_lower=lower,
        friction_upper=upper,
        friction_information=information,
        envelope_distance=step.envelope_distance,
        total_ms=1e3 * step.timings.total,
        queue_ms=1e3 * step.timings.queue,
        compute_ms=1e3 * step.timings.compute,
        replica=step.replica,
    )
