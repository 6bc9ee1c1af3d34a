//! The vehicles of the CommonRoad benchmarks.

use crate::VehicleParameters;

impl VehicleParameters {
    /// CommonRoad vehicle 1, a Ford Escort with front-wheel drive.
    ///
    /// - `mass`, `yaw_inertia`, `width`, `steering_angle` and `steering_rate` are those of
    ///   `commonroad-vehicle-models` 3.0.2 (`parameters_vehicle1.yaml`), rounded.
    /// - `l_f` and `l_r` are 0.88392 m and 1.50876 m there, here rounded to 0.1 m: the published results were measured
    ///   with a bound on the front tyres' slip that takes 0.9 m.
    /// - `a_min` and `a_max` lie inside the 11.5 m/s² of the same file, within what its tyres reach; `power` is
    ///   11.5 m/s² times the switching speed of 4.755 m/s.
    /// - `a_slew` and `steering_slew` are choices: 3 m/s² and 0.4 rad/s in 50 ms, as in the prototype.
    /// - `peak_slip` is just below the slip of 0.128 rad at which the lateral force of the CommonRoad tyre peaks.
    /// - The three grips were measured with the multi-body vehicle: at 15 m/s it turned with 9.5 m/s² on friction 1.1.
    pub const FORD_ESCORT: Self = Self {
        mass: 1225.887,
        yaw_inertia: 1538.853,
        l_f: 0.9,
        l_r: 1.5,
        width: 1.674,
        a_min: -8.0,
        a_max: 6.0,
        power: 54.7,
        a_slew: 60.0,
        steering_angle: 0.91,
        steering_rate: 0.4,
        steering_slew: 8.0,
        peak_slip: 0.12,
        lateral_grip: 0.88,
        braking_grip: 0.45,
        driving_grip: 0.22,
    };

    /// CommonRoad vehicle 2, a BMW 320i with rear-wheel drive.
    ///
    /// Mass, inertia, axles and width are those of `parameters_vehicle2.yaml`, rounded. Everything else is
    /// [`VehicleParameters::FORD_ESCORT`]'s: this vehicle has the same tyres, its steering and engine allow more, and its
    /// grips were not measured.
    pub const BMW_320I: Self = Self {
        mass: 1093.295,
        yaw_inertia: 1791.6,
        l_f: 1.156,
        l_r: 1.423,
        width: 1.61,
        ..Self::FORD_ESCORT
    };
}
