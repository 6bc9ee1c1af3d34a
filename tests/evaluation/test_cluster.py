"""Work on a Ray cluster gives what it gives on this machine."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import pytest
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app
from egp_service.control.endpoints import free_port
from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.experiment import Experiment
from egp_service.data.exploration import ExplorationSettings
from egp_service.workers import WorkerError, workers

if TYPE_CHECKING:
    from collections.abc import Iterator
    from concurrent.futures import Executor

LONG = 3600.0  # s
# The processes import torch, and may get little of a busy machine.
PATIENCE = 300.0


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Start a cluster of one machine with two cores; gives its address."""
    port = free_port()
    ray = Path(sys.executable).with_name("ray")
    options = ["--num-cpus=2", f"--port={port}", "--node-ip-address=127.0.0.1"]
    quiet = ["--include-dashboard=false", "--disable-usage-stats", "--log-style=record"]
    with subprocess.Popen(
        [ray, "start", "--head", "--block", *options, *quiet],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as head:
        assert head.stdout is not None
        try:
            for line in head.stdout:
                if "--block" in line:  # the cluster runs, and the command waits
                    break
            else:
                pytest.fail(f"ray ended with code {head.wait()} before the cluster ran")
            yield f"127.0.0.1:{port}"
        finally:
            head.terminate()


def test_a_dataset_collected_on_a_cluster_is_the_same(cluster: str) -> None:
    exploration = ExplorationSettings(episodes=4, seconds=0.5)
    settings = CollectionSettings(runs=3, samples=0, steady=0, exploration=exploration)
    experiment = Experiment(friction=0.8, label="test", seed=3)
    here = collect(experiment, settings, jobs=1)
    assert collect(experiment, settings, cluster=cluster).digest() == here.digest()


def test_an_interruption_ends_what_the_cluster_works_on(cluster: str) -> None:
    start = time.monotonic()

    def interrupt_when_busy(pool: Executor) -> NoReturn:
        for _ in range(4):
            pool.submit(time.sleep, LONG)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), workers(cluster=cluster) as pool:
        interrupt_when_busy(pool)
    assert time.monotonic() - start < PATIENCE
    # The cores are free again.
    with workers(cluster=cluster) as pool:
        assert pool.submit(int, "7").result(PATIENCE) == 7


def test_a_process_that_was_killed_on_a_cluster_is_an_error_in_words(cluster: str) -> None:
    with pytest.raises(WorkerError, match="ray status"), workers(cluster=cluster) as pool:
        pool.submit(signal.raise_signal, signal.SIGKILL).result(PATIENCE)


def test_an_address_without_a_cluster_is_an_error() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{probe.getsockname()[1]}"
        with pytest.raises(EgpError, match=address), workers(cluster=address):
            pass
    for address in ("cluster", "127.0.0.1:port"):
        with (
            pytest.raises(EgpError, match=f"no Ray cluster at '{address}'"),
            workers(cluster=address),
        ):
            pass


def test_a_cluster_leaves_no_choice_of_processes() -> None:
    with pytest.raises(EgpError, match="leave out --jobs"), workers(2, "127.0.0.1:6379"):
        pass


def test_training_on_given_data_needs_no_cluster() -> None:
    command = ["train", "wet.parquet", "-o", "wet.safetensors", "--cluster", "127.0.0.1:6379"]
    error = CliRunner().invoke(app, command).exception
    assert isinstance(error, EgpError)
    assert "--recipe" in str(error)
