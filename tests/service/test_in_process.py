"""The service inside a Python process, asked over the network by a plain zenoh client."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
import tomllib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import zenoh

from egp_service import _core
from egp_service._core import testing
from egp_service.control.endpoints import free_endpoint
from egp_service.shipped import DEMO_LIBRARY
from library_example import write_example

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LIBRARY = str(DEMO_LIBRARY)


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def client(endpoint: str) -> Iterator[Any]:
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("connect/retry", "{ period_init_ms: 20, period_max_ms: 50 }")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield session


def toml(endpoint: str) -> str:
    return f"""
        library = '{LIBRARY}'
        workers = 1
        [zenoh]
        "listen/endpoints" = '["{endpoint}"]'
    """


def wait_until_alive(session: Any) -> None:  # noqa: ANN401
    deadline = time.monotonic() + 20
    while not [token for token in session.liveliness().get(_core.LIVE_KEYS) if token.ok]:
        assert time.monotonic() < deadline, "no replica came alive"
        time.sleep(0.02)


def first_request(engine: _core.Engine) -> bytes:
    way = 12.0 * engine.dt * np.arange(engine.horizon + 1)
    reference = np.column_stack([way, 0 * way, 12.0 + 0 * way, 0 * way])
    x = np.array([0.0, 0.3, 12.0, 0.0, 0.0, 0.0, 0.0])
    driver = _core.InProcessDriver(engine, gate=engine.vehicle.gate_limits())
    return driver.step(5.0, x, reference).request


def test_the_service_replies_with_the_engines_bytes(endpoint: str, client: Any) -> None:  # noqa: ANN401
    engine = _core.Engine(LIBRARY)
    request = first_request(engine)
    with _core.Server(toml(endpoint)):
        wait_until_alive(client)
        (reply,) = list(client.get(testing.step_key("main", "fleet", "car"), payload=request))
        (ready,) = list(client.get(testing.ready_key("main")))
    data = reply.ok.payload.to_bytes()
    assert data == engine.step(request)
    assert _core.decode_reply(data).status == "solved"
    assert testing.decode_timing(reply.ok.attachment.to_bytes())[1] > 0
    served = _core.decode_ready(ready.ok.payload.to_bytes())
    assert (served.ready, served.library) == (True, engine.library_id)
    assert (served.dt, served.horizon, served.history) == (
        engine.dt,
        engine.horizon,
        engine.history,
    )
    assert served.members == engine.members


def test_refusals_are_typed(endpoint: str, client: Any) -> None:  # noqa: ANN401
    with _core.Server(toml(endpoint)):
        wait_until_alive(client)
        (reply,) = list(client.get(testing.step_key("main", "fleet", "car"), payload=b"noise"))
    refusal = testing.decode_error(reply.err.payload.to_bytes())
    assert (refusal.code, refusal.retryable) == ("malformed", False)


def test_the_engine_raises_what_the_service_would_answer() -> None:
    engine = _core.Engine(LIBRARY, "horizon = 15")
    with pytest.raises(_core.RefusedError, match=r"invalid_field: reference: .*\[T\+1, 4\]"):
        engine.step(first_request(_core.Engine(LIBRARY)))
    with pytest.raises(_core.EgpError, match="horizn"):
        _core.Engine(LIBRARY, "horizn = 15")
    with pytest.raises(_core.EgpError, match=r"cannot read the library nowhere\.safetensors"):
        _core.Engine("nowhere.safetensors")
    with pytest.raises(_core.EgpError, match="libary"):
        _core.Server("libary = 'x'")


def test_horizon_and_window_last_as_long_at_any_period(tmp_path: Path) -> None:
    path = tmp_path / "library.safetensors"
    write_example(path)  # 0.05 s
    for engine, dt, horizon, window in (
        (_core.Engine(LIBRARY), 0.02, 40, 25),
        (_core.Engine(path), 0.05, 16, 10),
        (_core.Engine(path, "horizon = 20"), 0.05, 20, 10),
    ):
        assert (engine.dt, engine.horizon, engine.history) == (dt, horizon, window)
        settings = tomllib.loads(engine.settings_toml)
        assert (settings["horizon"], settings["weights"]["window"]) == (horizon, window)


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_serving_ends_cleanly_on_signals(endpoint: str, client: Any, sent: signal.Signals) -> None:  # noqa: ANN401
    program = "import sys; from egp_service import _core; _core.serve(sys.argv[1])"
    with subprocess.Popen(
        [sys.executable, "-c", program, toml(endpoint)], stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            wait_until_alive(client)
            process.send_signal(sent)
            _, log = process.communicate(timeout=20)
        finally:
            process.kill()
    assert process.returncode == 0, log
    assert "drained" in log
