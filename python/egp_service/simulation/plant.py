"""The simulated vehicle of a closed loop: the built-in one, or one's own simulator."""

from __future__ import annotations

import sys
import traceback
from contextlib import contextmanager
from dataclasses import asdict, astuple
from importlib import import_module
from importlib.machinery import PathFinder
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Protocol

import numpy as np

from egp_service._core import EgpError, Plant, VehicleLostError
from egp_service.quantities import DELTA, NX, OMEGA, P_X, P_Y, PSI, V_X, V_Y
from egp_service.simulation.scenario_checks import check_told

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from egp_service._core import Path
    from egp_service.simulation.scenario import Measurement, Scenario

# Number of updates of the friction under the wheels within a control period.
FRICTION_UPDATES = 10
FARTHEST = 1e7  # m; a service accepts no position beyond it


class Simulator(Protocol):
    """What a simulator needs for `egp drive --plant module:Class`; the class takes no arguments.

    States are `[p_x, p_y, v_x, psi, v_y, omega, delta]`: position in m in the map's frame, speeds
    in m/s in the vehicle's frame (x ahead, y to the left), yaw in rad counter-clockwise from the
    map's x axis, yaw rate in rad/s, steering angle of the front wheels in rad, positive to the
    left; all of the centre of mass. An exception of a method becomes a `PlantError`, and a state
    that is not finite or more than 1e7 m from the origin ends the run.
    """

    def reset(self, x: NDArray[np.float64]) -> None:
        """Put the vehicle into the state `x` (7,)."""

    def step(self, u: NDArray[np.float64], dt: float, friction: float) -> None:
        """Drive `dt` seconds with the constant input `u = [F_x, delta_dot]` in N and rad/s.

        `friction` is the friction coefficient under the vehicle.
        """

    @property
    def state(self) -> NDArray[np.float64]:
        """The state (7,)."""


class PlantError(EgpError):
    """A simulator that cannot be loaded or used."""


class CommonRoadPlant:
    """The built-in vehicle, with the friction of the path's zone under each wheel."""

    def __init__(self, scenario: Scenario, path: Path) -> None:
        """Make the scenario's vehicle with its disturbances."""
        self._plant = Plant(scenario.vehicle, asdict(scenario.disturbances))
        self._path = path

    def reset(self, x: NDArray[np.float64]) -> None:
        """Put the vehicle into the state, with its suspension at rest."""
        self._plant.reset(
            x[P_X], x[P_Y], x[PSI], x[V_X], yaw_rate=x[OMEGA], v_y=x[V_Y], delta=x[DELTA]
        )

    def drive(self, u: NDArray[np.float64], dt: float, s: float) -> None:
        """Drive one period from the arc length `s` on.

        Raises:
            VehicleLostError: if the vehicle spins.

        """
        for _ in range(FRICTION_UPDATES):
            self._plant.step(u, dt / FRICTION_UPDATES, self._path, s)

    @property
    def state(self) -> NDArray[np.float64]:
        """The state (7,)."""
        return self._plant.vehicle_state


class OwnPlant:
    """A user's simulator, checked."""

    def __init__(self, name: str, path: Path, folder: str | None = None) -> None:
        """Load `module:Class`; see `load_simulator`."""
        self._simulator = load_simulator(name, folder)
        self._name = name
        self._path = path

    def reset(self, x: NDArray[np.float64]) -> None:
        """Put the vehicle into the state (7,).

        Raises:
            PlantError: if the simulator raises an exception, or the state is then not finite.

        """
        with _calling(f"{self._name}.reset"):
            self._simulator.reset(x)
        if not np.isfinite(self.state).all():
            raise PlantError(f"{self._name}.state after reset is {self.state.tolist()}")

    def drive(self, u: NDArray[np.float64], dt: float, s: float) -> None:
        """Drive one period on the friction at the arc length `s`.

        Raises:
            PlantError: if the simulator raises an exception.
            VehicleLostError: if the state is no longer finite or more than 10 000 km away.

        """
        friction = float(self._path.sample(np.array([s]))[-1][0])
        with _calling(f"{self._name}.step"):
            self._simulator.step(u.copy(), dt, friction)  # a step may write into its argument
        state = self.state
        if not (np.abs(state) <= FARTHEST).all():
            finite = np.isfinite(state).all()
            fault = f"has a number beyond ±{FARTHEST:g}" if finite else "is not finite"
            raise VehicleLostError(f"{self._name}.state after step {fault}: {state.tolist()}")

    @property
    def state(self) -> NDArray[np.float64]:
        """The state (7,).

        Raises:
            PlantError: unless the state is an array of seven real numbers.

        """
        with _calling(f"{self._name}.state"):
            state = self._simulator.state
        if callable(state):
            raise PlantError(f"{self._name}.state is a method: make it a property")
        try:
            x = np.asarray(state)
            x = x.astype(np.float64, casting="same_kind")
        except (TypeError, ValueError) as error:
            raise PlantError(f"{self._name}.state is no array of seven numbers: {error}") from error
        if x.shape != (NX,):
            raise PlantError(
                f"{self._name}.state has the shape {x.shape}: expected (7,) with "
                "[p_x, p_y, v_x, psi, v_y, omega, delta]"
            )
        return x


def make_plant(scenario: Scenario, path: Path) -> CommonRoadPlant | OwnPlant:
    """Return the vehicle that a scenario's loop drives.

    Raises:
        ScenarioError: if the scenario's `plant` is not told what a zone states.
        PlantError: as `load_simulator`.

    """
    if scenario.plant is None:
        return CommonRoadPlant(scenario, path)
    check_told(scenario, scenario.name)
    return OwnPlant(scenario.plant, path, scenario.plant_folder)


def measurement_noise(measurement: Measurement) -> NDArray[np.float64]:
    """Return the standard deviations of the measured state (7,)."""
    position, *rest = astuple(measurement)
    return np.array([position, position, *rest])


def load_simulator(name: str, folder: str | None = None) -> Simulator:
    """Make a simulator from `module:Class`.

    The module is looked for in `folder` if one is given, in the working folder, and among the
    installed packages, in this order.

    Raises:
        PlantError: if there is no such class, it cannot be made, or it lacks `reset`, `step` or
            `state`, and if another module of this name was imported before.

    """
    module, colon, attribute = name.partition(":")
    if not (colon and module and attribute):
        raise PlantError(f"plant {name!r}: expected MODULE:CLASS, such as my_simulator:Car")
    folders = list(dict.fromkeys(str(FilePath(each).absolute()) for each in (folder or "", "")))
    sys.path[:0] = [each for each in folders if each not in sys.path]
    with _calling(f"plant {name!r} cannot be made"):
        try:
            imported = import_module(module)
            _check_place(module.partition(".")[0], folders, name)
            simulator: Simulator = getattr(imported, attribute)()
        except (ImportError, AttributeError, TypeError) as error:
            advice = (
                f"looked in {', '.join(folders)} and the installed packages: expected a class "
                "without arguments in a module there, or of a folder there as "
                "folder.my_simulator:Car"
            )
            if module.endswith(".py"):
                dotted = module.removesuffix(".py").lstrip("./").replace("/", ".")
                advice = f"expected the name of a module, not of its file: {dotted}:{attribute}"
            raise PlantError(f"plant {name!r} cannot be made: {error}; {advice}") from error
    # A property may need `reset` first, so it is looked for and not read.
    own = getattr(simulator, "__dict__", {})  # some classes have none
    has = {*dir(type(simulator)), *own}
    lacking = [part for part in ("reset", "step", "state") if part not in has]
    if lacking == ["state"]:
        with _calling(f"{name}.reset"):
            simulator.reset(np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0]))
        lacking = [] if "state" in own else lacking
    if lacking:
        raise PlantError(
            f"plant {name!r} has no {', '.join(lacking)}: expected reset(x), step(u, dt, friction) "
            "and state (docs/simulator.md)"
        )
    return simulator


def _check_place(module: str, folders: Sequence[str], name: str) -> None:
    """Raise `PlantError` if a module of these folders was not imported because of another one."""
    wanted = PathFinder.find_spec(module, folders)
    found = getattr(sys.modules[module], "__file__", None)
    if wanted is None or wanted.origin is None or found is None:  # as of folders without a file
        return
    if FilePath(found).resolve() != FilePath(wanted.origin).resolve():
        raise PlantError(
            f"plant {name!r} cannot be made: {wanted.origin} is not used, because {found} has the "
            "same name and comes first: rename one of the two"
        )


def source_file(name: str) -> FilePath | None:
    """Return the file that defines a class `module:Class`, which was loaded before.

    None if it has no file, as in a notebook.
    """
    module, _, attribute = name.partition(":")
    defined = getattr(getattr(sys.modules[module], attribute), "__module__", module)
    file = getattr(sys.modules.get(defined), "__file__", None)
    return None if file is None else FilePath(file)


@contextmanager
def _calling(what: str) -> Iterator[None]:
    """Turn an exception of a user's code into a `PlantError` with the place where it was raised."""
    try:
        yield
    except EgpError:  # such as `VehicleLostError`, which ends a run
        raise
    except Exception as error:
        text = f"{what}: {type(error).__name__}: {error}"
        if not isinstance(error, SyntaxError):  # whose own text has the place
            place = traceback.extract_tb(error.__traceback__)[-1]
            text += f" ({place.filename}, line {place.lineno})"
        raise PlantError(text) from error
