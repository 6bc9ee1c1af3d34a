"""Fields of recordings as columns of a table: those of control steps, and texts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter

from egp_service import Controller, EgpError, Plant, Recorder, shipped
from egp_service.data.recording import read_fields

if TYPE_CHECKING:
    from pathlib import Path


def test_a_recording_of_this_project_is_a_log(tmp_path: Path) -> None:
    path = tmp_path / "own.mcap"
    limits = Plant().parameters.gate_limits()
    with Controller(str(shipped.DEMO_LIBRARY), gate=limits) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
        with Recorder(path, controller) as recorder:
            forces = []
            for k in range(10):
                step = controller.step(np.array([0.0, 0.1, 15.0 + k, 0, 0, 0, 0]), reference)
                recorder.add(step, np.array([0.0, 0.1, 15.0 + k, 0, 0, 0, 0]), 0.02 * k)
                forces.append(step.u[0])
    table = read_fields(path, ["/step/v_x", "/step/force", "/step/weights[0]"], 0.02)
    assert table["/step/v_x"].to_list() == [15.0 + k for k in range(10)]
    assert table["/step/force"].to_list() == forces
    assert table["/step/weights[0]"][0] == 0.5  # of two members
    np.testing.assert_allclose(table["time"], 0.02 * np.arange(10), rtol=0.0, atol=1e-9)
    with pytest.raises(EgpError, match=r"has no 'speed', found .*v_x"):
        read_fields(path, ["/step/speed"], 0.02)
    for index in (2, 5):
        with pytest.raises(EgpError, match=rf"has no '{index}': there are 2 entries, from 0"):
            read_fields(path, [f"/step/weights[{index}]"], 0.02)
    assert read_fields(str(path), list(table.columns[1:]), 0.02).equals(table)
    for names in (list[str](), "/step/v_x"):
        with pytest.raises(EgpError, match="expected a list of TOPIC/"):
            read_fields(path, names, 0.02)
    for dt in (0.0, -0.02, float("nan"), float("inf")):
        with pytest.raises(EgpError, match=f"dt is {dt}: expected a positive period in s"):
            read_fields(path, ["/step/v_x"], dt)
    # Without names: the numbers and texts of the steps; lists are named by an index.
    plain = read_fields(path)
    assert set(plain["/step/mode"]) == {"normal"}
    assert plain["/step/detail"].to_list() == [""] * 10
    assert plain["/step/v_x"].equals(table["/step/v_x"])
    assert not [name for name in plain.columns if "weights" in name or "/plant" in name]


def test_texts_are_columns_and_those_of_other_topics_hold_until_the_next_message(
    tmp_path: Path,
) -> None:
    path = tmp_path / "car.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        speed, gear = (writer.register_channel(f"/{name}", "json", 0) for name in ("car", "gear"))
        for k in range(6):
            writer.add_message(
                speed,
                10**7 * k,
                b'{"speed": %d, "odd": %s}' % (k, b'"a"' if k else b"1"),
                10**7 * k,
            )
            if k % 2 == 0:
                writer.add_message(gear, 10**7 * k, b'{"name": "%d"}' % k, 10**7 * k)
        writer.finish()  # type: ignore[no-untyped-call]
    table = read_fields(path, ["/car/speed", "/gear/name"], 0.02)
    assert table["/car/speed"].to_list() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert table["/gear/name"].to_list() == ["0", "0", "2", "2", "4"]
    with pytest.raises(EgpError, match="'/car/odd' is a text in 5 of 6 messages"):
        read_fields(path, ["/car/odd"])
    with pytest.raises(EgpError, match=r"no topic of '/step' is recorded: .* /car, /gear$"):
        read_fields(path)
