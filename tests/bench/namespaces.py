"""Replicas in network namespaces of their own, whose links to vehicles can be cut.

A program that calls `enter` runs again in a network and a mount namespace of its own. Inside,
each replica has another network namespace, with a pair of virtual interfaces for each vehicle. All
namespaces and interfaces vanish with the last process in them. Nothing is sent to another machine.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from itertools import count

INSIDE = "EGP_BENCH_NAMESPACE"
PORT = 7447
_IP = shutil.which("ip") or "ip"
_NUMBERS = count(1)
_SETUP = "mkdir -p /run/netns && mount -t tmpfs tmpfs /run/netns && ip link set lo up"


def missing() -> str:
    """Return why namespaces cannot be made here, or nothing."""
    if os.geteuid() != 0:
        return "only root may make network namespaces"
    for tool in ("ip", "unshare", "mount"):
        if shutil.which(tool) is None:
            return f"the program {tool} is not installed"
    probe = ["unshare", "--net", "--mount", "sh", "-c", f"{_SETUP} && ip netns add probe"]
    done = subprocess.run(probe, capture_output=True, text=True, check=False)
    return done.stderr.strip()


def enter() -> None:
    """Run this program again in namespaces of its own, unless it is there; return inside."""
    if INSIDE not in os.environ:
        again = f'{_SETUP} && exec "$0" "$@"'
        command = ["unshare", "--net", "--mount", "sh", "-c", again, sys.executable, *sys.argv]
        os.execvpe(command[0], command, os.environ | {INSIDE: "1"})  # noqa: S606 - no shell needed


def _ip(*command: str) -> None:
    subprocess.run([_IP, *command], check=True)


@dataclass(frozen=True)
class Place:
    """The namespace of one replica."""

    name: str
    reached: tuple[str, ...]
    """The endpoint at which each vehicle reaches the replica."""

    @classmethod
    def make(cls, vehicles: int) -> Place:
        """Make a namespace with a link for each vehicle."""
        number = next(_NUMBERS)
        name = f"replica-{number}"
        _ip("netns", "add", name)
        _ip("-n", name, "link", "set", "lo", "up")
        reached = []
        for v in range(vehicles):
            near, far = f"near{number}-{v}", f"far{v}"
            network = f"10.{number // 64}.{4 * (number % 64) + v}"
            _ip("link", "add", near, "type", "veth", "peer", "name", far, "netns", name)
            _ip("address", "add", f"{network}.1/24", "dev", near)
            _ip("-n", name, "address", "add", f"{network}.2/24", "dev", far)
            _ip("link", "set", near, "up")
            _ip("-n", name, "link", "set", far, "up")
            reached.append(f"tcp/{network}.2:{PORT}")
        return cls(name, tuple(reached))

    def cut(self, vehicle: int, *, heal: bool = False) -> None:
        """Lose all packets between the replica and a vehicle, or none again."""
        _ip("-n", self.name, "link", "set", f"far{vehicle}", "up" if heal else "down")

    @property
    def inside(self) -> tuple[str, ...]:
        """The words before a command that is to run in the namespace."""
        return ("ip", "netns", "exec", self.name)

    def remove(self) -> None:
        """Remove the namespace with its links."""
        _ip("netns", "delete", self.name)
