"""Types of the compiled extension, one section per Rust file under `rust/python/src`."""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Literal, Self, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "GRAVITY",
    "LIVE_KEYS",
    "STANDARD_GRAVITY",
    "AffineOcp",
    "Command",
    "Decision",
    "Discovery",
    "Driver",
    "EgpError",
    "Engine",
    "FrictionMap",
    "Gate",
    "InProcessDriver",
    "InvalidArgumentError",
    "Library",
    "LibraryError",
    "Member",
    "MemberData",
    "OcpBounds",
    "OcpResult",
    "OcpWeights",
    "Path",
    "Plant",
    "Projection",
    "Query",
    "Ready",
    "Refusal",
    "RefusedError",
    "Reply",
    "Request",
    "Server",
    "SpeedProfile",
    "VehicleParameters",
    "decode_error",
    "decode_ready",
    "decode_reply",
    "decode_request",
    "decode_timing",
    "encode_plant_truth",
    "file_descriptor_set",
    "health_key",
    "horizon_reference",
    "live_key",
    "metrics_key",
    "ocp_to_qp",
    "plant_derivative",
    "plant_initial_states",
    "plant_step_batch",
    "ready_key",
    "replica_of_live",
    "serve",
    "solve_ocp",
    "solve_weights",
    "step_key",
    "surface_friction",
    "write_library",
    "write_library_subset",
]

# error.rs

class EgpError(ValueError):
    """An input that cannot be used or a computation that failed; the message says why."""

class InvalidArgumentError(EgpError):
    """An argument of the wrong shape, or with a value outside its domain."""

class RefusedError(EgpError):
    """The control step answered a request with an error; the message begins with its code."""

# driver.rs

@final
class Query:
    """A question to a replica, to be sent as it is; its answer is told with its `id`."""

    @property
    def id(self) -> int:
        """Names the query to the driver."""
    @property
    def replica(self) -> str:
        """Who is asked."""
    @property
    def key(self) -> str:
        """Key of the zenoh query."""
    @property
    def payload(self) -> bytes:
        """Bytes to send."""
    @property
    def listen(self) -> float:
        """How long to listen for the answer, s."""

@final
class Decision:
    """What one control period brought; `egp_service.Step` has the same fields and more."""

    @property
    def u(self) -> NDArray[np.float64]:
        """Force [N] and steering rate [rad/s] for the actuators (2,)."""
    @property
    def mode(self) -> Literal["normal", "tail", "stop", "waiting"]:
        """Where the command comes from."""
    @property
    def limited(self) -> bool:
        """Whether a limit changed what the plan asked for."""
    @property
    def status(self) -> str:
        """The outcome in one word."""
    @property
    def detail(self) -> str:
        """Why there is no plan, or why the vehicle counts as lost; empty otherwise."""
    @property
    def lost(self) -> bool:
        """Whether the vehicle counts as lost and is therefore stopped."""
    @property
    def envelope_distance(self) -> float:
        """Distance of the state from the library's training data, in half widths; 0 inside."""
    @property
    def plan_x(self) -> NDArray[np.float64] | None:
        """States of the new plan (T+1, 7)."""
    @property
    def plan_u(self) -> NDArray[np.float64] | None:
        """Inputs of the new plan (T, 2)."""
    @property
    def sigma(self) -> NDArray[np.float64] | None:
        """Standard deviations along the plan (T+1, 3)."""
    @property
    def replica(self) -> str:
        """Who replied, or who was asked last."""
    @property
    def request(self) -> bytes:
        """Bytes of the request; empty when none was made."""
    @property
    def reply(self) -> bytes | None:
        """Bytes of this period's reply."""
    @property
    def late(self) -> list[bytes]:
        """Replies to earlier requests that came since the last step."""
    @property
    def service_time(self) -> tuple[float, float]:
        """Seconds in the service's queue and in its worker; zeros when unknown."""
    @property
    def asked(self) -> int:
        """Number of replicas that were asked."""

@final
class Driver:
    """Decides for one vehicle: which replica to ask, how long to wait, which replies to use.

    A state machine without clock, network or threads. Tell it what happened, each time with the
    time in s of a clock that does not run backwards, and carry out its actions. `ready` is what a
    replica answered on its `ready` key, `gate` the settings of the gate, `budget` the part of the
    control period that an answer may take. Raises `InvalidArgumentError` for values out of range.
    """

    def __new__(
        cls,
        ready: bytes,
        *,
        fleet: str,
        vehicle: str,
        gate: Mapping[str, float],
        budget: float = 0.8,
        want_sigma: bool = False,
    ) -> Driver: ...
    def replica_appeared(self, now: float, replica: str) -> None:
        """Note that a replica announces itself."""
    def replica_gone(self, now: float, replica: str) -> None:
        """Note that a replica withdrew its announcement or was lost."""
    def tick(
        self,
        now: float,
        deadline: float,
        x: NDArray[np.float64],
        reference: NDArray[np.float64],
        widths: NDArray[np.float64] | None = None,
    ) -> None:
        """Open a control period at the measured state (7,), with a command due by `deadline`.

        `reference` has rows [p_x, p_y, v_x, psi] (T+1, 4), `widths` rows [left, right] (T+1, 2).
        Raises `InvalidArgumentError` when no request can be made of the arguments.
        """
    def wake(self, now: float) -> None:
        """Decide the open period if its deadline has passed."""
    def replied(self, now: float, query: int, payload: bytes, attachment: bytes) -> None:
        """Note a reply and its attachment."""
    def refused(self, now: float, query: int, error: bytes) -> None:
        """Note an error reply."""
    def ended(self, now: float, query: int) -> None:
        """Note that no more answers to a query come."""
    def next_action(self) -> Query | Decision | None:
        """Give the next thing to do: a question to send, or the period's decision."""
    @property
    def budget(self) -> float:
        """Seconds that an answer may take unless a period states its deadline."""
    @property
    def mode(self) -> Literal["normal", "tail", "stop", "waiting"]:
        """Where the last command came from."""
    @property
    def weights(self) -> NDArray[np.float64]:
        """Weights of the newest reply (N,); empty before the first."""
    def hold_weights(self, weights: NDArray[np.float64]) -> None:
        """Start the next request from these weights and carry no history from now on."""
    def reset(self) -> None:
        """Leave STOP and forget history, weights, plan and outstanding requests."""

@final
class Discovery:
    """Finds a replica that is ready, asking those that announce themselves in turn."""

    def __new__(cls, fleet: str, vehicle: str) -> Discovery: ...
    def replica_appeared(self, replica: str) -> None:
        """Note that a replica announces itself."""
    def replica_gone(self, replica: str) -> None:
        """Note that a replica withdrew its announcement or was lost."""
    @property
    def live(self) -> list[str]:
        """The replicas that announce themselves."""
    def next_question(self) -> tuple[str, str] | None:
        """Give a replica to ask and the key; none when every one was asked in this round."""
    @staticmethod
    def is_ready(replica: str, answer: bytes) -> bool:
        """Whether an answer describes a replica that is ready; `EgpError` when malformed."""

# gate.rs

@final
class Command:
    """What leaves the gate in one period."""

    @property
    def u(self) -> tuple[float, float]:
        """Force [N] and steering rate [rad/s]."""
    @property
    def mode(self) -> Literal["normal", "tail", "stop", "waiting"]:
        """Where it comes from."""
    @property
    def limited(self) -> bool:
        """Whether a limit changed what the plan asked for."""

@final
class Gate:
    """WAITING (brakes) → NORMAL → TAIL (rest of the last plan) → STOP (brakes, latched).

    Every command lies inside hard limits of value and slew.
    """

    def __new__(cls, dt: float, settings: Mapping[str, float]) -> Gate:
        """Make a gate with periods of `dt` s.

        `settings` holds all limits, as `VehicleParameters.gate_limits` gives them, and may hold
        `max_tail_ticks` (25) and `stop_deceleration` (3 m/s²). Raises `EgpError` for a limit that
        is missing or has the wrong sign, and for an unknown name.
        """

    def accept(
        self, tick: int, plan_u: Sequence[tuple[float, float]] | NDArray[np.float64]
    ) -> None:
        """Take a plan of (T, 2) inputs whose first one is meant for period `tick`."""
    def command(self, tick: int, v_x: float, delta: float) -> Command:
        """Give what the actuators get in period `tick`, at this measured speed and angle."""
    def reset(self) -> None:
        """Leave STOP and forget the old plan."""
    @property
    def mode(self) -> Literal["normal", "tail", "stop", "waiting"]:
        """Where the last command came from."""

# parameters.rs

GRAVITY: float
"""Gravity of all vehicle models, m/s²."""

STANDARD_GRAVITY: float
"""Standard gravity, m/s²: that of speed profiles, and the unit "g" of logs."""

@final
class VehicleParameters:
    """What one vehicle is and what its actuators may be asked for; all positive but `a_min`."""

    def __new__(
        cls,
        *,
        mass: float,
        yaw_inertia: float,
        l_f: float,
        l_r: float,
        width: float,
        a_min: float,
        a_max: float,
        power: float,
        a_slew: float,
        steering_angle: float,
        steering_rate: float,
        steering_slew: float,
        peak_slip: float,
        lateral_grip: float,
        braking_grip: float,
        driving_grip: float,
    ) -> VehicleParameters:
        """Take over the values.

        Raises `EgpError` naming the field that is missing, unknown or out of range.
        """

    @staticmethod
    def commonroad(number: int) -> VehicleParameters:
        """Give the vehicle of this CommonRoad number: 1 a Ford Escort, 2 a BMW 320i.

        Raises `EgpError` for any other number.
        """

    def fields(self) -> dict[str, float]:
        """All values by their name."""

    def gate_limits(self) -> dict[str, float]:
        """Give the limits of a gate that lets through what this vehicle can do, and no more."""

    def check_same(self, planned: VehicleParameters) -> None:
        """Raise `EgpError` with both values unless all are within 1 % of those of `planned`."""

    @property
    def mass(self) -> float:
        """Mass, kg."""

    @property
    def yaw_inertia(self) -> float:
        """Moment of inertia about the vertical axis, kg m²."""

    @property
    def l_f(self) -> float:
        """Distance from the centre of mass to the front axle, m."""

    @property
    def l_r(self) -> float:
        """Distance from the centre of mass to the rear axle, m."""

    @property
    def width(self) -> float:
        """Width without mirrors, m."""

    @property
    def a_min(self) -> float:
        """Strongest braking `F_x / mass`, m/s², negative."""

    @property
    def a_max(self) -> float:
        """Strongest drive `F_x / mass`, m/s²."""

    @property
    def power(self) -> float:
        """Drive power per mass, W/kg."""

    @property
    def a_slew(self) -> float:
        """Largest change of `F_x / mass` per second, m/s³."""

    @property
    def steering_angle(self) -> float:
        """Largest steering angle, rad."""

    @property
    def steering_rate(self) -> float:
        """Largest steering rate, rad/s."""

    @property
    def steering_slew(self) -> float:
        """Largest change of the steering rate per second, rad/s²."""

    @property
    def peak_slip(self) -> float:
        """Slip angle at which the front tyres' force peaks on friction 1, rad."""

    @property
    def lateral_grip(self) -> float:
        """Reachable lateral acceleration as a share of mu g."""

    @property
    def braking_grip(self) -> float:
        """Reachable deceleration as a share of mu g."""

    @property
    def driving_grip(self) -> float:
        """Reachable acceleration as a share of mu g."""

# path.rs

@final
class Path:
    """A curve by arc length `s` in m, with distances to the track's edges and zones of friction.

    Closed paths wrap at their length; open ones go straight on beyond their ends. SI units, yaw
    counter-clockwise from +x, lateral errors positive to the left.
    """

    @staticmethod
    def from_points(
        points: NDArray[np.float64], closed: bool, widths: NDArray[np.float64] | None = None
    ) -> Path:
        """Make a smooth path through points (n, 2), with `[left, right]` widths (n, 2) at them."""

    @staticmethod
    def rounded_rectangle(
        length: float = 120.0,
        width: float = 60.0,
        radius: float = 15.0,
        transition: float = 10.0,
        track_width: float = 7.0,
    ) -> Path:
        """Make a counter-clockwise lap from the middle of the lower side, which starts along +x.

        Corners are arcs between clothoids of length `transition`.
        """

    @staticmethod
    def l_shape(
        length: float = 130.0,
        width: float = 110.0,
        arm: float = 50.0,
        radius: float = 15.0,
        transition: float = 10.0,
        track_width: float = 7.0,
    ) -> Path:
        """Make a closed L with arms of width `arm`: five left turns and a right one."""

    @staticmethod
    def iso_3888_2(
        vehicle_width: float,
        margin: float = 0.1,
        lead_in: float = 40.0,
        lead_out: float = 40.0,
    ) -> Path:
        """Make the severe double lane change of ISO 3888-2, with a drivable path inside the cones.

        Widths reach to the cones, which start after `lead_in`; `margin` is what the path keeps
        between them and the vehicle's sides.
        """

    @staticmethod
    def lane_changes(
        length: float = 500.0,
        offset: float = 2.5,
        transition: float = 30.0,
        hold: float = 20.0,
        track_width: float = 7.0,
    ) -> Path:
        """Make a straight road on which one changes lanes to the left and back, over and over."""

    @staticmethod
    def random(
        seed: int, length: float = 500.0, min_radius: float = 15.0, track_width: float = 7.0
    ) -> Path:
        """Make a closed track from a seed: no crossing, no turn tighter than `min_radius`."""

    @staticmethod
    def from_csv(file: str | PathLike[str], scale: float = 1.0) -> Path:
        """Read a closed track: a raceline (columns by `;`) or a centre line (columns by `,`).

        `s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2` has no widths, and its psi must fit
        the positions, from +x or from +y; `x_m,y_m,w_tr_right_m,w_tr_left_m` has widths. Lengths
        are multiplied by `scale`, 10 for a track of 1:10 cars.
        """

    def with_friction(
        self, zones: Sequence[tuple[float, _Surface] | tuple[float, _Surface, _Surface]]
    ) -> Path:
        """Give the same path zones, from 0 on: start as a fraction of the length, surface.

        The third member of a tuple is the surface right of the path; the second is then that of the
        left side alone. `surface_friction` describes surfaces.
        """

    @property
    def length(self) -> float:
        """In m, of one lap when closed."""

    @property
    def closed(self) -> bool:
        """Whether the end joins the start."""

    def project(self, position: NDArray[np.float64], hint: float | None = None) -> Projection:
        """Where a position `[x, y]` stands: nearest of all, or nearest downhill from `hint`.

        With the last `s` as hint it stays on its branch where the path nears itself.
        """

    def sample(
        self, s: NDArray[np.float64]
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
    ]:
        """x, y, yaw, curvature, left, right, friction at arc lengths (n,), each (n,).

        Yaw lies in (-pi, pi]; left and right are infinite on a path without widths.
        """

@final
class Projection:
    """Where a position stands relative to a path, and the path at its nearest point."""

    @property
    def s(self) -> float:
        """Arc length of the nearest point; beyond an open path's ends on its extensions."""
    @property
    def lateral(self) -> float:
        """Signed distance from the path, positive to its left."""
    @property
    def x(self) -> float:
        """The path's nearest point."""
    @property
    def y(self) -> float:
        """The path's nearest point."""
    @property
    def yaw(self) -> float:
        """The path's direction, in (-pi, pi]."""
    @property
    def curvature(self) -> float:
        """In 1/m, positive in left turns."""
    @property
    def left(self) -> float:
        """Distance from the path to the left edge; infinite without widths."""
    @property
    def right(self) -> float:
        """Distance from the path to the right edge; infinite without widths."""
    @property
    def friction(self) -> float:
        """Friction coefficient."""

@final
class SpeedProfile:
    """The fastest speed along a path within `grip` (a fraction) of the friction ellipse.

    What is reached of the friction, and the strongest braking and drive, are those of `vehicle`.
    `v_max` and the start and end speed of an open path are in m/s; the latter default to the
    fastest.
    """

    def __new__(
        cls,
        path: Path,
        vehicle: VehicleParameters,
        grip: float = 0.8,
        v_max: float = 30.0,
        *,
        start_speed: float | None = None,
        end_speed: float | None = None,
    ) -> SpeedProfile: ...
    @staticmethod
    def constant(path: Path, speed: float) -> SpeedProfile:
        """One speed everywhere."""

    @property
    def lap_time(self) -> float:
        """Seconds for the lap, or from start to end."""

    def speed(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Speed at arc lengths (n,)."""

def horizon_reference(
    path: Path,
    profile: SpeedProfile,
    x: NDArray[np.float64],
    dt: float,
    horizon: int,
    hint: float | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, Projection]:
    """Give reference rows `[p_x, p_y, v_x, psi]` (horizon + 1, 4), widths and projection.

    `x` is the vehicle's state (7,). Rows follow the profile by time from the vehicle's projection;
    yaw is unwrapped relative to the vehicle's. Widths `[left, right]` (horizon + 1, 2) are None for
    a path without.
    Pass the last projection's `s` as `hint`.
    """

# plant.rs

@final
class Plant:
    """A simulated vehicle: the 29-state multi-body vehicle of the CommonRoad benchmarks.

    `vehicle` is its CommonRoad number: 1 a Ford Escort, 2 a BMW 320i. Starts at rest in the origin.
    `disturbances` are those of `egp_service.simulation.scenario.Disturbances` by name, 0 unless
    stated. Raises `EgpError` if a name is unknown or a value out of its range.
    """

    def __new__(
        cls, vehicle: int = 1, disturbances: Mapping[str, float] | None = None
    ) -> Plant: ...
    def reset(
        self,
        x: float,
        y: float,
        yaw: float,
        v: float,
        yaw_rate: float = 0.0,
        v_y: float = 0.0,
        delta: float = 0.0,
    ) -> None:
        """Put the vehicle somewhere at forward speed `v >= 0`, its suspension at rest."""

    def step(
        self,
        u: NDArray[np.float64],
        dt: float,
        friction: _Surface | FrictionMap | Path,
        hint: float | None = None,
    ) -> None:
        """Drive `dt` seconds under the constant input `u = [F_x, delta_dot]` (N, rad/s).

        The surface is the same everywhere, or that of the map's cell or of the path's zone under
        each wheel. On a path the wheels are sought as by `Path.project`: pass the last
        projection's `s` as `hint`, or the whole path is searched in every call.

        Raises `EgpError` for refused input and when the vehicle has spun, and keeps the state then.
        """

    @property
    def state(self) -> NDArray[np.float64]:
        """All 29 states in the order of CommonRoad's multi-body vehicle."""

    @state.setter
    def state(self, value: NDArray[np.float64]) -> None: ...
    @property
    def vehicle_state(self) -> NDArray[np.float64]:
        """What a controller sees: `[p_x, p_y, v_x, psi, v_y, omega, delta]`, SI units."""

    @property
    def parameters(self) -> VehicleParameters:
        """What a controller of this vehicle knows about it."""

    @property
    def mass(self) -> float:
        """In kg, to the last digit of the simulated vehicle."""

    @property
    def lateral_acceleration(self) -> float:
        """Lateral acceleration of the body in m/s²."""

def plant_derivative(
    state: NDArray[np.float64],
    u: NDArray[np.float64],
    friction: float | NDArray[np.float64],
    vehicle: int = 1,
) -> NDArray[np.float64]:
    """Right-hand side of the 29 differential equations.

    `friction` is one coefficient or four: front -y, front +y, rear -y, rear +y, with y to the left.
    """

def plant_initial_states(
    vehicle_states: NDArray[np.float64], vehicle: int = 1
) -> NDArray[np.float64]:
    """Full states (n, 29) for `[p_x, p_y, v_x, psi, v_y, omega, delta]` rows (n, 7)."""

def plant_step_batch(
    states: NDArray[np.float64],
    u: NDArray[np.float64],
    dt: float,
    friction: NDArray[np.float64] | _Surface,
    vehicle: int = 1,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Drive n vehicles `dt` seconds on all cores without the GIL.

    States (n, 29), inputs (n, 2), friction (n,) or one surface for all. Returns the new states and
    which vehicles completed the period; one that spun keeps its state.
    """

# surface.rs

# A surface: a friction coefficient, the name of a preset, or a table of factors.
_Surface: TypeAlias = float | str | Mapping[str, float]

def surface_friction(surface: _Surface) -> float:
    """Friction coefficient of a surface: the ratio of its longitudinal peak force to the load.

    A surface is this number alone, a preset (`dry`, `wet`, `snow`, `ice`), or a table with `peak`
    and factors on the tyre's `stiffness`, `shape` and `curvature`, all 1 unless stated. The lateral
    force has a peak of `0.9 peak` and the same factors, unless `lateral_peak`, `lateral_stiffness`,
    `lateral_shape` or `lateral_curvature` say otherwise.

    Raises `EgpError` if a name is unknown or a value out of its range.
    """

@final
class FrictionMap:
    """Friction coefficients `values` (rows along +y, columns along +x) in square cells.

    `origin` is the lower left corner of the grid, `cell` a cell's side in m. The border
    continues outside.
    """

    def __new__(
        cls, values: NDArray[np.float64], origin: tuple[float, float], cell: float
    ) -> FrictionMap: ...

# library.rs

class LibraryError(EgpError):
    """A refused library file; `code` names the kind of refusal, the message what to do next."""

    code: str

@final
class Library:
    """A verified library: one member for each surface, never changing after it was loaded."""

    @staticmethod
    def load(path: str | PathLike[str]) -> Library:
        """Read, verify and factor a library file.

        Raises `LibraryError` for a file that fails a check, `OSError` for one that cannot be read.
        """

    @property
    def id(self) -> str:
        """SHA-256 of the file, hexadecimal; requests pin it."""

    @property
    def dt(self) -> float:
        """Period over which the outputs change, s."""

    @property
    def kernel(self) -> str:
        """Name of the kernel, "rbf" or "matern52"."""

    @property
    def vehicle(self) -> str:
        """Name of the vehicle that the data come from."""

    @property
    def parameters(self) -> VehicleParameters:
        """That vehicle's parameters."""

    @property
    def provenance(self) -> dict[str, str]:
        """How the library was made: versions, settings, seeds."""

    @property
    def members(self) -> list[Member]:
        """The members, in the order of the weights."""

    def predict(
        self, z: NDArray[np.float64], member: int = 0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Predict with one member at GP inputs `z` (n, 6), all in physical units.

        Returns the mean (n, 3), its Jacobian (n, 3, 6) and the variance of the latent function,
        measurement noise not included, (n, 3).

        >>> import numpy as np
        >>> from egp_service._core import Library
        >>> from egp_service.simulation.scenario import library_path, load_scenario
        >>> library = Library.load(library_path(load_scenario("rounded-rectangle")))
        >>> z = np.array([[15.0, 0.1, 0.2, 0.03, 500.0, 0.0]])
        >>> mean, jacobian, variance = library.predict(z)
        >>> step = np.array([[0.0, 0.0, 0.0, 1e-5, 0.0, 0.0]])
        >>> slope = (library.predict(z + step)[0] - library.predict(z - step)[0]) / 2e-5
        >>> bool(np.allclose(jacobian[:, :, 3], slope)), bool((variance > 0.0).all())
        (True, True)
        """

@final
class Member:
    """One surface's GPs inside a library; hyperparameters live in the z-scored space."""

    @property
    def label(self) -> str:
        """The surface's name."""

    @property
    def friction(self) -> float:
        """Nominal friction coefficient of the surface; scales the step's bound on slip."""

    @property
    def dataset(self) -> str:
        """SHA-256 of the dataset the member was trained on."""

    @property
    def n_points(self) -> int:
        """Number of training points."""

    @property
    def envelope(self) -> NDArray[np.float64]:
        """Smallest and largest training inputs (2, 6), physical units."""

    @property
    def lengthscales(self) -> NDArray[np.float64]:
        """Lengthscales of each output (3, 6)."""

    @property
    def outputscale(self) -> NDArray[np.float64]:
        """Prior variances (3,)."""

    @property
    def noise(self) -> NDArray[np.float64]:
        """Noise variances (3,)."""

    @property
    def constant(self) -> NDArray[np.float64]:
        """Prior means (3,)."""

    @property
    def noise_std(self) -> NDArray[np.float64]:
        """Standard deviations of the targets' noise (3,), output units."""

    @property
    def single_track(self) -> NDArray[np.float64] | None:
        """Parameters (17,) of the vehicle that the GPs are added to; None for constants alone.

        m, l_f, l_r, k^2 (radius of gyration), h in kg and m; longitudinal grip D_x under drive and
        braking; of the front tyres, then of the rear ones, the coupling e under drive and braking,
        friction D, stiffness B and shape C.
        """

# library_writer.rs

@final
class MemberData:
    """One surface's GPs on their way into a file; M points, G golden points.

    Inputs, targets, scalers, envelope and golden predictions are in physical units, everything else
    in the z-scored space: `alpha = (K + noise I)^-1 (y - constant)` with z-scored `y`. The golden
    arrays hold what the trainer's own implementation predicts; loading must reproduce them. A few
    points inside the data and a few far outside will do.
    """

    def __new__(
        cls,
        *,
        label: str,
        friction: float,
        dataset: str,
        inputs: NDArray[np.float64],
        targets: NDArray[np.float64],
        input_mean: NDArray[np.float64],
        input_std: NDArray[np.float64],
        target_mean: NDArray[np.float64],
        target_std: NDArray[np.float64],
        lengthscales: NDArray[np.float64],
        outputscale: NDArray[np.float64],
        noise: NDArray[np.float64],
        constant: NDArray[np.float64],
        alpha: NDArray[np.float64],
        envelope: NDArray[np.float64],
        golden_z: NDArray[np.float64],
        golden_mean: NDArray[np.float64],
        golden_jacobian: NDArray[np.float64],
        golden_variance: NDArray[np.float64],
        single_track: NDArray[np.float64] | None = None,
    ) -> MemberData:
        """Take over the arrays.

        Shapes: inputs (M, 6), targets (M, 3), input_mean and input_std (6,), target_mean and
        target_std (3,), lengthscales (3, 6), outputscale, noise and constant (3,), alpha (3, M),
        envelope (2, 6), golden_z (G, 6), golden_mean (G, 3), golden_jacobian (G, 3, 6),
        golden_variance (G, 3); `single_track` (17,) as in `Member`, with which targets and golden
        arrays include that vehicle's part and `y` is the rest of the targets.
        """

def write_library(
    path: str | PathLike[str],
    *,
    dt: float,
    kernel: str,
    vehicle: str,
    parameters: VehicleParameters,
    members: Sequence[MemberData],
    provenance: Mapping[str, str],
) -> None:
    """Write a library file, all of it or nothing, after verifying that it can be loaded.

    `dt` in s, `kernel` "rbf" or "matern52"; `vehicle` and `parameters` are name and parameters of
    the vehicle that the data come from. The same arguments give the same bytes.
    Raises `LibraryError` for content that fails a check, `OSError` when writing fails.
    """

def write_library_subset(
    source: str | PathLike[str], path: str | PathLike[str], members: Sequence[int]
) -> None:
    """Write a library of some of another one's members (by index), bit for bit the same GPs.

    A member taken more than once gets a number behind its label. Raises `LibraryError` when there
    is no such member, `OSError` when reading or writing fails.
    """

# problem.rs

@final
class OcpWeights:
    """Quadratic cost of `solve_ocp`; every term is `1/2 weight * error^2`.

    q (T, 7, 7) on the error of the state after each input: symmetric, a block for the position and
    a diagonal. Diagonals r (2,) on inputs, positive, and r_d (2,) on their changes, the first from
    `u_prev`. Without its axis T, q holds for all stages.
    """

    def __new__(cls, *, q: ArrayLike, r: ArrayLike, r_d: ArrayLike) -> OcpWeights: ...

@final
class OcpBounds:
    """Bounds of `solve_ocp`, all finite.

    Hard ones, (T, 2): u_min, u_max on inputs and du_min, du_max on their changes. Soft ones on n <=
    5 rows: `soft_lower <= soft_normal x <= soft_upper`, (T, n), (T, n, 7), (T, n), where penalty
    (n, 2), positive, is the price `linear * s + 1/2 quadratic * s^2` of a violation s. The first
    row may involve v_x, the second delta, the third p_x and p_y, the fourth v_y, the fifth omega;
    a row of zeros is none. Arrays without their axis T hold for all stages.
    """

    def __new__(
        cls,
        *,
        u_min: ArrayLike,
        u_max: ArrayLike,
        du_min: ArrayLike,
        du_max: ArrayLike,
        soft_normal: ArrayLike | None = None,
        soft_lower: ArrayLike | None = None,
        soft_upper: ArrayLike | None = None,
        penalty: ArrayLike | None = None,
    ) -> OcpBounds: ...

# ocp.rs

def ocp_to_qp(
    A: ArrayLike,
    B: ArrayLike,
    c: ArrayLike,
    x0: ArrayLike,
    u_prev: ArrayLike,
    reference: ArrayLike,
    weights: OcpWeights,
    bounds: OcpBounds,
) -> tuple[
    tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]],
    NDArray[np.float64],
    tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]],
    NDArray[np.float64],
    NDArray[np.float64],
]:
    """Write an optimal control problem as `min 1/2 z'Pz + q'z` subject to `l <= Az <= u`.

    Returns P (upper triangle), q, A, l, u; matrices as (values, row indices, column starts). `z`
    holds, stage by stage, `u_t`, `x_{t+1} - reference_{t+1}` and the slacks. Arguments as of
    `solve_ocp`.
    """

@final
class OcpResult:
    """What became of an optimal control problem."""

    @property
    def status(self) -> str:
        """One of "solved", "iteration_limit", "infeasible", "numerical_error", "check_failed"."""
    @property
    def x(self) -> NDArray[np.float64]:
        """States (T+1, 7)."""
    @property
    def u(self) -> NDArray[np.float64]:
        """Scaled inputs (T, 2)."""
    @property
    def iterations(self) -> int:
        """Iterations of the solver that had the last word."""
    @property
    def kkt_residual(self) -> float:
        """Largest residual of the optimality conditions."""
    @property
    def solver(self) -> str:
        """The solver that had the last word."""
    @property
    def seconds(self) -> float:
        """Shortest time of all repetitions, our check included, Python excluded."""

def solve_ocp(
    A: ArrayLike,
    B: ArrayLike,
    c: ArrayLike,
    x0: ArrayLike,
    u_prev: ArrayLike,
    reference: ArrayLike,
    weights: OcpWeights,
    bounds: OcpBounds,
    *,
    solver: Literal["riccati", "clarabel"] = "riccati",
    guess: ArrayLike | None = None,
    repeat: int = 1,
) -> OcpResult:
    """Solve a linear time-varying optimal control problem, eq. (18).

    Of x_{t+1} = A_t x_t + B_t u_t + c_t, t = 0..T-1, with states [p_x, p_y, v_x, psi, v_y, omega,
    delta] and inputs [acceleration, steering rate]: A (T, 7, 7), B (T, 7, 2), c (T, 7), measured
    state x0 (7,), input now applied u_prev (2,), and reference (T, 7) of x_1..x_T. Arrays of
    problem, weights and bounds without their axis T hold for all stages, except A.

    Entries may be different from zero where the vehicle's equations have them, eq. (11) with
    positions along the yaw of any moment of the period: position rows of A at themselves, v_x, psi,
    v_y and omega; yaw at itself and omega; v_x, v_y and omega at each other and delta; delta at
    itself; rows v_x, v_y and omega of B, and delta's at the steering rate.

    `solver` is asked first; when its answer fails our check, "riccati" is followed by "clarabel".
    `guess` (T, 2) holds inputs to start from, such as those of the last plan, shifted. `repeat`
    solves so many times, to measure `seconds`; each solve starts from nothing but the arguments.
    Raises `EgpError` for a wrong shape, numbers that are not finite, or bounds that cross.

    Drive 1 m/s faster within a second, on a straight:

    >>> import numpy as np
    >>> from egp_service._core import OcpBounds, OcpWeights, solve_ocp
    >>> dt, T = 0.05, 20
    >>> A = np.tile(np.eye(7), (T, 1, 1))
    >>> A[:, 0, 2] = A[:, 1, 4] = A[:, 3, 5] = dt
    >>> B = np.zeros((7, 2))
    >>> B[2, 0] = B[6, 1] = dt
    >>> weights = OcpWeights(q=np.diag([0, 0, 10, 0, 0, 0, 0]), r=[0.05, 2], r_d=[0.05, 5])
    >>> bounds = OcpBounds(u_min=[-8, -0.4], u_max=[2, 0.4], du_min=[-1, -0.4], du_max=[1, 0.4])
    >>> x0, reference = [0, 0, 10, 0, 0, 0, 0], [0, 0, 11, 0, 0, 0, 0]
    >>> result = solve_ocp(A, B, np.zeros(7), x0, [0, 0], reference, weights, bounds)
    >>> result.status, result.kkt_residual < 1e-6
    ('solved', True)
    >>> np.abs(result.u[:4, 0].round(6)).tolist(), result.x.shape
    ([1.0, 2.0, 2.0, 2.0], (21, 7))
    >>> oracle = solve_ocp(
    ...     A, B, np.zeros(7), x0, [0, 0], reference, weights, bounds, solver="clarabel"
    ... )
    >>> bool(np.abs(result.u - oracle.u).max() < 1e-6)
    True
    """

@final
class AffineOcp:
    """The control step's optimal control problem, eq. (18), around dynamics of any origin.

    `settings_toml` holds the settings of a control step, over those of `vehicle`; `dt` is the
    period in s, `friction` the surface's coefficient. Cost, bounds and solvers are those of the
    step.

    Raises `EgpError` for settings out of range, and a period or friction that is not a positive
    number.
    """

    def __new__(
        cls, settings_toml: str, vehicle: VehicleParameters, dt: float, friction: float
    ) -> AffineOcp: ...
    def solve(
        self,
        x0: NDArray[np.float64],
        u_prev: NDArray[np.float64],
        operating_x: NDArray[np.float64],
        operating_u: NDArray[np.float64],
        a: NDArray[np.float64],
        b: NDArray[np.float64],
        c: NDArray[np.float64],
        reference: NDArray[np.float64],
        widths: NDArray[np.float64] | None = None,
    ) -> OcpResult:
        """Solve for x_{t+1} = A x_t + B u_t + c, positions and yaw relative to the vehicle's place.

        Measured state x0 (7,), input now applied u_prev (2,), operating trajectory (T+1, 7) and
        (T, 2), a (T, 7, 7), b (T, 7, 2), c (T, 7), reference rows [p_x, p_y, v_x, psi] (T+1, 4) and
        widths [left, right] (T+1, 2); forces in N. The result's inputs are scaled to accelerations.
        """

def solve_weights(
    predictions: NDArray[np.float64],
    measured: NDArray[np.float64],
    noise_std: NDArray[np.float64],
    previous: NDArray[np.float64],
    prior: Literal["quadratic", "l1"],
    strength: float,
    measurement_std: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Solve for the weights (N,), eq. (6).

    Minimises the squared errors of predictions (k, N, 3) against measured (k, 3), whitened, plus
    `strength` times the squared or absolute distance from the previous weights (N,), on the
    simplex. noise_std (3,) is the standard deviation of the predictions' own noise. With
    measurement_std (3,), that of the measured states, the k transitions have to be consecutive:
    an output's errors then have the covariance noise_std² + 2 measurement_std², and neighbours
    -measurement_std². `EgpError` for shapes that differ and numbers that make no sense.

    Measured halfway between what two members predict:

    >>> import numpy as np
    >>> from egp_service._core import solve_weights
    >>> predictions = np.array([[[0.1, 0.0, 0.0], [0.3, 0.0, 0.0]]])
    >>> measured = np.array([[0.2, 0.0, 0.0]])
    >>> solve_weights(
    ...     predictions, measured, np.full(3, 0.01), np.array([0.9, 0.1]), "quadratic", 1e-6
    ... ).round(4).tolist()
    [0.5, 0.5]
    """

# service.rs

@final
class Engine:
    """The control step of the service, in-process: the same bytes in, the same bytes out.

    `settings_toml` holds the settings of the control step; fields left out keep their default,
    which for the horizon is 0.8 s of the library's periods and for the window 0.5 s. With more than
    one of `cores` (no more than the machine has), members are evaluated at once where there is half
    a millisecond of them: standard deviations of four active members of 700 points, for example,
    not of two. The bytes of a reply do not depend on it. Such an engine does not survive a fork:
    its threads stay behind.
    """

    def __new__(
        cls, library_path: str | PathLike[str], settings_toml: str = "", *, cores: int = 1
    ) -> Engine: ...
    def step(self, request: bytes) -> bytes:
        """Answer one request, without the GIL; `RefusedError` begins with the code of the error."""
    @property
    def dt(self) -> float:
        """Control period in s."""
    @property
    def horizon(self) -> int:
        """Inputs in a plan, T."""
    @property
    def history(self) -> int:
        """Transitions worth carrying, K."""
    @property
    def library_id(self) -> bytes:
        """SHA-256 of the library file."""
    @property
    def members(self) -> list[str]:
        """Surfaces, in the order of the weights."""
    @property
    def ready(self) -> bytes:
        """Bytes of the Ready message that a replica with this engine would answer."""
    @property
    def vehicle(self) -> VehicleParameters:
        """The library's vehicle, with the settings' mass, axles and tyres in place of its own."""
    @property
    def settings_toml(self) -> str:
        """All settings, defaults included."""

@final
class InProcessDriver:
    """A `Driver` whose answers an engine of this process computes."""

    def __new__(
        cls, engine: Engine, *, gate: Mapping[str, float], want_sigma: bool = False
    ) -> InProcessDriver: ...
    def step(
        self,
        budget: float,
        x: NDArray[np.float64],
        reference: NDArray[np.float64],
        widths: NDArray[np.float64] | None = None,
    ) -> Decision:
        """Decide one control period; see `Driver.tick`. `budget` is only stated in the request."""
    @property
    def budget(self) -> float:
        """Seconds that requests state unless a period has its own."""
    @property
    def mode(self) -> Literal["normal", "tail", "stop", "waiting"]:
        """Where the last command came from."""
    @property
    def weights(self) -> NDArray[np.float64]:
        """Weights of the newest reply (N,); empty before the first."""
    def start_from(self, weights: NDArray[np.float64]) -> None:
        """Start the next request from these weights instead of the last reply's."""
    def hold_weights(self, weights: NDArray[np.float64]) -> None:
        """Start the next request from these weights and carry no history from now on."""
    def reset(self) -> None:
        """Leave STOP and forget history, weights and plan."""

@final
class Server:
    """A service that runs in this process until it is stopped; a context manager.

    `config_toml` is what `egp-server --config` reads; relative paths count from the working folder.
    """

    def __new__(cls, config_toml: str) -> Server: ...
    def stop(self) -> None:
        """Withdraw the announcement, answer what waits, close."""
    def __enter__(self) -> Self: ...
    def __exit__(self, *_exception: object) -> None: ...

def serve(config_toml: str) -> None:
    """Serve until SIGTERM or Ctrl-C, then drain; the same as `egp-server --config`."""

# wire.rs

LIVE_KEYS: str
"""Key expression of the liveliness tokens of all replicas."""

@final
class Request:
    """A validated request; fields as in the .proto, absent ones have no rows."""

    @property
    def library(self) -> bytes: ...
    @property
    def sequence(self) -> int: ...
    @property
    def budget_us(self) -> int: ...
    @property
    def x(self) -> NDArray[np.float64]: ...
    @property
    def u_prev(self) -> NDArray[np.float64]: ...
    @property
    def weights(self) -> NDArray[np.float64]: ...
    @property
    def plan_x(self) -> NDArray[np.float64]: ...
    @property
    def plan_u(self) -> NDArray[np.float64]: ...
    @property
    def plan_shift(self) -> int: ...
    @property
    def history_z(self) -> NDArray[np.float64]: ...
    @property
    def history_y(self) -> NDArray[np.float64]: ...
    @property
    def history_f(self) -> NDArray[np.float64]: ...
    @property
    def reference(self) -> NDArray[np.float64]: ...
    @property
    def widths(self) -> NDArray[np.float64]: ...
    @property
    def want_sigma(self) -> bool: ...

@final
class Reply:
    """A validated reply; fields as in the .proto, absent ones have no rows."""

    @property
    def library(self) -> bytes: ...
    @property
    def sequence(self) -> int: ...
    @property
    def status(
        self,
    ) -> Literal["solved", "iteration_limit", "infeasible", "numerical_error", "check_failed"]:
        """Only "solved" comes with a plan."""
    @property
    def plan_x(self) -> NDArray[np.float64]: ...
    @property
    def plan_u(self) -> NDArray[np.float64]: ...
    @property
    def weights(self) -> NDArray[np.float64]: ...
    @property
    def sigma(self) -> NDArray[np.float64]: ...
    @property
    def history_f(self) -> NDArray[np.float64]: ...
    @property
    def dropped_mass(self) -> float: ...
    @property
    def iterations(self) -> int: ...
    @property
    def kkt_residual(self) -> float: ...
    @property
    def solver(self) -> str: ...

@final
class Refusal:
    """An error reply of the service."""

    @property
    def code(
        self,
    ) -> Literal[
        "unspecified",
        "malformed",
        "version",
        "invalid_field",
        "unknown_library",
        "overloaded",
        "superseded",
        "too_late",
        "draining",
        "internal",
    ]:
        """What kind of error; "unspecified" when this version does not know it."""
    @property
    def retryable(self) -> bool:
        """Whether another attempt, here or at another replica, may succeed."""
    @property
    def retry_after_us(self) -> int:
        """How long to wait before that, microseconds."""
    @property
    def field(self) -> str:
        """The field at fault, or nothing."""
    @property
    def detail(self) -> str:
        """What was expected, what came, what to try."""

@final
class Ready:
    """What a replica serves."""

    @property
    def ready(self) -> bool:
        """False while it drains."""
    @property
    def library(self) -> bytes:
        """SHA-256 of its library file."""
    @property
    def dt(self) -> float:
        """Control period in s."""
    @property
    def horizon(self) -> int:
        """Inputs in a plan, T."""
    @property
    def history(self) -> int:
        """Transitions worth carrying, K."""
    @property
    def members(self) -> list[str]:
        """Surfaces, in the order of the weights."""
    @property
    def envelope(self) -> list[list[float]]:
        """Smallest and largest GP input [v_x, v_y, omega, delta, F_x, delta_dot] trained on."""
    @property
    def vehicle(self) -> VehicleParameters | None:
        """The vehicle that plans are made for; None from services that do not say."""

def decode_request(data: bytes) -> Request:
    """Read and validate a StepRequest; `EgpError` names the field at fault."""

def decode_reply(data: bytes) -> Reply:
    """Read and validate a StepReply; `EgpError` names the field at fault."""

def decode_error(data: bytes) -> Refusal:
    """Read an Error."""

def decode_ready(data: bytes) -> Ready:
    """Read and validate a Ready."""

def decode_timing(data: bytes) -> tuple[int, int]:
    """Read a Timing: microseconds in the queue and in the step."""

def encode_plant_truth(
    *,
    time: float,
    state: NDArray[np.float64],
    u: Sequence[float],
    friction: float,
    path_s: float,
    lateral_error: float,
    heading_error: float,
    speed_reference: float,
    mode: str,
    weights: Sequence[float] | NDArray[np.float64],
) -> bytes:
    """Bytes of a PlantTruth for a recording; `state` is [p_x, p_y, v_x, psi, v_y, omega, delta]."""

def file_descriptor_set() -> bytes:
    """Give the serialised google.protobuf.FileDescriptorSet of the messages."""

def step_key(replica: str, fleet: str, vehicle: str) -> str:
    """Where a vehicle asks a replica for a control step."""

def ready_key(replica: str) -> str:
    """Where a replica answers what it serves."""

def health_key(replica: str) -> str:
    """Where a replica answers whether it is alive."""

def metrics_key(replica: str) -> str:
    """Where a replica answers its OpenMetrics text."""

def live_key(replica: str) -> str:
    """Liveliness token of a replica."""

def replica_of_live(key: str) -> str | None:
    """Name of the replica a liveliness token belongs to."""
