"""Scenarios: vehicle, track, speed, surfaces and library of a run.

A scenario is one TOML file, whose fields are those of `Scenario` (docs/settings.md); unknown fields
are errors. The built-in scenarios are in `scenarios/` next to this module.
"""

from __future__ import annotations

import tomllib
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from pathlib import Path

from egp_service import shipped
from egp_service._core import EgpError, Plant, VehicleParameters, surface_friction
from egp_service.control.toml_text import dumps
from egp_service.simulation.configuration import build, without_none
from egp_service.simulation.scenario_checks import (
    ScenarioError,
    check_control,
    check_measurement,
    check_name,
    check_seed,
    check_speed,
    check_starts,
    check_track,
)
from egp_service.simulation.zones import read_zone_rows
from egp_service.vehicle import read_vehicle

BUILT_IN = resources.files("egp_service.simulation") / "scenarios"
DEMO_LIBRARY = "demo"
MAX_DELAY = 100
# m, of a full-size vehicle.
_LEAVE = 3.0


@dataclass(frozen=True, slots=True)
class Zone:
    """A stretch of road with its own surface, up to the next zone, whose `start` is larger."""

    start: float
    """Start as a fraction of the path's length, or in m with `zones_in_metres`."""
    friction: float | None = None
    """Friction coefficient mu."""
    right: float | None = None
    """Friction right of the path on a split road; `friction` is then that of the left side."""
    surface: str | dict[str, float] | None = None
    """Name of a preset or table of factors (`_core.surface_friction`), in place of `friction`."""
    surface_right: str | dict[str, float] | None = None
    """Surface right of the path, in place of `right`."""

    def sides(
        self,
    ) -> (
        tuple[float | str | dict[str, float]]
        | tuple[float | str | dict[str, float], float | str | dict[str, float]]
    ):
        """Give the surface, or the left and the right one of a split road.

        Raises:
            ScenarioError: if a side has no surface or two.

        """
        left = _one_of(self.friction, self.surface, "friction", "surface")
        if left is None:
            raise ScenarioError("expected `friction` or `surface`, got neither")
        right = _one_of(self.right, self.surface_right, "right", "surface_right")
        return (left,) if right is None else (left, right)


@dataclass(frozen=True, slots=True)
class Track:
    """A track: a built-in kind with its dimensions, or a CSV file."""

    kind: str
    """`rounded-rectangle`, `l-shape`, `circle`, `circuit`, `lane-change`, `iso-3888-2`, `random`,
    or `csv`."""
    file: str | None = None
    """Raceline or centre line, for kind `csv`; relative to the scenario file."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Dimensions of the kind, with the names of the constructors of `_core.Path`."""
    closed: bool | None = None
    """Whether the end of the file's track joins its start, for kind `csv`; true by default."""


@dataclass(frozen=True, slots=True)
class Speed:
    """The reference speed, which uses the fraction `grip` of the friction, up to `v_max`."""

    grip: float = 0.85
    """Fraction of the friction that the reference speed uses; on a split road, of the mean of both
    sides."""
    knows: str = "zones"
    """What the reference speed depends on: `zones`, the friction of all zones; `here`, the friction
    under the vehicle, as if it were the same everywhere; `weights`, that of the members,
    blended with the last step's weights; `nothing`, what the control steps found. The controller's
    model is not told the zones in any case."""
    risk: float = 0.05
    """With `nothing`: probability that a place has less friction than its speed is planned for."""
    friction: float | None = None
    """With `nothing`: a friction assumed everywhere, in place of what was found. With `here` and
    `weights`: the largest friction to plan for."""
    preview: bool = True
    """With `nothing`: whether the model of each stage follows what was found about the road there;
    otherwise it is that of the last transitions at all stages."""
    tyres: bool = False
    """Whether the speed in bends is limited to what the tyres of the library's members transmit,
    for surfaces on which the vehicle reaches less of the friction than `lateral_grip` says."""
    v_max: float = 20.0
    """Largest speed, m/s."""
    constant: bool = False
    """Whether the speed is `v_max` on all surfaces."""
    v_start: float | None = None
    """Speed at the start, m/s; by default that of the profile."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """Standard deviations of the measurement noise; zero by default."""

    position: float = 0.0
    """Of `p_x` and `p_y`, m."""
    v_x: float = 0.0
    """Of the speed, m/s."""
    psi: float = 0.0
    """Of the yaw, rad."""
    v_y: float = 0.0
    """Of the lateral speed, m/s."""
    omega: float = 0.0
    """Of the yaw rate, rad/s."""
    delta: float = 0.0
    """Of the steering angle, rad."""


@dataclass(frozen=True, slots=True)
class Disturbances:
    """Constant disturbances that the simulated vehicle's single-track model lacks; 0 by default."""

    load: float = 0.0
    """Mass of a load at the height of the body's centre of mass, kg."""
    load_x: float = 0.0
    """Position of the load ahead of the unloaded vehicle's centre of mass, m."""
    load_y: float = 0.0
    """Position of the load to the left of the unloaded vehicle's centre of mass, m."""
    wear_front: float = 0.0
    """Share of peak force and stiffness that the front tyres have lost."""
    wear_rear: float = 0.0
    """Share of peak force and stiffness that the rear tyres have lost."""
    brake_bias: float = 0.0
    """Share of the brake torque on the front axle beyond the vehicle's own share."""
    brake_pull: float = 0.0
    """Share of each right wheel's brake torque that acts on the left wheel instead."""
    wind_x: float = 0.0
    """Velocity of the air along the map's x axis, m/s."""
    wind_y: float = 0.0
    """Velocity of the air along the map's y axis, m/s."""
    wind_arm: float = 0.0
    """Distance of the wind's lateral force ahead of the unloaded vehicle's centre of mass, m."""
    grade: float = 0.0
    """Inclination of the road along the vehicle, rad, positive uphill."""
    bank: float = 0.0
    """Inclination of the road across the vehicle, rad, positive if the road rises to the left."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """A validated scenario."""

    name: str
    """Name of the run's folder: 1 to 50 letters, digits, spaces and `. _ -`, of which a letter, a
    digit or an underscore comes first."""
    track: Track
    zones: tuple[Zone, ...] = ()
    zones_in_metres: bool = False
    """Whether the zones' `start` is in m instead of a fraction of the path's length."""
    zones_file: str | None = None
    """CSV file of the zones, in place of `zones`; relative to the scenario file."""
    description: str = ""
    library: str = DEMO_LIBRARY
    """`demo` for the shipped library, or a path relative to the scenario file."""
    vehicle: int = 1
    """CommonRoad number of the simulated vehicle."""
    plant: str | None = None
    """`module:Class` of a simulator that is driven in place of the built-in vehicle."""
    plant_folder: str | None = None
    """Folder in which the module of `plant` is looked for first, relative to the scenario file; by
    default that file's own."""
    vehicle_file: str | None = None
    """TOML file of a vehicle's parameters for gate and speeds, in place of those of the simulated
    vehicle; relative to the scenario file."""
    seed: int = 0
    """Seed of the measurement noise, and of the track for kind `random`."""
    laps: float = 1.0
    """Number of laps on a closed track."""
    leave_distance: float | None = None
    """Distance from the reference, m, beyond which the run ends; by default 3 m times the vehicle's
    `VehicleParameters.scale`."""
    actuator_delay: int = 0
    """Delay from the command to the wheels, in control periods, in addition to the plant's."""
    speed: Speed = field(default_factory=Speed)
    measurement: Measurement = field(default_factory=Measurement)
    disturbances: Disturbances = field(default_factory=Disturbances)
    control: dict[str, object] = field(default_factory=dict)
    """Settings of the control step, passed unchanged to service or engine."""
    gate: dict[str, float] = field(default_factory=dict)
    """Settings of the gate in place of the simulated vehicle's own limits."""

    def toml(self) -> str:
        """Return a complete scenario file that reproduces the run."""
        return dumps(without_none(asdict(self)))


def built_in_names() -> list[str]:
    """Names of the scenarios shipped with the package."""
    files = (entry.name for entry in BUILT_IN.iterdir())
    return sorted(name.removesuffix(".toml") for name in files if name.endswith(".toml"))


def load_scenario(name_or_file: str) -> Scenario:
    """Load a built-in scenario by name, or a scenario file by path.

    Raises:
        ScenarioError: if the scenario does not exist, or its file cannot be read or is invalid.

    """
    if name_or_file in built_in_names():
        text = (BUILT_IN / f"{name_or_file}.toml").read_text(encoding="utf-8")
        return parse_scenario(text, Path.cwd(), name_or_file)
    file = Path(name_or_file)
    if not file.is_file():
        raise ScenarioError(
            f"no scenario {name_or_file!r}: "
            f"give a TOML file or one of {', '.join(built_in_names())}"
        )
    # The scenario is stored with a run, from whose folder relative paths would not be found.
    folder = file.parent.absolute()
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScenarioError(
            f"{file}: expected the TOML file of a scenario, got bytes that are no UTF-8 text"
        ) from error
    except OSError as error:
        raise ScenarioError(f"{file}: {error.strerror}") from error
    return parse_scenario(text, folder, str(file))


def parse_scenario(text: str, folder: Path, origin: str) -> Scenario:
    """Parse a scenario file's text; paths in it are relative to `folder`.

    Raises:
        ScenarioError: with a message that begins with `origin`, if a value is out of its range, or
            if track or vehicle cannot be built.
        ConfigurationError: if a field is unknown, missing or of the wrong type.

    """
    from egp_service.simulation.course import build_path  # noqa: PLC0415 - it builds on this file

    try:
        table = tomllib.loads(text)
    except ValueError as error:  # also of a number with thousands of digits
        raise ScenarioError(f"{origin} is not TOML: {error}") from error
    if isinstance(zones_file := table.get("zones_file"), str):
        if "\0" in zones_file:
            raise ScenarioError(
                f"{origin}: zones_file must not contain the character NUL, got {zones_file!r}"
            )
        if "zones" in table:
            raise ScenarioError(f"{origin}: expected `zones` or `zones_file`, got both")
        del table["zones_file"]
        table["zones"] = read_zone_rows(folder / zones_file)
    scenario = build(Scenario, table, origin)
    check_scenario(scenario, origin)
    if scenario.vehicle_file is not None:
        scenario = replace(scenario, vehicle_file=str(folder / scenario.vehicle_file))
    if scenario.track.file is not None:
        track = replace(scenario.track, file=str(folder / scenario.track.file))
        scenario = replace(scenario, track=track)
    if scenario.plant is not None:
        scenario = replace(scenario, plant_folder=str(folder / (scenario.plant_folder or "")))
    if scenario.library != DEMO_LIBRARY:
        scenario = replace(scenario, library=str(folder / scenario.library))
    try:
        vehicle_parameters(scenario)
    except EgpError as error:
        raise ScenarioError(f"{origin}: vehicle_file: {error}") from error
    build_path(scenario, origin)
    return scenario


def told_zones(scenario: Scenario) -> Scenario:
    """Return the scenario with a reference speed that is told the friction of all zones."""
    plain = Speed()
    told = replace(
        scenario.speed, knows="zones", friction=None, risk=plain.risk, preview=plain.preview
    )
    return replace(scenario, speed=told)


def library_path(scenario: Scenario) -> Path:
    """Path of the scenario's library file."""
    if scenario.library != DEMO_LIBRARY:
        return Path(scenario.library)
    return shipped.DEMO_LIBRARY


def gate_settings(scenario: Scenario) -> dict[str, float]:
    """Return the gate's settings: the simulated vehicle's limits and those of the scenario."""
    return vehicle_parameters(scenario).gate_limits() | scenario.gate


def vehicle_parameters(scenario: Scenario) -> VehicleParameters:
    """Return the parameters of the vehicle for gate and speeds.

    Raises:
        EgpError: if the scenario's file of a vehicle cannot be used.

    """
    if scenario.vehicle_file is not None:
        return read_vehicle(Path(scenario.vehicle_file))
    return VehicleParameters.commonroad(scenario.vehicle)


def leave_distance(scenario: Scenario) -> float:
    """Return the distance from the reference, m, beyond which the run ends.

    Raises:
        EgpError: if the scenario's file of a vehicle cannot be used.

    """
    if scenario.leave_distance is not None:
        return scenario.leave_distance
    return _LEAVE * vehicle_parameters(scenario).scale


def _one_of(
    friction: float | None, surface: str | dict[str, float] | None, *names: str
) -> float | str | dict[str, float] | None:
    """Give what is stated of the two, or None."""
    if friction is not None and surface is not None:
        raise ScenarioError(f"expected `{names[0]}` or `{names[1]}`, got both")
    return surface if friction is None else friction


def check_scenario(scenario: Scenario, origin: str) -> None:
    """Check the ranges of the values, which `dataclasses.replace` may have changed.

    Raises:
        ScenarioError: with a message that begins with `origin`.

    """
    check_starts([zone.start for zone in scenario.zones], scenario.zones_in_metres, origin)
    check_name(scenario.name, origin)
    check_seed(scenario.seed, f"{origin}: seed")
    if not 0 <= scenario.actuator_delay <= MAX_DELAY:
        raise ScenarioError(
            f"{origin}: actuator_delay must be in 0..={MAX_DELAY}, got {scenario.actuator_delay}"
        )
    check_speed(scenario.speed, origin)
    check_track(scenario.track, origin)
    positive = {
        "speed.friction": 1.0 if scenario.speed.friction is None else scenario.speed.friction,
        "laps": scenario.laps,
        "leave_distance": 1.0 if scenario.leave_distance is None else scenario.leave_distance,
        **{
            f"zones[{i}].{side}": value
            for i, zone in enumerate(scenario.zones)
            for side, value in (("friction", zone.friction), ("right", zone.right))
            if value is not None
        },
    }
    for name, value in positive.items():
        if not 0.0 < value < float("inf"):
            raise ScenarioError(f"{origin}: {name} must be positive and finite, got {value}")
    check_measurement(scenario.measurement, origin)
    check_control(scenario.control, origin)
    for i, zone in enumerate(scenario.zones):
        try:
            for side in zone.sides():
                surface_friction(side)
        except EgpError as error:
            raise ScenarioError(f"{origin}: zones[{i}]: {error}") from error
    _check_plant(scenario, origin)


def _check_plant(scenario: Scenario, origin: str) -> None:
    if scenario.plant_folder is not None and scenario.plant is None:
        raise ScenarioError(f"{origin}: plant_folder has no effect without `plant`: leave it out")
    if scenario.plant is not None and scenario.disturbances != Disturbances():
        raise ScenarioError(f"{origin}: disturbances have no effect on plant {scenario.plant!r}")
    try:
        Plant(scenario.vehicle, asdict(scenario.disturbances))
    except EgpError as error:
        raise ScenarioError(f"{origin}: {error}") from error
    except OverflowError as error:
        raise ScenarioError(
            f"{origin}: vehicle is {scenario.vehicle}: expected a number of CommonRoad, 1 or 2"
        ) from error
