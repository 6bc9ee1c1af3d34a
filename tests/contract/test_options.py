"""Options that a command would not use, or that contradict each other, are errors at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app

if TYPE_CHECKING:
    from pathlib import Path

RUNNER = CliRunner()
NOBODY = "tcp/127.0.0.1:9"


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("replay run.mcap -o x.png --no-pictures", "--output names a picture, which --no-pictures"),
        ("load --replay run.mcap --grip 0.3", "--grip is for simulated vehicles, and --replay"),
        ("load --replay run.mcap --json run.mcap", "run.mcap would overwrite run.mcap"),
        ("load --replay run.mcap --picture x.png --json x.png", "x.png would overwrite x.png"),
        ("evaluate --train --jobs 2 --cluster 127.0.0.1:6379", "--jobs and --cluster exclude"),
        ("evaluate --train -o .", "runs of a library that was not trained there"),
        (
            "collect --friction 0.5 -o .",
            ". is a folder: name a dataset in it, such as data.parquet",
        ),
        ("train data.parquet -o .", ". is a folder: name a file in it"),
        ("train a.parquet -o l --validation 1.5", "--validation is 1.5: expected a share between"),
        (
            "train a -o l --mean single-track --restarts 1",
            "--restarts cannot be used with --mean single-track: add --mean constant",
        ),
        ("train a -o l --mean constant --restarts -1", "--restarts is -1: expected 0 or more"),
        ("train a -o l --max-points 151", "max_points is 151: expected at most 150 with the mean"),
        ("drive --in-process --connect tcp/127.0.0.1:9", "--in-process excludes --connect"),
        ("drive --in-process --zenoh z.json5", "--zenoh has no use with --in-process unless"),
        (
            "drive --in-process --zenoh z.json5 --monitor tcp/127.0.0.1:9 --key k",
            "--key has no use with --in-process",
        ),
    ],
)
def test_what_would_not_be_used_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "library.sha256").write_text("0" * 64)
    result = RUNNER.invoke(app, command.split(), env={"COLUMNS": "200"})
    message = result.output
    if isinstance(result.exception, EgpError):
        message = str(result.exception)
    assert result.exit_code != 0
    assert told in message
    assert [path.name for path in tmp_path.iterdir()] == ["library.sha256"]


@pytest.mark.parametrize(
    "command", ["train a.parquet -o l", "vehicle fit a.parquet", "evaluate --log a.parquet"]
)
def test_a_terminal_shows_that_a_command_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    shown = RUNNER.invoke(app, command.split(), env={"FORCE_COLOR": "1"})
    assert isinstance(shown.exception, EgpError | OSError)
    assert "Loading ..." in shown.output
    assert not RUNNER.invoke(app, command.split()).output


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ("", True),
        ("[measurement]\nv_x = 0.1\n", False),
        ('[track]\nkind = "random"\n', False),
        ('[track]\nkind = "random"\nparameters = {seed = 3}\n', True),
    ],
)
def test_a_seed_that_changes_nothing_is_told(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    changes: str,
    told: bool,  # noqa: FBT001 - a parameter
) -> None:
    def stopped(*_: object) -> None:
        raise EgpError("before the drive")

    monkeypatch.setattr("egp_service.simulation.reference.load_belief", stopped)
    own, track = tmp_path / "own.toml", "" if "[track]" in changes else '[track]\nkind = "circle"\n'
    zones = "zones = [{start = 0.0, friction = 1.0}]\n"
    own.write_text(f'name = "own"\n{zones}{track}{changes}')
    command = ["drive", "-s", str(own), "--in-process"]
    shown = RUNNER.invoke(app, [*command, "--seed", "7"])
    assert str(shown.exception) == "before the drive"
    assert ("--seed has no effect: own has neither" in shown.output) == told
    assert "--seed" not in RUNNER.invoke(app, command).output


def test_a_drive_in_this_process_publishes_by_a_configuration_of_zenoh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def called(controller: object, *_: object, zenoh_file: Path, **__: object) -> None:
        raise EgpError(f"{type(controller).__name__} with {zenoh_file}")

    monkeypatch.setattr("egp_service.cli.publication.StatusPublisher", called)
    command = ["drive", "--in-process", "--zenoh", "z.json5", "--monitor", NOBODY]
    result = RUNNER.invoke(app, [*command, "-o", str(tmp_path)])
    assert str(result.exception) == "Controller with z.json5"
