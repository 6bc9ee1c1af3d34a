"""The client of the service over zenoh.

The driver in Rust makes all decisions. This module carries out its actions and reports events.
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Self

from egp_service._core import Decision, Discovery, Driver, InvalidArgumentError, decode_ready
from egp_service.control.certificates import check_zenoh_file
from egp_service.control.endpoints import SERVICE_PORT, endpoint_list
from egp_service.control.network import Announcement, Network, no_link, unreachable
from egp_service.control.session import check_process, session_config
from egp_service.control.step import StepController, as_dict

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Mapping, Sequence

    from egp_service.control.step import Measured

# Time that a replica may take to answer what it serves, and time between two rounds of questions.
_QUESTION_SECONDS = 1.0
_POLL_SECONDS = 0.05
# Events that are passed to the driver in each period even if its deadline has passed, so that they
# do not pile up. Further ones are passed until the deadline, and the next step goes on.
_FEW_EVENTS = 64


class LostTracesWarning(UserWarning):
    """Spans of traces could not be written to their file; the control steps were not affected."""


class VehicleClient(StepController):
    """Drive with the service; make one with `VehicleClient.connect`.

    If no answer comes before the deadline of the step, the gate gives the command. A service that
    returns is found again automatically; after a stop, `reset()` continues the drive.
    """

    _driver: Driver

    def __init__(
        self, network: Network, ready: bytes, driver: Driver, traces: Path | None = None
    ) -> None:
        """Use an open network; `ready` is a replica's answer on its `ready` key.

        `traces` is the file to which the driver writes them.
        """
        super().__init__()
        served = decode_ready(ready)
        self.library, self.members = served.library, served.members
        self.dt, self.horizon, self.history = served.dt, served.horizon, served.history
        self._network = network
        self._driver = driver
        self._traces = traces

    @classmethod
    def connect(
        cls,
        endpoints: str | Sequence[str],
        *,
        fleet: str = "default",
        vehicle: str = "vehicle-1",
        gate: Mapping[str, float],
        budget: float = 0.8,
        hedge: float = 0.5,
        want_sigma: bool = False,
        timeout: float = 10.0,
        key_file: str | os.PathLike[str] | None = None,
        zenoh_file: str | os.PathLike[str] | None = None,
        zenoh_config: Mapping[str, object] | None = None,
        traces: str | os.PathLike[str] | None = None,
        traces_share: float = 1.0,
    ) -> Self:
        """Connect to zenoh at `endpoints`, such as `tcp/127.0.0.1:7447`, and ask for the library.

        Without `endpoints` those of `zenoh_file` are used, a configuration of zenoh in JSON5 that
        replaces the defaults of this client. From 30 days before one of its certificates expires, a
        warning is logged.

        `fleet` and `vehicle` name the vehicle; no two vehicles of a fleet may have the same name.
        `gate` holds the limits of the driven vehicle in SI units and rad, as
        `VehicleParameters.gate_limits` gives them, and may hold `max_tail_ticks` and
        `stop_deceleration`. With `want_sigma` steps have the standard deviations `sigma`.
        `timeout` is the time for which a replica that fits is awaited, s.
        `key_file` has the vehicle's secret key, made by `egp keys`: requests are sealed with it,
        and only answers of a service that has the same key are used (docs/security.md).
        `budget` is the part of the control period that an answer may take, in (0, 1].
        `hedge` is the part of the time until the deadline, in (0, 1], after which the next replica
        is asked as well if none has answered; with 1 they are asked only one after the other. At
        most one period in twenty asks twice in the long run.
        `zenoh_config` holds more of zenoh's configuration by path, such as
        `{"transport/link/tls/root_ca_certificate": "ca.pem"}`.
        `traces` is a file to which the spans of all steps are appended as JSON lines of
        OpenTelemetry, or those of the share `traces_share` of the steps (docs/deploying.md).
        A replica is passed over if its description is not valid, or if the gate allows more than
        the vehicle that this replica plans for can do.

        Raises:
            TypeError: for endpoints or gate settings of another type.
            InvalidArgumentError: for names, gate settings, a timeout, a configuration, or a file of
                keys or traces that cannot be used.
            EgpError: for a certificate in `zenoh_file` that has expired, is not valid yet or is not
                that of a vehicle, and in a process that was forked from one in which zenoh ran.
            ServiceUnreachableError: naming each replica with the reason, when no replica gives a
                usable answer within `timeout` seconds.

        """
        names = endpoint_list(endpoints, SERVICE_PORT, configured=bool(zenoh_file or zenoh_config))
        gate = as_dict(gate)
        spans = None if traces is None else Path(traces)
        deadline = time.monotonic() + timeout
        keys = None if key_file is None else _read_keys(key_file)
        try:
            discovery = Discovery(
                fleet=fleet, vehicle=vehicle, gate=gate, budget=budget, hedge=hedge, keys=keys
            )
        except InvalidArgumentError as error:
            if key_file is not None:
                error.add_note(f"with the keys of {key_file}")
            raise
        config = session_config(names, timeout, zenoh_config or {}, zenoh_file)
        check_zenoh_file(zenoh_file, zenoh_config or {})
        network = Network(config, names, timeout)
        try:
            fitting, ready = _first_ready(network, discovery, names, deadline)
            driver = Driver(
                ready,
                fleet=fleet,
                vehicle=vehicle,
                gate=gate,
                budget=budget,
                hedge=hedge,
                want_sigma=want_sigma,
                keys=keys,
                traces=spans,
                traces_share=traces_share,
            )
            for replica in discovery.live:
                driver.replica_appeared(replica)
            driver.replica_fits(fitting)
            return cls(network, ready, driver, spans)
        except BaseException:
            network.close()
            raise

    def _decide(self, start: float, budget: float, measured: Measured) -> Decision:
        check_process()
        due = start + budget
        few = max(0, _FEW_EVENTS - self._tell_what_came(_FEW_EVENTS, due))
        self._driver.tick(start, due, *measured)
        while True:
            while (action := self._driver.next_action()) is not None:
                if isinstance(action, Decision):
                    return action
                self._network.ask(action)
            wake = self._driver.next_wake
            happened = self._network.next(wake - time.monotonic())
            if happened is not None:
                self._tell(happened)
            # The deadline ends the period although events keep coming. After a delay of this
            # program, an answer that came in time may still wait behind a few others.
            if time.monotonic() >= wake:
                few -= self._tell_what_came(few, time.monotonic())
                self._driver.wake(time.monotonic())

    def _tell_what_came(self, few: int, due: float) -> int:
        """Pass the first `few` received events to the driver, and further ones until `due`."""
        told = 0
        while told < few or time.monotonic() < due:
            if (happened := self._network.next(0.0)) is None:
                break
            self._tell(happened)
            told += 1
        return told

    def _tell(self, happened: Callable[[Driver], None]) -> None:
        # This program may have been held up since the event came.
        self._driver.clock(time.monotonic())
        happened(self._driver)

    def close(self) -> None:
        """Close the zenoh session, and write the spans that wait; no step can follow."""
        super().close()
        try:
            self._network.close()
        finally:
            lost, reason = self._driver.finish_traces()
        if lost:
            warnings.warn(
                f"{self._traces}: {lost} spans of traces could not be written "
                f"({reason or 'too many waited'}), so that the traces of some steps are "
                "incomplete; make room on the disk, or choose another file",
                LostTracesWarning,
                stacklevel=2,
            )


def _read_keys(file: str | os.PathLike[str]) -> str:
    try:
        return Path(file).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InvalidArgumentError(
            f"key_file: {error}; expected a file of secret keys, which `egp keys` writes"
        ) from error
    except UnicodeDecodeError as error:
        raise InvalidArgumentError(
            f"{file}: expected a file of secret keys, got bytes that are no UTF-8 text; `egp keys` "
            "writes such files"
        ) from error


def _first_ready(
    network: Network, discovery: Discovery, endpoints: Sequence[str], deadline: float
) -> tuple[str, bytes]:
    """Ask the live replicas in turn until one can be used; give its name and its answer."""
    while (left := deadline - time.monotonic()) > 0.0:
        question = discovery.next_question()
        if question is None:
            # Every live replica was asked, or there is none: wait for a change. All that have come
            # count before the next round, in which each frozen replica takes a second.
            patience = min(left, _POLL_SECONDS)
            while (event := network.next(patience)) is not None:
                if isinstance(event, Announcement):
                    note = discovery.replica_appeared if event.appeared else discovery.replica_gone
                    note(event.replica)
                patience = 0.0
            continue
        replica, key, seal = question
        for answer, attachment in network.ask_and_wait(key, seal, min(left, _QUESTION_SECONDS)):
            if discovery.is_usable(replica, answer, attachment):
                return replica, answer
    known = discovery.unusable or network.has_link()
    error = unreachable(endpoints, discovery.error if known else no_link(endpoints))
    error.replicas = discovery.unusable
    raise error
