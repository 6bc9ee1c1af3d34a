//! The model of a vehicle on a road of a given friction coefficient, from the members.

use crate::vehicle::{SingleTrack, VehicleModel};
use crate::{GpOutput, Member, NY};

/// Least and largest power of the friction in the forces of tyres beyond the members' range. Members with similar
/// frictions determine the power so badly that it needs bounds.
const EXPONENTS: (f64, f64) = (0.8, 1.25);

/// A model for one friction coefficient `mu`:
///
/// ```text
/// f_mu(z) = vehicle_mu(z) + (1 - t) (f_a(z) - vehicle_a(z)) + t (f_b(z) - vehicle_b(z))
/// t = ln(mu / mu_a) / ln(mu_b / mu_a)
/// ```
///
/// Members `a` and `b` have the nearest frictions below and above. Parameters of `vehicle_mu` are interpolated like
/// `t`, geometrically, so that its tyres saturate at the right force; a blend of two predictions would be wrong for
/// every force that only one of the surfaces can transmit. Beyond the members' range `a = b` is the nearest member, and
/// the forces of its tyres are scaled by a power of the friction: that with which the lateral grip `sqrt(D_f D_r)` changes
/// from it to the member with the most different friction. Where a neighbour has no single-track vehicle, the model is the blend of the members'
/// predictions.
#[derive(Debug, Clone)]
pub(super) struct Hypothesis {
    vehicle: Option<SingleTrack>,
    members: [usize; 2],
    /// `t`.
    share: f64,
}

impl Hypothesis {
    /// The model for `mu` from the members of a library, of which there is at least one.
    pub fn new(mu: f64, members: &[Member]) -> Self {
        let below = nearest(mu, members, |friction| friction <= mu);
        let above = nearest(mu, members, |friction| friction > mu);
        let [a, b] = [below.or(above), above.or(below)].map(Option::unwrap_or_default);
        let (low, high) = (members[a].friction(), members[b].friction());
        let vehicles = [a, b].map(|i| match members[i].vehicle() {
            Some(VehicleModel::SingleTrack(vehicle)) => Some(vehicle),
            _ => None,
        });
        let (vehicle, share) = if a == b {
            let scaled = vehicles[0].map(|vehicle| {
                vehicle.with_friction((mu / low).powf(exponent(vehicle, low, members)))
            });
            (scaled, 0.0)
        } else {
            let share = (mu / low).ln() / (high / low).ln();
            let [below, above] = vehicles;
            let between = below.zip(above).map(|(a, b)| a.between(b, share));
            (between, share)
        };
        Self {
            vehicle,
            members: [a, b],
            share,
        }
    }

    /// `vehicle_mu`, unless a neighbour has no single-track vehicle.
    pub fn vehicle(&self) -> Option<VehicleModel> {
        self.vehicle.map(VehicleModel::SingleTrack)
    }

    /// The change of `[v_x, v_y, omega]` over one period, from that of `vehicle_mu`, the members' predictions `f` and what
    /// their GPs added to their vehicles.
    pub fn change(&self, vehicle: GpOutput, f: &[[f64; NY]], learned: &[GpOutput]) -> GpOutput {
        let blend = |a: GpOutput, b: GpOutput| a + (b - a) * self.share;
        let [a, b] = self.members;
        if self.vehicle.is_some() {
            vehicle + blend(learned[a], learned[b])
        } else {
            blend(f[a].into(), f[b].into())
        }
    }
}

/// The power of the friction with which the lateral grip of the tyres changes from the vehicle of a member with the friction
/// `mu` to the member with the most different friction; 1 if no other one has a single-track vehicle.
fn exponent(vehicle: &SingleTrack, mu: f64, members: &[Member]) -> f64 {
    let (low, high) = EXPONENTS;
    let others = members.iter().filter_map(|member| match member.vehicle() {
        Some(VehicleModel::SingleTrack(other)) => {
            let grips = other.lateral_grip() / vehicle.lateral_grip();
            Some(((member.friction() / mu).ln(), grips.ln()))
        }
        _ => None,
    });
    // Of several members with this friction it is the first one, as in `nearest`.
    let farthest = others.rev().max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
    match farthest {
        Some((friction, grip)) if friction != 0.0 => (grip / friction).clamp(low, high),
        _ => 1.0,
    }
}

/// The member with the friction nearest to `mu`, by ratio, among those on one side. Of several members of this friction it is
/// the first one with a single-track vehicle, or the first one if none has.
fn nearest(mu: f64, members: &[Member], side: impl Fn(f64) -> bool) -> Option<usize> {
    let distance = |i: usize| (members[i].friction() / mu).ln().abs();
    let is_single_track =
        |i: usize| matches!(members[i].vehicle(), Some(VehicleModel::SingleTrack(_)));
    (0..members.len())
        .filter(|i| side(members[*i].friction()))
        .min_by(|i, j| {
            let nearer = distance(*i).total_cmp(&distance(*j));
            nearer.then(is_single_track(*j).cmp(&is_single_track(*i)))
        })
}
