"""The checks of `egp doctor`."""

from __future__ import annotations

import os
import platform
import time
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from egp_service import shipped
from egp_service._core import EgpError, Library, available_cores, vector_instructions
from egp_service.cli.extras import EXTRAS
from egp_service.control.controller import Controller
from egp_service.control.endpoints import (
    MAP_ENDPOINT,
    MONITOR_ENDPOINT,
    ROUTER_ENDPOINT,
    SERVICE_ENDPOINT,
    free_endpoint,
    why_not_free,
    why_unreachable,
)
from egp_service.control.session import session_config, zenoh_reason

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PORTS: Final = {
    "egp serve": SERVICE_ENDPOINT,
    "egp map": MAP_ENDPOINT,
    "egp router": ROUTER_ENDPOINT,
    "egp monitor": MONITOR_ENDPOINT,
}
PAGE: Final = "tcp/127.0.0.1:8642"
"""Where `egp monitor` serves its page."""
STEPS: Final = 60
_SHARE: Final = 0.5
"""Share of the control period from which a step counts as slow."""


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one check."""

    name: str
    verdict: Literal["ok", "warn", "fail"]
    found: str
    advice: str = ""
    """What to do; empty if nothing."""


def run_checks(library: Path | None = None) -> list[Check]:
    """Check the machine, the installation and a library file, the shipped one by default."""
    file = shipped.DEMO_LIBRARY if library is None else library
    checks: list[Callable[[], Check]] = [_versions, _processor, _timer, _clock, _extras, _zenoh]
    results = [check() for check in checks]
    results += [_port(f"port of {name}", endpoint, "--listen") for name, endpoint in PORTS.items()]
    results.append(_port("page of egp monitor", PAGE, "--port"))
    return [*results, *_library(file)]


def _versions() -> Check:
    text = f"egp-service {version('egp-service')}, Python {platform.python_version()}, numpy "
    return Check("versions", "ok", f"{text}{np.__version__}, {platform.platform()}")


def _processor() -> Check:
    instructions, busy, machine = vector_instructions(), os.getloadavg()[0], os.cpu_count() or 1
    found = (
        f"{_cores(available_cores())} for this process, load {busy:.1f} on "
        f"{_cores(machine)}, vector instructions {instructions}"
    )
    if instructions == "none":
        advice = "steps take several times as long without AVX2; use another processor"
        return Check("processor", "warn", found, advice)
    if busy > machine:
        advice = "other programs are running: times measured now are too long"
        return Check("processor", "warn", found, advice)
    return Check("processor", "ok", found)


def _cores(number: int) -> str:
    return f"{number} core{'' if number == 1 else 's'}"


def _timer() -> Check:
    """Measure by how much a sleep of 1 ms is too long."""
    late = []
    for _ in range(100):
        start = time.monotonic()
        time.sleep(1e-3)
        late.append(time.monotonic() - start - 1e-3)
    worst = 1e3 * float(np.percentile(late, 99))
    found = f"a sleep of 1 ms ends {1e3 * float(np.median(late)):.2f} ms late, p99 {worst:.2f} ms"
    if worst > 2.0:  # noqa: PLR2004 - a tenth of a period of 20 ms
        advice = "give the control loop a core of its own, or a real-time priority (chrt)"
        return Check("timer", "warn", found, advice)
    return Check("timer", "ok", found)


def _clock() -> Check:
    """Compare wall clock and monotonic clock, which drift apart while the clock is adjusted."""
    info = time.get_clock_info("monotonic")
    wall, steady = time.time(), time.monotonic()
    time.sleep(0.1)
    drift = 1e3 * abs((time.time() - wall) - (time.monotonic() - steady))
    found = f"monotonic clock with {1e9 * info.resolution:.0f} ns, wall clock moved {drift:.2f} ms"
    if drift > 1.0:
        advice = (
            "the wall clock is being adjusted: the age of a map depends on it, control does not"
        )
        return Check("clocks", "warn", found, advice)
    return Check("clocks", "ok", found)


def _extras() -> Check:
    missing: dict[str, list[str]] = {}
    for package, extra in EXTRAS.items():
        if find_spec(package) is None:
            missing.setdefault(extra, []).append(package)
    have = sorted(set(EXTRAS.values()) - set(missing))
    found, advice = f"installed: {', '.join(have) or 'none'}", ""
    if missing:
        found += f"; not installed: {', '.join(sorted(missing))}"
        extras = ",".join(sorted(missing))
        advice = f"only if you need them: pip install 'egp-service[{extras}]'"
    return Check("extras", "ok", found, advice)


def _zenoh() -> Check:
    import zenoh  # noqa: PLC0415 - an installation without it is what this checks

    found = f"eclipse-zenoh {version('eclipse-zenoh')}"
    advice = "check that the loopback interface is up and no firewall blocks it"
    try:
        endpoint = free_endpoint()
        with zenoh.open(session_config([], 1.0, {"listen/endpoints": [endpoint]})):
            reason = why_unreachable(endpoint)
    except (zenoh.ZError, EgpError) as error:
        return Check("zenoh", "fail", f"{found} opens no session: {zenoh_reason(error)}", advice)
    if reason is not None:
        found += f" opens a session, which cannot be reached at {endpoint}: {reason}"
        return Check("zenoh", "fail", found, advice)
    return Check("zenoh", "ok", f"{found} opens a session, which can be reached")


def _port(name: str, endpoint: str, option: str) -> Check:
    reason = why_not_free(endpoint)
    if reason is None:
        return Check(name, "ok", f"{endpoint} is free")
    advice = f"fine if {name.partition(' of ')[2]} is running; otherwise choose another {option}"
    return Check(name, "warn", f"{endpoint}: {reason}", advice)


def _library(file: Path) -> list[Check]:
    try:
        loaded = Library.load(file)
    except (EgpError, OSError) as error:
        advice = "give a library that `egp train` wrote; `egp inspect FILE` shows one"
        reason = f"{file}: {error.strerror}" if isinstance(error, OSError) else str(error)
        return [Check("library", "fail", reason, advice)]
    points = sum(member.n_points for member in loaded.members)
    names = ", ".join(member.label for member in loaded.members)
    noun = "member" if len(loaded.members) == 1 else "members"
    found = f"{file.name}: {len(loaded.members)} {noun} ({names}), {points} points, verified"
    return [Check("library", "ok", found), _step_time(file, loaded)]


def _step_time(file: Path, library: Library) -> Check:
    """Drive straight ahead without a plant, and measure the steps."""
    gate = library.parameters.gate_limits()
    with Controller(file, gate=gate) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
        taken, statuses = [], set()
        for _ in range(STEPS):
            step = controller.step([0.0, 0.2, 15.0, 0.0, 0.0, 0.0, 0.0], reference)
            taken.append(step.timings.total)
            statuses.add(step.status)
        dt = controller.dt
    worst = float(np.percentile(taken, 99))
    found = (
        f"median {1e3 * float(np.median(taken)):.2f} ms, p99 {1e3 * worst:.2f} ms of a period of "
        f"{1e3 * dt:g} ms; status {', '.join(sorted(statuses))}"
    )
    if statuses != {"solved"}:
        advice = "the library does not drive straight ahead: compare it with `egp evaluate`"
        return Check("control step", "fail", found, advice)
    if worst > _SHARE * dt:
        advice = "use fewer members or points, a longer period, or a faster machine"
        return Check("control step", "warn", found, advice)
    return Check("control step", "ok", found)
