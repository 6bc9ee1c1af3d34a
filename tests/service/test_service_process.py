"""The process of a service: how it starts, and what it removes."""

from __future__ import annotations

import socket
import subprocess
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from egp_service import EgpError, Library
from egp_service._core import write_library_subset
from egp_service.cli.backends import remote_controller, service_controller
from egp_service.control.endpoints import free_endpoint, why_unreachable
from egp_service.control.service_process import ServiceProcess, ServiceStartError
from egp_service.control.toml_text import dumps
from egp_service.shipped import DEMO_LIBRARY
from egp_service.simulation.scenario import load_scenario
from patience import PATIENCE, wait_until

if TYPE_CHECKING:
    from pathlib import Path


def test_a_service_starts_only_within_its_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    service = ServiceProcess(DEMO_LIBRARY, {})
    with pytest.raises(EgpError, match="start it within `with ServiceProcess"):
        service.start()
    with service:
        with pytest.raises(EgpError, match="runs already"):
            service.start()
        assert why_unreachable(service.endpoint) is None
    with pytest.raises(EgpError, match="start it within `with ServiceProcess"):
        service.start()
    assert not list(tmp_path.iterdir())


def test_the_controller_of_a_service_states_the_frictions_of_a_library_that_is_known(
    tmp_path: Path,
) -> None:
    scenario = load_scenario("rounded-rectangle")
    frictions = [member.friction for member in Library.load(DEMO_LIBRARY).members]
    with service_controller(scenario) as started:
        assert started.frictions == frictions
    other = tmp_path / "other.safetensors"
    write_library_subset(DEMO_LIBRARY, other, [1, 0])
    with ServiceProcess(DEMO_LIBRARY, {}) as service:
        with remote_controller(scenario, service.endpoint) as same:
            assert same.frictions == frictions
        with remote_controller(replace(scenario, library=str(other)), service.endpoint) as unlike:
            assert unlike.frictions is None


def test_another_program_at_the_endpoint_is_no_service() -> None:
    service = ServiceProcess(DEMO_LIBRARY, {})
    host, _, port = service.endpoint.removeprefix("tcp/").rpartition(":")
    with (
        socket.create_server((host, int(port))),
        pytest.raises(ServiceStartError, match="another program listens at tcp/127"),
        service,
    ):
        pass


@pytest.mark.parametrize("starting", [False, True])
@pytest.mark.parametrize("name", ["egp-service-x", "someones"])
def test_a_service_left_alone_removes_no_folder_but_its_own(
    tmp_path: Path, name: str, *, starting: bool
) -> None:
    folder, endpoint = tmp_path / name, free_endpoint()
    folder.mkdir()
    config = folder / "service.toml"
    listening = {"zenoh": {"listen/endpoints": f'["{endpoint}"]'}}
    config.write_text(dumps({"library": str(DEMO_LIBRARY), **listening}), encoding="utf-8")
    command = [sys.executable, "-m", "egp_service.control.service_child", "serve", "--config"]
    with subprocess.Popen([*command, str(config)], stdin=subprocess.PIPE) as process:
        if not starting:
            wait_until(lambda: why_unreachable(endpoint) is None or process.poll() is not None)
        assert process.stdin is not None
        process.stdin.close()  # as the system does when the process that began it ends
        process.wait(PATIENCE)
    assert folder.exists() == (name == "someones")


def test_a_service_that_cannot_start_says_why(tmp_path: Path) -> None:
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"no library")
    with (
        pytest.raises(ServiceStartError, match=r"broken\.safetensors") as caught,
        ServiceProcess(broken, {}),
    ):
        pass
    # The interpreter of its process ends as usual.
    assert len(str(caught.value).splitlines()) == 1
