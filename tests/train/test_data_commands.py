"""`egp collect`, `egp train`, `egp vehicle fit`: options that do not fit, and files they keep."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from plant_log import MASS, options, plant_log
from surfaces import TOY, surface
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app
from egp_service.control.toml_text import dumps
from egp_service.data.coverage import Coverage
from egp_service.data.dataset import Dataset
from egp_service.training.recipe import Recipe
from egp_service.vehicle import known_vehicle

# A recipe of two surfaces, of which the second one is left open.
TWO = '[[surface]]\nlabel = "wet"\nfriction = 0.5\n[[surface]]\nlabel = "{}"\n{}\n'


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


def test_a_file_that_is_no_toml_is_told_alike_by_all(tmp_path: Path) -> None:
    data, output = tmp_path / "own.parquet", ("-o", str(tmp_path / "output"))
    surface().write(data)
    (tmp_path / "own.toml").write_text(
        'name = "own"\nvehicle_file = "own.parquet"\nzones = [{start = 0.0, friction = 1.0}]\n'
        '[track]\nkind = "circle"\n'
    )
    for command in (
        ("train", str(data), "--vehicle", str(data), *output),
        ("train", "--recipe", str(data), *output),
        ("vehicle", "fit", str(data), "--known", str(data), *output),
        ("drive", "-s", str(tmp_path / "own.toml")),
    ):
        told = failure(*command)
        assert told.endswith(f"{data}: expected a TOML file, got bytes that are no UTF-8 text")
    nothing = tmp_path / "nothing.toml"
    for option in ("--vehicle", "--recipe"):
        told = failure("train", option, str(nothing), *output)
        assert told == f"{nothing}: No such file or directory"


def test_options_of_the_other_source_are_errors(tmp_path: Path) -> None:
    collect = ("collect", "--friction", "0.5", "-o", str(tmp_path / "data.parquet"))
    told = failure(*collect, "--mass", "1400", "--column", "time=t:s")
    assert told == "--column, --mass can be given for logs only: name the log with --from-log"
    for option in (("--separator", ";"), ("--steering-ratio", "16"), ("--accelerometer",)):
        assert "--from-log" in failure(*collect, *option)
    log = options(tmp_path / "log.csv", plant_log())
    told = failure("collect", *log, "-o", str(tmp_path / "data.parquet"), "--mass", "1.2")
    assert told.startswith("--mass 1.2 is below 50 kg: state kg, such as 1200 for 1.2 t")
    assert told.endswith("; a car that is so light needs a file, given with --vehicle")
    model = ("--mass", "3.5", "--vehicle", "f1.toml")
    told = failure("collect", *log, "-o", str(tmp_path / "data.parquet"), *model)
    assert told.endswith("for 3.5 t; leave out --mass: f1.toml states it")
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


def test_a_recipe_states_what_options_would(tmp_path: Path) -> None:
    recipe = tmp_path / "recipe.toml"
    recipe.write_text('[[surface]]\nlabel = "wet"\nfriction = 0.5\n', encoding="utf-8")
    command = ["train", "--recipe", str(recipe), "-o", str(tmp_path / "library.safetensors")]
    for option in (
        ["--mean", "constant"],
        ["--kernel", "rbf"],
        ["--max-points", "30"],
        ["--restarts", "0"],
        ["--validation", "0.5"],
        ["--seed", "7"],
    ):
        assert f"{option[0]} cannot be used with --recipe" in failure(*command, *option)
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.toml"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "[[surface]]\nlabel = 5\nfriction = 0.5",
            r"surface\[0\]: label must be a text, got 5$",
        ),
        (
            '[surface]  # [[surface]]\nlabel = "wet"',
            "surface must be an array of tables, each below a header in double brackets, got {",
        ),
        ("collection = [1]", r"collection must be a table, got \[1\]$"),
        ("collection.tracks = 1", "collection: tracks must be an array, got 1$"),
        ("collection.tracks = [1]", r"collection: tracks\[0\] must be a text, got 1$"),
        ("training.foo = 1", "training: unknown field 'foo'; known: kernel, mean, max_points"),
        (
            "training.kernel = 'rgb'",
            "training: kernel must be one of 'rbf', 'matern52', got",
        ),
        ("training.max_points = 6000", "training: max_points is 6000: expected at most 5000"),
        (
            "training = {mean = 'best', max_points = 2000}",
            "training: max_points is 2000: expected at most 150 with the mean 'best'",
        ),
        ("foo = 1", "unknown field 'foo'; known: surface, collection, .*, friction, .*, dt"),
        ("dt = '20 ms'", "dt must be a number, got '20 ms'$"),
        ("vehicle = 1.0", "vehicle must be a whole number, got 1.0$"),
        ("disturbances = {load = true}", "disturbances.load must be a number, got True$"),
        ("on_policy.grip = [0.9, 1.2]", "on_policy: grip is .*: .* above 0 and at most 1$"),
        (
            "collection.sampling.v_x = [27.0, 2.0]",
            "collection: sampling: v_x is .*: expected the smaller number first",
        ),
        (
            "collection.sampling.v_x = [2.0, nan]",
            r"collection: sampling: v_x\[1\] must be a finite number, got nan",
        ),
        (
            "collection.sampling.v_x = [1.0, 2.0, 3.0]",
            "collection: sampling: v_x must be an array of 2 values, got",
        ),
        (
            "collection.sampling.sideslip = -1",
            "collection: sampling: sideslip is -1.0: expected 0 to 10",
        ),
        (
            "collection.exploration.noise = [0.0, 12.0]",
            "collection: exploration: noise is .*: expected 0 to 10",
        ),
        (
            "collection.exploration.seconds = -3.0",
            "collection: exploration: seconds is -3.0: expected 0.1 to 3600",
        ),
        (
            "collection.exploration.episodes = 0",
            "collection: exploration: episodes is 0: expected 1 to 100000",
        ),
        (
            "collection.exploration.arrivals = 3.0",
            "collection: exploration: arrivals is 3.0: expected 0 to 1",
        ),
        ("surface = []  # [[surface]]", "no surfaces: add a table"),
        ("# no [[surface]]", "no surfaces: add a table"),
        (TWO.format("wet", "friction = 0.3"), "frictions 0.5 and 0.3 share a surface label, 'wet'"),
        (TWO.format("ice", "friction = 0.3\ndt = 0.04"), ".*: one library has one dt and one"),
        (TWO.format("ice", "friction = 0.3\nvehicle = 2"), ".*: one library has one dt and one"),
        (TWO.format("wet", "friction = 0.5"), "surface 'wet' with seed 0 is stated twice"),
        (
            TWO.format("ice", "friction = [0.3]"),
            r"surface\[1\]: friction must be a number or a text, got \[0.3\]",
        ),
        (
            TWO.format("ice", "friction = -0.3"),
            r"surface\[1\]: expected a friction coefficient > 0 and at most 3, got -0.3",
        ),
        (
            TWO.format("ice", "friction = 0.3\ndt = 2.0"),
            r"surface\[1\]: dt is 2.0 s: expected a period",
        ),
        (TWO.format("", "friction = 0.3"), r"surface\[1\]: the surface label is empty"),
    ],
)
def test_values_of_a_recipe_have_ranges(tmp_path: Path, text: str, complaint: str) -> None:
    recipe = tmp_path / "recipe.toml"
    sound = '[[surface]]\nlabel = "wet"\nfriction = 0.5\n'
    recipe.write_text(text if "[[surface]]" in text else f"{text}\n{sound}", encoding="utf-8")
    with pytest.raises(EgpError, match=f"recipe.toml: {complaint}"):
        Recipe.read(recipe)


def test_a_surface_of_a_recipe_may_differ_from_what_holds_for_all(tmp_path: Path) -> None:
    recipe = tmp_path / "recipe.toml"
    surface = '[[surface]]\nlabel = "{}"\nfriction = 0.5\n{}\n'
    text = "seed = 3\n" + surface.format("a", "") + surface.format("b", "seed = 4")
    recipe.write_text(text, encoding="utf-8")
    assert [experiment.seed for experiment in Recipe.read(recipe).experiments] == [3, 4]


def test_a_library_that_cannot_be_written_is_an_error_before_training(tmp_path: Path) -> None:
    surface(trajectories=2).write(tmp_path / "wet.parquet")
    told = failure("train", str(tmp_path / "wet.parquet"), "-o", "/proc/library.safetensors")
    assert "/proc/library.safetensors: no file can be written there" in told


def test_a_vehicle_that_cannot_be_written_is_an_error_before_the_data_are_read() -> None:
    told = failure("vehicle", "fit", "none.parquet", "-o", "/proc/vehicle.toml")
    assert "/proc/vehicle.toml: no file can be written there" in told


def test_the_folder_of_a_vehicle_is_made(tmp_path: Path) -> None:
    output = tmp_path / "new" / "vehicle.toml"
    told = failure("vehicle", "fit", str(tmp_path / "none.parquet"), "-o", str(output))
    assert told.endswith("none.parquet: no such file")
    assert output.parent.is_dir()


def test_one_member_is_counted_as_one(tmp_path: Path) -> None:
    data, car, library = (tmp_path / name for name in ("d.parquet", "car.toml", "l.safetensors"))
    surface(trajectories=8).write(data)
    car.write_text(dumps(TOY.fields()), encoding="utf-8")
    command = ["train", str(data), "--vehicle", str(car), "-o", str(library)]
    result = CliRunner().invoke(app, [*command, "--mean", "constant", "--max-points", "20"])
    assert result.exit_code == 0, result.output
    assert ": 1 member, id " in " ".join(result.output.split())


def test_a_dataset_that_cannot_be_written_is_an_error_before_it_is_collected(
    tmp_path: Path,
) -> None:
    told = failure("collect", "--friction", "0.5", "-o", "/proc/data.parquet")
    assert "/proc/data.parquet: no file can be written there" in told
    log = options(tmp_path / "log.csv", plant_log())
    (tmp_path / "log.csv").unlink()
    assert "no file can be written" in failure("collect", *log, "-o", "/proc/data.parquet")


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


def test_an_accelerometer_does_not_feel_what_the_front_tyres_take(tmp_path: Path) -> None:
    log = plant_log()
    commanded = log["a_x"].copy()
    v_x, v_y, omega = log["v_x"], log["v_y"], log["omega"]
    between = 0.5 * (v_y * omega + np.roll(v_y * omega, -1))
    log["a_x"] = (np.roll(v_x, -1) - v_x) / 0.02 - between
    log = {name: column[:-1] for name, column in log.items()}
    car = tmp_path / "car.toml"
    car.write_text(dumps(known_vehicle("commonroad-1").fields()), encoding="utf-8")
    collect = ("collect", *options(tmp_path / "log.csv", log), "-o", str(tmp_path / "d.parquet"))
    assert "--vehicle FILE.toml" in failure(*collect, "--accelerometer")
    bends = np.abs(log["delta"][:-1]) > 0.03
    errors = []
    for more in ((), ("--accelerometer",)):
        result = CliRunner().invoke(app, [*collect, "--vehicle", str(car), *more])
        assert result.exit_code == 0, result.output
        data = Dataset.read(tmp_path / "d.parquet")
        error = (data.z[:, 4] / MASS - commanded[: len(data)])[bends]
        errors.append((abs(error.mean()), np.sqrt(np.mean(error**2))))
    measured, corrected = errors
    assert measured[0] > 0.08
    assert corrected[0] < 0.25 * measured[0]
    assert corrected[1] < 0.6 * measured[1]


def test_a_mass_that_contradicts_the_file_of_the_car_is_an_error(tmp_path: Path) -> None:
    car, log = tmp_path / "car.toml", options(tmp_path / "log.csv", plant_log())
    collect = ("collect", *log, "-o", str(tmp_path / "d.parquet"), "--vehicle", str(car))
    fields = known_vehicle("commonroad-1").fields()
    for known, ratio in ((2000.0, "0.613"), (800.0, "1.53")):  # the option states 1225.887 kg
        car.write_text(dumps(fields | {"mass": known}), encoding="utf-8")
        told = failure(*collect)
        assert told.startswith(
            f"--mass 1225.89 kg is {ratio} times the mass in {car}, {known:g} kg"
        )
        assert "leave out --mass" in told
    # The file may be that of the car without its load, or with one.
    for known in (0.67 * MASS, 1.49 * MASS):
        car.write_text(dumps(fields | {"mass": known}), encoding="utf-8")
        result = CliRunner().invoke(app, collect)
        assert result.exit_code == 0, result.output


@pytest.mark.parametrize("vehicle", ["commonroad-1", "commonroad-own.toml"])
def test_a_car_of_ones_own_has_no_name_of_a_simulated_one(tmp_path: Path, vehicle: str) -> None:
    log = options(tmp_path / "log.csv", plant_log())
    if vehicle.endswith(".toml"):
        vehicle = str(tmp_path / vehicle)
        Path(vehicle).write_text(dumps(known_vehicle("commonroad-1").fields()))
    command = ["collect", *log, "--vehicle", vehicle, "-o", str(tmp_path / "data.parquet")]
    result = CliRunner().invoke(app, command)
    assert "begin with commonroad- are those of the simulated cars" in str(result.exception)


def test_a_file_that_describes_no_car_is_not_its_name(tmp_path: Path) -> None:
    car = tmp_path / "own.parquet"
    surface().write(car)
    log = options(tmp_path / "log.csv", plant_log())
    told = failure("collect", *log, "-o", str(tmp_path / "d.parquet"), "--vehicle", str(car))
    assert told.startswith(f"--vehicle {car}: expected the name of a car, or a TOML file")


def test_a_single_trajectory_is_as_long_as_the_data() -> None:
    data = surface(trajectories=1)
    for count, time in ((1, "0.05"), (11, "0.55"), (20, "1")):
        part = data.select(np.arange(len(data)) < count)
        told = next(Coverage.of(part).lines())
        assert told == f"{time} s in 1 trajectory of at most {time} s"


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
