"""The parameters of a vehicle, and gravity."""

from typing import final

GRAVITY: float  # of all vehicle models, m/s²
FULL_SIZE: float  # distance of the axles in m from which on `slip_speed` is `MIN_SLIP_SPEED`
MIN_SLIP_SPEED: float  # m/s
STANDARD_GRAVITY: float  # of speed profiles, and the unit "g" of logs, m/s²

def slip_speed(wheelbase: float) -> float:
    """Return the lowest speed, m/s, at which slip angles are computed: 3 sqrt(min(1, L / 2 m)).

    L is the distance of the axles.
    """

@final
class VehicleParameters:
    """The body of one vehicle, the limits of its actuators, and its tyres.

    All fields are required keywords and positive, except `a_min`, which is negative.

    Raises:
        InvalidArgumentError: naming the field that is missing, unknown or outside `ranges()`, as
            a value in another unit is; also if the yaw inertia is not 0.05 to 20 times
            `mass l_f l_r`.

    """

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
    ) -> VehicleParameters: ...
    @staticmethod
    def commonroad(number: int) -> VehicleParameters:
        """Return the vehicle of this CommonRoad number: 1 is a Ford Escort, 2 is a BMW 320i.

        Raises:
            InvalidArgumentError: for any other number.
            OverflowError: for a negative number or one above 2³² - 1.

        """
    @staticmethod
    def ranges() -> dict[str, tuple[float, float]]:
        """Return the smallest and the largest value of each field: model cars to lorries."""
    def fields(self) -> dict[str, float]:
        """Return all values by the names of the arguments, in their units."""
    @property
    def scale(self) -> float:
        """Size relative to a full-size vehicle: (l_f + l_r) / 2 m, at most 1.

        On the same surfaces vehicles of similar shape have the same accelerations. Their lengths
        are proportional to the scale, times and speeds to its square root (Froude's law). Defaults
        that are lengths, speeds or weights of such quantities follow it.
        """
    @property
    def slip_speed(self) -> float:
        """Lowest speed, m/s, at which slip angles of this vehicle are computed."""
    def gate_limits(self) -> dict[str, float]:
        """Return the limits of a gate that allows exactly what this vehicle can do.

        Keys and units are those of docs/settings.md, section 4.
        """
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, float]]: ...
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
        """Slip angle at which the front tyres' force peaks on friction 1, rad.

        It bounds the slip on surfaces whose member has no fitted tyres, times their friction.
        """
    @property
    def lateral_grip(self) -> float:
        """Reachable lateral acceleration as a share of mu g."""
    @property
    def braking_grip(self) -> float:
        """Reachable deceleration as a share of mu g."""
    @property
    def driving_grip(self) -> float:
        """Reachable acceleration as a share of mu g."""
