"""The result of a control period, and the interface of the controllers that compute it."""

from __future__ import annotations

import math
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal, Never, Self, TypeAlias

import numpy as np

from egp_service._core import EgpError, Friction

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from types import FrameType

    from _typeshed import DataclassInstance
    from numpy.typing import ArrayLike, NDArray

    from egp_service._core import Decision, Driver, InProcessDriver

    Measured: TypeAlias = tuple[ArrayLike, ArrayLike, ArrayLike | None, ArrayLike | None]
    """State (7,), reference (T+1, 4), widths (T+1, 2) and friction of the road (T+2, 2) of one
    period."""


_FIXED: Final = frozenset(
    {
        "dt",
        "frictions",
        "history",
        "horizon",
        "library",
        "library_file",
        "members",
        "settings",
        "stated_settings",
    }
)
"""Attributes of a controller that describe its control step."""
_LONGEST: Final = 10.0
"""Largest time for a step that a request states, s."""


class EqualByValue:
    """A base of dataclasses with `eq=False`: two are equal if the values of all fields are.

    Arrays are equal if their shapes and all elements are, and NaN equals NaN. Fields with
    `compare=False` do not count. As arrays have no hash, such objects have none either.
    """

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]

    def __eq__(self: DataclassInstance, other: object) -> bool:
        """Compare the values of all fields."""
        if type(other) is not type(self):
            return NotImplemented
        return all(
            _equal(getattr(self, field.name), getattr(other, field.name))
            for field in fields(self)
            if field.compare
        )


def _equal(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")
    if isinstance(one, Friction) and isinstance(other, Friction):
        return _equal(one.__getnewargs__(), other.__getnewargs__())
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return one == other or (math.isnan(one) and math.isnan(other))
    return type(one) is type(other) and one == other


class Closing(ABC):
    """A base of context managers whose block ends with `close`."""

    @abstractmethod
    def close(self) -> None:
        """Release what the object holds."""

    def __enter__(self) -> Self:
        """Return the object itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close, also after an error."""
        self.close()


@dataclass(frozen=True, slots=True)
class Timings:
    """The times within a step, s."""

    total: float
    """Time from the call to the command."""
    queue: float = 0.0
    """Time in the service's queue."""
    compute: float = 0.0
    """Time of decoding, control step and encoding in the service or engine."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Step(EqualByValue):
    """One control period: the command, its origin, and the messages that were exchanged.

    States are `[p_x, p_y, v_x, psi, v_y, omega, delta]` of the centre of mass: position in m in the
    map's frame, speeds ahead and to the left in m/s, yaw in rad counter-clockwise from the map's x
    axis, yaw rate in rad/s, steering angle of the front wheels in rad. Inputs are
    `[F_x, delta_dot]` in N and rad/s.

    - `u` (2,): the command for the actuators; `mode`, `limited`, `status`, `detail`: its origin.
    - `plan_x` (T+1, 7), `plan_u` (T, 2), `sigma` (T+1, 3): the new plan, if there is one.
    - `weights` (N,), `friction`: the members' weights and the posterior of the friction.
    - `envelope_distance`, `lost`: distance from the training data, and whether the vehicle is
      stopped because of it.
    - `timings`, `replica`, `request`, `reply`, `late`: times, and what was exchanged.

    Two steps are equal if all their values are, where NaN equals NaN.
    """

    u: NDArray[np.float64]
    """Force [N] and steering rate [rad/s] for the actuators, inside all limits."""
    mode: Literal["normal", "tail", "stop", "waiting"]
    """`normal` (a new plan), `tail` (the rest of an older plan), `stop` (braking until `reset()`)
    or `waiting` (braking until the first plan). A new plan that came just after the deadline is
    driven, too; its reply is then in `late`, the status is `late`, and `plan_u` is `None`."""
    limited: bool
    """Whether a limit of the gate changed the command of the plan."""
    status: str
    """The solver's status (`solved`, `iteration_limit`, `infeasible`, `numerical_error`,
    `check_failed`), or why there is none: `refused`, `unusable` (a reply that failed its check),
    `late`, `unreachable`, `invalid_state`."""
    detail: str
    """Why there is no plan, or why the vehicle counts as lost; empty otherwise."""
    weights: NDArray[np.float64]
    """Weights (N,) of the newest reply; empty before the first."""
    plan_x: NDArray[np.float64] | None
    """States (T+1, 7) of the new plan, from the measured state on."""
    plan_u: NDArray[np.float64] | None
    """Inputs (T, 2) of the new plan, `[F_x, delta_dot]` in N and rad/s."""
    sigma: NDArray[np.float64] | None
    """Standard deviations (T+1, 3) of `[v_x, v_y, omega]` along the plan, if requested, in m/s, m/s
    and rad/s."""
    friction: Friction | None
    """Posterior of the friction coefficient from the last transitions; `None` without a reply.
    Its field `informed` states whether these transitions contain information about the friction."""
    timings: Timings
    replica: str
    """Name of the replica that replied or was asked last; empty if none was asked."""
    request: bytes
    """The bytes sent; empty if there was no request."""
    reply: bytes | None
    """The bytes of this period's reply."""
    late: tuple[bytes, ...]
    """Replies to earlier requests that came in the meantime."""
    envelope_distance: float = float("nan")
    """Distance of `[v_x, v_y, omega, delta]` from the library's training data: the largest excess
    of a component over its range, in half widths of that range; 0 inside."""
    lost: bool = False
    """Whether the vehicle counts as lost (far outside the training data, far from the reference, or
    pointing away from it) and is therefore stopped, until `reset()`."""
    held_up: int = 0
    """Control periods in which the program was held up before or in this step, if they are more
    than a plan may bridge (`max_tail_ticks`); 0 otherwise, and always in a `Controller`."""

    def __repr__(self) -> str:
        """Return mode, status, command, weights and friction in one line."""
        force, rate = self.u
        weights = ", ".join(f"{weight:.2f}" for weight in self.weights)
        friction = "unknown"
        if self.friction is not None:
            friction = f"{self.friction.lower:.2f} to {self.friction.upper:.2f}"
        return (
            f"<Step {self.mode}, {self.status}: {force:.0f} N, {rate:+.3f} rad/s, "
            f"weights [{weights}], friction {friction}>"
        )

    @classmethod
    def of(cls, decision: Decision, weights: NDArray[np.float64], total: float) -> Self:
        """Make the step of a driver's decision that took `total` seconds."""
        queue, compute = decision.service_time
        return cls(
            u=decision.u,
            mode=decision.mode,
            limited=decision.limited,
            status=decision.status,
            detail=decision.detail,
            weights=weights,
            plan_x=decision.plan_x,
            plan_u=decision.plan_u,
            sigma=decision.sigma,
            friction=decision.friction,
            timings=Timings(total, queue, compute),
            replica=decision.replica,
            request=decision.request,
            reply=decision.reply,
            late=tuple(decision.late),
            envelope_distance=decision.envelope_distance,
            lost=decision.lost,
            held_up=decision.held_up,
        )


class StepController(Closing):
    """Computes commands for the actuators from measured states and references.

    Once in each control period::

        step = controller.step(x, reference, widths)
        vehicle.apply(step.u)

    `Controller` computes the step in this process, `VehicleClient` asks the service; both send the
    same request and get the same bytes back, and the driver in Rust makes every decision.

    Each vehicle needs a controller of its own. `reset` may be called in another thread than `step`:
    it waits until a step that runs has ended.
    """

    library: bytes
    """SHA-256 of the library file."""
    dt: float
    """Control period in s."""
    horizon: int
    """Inputs in a plan, T."""
    history: int
    """Transitions from which a step estimates weights and friction, K."""
    members: Sequence[str]
    """Surfaces, in the order of the weights."""
    frictions: Sequence[float] | None = None
    """Nominal friction coefficients of the members, no unit, in the order of the weights; `None` if
    they are not known, as with a service."""
    settings: Mapping[str, object] | None = None
    """Every setting that the control step uses; `None` if they are not known, as with a service."""
    stated_settings: Mapping[str, object] = MappingProxyType({})
    """Settings that were stated in place of defaults."""
    library_file: Path | None = None
    """The library file, if it is known."""
    _driver: Driver | InProcessDriver

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute; what describes the control step can be set once only."""
        if name in _FIXED and name in vars(self):
            raise AttributeError(f"{name} of a controller cannot be changed: make another one")
        super().__setattr__(name, value)

    def __reduce__(self) -> Never:
        """Raise `TypeError`."""
        raise TypeError(
            f"a {type(self).__name__} cannot be pickled or copied: make one in each process"
        )

    def __init__(self) -> None:
        """Make what all controllers have."""
        # The lock is re-entrant: a signal handler may call a method while another one runs.
        self._lock = threading.RLock()
        self._to_reset = self._closed = False

    def __repr__(self) -> str:
        """Return members, period and horizon in one line, and whether it was closed."""
        return (
            f"<{type(self).__name__} of {', '.join(self.members)}: dt {self.dt:g} s, "
            f"horizon {self.horizon}{', closed' if self._closed else ''}>"
        )

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        road_friction: ArrayLike | None = None,
        deadline: float | None = None,
    ) -> Step:
        """Return the step for a measured state (7,), a reference (T+1, 4) and widths (T+1, 2).

        `x` is `[p_x, p_y, v_x, psi, v_y, omega, delta]`, `reference` has rows
        `[p_x, p_y, v_x, psi]` from now on, `widths` rows `[left, right]`, all in SI units and rad.
        `road_friction` (T+2, 2) is what is known about the road: rows of friction coefficient and
        standard deviation, first of the road on which the last transitions were measured, then at
        each row of the reference (see `RoadBelief.preview`). The model of each stage follows it.
        Call it once each period. It returns within `deadline` seconds (default: the property
        `deadline`), with a command whatever happens to the service; without a service it takes as
        long as the control step, and `deadline` is only stated in the request. With a deadline of 0
        or less a command is returned, too; values above 10 s count as 10 s. A measured state that
        is not finite, or is outside its domain, is not an error: its command is a stop.

        Raises:
            InvalidArgumentError: if an argument has the wrong shape, `deadline` is not finite, or
                the reference is not one to drive, for instance with a yaw in degrees or speeds in
                km/h.
            EgpError: after `close`, and in a handler of a signal that interrupts another step of
                this controller.

        """
        start = time.monotonic()
        with self._lock:
            if self._closed:
                raise EgpError("the controller was closed: make another one")
            budget = self._driver.budget if deadline is None else deadline
            if math.isfinite(budget):
                budget = min(max(budget, 0.0), _LONGEST)
            if self._is_within_step(sys._getframe(1)):  # noqa: SLF001
                raise EgpError(
                    "this thread is within a step of this controller, which a signal interrupts; "
                    "step again after it"
                )
            try:
                decision = self._decide(start, budget, (x, reference, widths, road_friction))
                return Step.of(decision, self._driver.weights, time.monotonic() - start)
            except BaseException:
                # Gives the open period up, so that a later step does not return its command.
                self._driver.abandon()
                raise
            finally:
                if self._to_reset:
                    self._to_reset = False
                    self._driver.reset()

    @property
    def deadline(self) -> float:
        """Time that a step may take unless its call states another one, s."""
        with self._lock:
            return self._driver.budget

    @abstractmethod
    def _decide(self, start: float, budget: float, measured: Measured) -> Decision:
        """Decide the period that began at `start` of the monotonic clock, within `budget` s."""

    def reset(self) -> None:
        """Leave STOP and discard history, weights, plan and outstanding requests.

        Call it for instance after the vehicle was moved. The input that the actuators apply is
        kept. In a handler of a signal that interrupts a step, the reset comes at the end of that
        step.
        """
        with self._lock:
            if self._is_within_step(sys._getframe(1)):  # noqa: SLF001
                self._to_reset = True
            else:
                self._driver.reset()

    def _is_within_step(self, frame: FrameType | None) -> bool:
        """Whether a frame is that of a step of this controller, or of what such a step calls.

        A mark that the step sets and takes away again could stay: Python calls handlers of signals
        at any call of a function, and what they raise ends the step there.
        """
        while frame is not None:
            if frame.f_code is StepController.step.__code__ and frame.f_locals["self"] is self:
                return True
            frame = frame.f_back
        return False

    def close(self) -> None:
        """Release the controller's resources; no step can follow."""
        self._closed = True


def check_type(name: str, value: object, expected: type) -> None:
    """Raise `TypeError` if the argument `name` has another type than the expected one."""
    if not isinstance(value, expected):
        raise TypeError(
            f"{name}: expected {expected.__name__}, got an object of the type "
            f"{type(value).__name__}"
        )


def as_dict(gate: Mapping[str, float]) -> dict[str, float]:
    """Return the settings of a gate for the extension; raise `TypeError` if they are no mapping."""
    if not isinstance(gate, Mapping):
        raise TypeError(
            "gate: expected a mapping such as `VehicleParameters.gate_limits()`, got an object of "
            f"the type {type(gate).__name__}"
        )
    return dict(gate)
