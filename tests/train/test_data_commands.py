"""`egp collect`, `egp train`, `egp vehicle fit`: options that do not fit, and files they keep."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from plant_log import options, plant_log
from surfaces import TOY, surface
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app
from egp_service.control.toml_text import dumps


def failure(*arguments: str) -> str:
    """Run a command that must fail with an `EgpError`, and return its message."""
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, EgpError), result.output
    return str(result.exception)


def test_an_input_is_not_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    surface().write(Path("data.parquet"))
    Path("car.toml").write_text(dumps(TOY.fields()), encoding="utf-8")
    Path("alias.parquet").symlink_to("data.parquet")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    collect = ("collect", "--friction", "0.5")
    fit = ("vehicle", "fit", "data.parquet")
    for command in (
        (*collect, "--from-log", "data.parquet", "-o", "data.parquet"),
        (*collect, "--from-log", "data.parquet", "-o", "./alias.parquet"),
        ("train", "data.parquet", "-o", "data.parquet"),
        ("train", "data.parquet", "--vehicle", "car.toml", "-o", "car.toml"),
        ("train", "data.parquet", "-o", "a.png", "--picture", "a.png"),
        (*fit, "-o", "data.parquet"),
        (*fit, "--known", "car.toml", "-o", str(tmp_path / "car.toml")),
    ):
        assert "name another output" in failure(*command)
    # The default output of a fit may be a file that somebody has edited.
    Path("vehicle.toml").write_text("mass = 1\n")
    assert "vehicle.toml exists: state -o vehicle.toml to replace it" in failure(*fit)
    Path("vehicle.toml").unlink()
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_options_of_the_other_source_are_errors(tmp_path: Path) -> None:
    collect = ("collect", "--friction", "0.5", "-o", str(tmp_path / "data.parquet"))
    told = failure(*collect, "--mass", "1400", "--column", "time=t:s")
    assert told == "--column, --mass can be given for logs only: name the log with --from-log"
    for option in (("--separator", ";"), ("--steering-ratio", "16")):
        assert "--from-log" in failure(*collect, *option)
    log = options(tmp_path / "log.csv", plant_log())
    for option in (("--track", "random"), ("--runs", "2"), ("--disturbance", "load=300")):
        told = failure("collect", *log, "-o", str(tmp_path / "data.parquet"), *option)
        assert told.startswith(f"{option[0]} can be given for simulated data only")


def test_a_name_that_is_given_twice_is_an_error(tmp_path: Path) -> None:
    output = ("-o", str(tmp_path / "data.parquet"))
    log = options(tmp_path / "log.csv", plant_log())
    told = failure("collect", *log, *output, "--column", "v_x=omega:m/s")
    assert "--column v_x is given twice" in told
    loads = ("--disturbance", "load=100", "--disturbance", "load=200")
    told = failure("collect", "--friction", "0.5", *output, *loads)
    assert "--disturbance load is given twice" in told


@pytest.mark.parametrize("label", ["[/x]", "[bold]wet"])
def test_brackets_are_no_markup(tmp_path: Path, label: str) -> None:
    folder = tmp_path / "x[y]"
    log = options(tmp_path / "log.csv", plant_log())
    command = ["collect", *log, "--surface", label, "-o", str(folder / "data.parquet")]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    assert f"of 0.02 s on {label}" in result.output
    assert "x[y]/data.parquet" in re.sub(r"\s", "", result.output)


def test_a_picture_has_an_ending_that_can_be_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra `viz` is not installed")
    data, library = tmp_path / "data.parquet", str(tmp_path / "library.safetensors")
    surface().write(data)
    log = options(tmp_path / "log.csv", plant_log())
    for name in ("picture.xyz", "picture"):
        picture = str(tmp_path / name)
        collect = ("collect", *log, "-o", str(tmp_path / "new.parquet"), "--picture", picture)
        for command in (collect, ("train", str(data), "-o", library, "--picture", picture)):
            assert "does not name a picture" in failure(*command)
    assert not (tmp_path / "new.parquet").exists()


def test_a_file_is_named_once(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    command = ["collect", *options(path, plant_log()), "-o", str(tmp_path / "data.parquet")]
    path.write_text(path.read_text().replace(",8.0,", ",,", 1))
    assert failure(*command).count("log.csv") == 1
    path.unlink()
    assert failure(*command).count("log.csv") == 1


def test_the_same_data_twice_are_an_error(tmp_path: Path) -> None:
    data, output = tmp_path / "data.parquet", ("-o", str(tmp_path / "output"))
    car = tmp_path / "car.toml"
    surface().write(data)
    car.write_text(dumps(TOY.fields()), encoding="utf-8")
    twice = (str(data), str(data))
    train = ("train", *twice, "--vehicle", str(car), *output)
    for command in (train, ("vehicle", "fit", *twice, *output)):
        assert "have the same transitions: give each once" in failure(*command)
