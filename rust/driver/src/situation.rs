//! Where the vehicle is relative to what the library and the reference are about.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::fmt;

use egp_wire::{GpInput, ReferenceRow, State};

/// Largest distance from the envelope at which the library's prediction is still used, in half widths.
pub(crate) const MAX_ENVELOPE: f64 = 0.4;
/// Largest distance of a full-size vehicle from the reference, m. That of smaller ones is in proportion to their scale.
pub(crate) const MAX_DISTANCE: f64 = 25.0;
/// Largest angle between the vehicle's and the reference's heading, rad.
pub(crate) const MAX_HEADING: f64 = FRAC_PI_2;
/// A vehicle counts as lost after this many successive periods beyond a limit, so that one outlier of a sensor does not
/// stop it.
const PATIENCE: u32 = 3;

/// Where the vehicle is relative to the library's training data and to the reference's first row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Situation {
    /// Distance of `[v_x, v_y, omega, delta]` from the library's envelope: the largest excess over the training data's
    /// range among the components, in half widths of that range; 0 inside.
    pub envelope_distance: f64,
    /// Distance from the reference, m.
    pub distance: f64,
    /// Angle from the reference's heading to the vehicle's, rad, in (-π, π].
    pub heading: f64,
    /// The component that is farthest from the envelope.
    farthest: Outside,
}

/// A component of the state outside the training data of the library.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outside {
    /// Its name.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Its value.
    pub value: f64,
    /// The smallest and the largest value in the training data.
    pub data: [f64; 2],
}

/// Why a vehicle counts as lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lost {
    /// Its state is too far outside the training data of the library.
    Envelope(Outside),
    /// Its distance from the reference, m, which is too large, and the largest one that is allowed.
    Distance(f64, f64),
    /// The angle between its yaw and the reference's, rad, which is too large.
    Heading(f64),
}

impl fmt::Display for Lost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Envelope(Outside {
                name,
                unit,
                value,
                data: [low, high],
            }) => {
                let beyond = 0.5 * MAX_ENVELOPE * (high - low);
                write!(
                    f,
                    "the vehicle is lost: {name} is {value:.3} {unit}, and with this library it may be {:.3} to {:.3} {unit}, \
                     because the training data have {low:.3} to {high:.3} {unit}",
                    low - beyond,
                    high + beyond
                )
            }
            Self::Distance(distance, allowed) => write!(
                f,
                "the vehicle is lost: it is {distance:.1} m from the reference, {allowed:.3} m are allowed"
            ),
            Self::Heading(angle) => write!(
                f,
                "the vehicle is lost: its yaw differs from the reference's by {angle:.2} rad, {MAX_HEADING:.2} are \
                 allowed; yaw is measured in rad, counter-clockwise from +x"
            ),
        }
    }
}

impl Situation {
    /// The situation of a vehicle at `x` with the reference's `first` row and the library's `envelope`, smallest and
    /// largest GP input.
    pub(crate) fn new(x: &State, first: &ReferenceRow, envelope: &[GpInput; 2]) -> Self {
        let [p_x, p_y, v_x, psi, v_y, omega, delta] = *x;
        let [low, high] = envelope;
        let motion = [
            ("v_x", "m/s", v_x),
            ("v_y", "m/s", v_y),
            ("omega", "rad/s", omega),
            ("delta", "rad", delta),
        ];
        let mut farthest = (f64::NEG_INFINITY, Outside::default());
        for ((name, unit, value), (low, high)) in motion.into_iter().zip(low.iter().zip(high)) {
            let half = 0.5 * (high - low);
            let excess = ((value - 0.5 * (low + high)).abs() - half) / half;
            if excess > farthest.0 {
                let data = [*low, *high];
                farthest = (
                    excess,
                    Outside {
                        name,
                        unit,
                        value,
                        data,
                    },
                );
            }
        }
        Self {
            envelope_distance: farthest.0.max(0.0),
            farthest: farthest.1,
            distance: (p_x - first[0]).hypot(p_y - first[1]),
            heading: wrap(psi - first[3]),
        }
    }

    /// The first limit that the situation exceeds, with the largest distance that is allowed, m.
    fn beyond(&self, allowed: f64) -> Option<Lost> {
        if self.envelope_distance > MAX_ENVELOPE {
            Some(Lost::Envelope(self.farthest))
        } else if self.distance > allowed {
            Some(Lost::Distance(self.distance, allowed))
        } else if self.heading.abs() > MAX_HEADING {
            Some(Lost::Heading(self.heading))
        } else {
            None
        }
    }
}

/// Counts the successive periods that a vehicle spends beyond a limit, and remembers why it was lost.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LostDetector {
    /// Largest distance from the reference that is allowed, m.
    allowed: f64,
    periods: u32,
    lost: Option<Lost>,
}

impl LostDetector {
    /// For a vehicle of this [scale](egp_parameters::VehicleParameters::scale).
    pub(crate) fn new(scale: f64) -> Self {
        Self {
            allowed: scale * MAX_DISTANCE,
            periods: 0,
            lost: None,
        }
    }

    /// Forgets what was noted.
    pub(crate) fn reset(&mut self) {
        (self.periods, self.lost) = (0, None);
    }

    /// A period without a usable reference ends a succession of periods beyond a limit.
    pub(crate) fn skip(&mut self) {
        self.periods = 0;
    }

    /// Notes the situation of a period. Returns [`LostDetector::lost`].
    pub(crate) fn observe(&mut self, situation: &Situation) -> Option<Lost> {
        let beyond = situation.beyond(self.allowed);
        self.periods = if beyond.is_some() {
            self.periods + 1
        } else {
            0
        };
        if self.periods >= PATIENCE {
            self.lost = self.lost.or(beyond);
        }
        self.lost
    }

    /// Why the vehicle counts as lost. It remains lost, for the reason that came first, because the stop lasts as well.
    pub(crate) fn lost(&self) -> Option<Lost> {
        self.lost
    }
}

/// The angle in (-π, π] that differs from `angle` (rad) by whole turns.
pub(crate) fn wrap(angle: f64) -> f64 {
    let turned = angle.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::float_cmp)]
    use super::*;

    const ENVELOPE: [GpInput; 2] = [
        [2.0, -6.0, -1.0, -0.5, -9e3, -0.4],
        [26.0, 4.0, 1.0, 0.5, 9e3, 0.4],
    ];

    fn situation(x: State) -> Situation {
        Situation::new(&x, &[1.0, 2.0, 10.0, 3.0], &ENVELOPE)
    }

    #[test]
    fn inside_the_envelope_the_distance_is_zero_and_outside_it_counts_half_widths() {
        let inside = situation([1.0, 2.0, 26.0, 3.0, -6.0, 1.0, 0.5]);
        assert_eq!(
            (inside.envelope_distance, inside.distance, inside.heading),
            (0.0, 0.0, 0.0)
        );
        // 2.5 m/s below -6 m/s, where half the range is 5 m/s.
        assert_eq!(
            situation([1.0, 2.0, 10.0, 3.0, -8.5, 0.0, 0.0]).envelope_distance,
            0.5
        );
        assert_eq!(
            situation([4.0, 6.0, 10.0, 3.0, 0.0, 0.0, 0.0]).distance,
            5.0
        );
    }

    #[test]
    fn headings_are_compared_across_the_turn() {
        let heading = situation([1.0, 2.0, 10.0, -3.0, 0.0, 0.0, 0.0]).heading;
        assert!((heading - (TAU - 6.0)).abs() < 1e-12, "{heading}");
        assert!(situation([1.0, 2.0, 10.0, 0.5 - TAU, 0.0, 0.0, 0.0]).heading < -2.4);
    }

    #[test]
    fn a_vehicle_is_lost_from_the_third_period_beyond_a_limit_on() {
        let spin = situation([1.0, 2.0, 10.0, 3.0, -9.0, 0.0, 0.0]);
        let fine = situation([1.0, 2.0, 10.0, 3.0, 0.0, 0.0, 0.0]);
        let mut detector = LostDetector::new(1.0);
        let verdicts: Vec<bool> = [spin, spin, fine, spin, spin, spin, spin, fine]
            .iter()
            .map(|situation| detector.observe(situation).is_some())
            .collect();
        assert_eq!(
            verdicts,
            [false, false, false, false, false, true, true, true]
        );
        let far = situation([60.0, 2.0, 10.0, 3.0, 0.0, 0.0, 0.0]);
        let reason = detector.observe(&far);
        assert_eq!(
            reason,
            spin.beyond(MAX_DISTANCE),
            "the first reason is kept"
        );
        assert_eq!(reason, detector.lost());
    }

    #[test]
    fn half_a_turn_stays_positive() {
        assert_eq!((wrap(PI), wrap(-PI)), (PI, PI));
        assert!((wrap(PI + 0.25) - (0.25 - PI)).abs() < 1e-12);
        assert_eq!(wrap(0.0), 0.0);
    }

    #[test]
    fn a_vehicle_at_a_limit_is_not_beyond_it() {
        // 2 m/s beyond half a range of 5 m/s are 0.4 half widths.
        let envelope = situation([1.0, 2.0, 10.0, 3.0, -8.0, 0.0, 0.0]);
        let distance = situation([26.0, 2.0, 10.0, 3.0, 0.0, 0.0, 0.0]);
        let x = [0.0, 0.0, 10.0, FRAC_PI_2, 0.0, 0.0, 0.0];
        let heading = Situation::new(&x, &[0.0; 4], &ENVELOPE);
        assert_eq!(envelope.envelope_distance, MAX_ENVELOPE);
        assert_eq!(distance.distance, MAX_DISTANCE);
        assert_eq!(heading.heading, MAX_HEADING);
        for at in [envelope, distance, heading] {
            assert_eq!(at.beyond(MAX_DISTANCE), None);
        }
    }

    #[test]
    fn a_small_vehicle_is_lost_nearer_to_its_reference() {
        let far = situation([6.0, 2.0, 10.0, 3.0, 0.0, 0.0, 0.0]);
        let mut detector = LostDetector::new(0.125);
        let lost = [far; 3].map(|far| detector.observe(&far));
        assert_eq!(lost, [None, None, Some(Lost::Distance(5.0, 3.125))]);
    }

    #[test]
    fn only_successive_periods_count() {
        let far = situation([60.0, 2.0, 10.0, 3.0, 0.0, 0.0, 0.0]);
        let mut detector = LostDetector::new(1.0);
        for _ in 0..3 {
            assert_eq!(detector.observe(&far), None);
            assert_eq!(detector.observe(&far), None);
            detector.skip();
        }
    }

    #[test]
    fn every_limit_is_told_by_name() {
        for (x, word) in [
            (
                [1.0, 2.0, 10.0, 3.0, -9.0, 0.0, 0.0],
                "v_y is -9.000 m/s, and with this library it may be -8.000 to 6.000 m/s, because the training data have -6.000",
            ),
            ([30.0, 2.0, 10.0, 3.0, 0.0, 0.0, 0.0], "29.0 m from"),
            ([1.0, 2.0, 10.0, 1.0, 0.0, 0.0, 0.0], "yaw"),
        ] {
            let lost = situation(x)
                .beyond(MAX_DISTANCE)
                .map(|lost| lost.to_string());
            assert!(
                lost.as_ref().is_some_and(|text| text.contains(word)),
                "{lost:?}"
            );
        }
    }
}
