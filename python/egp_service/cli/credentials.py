"""The files of `egp keys`: secret keys, and configurations of zenoh with certificates.

Each configuration is complete, with its certificate, its private key and the authority's
certificate inside, so that it can be copied to where it is used.
"""

from __future__ import annotations

import json
import os
import re
import secrets
from base64 import b64decode, b64encode
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from egp_service._core import EgpError
from egp_service.cli.access import (
    MAP,
    OPERATOR,
    ROUTER,
    SERVICE,
    client_access,
    listener_access,
    size_limits,
)
from egp_service.cli.certificates import (
    Authority,
    Identity,
    check_hosts,
    listening_hosts,
    read_authority,
)
from egp_service.cli.signing import new_signing_key, public_line
from egp_service.control.endpoints import MAP_PORT, ROUTER_PORT, SERVICE_PORT
from egp_service.control.session import LARGEST_AT_CLIENT, LARGEST_AT_SERVICE, LEASE_MS, RETRY
from egp_service.files import locked, replacing

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")
_KEY_LINE = re.compile(rf"{_NAME.pattern}/{_NAME.pattern}\s+[0-9A-Fa-f]{{64}}")
# A key of replicas that stands where steps have the fleet; access control cannot tell them apart.
_RESERVED_FLEET = "library"
# The file of `egp monitor`, which has the operator's certificate.
_MONITOR = "monitor"
# The length to which X.509 limits a common name.
_LONGEST = 64
_SCOUTING = {"multicast": {"enabled": False}}
# Ports of `egp serve`, `egp map` and `egp router` by default.
_PORTS = {SERVICE: SERVICE_PORT, MAP: MAP_PORT, ROUTER: ROUTER_PORT}
# Sessions of each vehicle at a service or router (control, status, map and one that replaces a lost
# one), and of operators and services together.
_SESSIONS_OF_VEHICLE, _OTHER_SESSIONS = 4, 16
# Time in which a connection must become a session after its handshake, which may take as long, ms.
_ACCEPT_MS = 2000
_HANDSHAKE = f"tls_handshake_timeout_ms={_ACCEPT_MS}"
# A reply has the quality of service of its query, which waits for room on a link by default.
_REPLIES_DO_NOT_WAIT = {
    "messages": ["query"],
    "flows": ["ingress"],
    "overwrite": {"congestion_control": "drop", "express": False},
}


def write_credentials(
    folder: Path,
    fleet: str,
    vehicles: Sequence[str],
    *,
    hosts: Sequence[str],
    port: int | None = None,
    days: int,
    report: Callable[[str], None] = lambda _: None,
) -> list[str]:
    """Write or complete the files of a fleet in `folder`; return the vehicles that are new.

    The folder, if it is made, `vehicles` in it, and all files are for their owner alone.

    The other `vehicles` keep their secret keys and endpoints, and get new certificates; so do
    operator and monitor. The files of new ones connect to `hosts`. The certificates of service, map
    and router are also valid for the hosts of earlier calls, and they listen where they did. The
    service listens on `port` if it is given, which `report` is told if it changes; a new one
    listens on 7447 without it. `report` is also told if certificates cannot be valid for `days`,
    and if a fleet that has files gets a new key to sign libraries with.

    Raises:
        EgpError: before anything is written, for a name or host that cannot be used, for a file
            that is not as an earlier call wrote it or is missing, and if the folder's authority has
            expired or lacks its certificate or key, unless a first call was interrupted between
            writing these two.

    """
    names = list(dict.fromkeys(_vehicle(fleet, vehicle) for vehicle in vehicles))
    check_hosts(hosts)
    with locked(folder):
        found = _collect(folder, names, hosts=hosts, port=port, report=report)
        authority = None
        if not _interrupted(folder):
            authority = read_authority(folder / "ca.pem", folder / "ca.key", days, report)
        _write_all(folder, found, authority, days)
    return found.new


@dataclass(frozen=True, slots=True)
class _Fleet:
    """What the files of a fleet are to hold."""

    keys: dict[str, str]
    """Secret keys of all vehicles."""
    new: list[str]
    """Vehicles that have no files yet."""
    connected: dict[str, list[str]]
    """Where each vehicle to write connects to."""
    watching: dict[str, list[str]]
    """Where operator and monitor connect to."""
    listening: dict[str, list[str]]
    """Where service, map and router listen."""
    hosts: dict[str, list[str]]
    """Hosts in the certificates of service, map and router."""


def _collect(
    folder: Path,
    names: Sequence[str],
    *,
    hosts: Sequence[str],
    port: int | None,
    report: Callable[[str], None],
) -> _Fleet:
    """Join what earlier calls wrote with what is to be added."""
    keys = _read_keys(_ring(folder))
    new = [name for name in names if name not in keys]
    keys |= {name: secrets.token_hex(32) for name in new}
    listening = {
        end: _endpoints(folder / f"{end}.json5", "listen") or [f"tls/[::]:{at}"]
        for end, at in _PORTS.items()
    }
    service = folder / f"{SERVICE}.json5"
    reached_at = _port(service, listening[SERVICE])
    if port is not None and port != reached_at:
        if service.exists():
            report(
                f"{service} listens on port {port} from now on, in place of {reached_at}. Vehicles "
                "that are not new, operator and monitor keep their endpoints: change these in "
                f"their files, or repeat the command with --port {reached_at}."
            )
        listening[SERVICE], reached_at = [f"tls/[::]:{port}"], port
    endpoints = [f"tls/{host}:{reached_at}" for host in hosts]
    connected = {}
    for name in names:
        file = _vehicle_file(folder, name)
        if name not in new and not file.exists():
            report(f"{file} is not there: the new one has the endpoints of --host.")
        connected[name] = endpoints if name in new else _endpoints(file, "connect") or endpoints
    watching = {
        name: _endpoints(folder / f"{name}.json5", "connect") or endpoints
        for name in (OPERATOR, _MONITOR)
    }
    hosts_of = {
        end: list(dict.fromkeys([*_hosts(folder / f"{end}.json5"), *hosts])) for end in _PORTS
    }
    private, public = folder / "library.key", folder / "library.pub"
    if private.exists():
        public_line(private)  # raises if it is damaged
    elif not public.exists() and (folder / "ca.pem").exists():
        report(
            f"{public} and {private} are not there: the new ones are another pair, with which no "
            "library was signed. A service that gets the new library.pub rejects all libraries "
            "until they are signed again. If there is a copy of the old library.pub, put it back."
        )
    return _Fleet(keys, new, connected, watching, listening, hosts_of)


def _ring(folder: Path) -> Path:
    """Return the list of the vehicles, which must be there if other files of the fleet are."""
    ring, own = folder / "vehicles.keys", sorted((folder / "vehicles").glob("*.keys"))
    others = (folder / "ca.pem", folder / f"{SERVICE}.json5", *own)
    found = [file for file in others if file.exists()]
    if found and not ring.exists():
        remedy = "restore it from the copy that the service has"
        if own:
            remedy += (
                f", or from the vehicles' own files by `cat {own[0].parent}/*.keys > "
                f"{ring}`, without the lines of vehicles that were removed"
            )
        raise EgpError(
            f"{ring} is missing, but {found[0]} is there: without this list vehicles would get "
            f"other secret keys, and those that are not named no access; {remedy}"
        )
    return ring


def _interrupted(folder: Path) -> bool:
    """Return whether a first call was interrupted after it wrote `ca.key` and before `ca.pem`.

    That call signed nothing, so that another authority may replace its key.
    """
    written = [(folder / name).exists() for name in ("vehicles.keys", "ca.key")]
    later = [(folder / name).exists() for name in ("ca.pem", "vehicles")]
    return all(written) and not any(later) and not any(folder.glob("*.json5"))


def _write_all(folder: Path, fleet: _Fleet, authority: Authority | None, days: int) -> None:
    # The list of the vehicles and the keys come before the authority: whoever finds an authority
    # finds them, too, and a call that was interrupted can be repeated.
    _write(folder / "vehicles.keys", _key_lines(fleet.keys))
    _signing_key(folder)
    if authority is None:
        authority = Authority.new(10 * days)
        _write(folder / "ca.key", authority.identity.private_key.decode())
        _write(folder / "ca.pem", authority.identity.certificate.decode())
    (folder / "vehicles").mkdir(mode=0o700, exist_ok=True)
    for name, endpoints in fleet.connected.items():
        file = _vehicle_file(folder, name)
        config = _client(authority, authority.issue(name, days), endpoints, name)
        _write(file.with_suffix(".keys"), _key_lines({name: fleet.keys[name]}))
        _write(file, _text(config))
    identity = authority.issue(OPERATOR, days)
    # What vehicles publish is passed on to clients: services and routers leave it to two peers to
    # have a link of their own.
    for name, mode in ((OPERATOR, "peer"), (_MONITOR, "client")):
        config = _client(authority, identity, fleet.watching[name], OPERATOR) | {"mode": mode}
        _write(folder / f"{name}.json5", _text(config))
    for end, at in fleet.listening.items():
        identity = authority.issue(end, days, fleet.hosts[end])
        config = _listener(authority, identity, end, at, fleet.keys)
        _write(folder / f"{end}.json5", _text(config))


def _vehicle_file(folder: Path, name: str) -> Path:
    return folder / "vehicles" / f"{name.replace('/', '@')}.json5"


def _vehicle(fleet: str, vehicle: str) -> str:
    name = f"{fleet}/{vehicle}"
    for part in (fleet, vehicle):
        if not _NAME.fullmatch(part):
            raise EgpError(f"expected a name of 1 to 64 of A-Z a-z 0-9 . _ -, got {part!r}")
    if fleet == _RESERVED_FLEET:
        raise EgpError(
            f"the fleet {fleet!r} would have keys of library files: choose another --fleet"
        )
    if len(name) > _LONGEST:
        raise EgpError(f"{name}: a certificate names at most {_LONGEST} characters; shorten a name")
    return name


def _signing_key(folder: Path) -> None:
    public, private = folder / "library.pub", folder / "library.key"
    if public.exists():
        return
    if not private.exists():
        _write(private, new_signing_key())
    _write(public, public_line(private))


def _read_keys(file: Path) -> dict[str, str]:
    if not file.exists():
        return {}
    keys = {}
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    for number, line in enumerate(map(str.strip, lines), 1):
        if line and not line.startswith("#"):
            if not _KEY_LINE.fullmatch(line):
                raise EgpError(
                    f"{file}, line {number}: expected FLEET/VEHICLE and a key of 64 hexadecimal "
                    "digits; write the line as the vehicle's own file in the folder vehicles has "
                    "it, or delete it to remove the vehicle"
                )
            name, key = line.split()
            if name in keys:
                raise EgpError(f"{file}, line {number}: {name} has a key already; delete one line")
            keys[name] = key
    return keys


def _hosts(file: Path) -> list[str]:
    """Return the hosts in the certificate of a configuration that an earlier call wrote."""
    if not file.exists():
        return []
    with _as_written(file):
        tls = json.loads(file.read_text(encoding="utf-8"))["transport"]["link"]["tls"]
        return listening_hosts(b64decode(tls["listen_certificate_base64"]))


def _endpoints(file: Path, direction: str) -> list[str]:
    """Return where a configuration that an earlier call wrote connects or listens."""
    if not file.exists():
        return []
    with _as_written(file):
        return list(json.loads(file.read_text(encoding="utf-8"))[direction]["endpoints"])


def _impatient(endpoint: str) -> str:
    """Return an endpoint with a time for the handshake, unless it states one."""
    if _HANDSHAKE.partition("=")[0] in endpoint:
        return endpoint
    return f"{endpoint}{';' if '#' in endpoint else '#'}{_HANDSHAKE}"


def _port(file: Path, endpoints: Sequence[str]) -> int:
    """Return the port of the first endpoint at which a configuration listens."""
    with _as_written(file):
        return int(re.split("[?#]", endpoints[0])[0].rpartition(":")[2])


@contextmanager
def _as_written(file: Path) -> Iterator[None]:
    try:
        yield
    except (ValueError, KeyError, TypeError) as error:
        raise EgpError(
            f"{file} is not as `egp keys` wrote it ({error}): move it away, and name all hosts"
        ) from error


def _key_lines(keys: dict[str, str]) -> str:
    return "".join(f"{name} {key}\n" for name, key in sorted(keys.items()))


def _tls(authority: Authority, identities: dict[str, Identity]) -> dict[str, object]:
    settings: dict[str, object] = {
        "root_ca_certificate_base64": b64encode(authority.identity.certificate).decode(),
        "enable_mtls": True,
        "verify_name_on_connect": True,
    }
    for end, identity in identities.items():
        settings |= identity.tls(end)
    return settings


def _transport(tls: dict[str, object], longest: int) -> dict[str, object]:
    return {
        "link": {
            "protocols": ["tls"],
            "tx": {"lease": LEASE_MS},
            "rx": {"max_message_size": longest},
            "tls": tls,
        },
        "shared_memory": {"enabled": False},
    }


def _client(
    authority: Authority, identity: Identity, endpoints: Sequence[str], name: str
) -> dict[str, object]:
    tls = _tls(authority, {"connect": identity})
    return {
        "mode": "peer",
        "scouting": _SCOUTING,
        "listen": {"endpoints": []},
        "connect": {"retry": dict(RETRY), "endpoints": list(endpoints)},
        "transport": _transport(tls, LARGEST_AT_CLIENT),
        "access_control": client_access(name),
    }


def _listener(
    authority: Authority,
    identity: Identity,
    name: str,
    endpoints: Sequence[str],
    vehicles: Collection[str],
) -> dict[str, object]:
    tls = _tls(authority, {"listen": identity, "connect": identity})
    sessions = {
        "max_sessions": _OTHER_SESSIONS + _SESSIONS_OF_VEHICLE * len(vehicles),
        "accept_timeout": _ACCEPT_MS,
    }
    return {
        "mode": "router" if name == ROUTER else "peer",
        "scouting": _SCOUTING,
        "connect": {"retry": dict(RETRY)},
        "listen": {"endpoints": [_impatient(endpoint) for endpoint in endpoints]},
        "transport": _transport(tls, LARGEST_AT_SERVICE) | {"unicast": sessions},
        "access_control": listener_access(name, vehicles),
        "low_pass_filter": size_limits(),
        "qos": {"network": [_REPLIES_DO_NOT_WAIT]},
    }


def _text(settings: dict[str, object]) -> str:
    return json.dumps(settings, indent=2) + "\n"


def _write(path: Path, text: str) -> None:
    """Write a file that only its owner can read."""
    with replacing(path) as beside:
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text)
