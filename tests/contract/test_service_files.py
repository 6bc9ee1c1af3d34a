"""Files of services and of settings: what `egp serve` and `egp replay` say about them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from typer.testing import CliRunner

from egp_service import EgpError, Library, shipped
from egp_service.cli import app
from egp_service.cli.replay_text import outcome
from egp_service.cli.settings_file import read_settings
from egp_service.cli.settings_text import read_settings_document
from egp_service.control.recorded import Recorded
from egp_service.control.replay import Replay

if TYPE_CHECKING:
    from pathlib import Path


def test_serve_shows_every_library_that_it_would_serve(tmp_path: Path) -> None:
    file, further = tmp_path / "service.toml", Library.load(shipped.EVALUATION_LIBRARY)
    libraries = f'libraries = ["{shipped.EVALUATION_LIBRARY}"]'
    file.write_text(f'library = "{shipped.DEMO_LIBRARY}"\n{libraries}\nworkers = 1\n')
    result = CliRunner().invoke(app, ["serve", "--config", str(file), "--check"])
    assert result.exit_code == 0, result.output
    assert result.output.splitlines()[:4] == [
        f"library {Library.load(shipped.DEMO_LIBRARY).id}",
        "surfaces: mu 0.5, mu 1.1",
        "period 0.02 s, horizon 40, window 25",
        f"further library {further.id}",
    ]


def test_every_key_of_a_service_is_known_among_settings(tmp_path: Path) -> None:
    keys = [each.key for each in read_settings_document() if each.section == "Service"]
    assert {"library", "watch_ms", "log_json", "zenoh"} <= set(keys)
    file = tmp_path / "service.toml"
    for key in keys:
        file.write_text(f'{key} = "a"\n')
        with pytest.raises(EgpError, match=f"`{key}` belongs to the configuration of a service"):
            read_settings(file)


def test_replay_asks_for_settings_only_if_none_are_given() -> None:
    recorded = Recorded({}, None, {}, None, [], complete=True)
    replay = Replay(
        np.zeros(1), np.zeros((1, 7)), [], [], np.array([True]), np.ones(2), unanswered=0
    )
    without = outcome(recorded, replay, {}, changed=False)
    assert "give the service's with --settings" in without[0]
    given = outcome(recorded, replay, {"cost": {"lateral": 20.0}}, changed=True)
    assert given == ["All 1 replies have the same bytes as recorded."]


def test_a_map_checks_its_configuration(tmp_path: Path) -> None:
    runner, file = CliRunner(), tmp_path / "map.toml"
    for command in (["--listen", "tcp/127.0.0.1:7448"], ["--config", str(file)]):
        file.write_text('http = "127.0.0.1:9465"\nfolder = "roads"\n')
        result = runner.invoke(app, ["map", "--check", *command])
        assert result.exit_code == 0, result.output
        assert result.output == "Configuration and network settings are valid.\n"
    for text, told in (
        ('http = "9465"', "such as 127.0.0.1:9464"),
        ('log = "loud"', "'loud' is no level"),
        ('[zenoh]\nmode = "\'router"', "mode"),
    ):
        file.write_text(text)
        message = str(runner.invoke(app, ["map", "--check", "--config", str(file)]).exception)
        assert message.startswith(f"{file}: ")
        assert told in message.replace('"', "'")
    assert [path.name for path in tmp_path.iterdir()] == ["map.toml"]
