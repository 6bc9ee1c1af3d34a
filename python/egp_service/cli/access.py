"""Zenoh's access control for each identity of a fleet: who may exchange which messages.

Every configuration denies all messages but those listed here. docs/security.md, section 3, has the
table of what they permit, and a test compares the table with what zenoh does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

# Common names of the certificates that are no vehicle's, whose names have a slash.
SERVICE: Final = "service"
MAP: Final = "map"
ROUTER: Final = "router"
OPERATOR: Final = "operator"

_LIVE, _LOAD = "egp/v1/@live/*", "egp/v1/@load/*"
_REPLICAS, _READY = "egp/v1/r/**", "egp/v1/r/*/ready"
_LIBRARIES = ("egp/v1/r/*/library/*", "egp/v1/r/*/library/*/*")
_STATUS, _STATUS_ROAD = "egp/v1/@vehicle/*/*", "egp/v1/@vehicle/*/*/road"
_MAP, _MAP_STATE = "egp/v1/map/**", ("egp/v1/map/health", "egp/v1/map/metrics")
_REPLICA_STATE = ("egp/v1/r/*/health", "egp/v1/r/*/metrics")
_CHANGED = "egp/v1/@map/*/*"
_OPPOSITE = {"ingress": "egress", "egress": "ingress"}
# Largest sizes of payload and attachment together, bytes.
_SMALL, _TILE, _PUBLICATION = 1 << 10, 1 << 13, 1 << 16


@dataclass(frozen=True, slots=True)
class Right:
    """Messages on some keys in one direction, as seen by the program at the other end."""

    flow: str
    messages: tuple[str, ...]
    keys: tuple[str, ...]


def _asks(declared: str, *keys: str) -> list[Right]:
    """Query `keys`; who answers declares keys that `declared` includes."""
    return [
        Right("ingress", ("query",), keys),
        Right("egress", ("reply",), keys),
        Right("egress", ("declare_queryable",), (declared,)),
    ]


def _answers(*keys: str) -> list[Right]:
    return [
        Right("ingress", ("declare_queryable", "reply"), keys),
        Right("egress", ("query",), keys),
    ]


def _publishes(subscribed: str, *keys: str) -> list[Right]:
    """Put on `keys`; who subscribes names keys that `subscribed` includes."""
    return [
        Right("ingress", ("put",), keys),
        Right("egress", ("declare_subscriber",), (subscribed,)),
    ]


def _subscribes(*keys: str) -> list[Right]:
    return [
        Right("ingress", ("declare_subscriber",), keys),
        Right("egress", ("put",), keys),
    ]


def _announces(key: str) -> list[Right]:
    return [
        Right("ingress", ("liveliness_token",), (key,)),
        Right("egress", ("liveliness_query", "declare_liveliness_subscriber"), (key,)),
    ]


def _mirrored(rights: Iterable[Right]) -> list[Right]:
    """Give the same rights as the identity itself sees them."""
    return [Right(_OPPOSITE[right.flow], right.messages, right.keys) for right in rights]


def _of_services() -> list[Right]:
    """Give what a service may do at a router."""
    own = [*_answers(_REPLICAS), *_announces(_LIVE), *_publishes(_LOAD, _LOAD)]
    return [*own, *_asks(_REPLICAS, *_LIBRARIES)]


def _between_services() -> list[Right]:
    """Give what a service may do at another one: fetch libraries, and give its own."""
    asks = _asks(_REPLICAS, *_LIBRARIES)
    return [*asks, *_mirrored(asks)]


def _of_maps() -> list[Right]:
    return [*_answers(_MAP), *_publishes(_CHANGED, _CHANGED)]


def _of_client(name: str) -> dict[str, list[Right]]:
    """Give what a vehicle or the operator may do at a service, and at the map service."""
    live = _mirrored(_announces(_LIVE))
    if name == OPERATOR:
        return {
            SERVICE: [
                *_asks(_REPLICAS, _READY, *_REPLICA_STATE, *_LIBRARIES),
                *live,
                *_subscribes(_LOAD, _STATUS),
                *_asks(_STATUS_ROAD, _STATUS_ROAD),
            ],
            MAP: _asks(_MAP, *_MAP_STATE),
        }
    fleet = name.partition("/")[0]
    return {
        SERVICE: [
            *_asks(_REPLICAS, _READY),
            *_asks(_REPLICAS, f"egp/v1/r/*/{name}/step"),
            *live,
            *_publishes(_STATUS, f"egp/v1/@vehicle/{name}"),
            *_answers(f"egp/v1/@vehicle/{name}/road"),
        ],
        MAP: [
            *_asks(_MAP, f"egp/v1/map/{name}/**"),
            *_subscribes(f"egp/v1/@map/{fleet}/*"),
        ],
    }


def client_access(name: str) -> dict[str, object]:
    """Give the access control of a vehicle or the operator, which connects to the others.

    It lets a program with the map's certificate answer questions to the map only, even if it
    listens in a service's place.
    """
    rights = {end: _mirrored(found) for end, found in _of_client(name).items()}
    return _access({**rights, ROUTER: [*rights[SERVICE], *rights[MAP]]})


def listener_access(name: str, vehicles: Iterable[str]) -> dict[str, object]:
    """Give the access control of the service, the map service or a router, which listens."""
    clients = {client: _of_client(client) for client in [OPERATOR, *sorted(vehicles)]}
    if name == ROUTER:
        both = {client: [*found[SERVICE], *found[MAP]] for client, found in clients.items()}
        return _access({**both, SERVICE: _of_services(), MAP: _of_maps()})
    own = _of_services() if name == SERVICE else _of_maps()
    at_own = {client: found[name] for client, found in clients.items()}
    if name == SERVICE:
        at_own[SERVICE] = _between_services()
    return _access({**at_own, ROUTER: _mirrored(own)})


def size_limits() -> list[dict[str, object]]:
    """Give zenoh's filters that drop messages larger than their keys ever need."""
    states = (
        _READY,
        *_REPLICA_STATE,
        *_LIBRARIES,
        *_MAP_STATE,
        _STATUS_ROAD,
        "egp/v1/map/*/*/*/tiles/*",
    )
    return [
        _size_limit("query", states, _SMALL),
        _size_limit("query", ("egp/v1/map/*/*/*/tile/*",), _TILE),
        _size_limit("put", (_LOAD, _STATUS, _CHANGED), _PUBLICATION),
    ]


def _size_limit(message: str, keys: tuple[str, ...], limit: int) -> dict[str, object]:
    return {
        "flows": ["ingress"],
        "messages": [message],
        "key_exprs": list(keys),
        "size_limit": limit,
    }


def _access(rights: Mapping[str, Iterable[Right]]) -> dict[str, object]:
    """Give each identity its rights and deny everything else; equal rights share a rule."""
    rules: dict[Right, str] = {}
    policies = []
    for name, found in rights.items():
        # The order of a dictionary without duplicates keeps the file the same for equal input.
        ids = [rules.setdefault(right, str(len(rules))) for right in dict.fromkeys(found)]
        policies.append({"subjects": [name], "rules": ids})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": number,
                "messages": list(right.messages),
                "flows": [right.flow],
                "permission": "allow",
                "key_exprs": list(right.keys),
            }
            for right, number in rules.items()
        ],
        "subjects": [{"id": name, "cert_common_names": [name]} for name in rights],
        "policies": policies,
    }
