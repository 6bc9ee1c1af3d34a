//! CommonRoad vehicle 1, a Ford Escort.

use super::{Axle, Joint, Parameters, SprungMass, Wheel};
use crate::{ActuatorLimits, TyreParameters};

pub(super) const PARAMETERS: Parameters = Parameters {
    mass: 1_225.887_846_725_334_4,
    yaw_inertia: 1_538.853_371_356_139_4,
    sprung: SprungMass {
        mass: 1_094.542_720_290_477,
        roll_inertia: 244.047_230_699_652_06,
        pitch_inertia: 1_342.259_768_848_086_4,
        roll_yaw_product: 0.0,
        height: 0.594_36,
    },
    front: Axle {
        position: 0.883_92,
        track_width: 1.389_888,
        unsprung_mass: 65.672_563_217_428_63,
        roll_inertia: 32.539_630_759_953_61,
        spring: 21_898.332_429_625_985,
        damper: 1_459.390_293_720_636_2,
        torsion: -12_880.270_509_148_304,
        roll_axis_height: 0.0,
        camber_gain: -0.623_359_580_052_493_4,
        brake_share: 0.76,
        drive_share: 1.0,
    },
    rear: Axle {
        position: -1.508_76,
        track_width: 1.423_416,
        unsprung_mass: 65.672_563_217_428_63,
        roll_inertia: 32.539_630_759_953_61,
        spring: 21_898.332_429_625_985,
        damper: 1_459.390_293_720_636_2,
        torsion: 0.0,
        roll_axis_height: 0.0,
        camber_gain: -0.209_973_753_280_839_86,
        brake_share: 0.24,
        drive_share: 0.0,
    },
    wheel: Wheel {
        radius: 0.344,
        inertia: 1.7,
        vertical_stiffness: 189_785.547_723_425_2,
        lateral_compliance: 1.027_826_487_851_876_4e-5,
    },
    joint: Joint {
        stiffness: 175_186.659_437_007_88,
        damping: 10_215.732_056_044_453,
    },
    limits: ActuatorLimits {
        steering_angle: 0.91,
        steering_rate: 0.4,
        acceleration: 11.5,
        switch_speed: 4.755,
        min_speed: -13.9,
        max_speed: 45.8,
    },
    tyre: TyreParameters::ADAMS,
};
