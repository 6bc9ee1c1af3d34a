"""What a vehicle publishes about itself for displays such as `egp monitor` (docs/monitor.md).

The publication costs a vehicle one small message every 0.1 s and never delays a control step: zenoh
drops a message that it cannot send at once, and one that nobody receives is not sent.
"""

from __future__ import annotations

import math
import secrets
import time as clock
from collections import deque
from typing import TYPE_CHECKING, Final

import zenoh

from egp_service._core import EgpError, vehicle_key, vehicle_road_key
from egp_service.control.certificates import check_zenoh_file
from egp_service.control.endpoints import (
    MONITOR_ENDPOINT,
    MONITOR_PORT,
    endpoint_list,
    endpoint_names,
)
from egp_service.control.messages import message_class
from egp_service.control.session import (
    check_process,
    close_session,
    direct,
    is_lost,
    open_session,
    session_config,
    zenoh_reason,
)
from egp_service.control.step import Closing, Step, StepController, check_type
from egp_service.control.step_record import measured_state, step_record
from egp_service.quantities import POSITION

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping, Sequence

    from google.protobuf.message import Message
    from numpy.typing import ArrayLike


VERSION: Final = 1
INTERVAL: Final = 0.1
"""Least time between two messages, s."""
_KEPT_TIMES: Final = 64
_ENCODING: Final = "application/protobuf;egp.v1."


class StatusPublisher(Closing):
    """Publishes the steps of one vehicle for displays; a context manager.

    It works with every controller, in a session of its own::

        with StatusPublisher(controller, "tcp/127.0.0.1:7450", vehicle="car-7") as status:
            while driving:
                step = controller.step(x, reference, widths)
                vehicle.apply(step.u)
                status.add(step, x, time)

    Every 0.1 s a message has the newest period, the counts of all periods, and the times of the
    periods since the last message, of which it has the newest 64 at most.
    """

    def __init__(
        self,
        controller: StepController,
        endpoints: str | Sequence[str] = MONITOR_ENDPOINT,
        *,
        fleet: str = "default",
        vehicle: str = "vehicle-1",
        road: Message | None = None,
        zenoh_file: str | os.PathLike[str] | None = None,
        zenoh_config: Mapping[str, object] | None = None,
    ) -> None:
        """Publish the steps of `controller` to `endpoints`, a monitor's or a router's.

        `road` is a message `VehicleRoad`, which is given to displays that ask for it. `zenoh_file`
        and `zenoh_config` are as for `VehicleClient.connect`. An endpoint that cannot be reached is
        tried again and again meanwhile.

        Raises:
            TypeError: for a controller or endpoints of another type.
            InvalidArgumentError: for names, endpoints or a configuration that cannot be used, and
                without endpoints unless there is a configuration.
            EgpError: for certificates as `VehicleClient.connect`, and if zenoh opens no session.

        """
        check_type("controller", controller, StepController)
        names = endpoint_list(endpoints, MONITOR_PORT, configured=bool(zenoh_file or zenoh_config))
        key, road_key = vehicle_key(fleet, vehicle), vehicle_road_key(fleet, vehicle)
        self._common = {
            "version": VERSION,
            "run": secrets.randbits(64),
            "dt": controller.dt,
            "deadline_ms": 1e3 * controller.deadline,
            "members": list(controller.members),
        }
        self._periods = self._misses = self._tails = 0
        self._times: deque[Message] = deque(maxlen=_KEPT_TIMES)
        self._next = 0.0
        self._last: Message | None = None
        try:
            config = session_config(names, 0.0, zenoh_config or {}, zenoh_file)
            check_zenoh_file(zenoh_file, zenoh_config or {})
            self._session = open_session(config, 0.0)
        except zenoh.ZError as error:
            raise EgpError(
                f"zenoh cannot open a session with {endpoint_names(names)}: {zenoh_reason(error)}"
            ) from error
        self._publisher = self._session.declare_publisher(
            key,
            encoding=_ENCODING + "VehicleStatus",
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_LOW,
        )
        if road is not None:
            payload = road.SerializeToString()

            def answer(query: zenoh.Query) -> None:
                query.reply(road_key, payload, encoding=_ENCODING + "VehicleRoad")

            self._queryable = self._session.declare_queryable(road_key, direct(answer))

    def add(
        self,
        step: Step,
        x: ArrayLike,
        time: float,
        *,
        lateral_error: float = math.nan,
        truth: Message | None = None,
    ) -> None:
        """Count one control period, and publish it if the last message is 0.1 s old.

        `x` is the measured state (7,), `[p_x, p_y, v_x, psi, v_y, omega, delta]` in SI units and
        rad, `time` the time since the start in s, `lateral_error` the distance from the reference
        in m, positive to the left. `truth` is the message `PlantTruth` of a simulated vehicle.

        Raises:
            InvalidArgumentError: unless `x` has the shape (7,).
            TypeError: unless `step` is a `Step`.
            EgpError: if the publisher is closed, and in a process that was forked from one in which
                zenoh ran.

        """
        check_type("step", step, Step)
        state = measured_state(x)
        check_process()
        if self._session.is_closed():
            raise EgpError("the publisher was closed")
        missed = step.mode != "normal" or step.status == "late"
        self._periods += 1
        self._misses += missed
        self._tails += step.mode == "tail"
        spent = step.timings
        self._times.append(
            message_class("PeriodTimes")(
                total_ms=1e3 * spent.total,
                queue_ms=1e3 * spent.queue,
                compute_ms=1e3 * spent.compute,
                missed=missed,
            )
        )
        now = clock.monotonic()
        if now < self._next:
            return
        # A period that is a little late does not delay the messages after it.
        self._next = max(self._next, now - INTERVAL) + INTERVAL
        plan = [] if step.plan_x is None else step.plan_x[:, POSITION].ravel().tolist()
        self._last = message_class("VehicleStatus")(
            **self._common,
            **self._counts(),
            step=step_record(step, state, time),
            truth=truth,
            lateral_error=lateral_error,
            plan=plan,
        )
        self._times.clear()
        self._publisher.put(self._last.SerializeToString())

    def _counts(self) -> dict[str, object]:
        """Give the fields that cover all periods."""
        return {
            "periods": self._periods,
            "misses": self._misses,
            "tails": self._tails,
            "times": self._times,
        }

    def close(self) -> None:
        """Publish that the vehicle ends its publication, and close the session."""
        if self._last is not None and not is_lost() and not self._session.is_closed():
            last = message_class("VehicleStatus")()
            last.CopyFrom(self._last)
            last.ClearField("times")
            counts = self._counts()
            last.MergeFrom(message_class("VehicleStatus")(**counts, ended=True))
            self._publisher.put(last.SerializeToString())
        close_session(self._session)
