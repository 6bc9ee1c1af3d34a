//! CommonRoad vehicle 2, a BMW 320i.

use super::{Axle, Joint, Parameters, SprungMass, Wheel};
use crate::{ActuatorLimits, TyreParameters};

pub(super) const PARAMETERS: Parameters = Parameters {
    mass: 1_093.295_233_467_404_6,
    yaw_inertia: 1_791.599_530_012_285_6,
    sprung: SprungMass {
        mass: 965.710_809_880_436_3,
        roll_inertia: 207.265_245_579_369_52,
        pitch_inertia: 1_565.817_878_712_554_1,
        roll_yaw_product: 0.0,
        height: 0.613_730_04,
    },
    front: Axle {
        position: 1.156_195_706_4,
        track_width: 1.386_84,
        unsprung_mass: 63.792_182_605_678_4,
        roll_inertia: 30.673_279_563_178_017,
        spring: 24_453.137_879_749_014,
        damper: 1_786.244_100_244_072_3,
        torsion: -6_914.881_688_272_133,
        roll_axis_height: 0.0,
        camber_gain: -0.393_700_787_401_574_77,
        brake_share: 0.66,
        drive_share: 0.0,
    },
    rear: Axle {
        position: -1.422_717_093_6,
        track_width: 1.363_98,
        unsprung_mass: 63.792_182_605_678_4,
        roll_inertia: 29.670_408_143_156_248,
        spring: 19_635.504_745_231_297,
        damper: 1_649.083_303_488_738_2,
        torsion: -2_643.600_952_015_530_8,
        roll_axis_height: 0.0,
        camber_gain: -0.905_511_811_023_622,
        brake_share: 0.34,
        drive_share: 1.0,
    },
    wheel: Wheel {
        radius: 0.344,
        inertia: 1.7,
        vertical_stiffness: 158_294.139_811_911_5,
        lateral_compliance: 1.643_072_459_997_472_5e-5,
    },
    joint: Joint {
        stiffness: 175_186.659_437_007_88,
        damping: 10_215.732_056_044_453,
    },
    limits: ActuatorLimits {
        steering_angle: 1.066,
        steering_rate: 0.4,
        acceleration: 11.5,
        switch_speed: 7.319,
        min_speed: -13.9,
        max_speed: 50.8,
    },
    tyre: TyreParameters::ADAMS,
};
