//! The friction of a window whose transitions come from a vehicle on a known surface.
#![allow(clippy::unwrap_used)]

use egp_core::friction::{FrictionEstimate, FrictionEstimator};
use egp_core::library::{LibrarySpec, MemberData, encode};
use egp_core::settings::WeightSettings;
use egp_core::vehicle::{ModelParameters, VehicleModel};
use egp_core::{GpInput, Kernel, Library, Member, NY};
use egp_parameters::{FRICTION_HYPOTHESES, friction_hypotheses};
use egp_testing::libraries;

/// A library of vehicles alone, whose tyres have the same slope at zero slip on every surface.
fn library(frictions: &[f64]) -> Library {
    with_noise(frictions, 0.1)
}

/// The same with this z-scored standard deviation of the members' noise.
fn with_noise(frictions: &[f64], noise: f64) -> Library {
    changed(frictions, noise, |member| member)
}

/// The same with members that are changed.
fn changed(frictions: &[f64], noise: f64, change: impl Fn(MemberData) -> MemberData) -> Library {
    let spec = libraries::spec(Kernel::Rbf, frictions, 8, 1);
    let alone = |member: &MemberData| {
        let mu = member.friction;
        let axle = [0.5, 0.5, 0.9 * mu, 16.0 / mu, 1.4];
        let mut parameters = [
            1226.0,
            0.88,
            1.51,
            1.5,
            0.5,
            0.4 * mu,
            0.7 * mu,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
        ];
        parameters[7..12].copy_from_slice(&axle);
        parameters[12..].copy_from_slice(&axle);
        MemberData {
            inputs: vec![],
            targets: vec![],
            golden_z: vec![],
            golden_mean: vec![],
            golden_jacobian: vec![],
            golden_variance: vec![],
            alpha: Default::default(),
            constant: [0.0; NY],
            target_mean: [0.0; NY],
            target_std: [0.01; NY],
            noise: [noise; NY],
            vehicle: Some(ModelParameters::SingleTrack(parameters)),
            ..member.clone()
        }
    };
    let members = spec.members.iter().map(alone).map(change).collect();
    Library::from_bytes(
        &encode(&LibrarySpec {
            members,
            dt: 0.02,
            ..spec
        })
        .unwrap(),
    )
    .unwrap()
}

/// Inputs of half a second of steering at 15 m/s; `steering` is the largest angle of the front wheels in rad.
fn window(steering: f64) -> Vec<[f64; 6]> {
    (0..25)
        .map(|k| {
            let delta = steering * (0.6 + 0.4 * (0.5 * f64::from(k)).sin());
            [15.0, 0.2 * delta, 3.0 * delta, delta, 300.0, 0.1]
        })
        .collect()
}

fn changes(member: &Member, z: &[[f64; 6]]) -> Vec<[f64; NY]> {
    z.iter()
        .map(|z| member.mean(&GpInput::from(*z)).into())
        .collect()
}

/// The estimate of `library` from transitions on the only surface of `truth`.
fn estimate(library: &Library, truth: &Library, z: &[[f64; 6]]) -> FrictionEstimate {
    of_changes(library, &changes(&truth.members()[0], z), z)
}

/// The estimate of `library` from measured changes.
fn of_changes(library: &Library, measured: &[[f64; NY]], z: &[[f64; 6]]) -> FrictionEstimate {
    let members = library.members();
    let columns: Vec<_> = members.iter().map(|member| changes(member, z)).collect();
    let predictions: Vec<f64> = (0..z.len())
        .flat_map(|k| columns.iter().flat_map(move |column| column[k]))
        .collect();
    FrictionEstimator::new(library, &WeightSettings::default()).estimate(z, &predictions, measured)
}

#[test]
fn the_friction_is_found_between_the_members_and_beyond_them() {
    let ensemble = library(&[0.5, 1.1]);
    let slides = window(0.3);
    for mu in [0.25, 0.35, 0.5, 0.65, 0.8, 1.0] {
        let found = estimate(&ensemble, &library(&[mu]), &slides);
        assert!(
            found.informed() && (found.mean - mu).abs() < 0.05,
            "{mu}: {found:?}"
        );
        assert!(
            found.lower < mu && mu < found.upper && found.std < 0.06,
            "{mu}: {found:?}"
        );
        assert!(found.upper - found.lower < 0.2, "{mu}: {found:?}");
        assert!(found.misfit < 1.0, "{mu}: {found:?}");
        assert!(found.log_likelihood.iter().all(|value| *value <= 0.0));
    }
}

#[test]
fn an_error_that_all_transitions_share_leaves_the_friction_open() {
    // In a steady bend all that the models of the friction differ by is the sum of the innovations.
    let ensemble = with_noise(&[0.5, 1.1], 1.0);
    let bend = vec![window(0.1)[0]; 25];
    for mu in [0.35, 0.5, 0.8, 1.0] {
        let own = changes(&library(&[mu]).members()[0], &bend);
        let width = |acceleration: f64| {
            // A yaw acceleration in rad/s² that no friction explains.
            let turned = |[v_x, v_y, omega]: [f64; NY]| [v_x, v_y, omega + 0.02 * acceleration];
            let measured: Vec<_> = own.iter().copied().map(turned).collect();
            let found = of_changes(&ensemble, &measured, &bend);
            assert!(
                found.lower < mu && mu < found.upper,
                "{mu}, {acceleration}: {found:?}"
            );
            found.upper - found.lower
        };
        let without = width(0.0);
        assert!(
            width(-0.3) > 1.2 * without && width(0.3) > 1.2 * without,
            "{mu}"
        );
    }
}

#[test]
fn the_misfit_tells_another_vehicle_from_another_friction() {
    // As heavy as two of the library's vehicles, and turned as easily as half of one.
    let other = |member: MemberData| {
        let Some(ModelParameters::SingleTrack(mut parameters)) = member.vehicle else {
            unreachable!();
        };
        parameters[0] *= 2.0;
        parameters[3] *= 0.5;
        MemberData {
            vehicle: Some(ModelParameters::SingleTrack(parameters)),
            ..member
        }
    };
    let ensemble = library(&[0.5, 1.1]);
    for mu in [0.35, 0.5, 0.8, 1.1] {
        let own = estimate(&ensemble, &library(&[mu]), &window(0.1));
        let foreign = estimate(&ensemble, &changed(&[mu], 0.1, other), &window(0.1));
        // Beyond the members, 0.35 lies between two hypotheses that are both far off without noise.
        let most = if mu < 0.5 { 0.5 } else { 0.03 };
        assert!(own.misfit < most, "{mu}: {own:?}");
        assert!(foreign.misfit > 10.0, "{mu}: {foreign:?}");
    }
    let none = FrictionEstimator::new(&ensemble, &WeightSettings::default());
    assert_eq!(none.clone().estimate(&[], &[], &[]).misfit, 0.0);
}

#[test]
fn beyond_the_members_grip_follows_their_power_of_the_friction() {
    let power = |exponent: f64| {
        move |member: MemberData| {
            let Some(ModelParameters::SingleTrack(mut parameters)) = member.vehicle else {
                unreachable!();
            };
            let grip = member.friction.powf(exponent);
            (parameters[5], parameters[6]) = (0.4 * grip, 0.7 * grip);
            for axle in [7, 12] {
                (parameters[axle + 2], parameters[axle + 3]) = (0.9 * grip, 16.0 / grip);
            }
            MemberData {
                vehicle: Some(ModelParameters::SingleTrack(parameters)),
                ..member
            }
        }
    };
    for exponent in [0.9, 1.0, 1.1] {
        let ensemble = changed(&[0.5, 1.1], 0.1, power(exponent));
        for mu in [0.2, 0.3] {
            let truth = changed(&[mu], 0.1, power(exponent));
            let found = estimate(&ensemble, &truth, &window(0.3));
            assert!(
                (found.mean - mu).abs() < 0.005,
                "{exponent}, {mu}: {found:?}"
            );
        }
    }
}

/// Numbers of mean 0 and standard deviation 1, nearly normal: sums of twelve of a linear congruential generator.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let uniform = |state: &mut u64| {
            *state = (state.wrapping_mul(6_364_136_223_846_793_005))
                .wrapping_add(1_442_695_040_888_963_407);
            (*state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform(&mut self.0)).sum::<f64>() - 6.0
    }
}

#[test]
fn noise_of_the_measured_states_does_not_read_as_little_friction() {
    // Slow turns to both sides that use little of the grip; only many windows together tell the friction.
    const WINDOWS: u32 = 200;
    const STD: [f64; NY] = [0.03, 0.03, 0.005];
    let mu = 0.9;
    let (ensemble, surface) = (library(&[0.5, 1.1]), library(&[mu]));
    let truth = &surface.members()[0];
    let mut noise = Noise(1);
    let mut measure =
        |x: [f64; NY]| -> [f64; NY] { std::array::from_fn(|i| x[i] + STD[i] * noise.next()) };
    let mut estimator = FrictionEstimator::new(&ensemble, &WeightSettings::default());
    let mut sums = [0.0; FRICTION_HYPOTHESES];
    for window in 0..WINDOWS {
        let (mut z, mut predictions, mut changes) = (vec![], vec![], vec![]);
        let mut x = [12.0, 0.0, 0.0];
        let mut measured = measure(x);
        for k in 0..25_u32 {
            let phase = 0.06 * f64::from(25 * window + k);
            let (delta, rate) = (0.03 * phase.sin(), 0.09 * phase.cos());
            let at = |x: [f64; NY]| GpInput::from([x[0], x[1], x[2], delta, 300.0, rate]);
            let change = truth.mean(&at(x));
            x = std::array::from_fn(|i| x[i] + change[i]);
            let next = measure(x);
            z.push(at(measured).into());
            for member in ensemble.members() {
                predictions.extend(member.mean(&at(measured)).iter());
            }
            changes.push(std::array::from_fn(|i| next[i] - measured[i]));
            measured = next;
        }
        z.reverse();
        changes.reverse();
        let rows: Vec<f64> = predictions
            .chunks(2 * NY)
            .rev()
            .flatten()
            .copied()
            .collect();
        let found = estimator.estimate(&z, &rows, &changes);
        for (sum, value) in sums.iter_mut().zip(found.log_likelihood) {
            *sum += value;
        }
    }
    let likeliest = (0..FRICTION_HYPOTHESES)
        .max_by(|a, b| sums[*a].total_cmp(&sums[*b]))
        .unwrap();
    let found = friction_hypotheses()[likeliest];
    // The coefficient that is nearest to the true one. The likeliest one is 0.80 if the noise is left out of the models' inputs.
    assert!((found / mu).ln().abs() < 0.1, "{found} {sums:?}");
}

#[test]
fn forces_that_all_surfaces_transmit_bound_the_friction_from_below_only() {
    let ensemble = library(&[0.5, 1.1]);
    let found = estimate(&ensemble, &library(&[0.9]), &window(0.02));
    assert!(found.lower > 0.3 && found.upper > 1.15, "{found:?}");
}

#[test]
fn a_window_without_excitation_gives_the_prior() {
    let ensemble = library(&[0.5, 1.1]);
    let straight = estimate(&ensemble, &library(&[0.5]), &window(0.0));
    assert!(
        !straight.informed() && straight.information < 0.02,
        "{straight:?}"
    );
    let empty = estimate(&ensemble, &library(&[0.5]), &[]);
    assert_eq!(empty, FrictionEstimate::default());
    assert!((empty.mean - 0.7).abs() < 1e-12 && (empty.lower - 0.16).abs() < 1e-12);
}

#[test]
fn members_without_vehicles_are_blended() {
    let gps = libraries::library(Kernel::Rbf, &[0.5, 1.1], 250, 3);
    let z = window(0.3);
    let found = estimate(&gps, &gps, &z);
    assert!(found.upper < 0.75, "{found:?}");
}

#[test]
fn a_window_without_noise_gives_numbers_that_a_reply_can_state() {
    let hypotheses = friction_hypotheses();
    let frictions = [hypotheses[5], hypotheses[14]];
    // Without single-track vehicles the models of all coefficients beyond the outermost member are the same.
    let rolling = |member: MemberData| MemberData {
        vehicle: Some(ModelParameters::Kinematic([1226.0, member.friction, 1.5])),
        ..member
    };
    for ensemble in [
        with_noise(&frictions, 1e-6),
        changed(&frictions, 1e-6, rolling),
    ] {
        estimate_silently(&ensemble);
    }
}

/// Checks the estimates of exact transitions of each member, for settings that expect no noise of the measurement.
fn estimate_silently(ensemble: &Library) {
    let silent = WeightSettings {
        measurement: Some([0.0; NY]),
        ..WeightSettings::default()
    };
    let z = window(0.1);
    let [low, high] = [0, 1].map(|i| changes(&ensemble.members()[i], &z));
    let predictions: Vec<f64> = (low.iter().zip(&high))
        .flat_map(|(low, high)| [*low, *high])
        .flatten()
        .collect();
    for measured in [low, high] {
        let mut estimator = FrictionEstimator::new(ensemble, &silent);
        let found = estimator.estimate(&z, &predictions, &measured);
        let FrictionEstimate {
            mean,
            std,
            lower,
            upper,
            information,
            log_likelihood,
            misfit,
        } = found;
        let numbers = [mean, std, lower, upper, information, misfit];
        assert!(numbers.iter().all(|number| number.is_finite()), "{found:?}");
        assert!(lower < mean && mean < upper, "{found:?}");
        assert!(log_likelihood.contains(&-1e6));
        assert!(
            log_likelihood
                .iter()
                .all(|value| (-1e6..=0.0).contains(value))
        );
    }
}

#[test]
fn of_members_of_one_friction_that_with_a_vehicle_counts_in_any_order() {
    let spec = |first: usize| {
        let mut spec = libraries::spec(Kernel::Rbf, &[0.5, 0.5, 1.1], 8, 1);
        let vehicles = library(&[0.5, 1.1]);
        for (at, member) in [(first, 0), (2, 1)] {
            let found = vehicles.members()[member].vehicle();
            let Some(VehicleModel::SingleTrack(found)) = found else {
                unreachable!("{found:?}");
            };
            let vehicle = ModelParameters::SingleTrack(*found.parameters());
            libraries::leave_vehicle(&mut spec.members[at], vehicle);
            spec.members[at].target_std = [0.01; NY];
        }
        for (member, label) in spec.members.iter_mut().zip(["a", "b", "c"]) {
            member.label = label.to_owned();
        }
        Library::from_bytes(&encode(&LibrarySpec { dt: 0.02, ..spec }).unwrap()).unwrap()
    };
    let truth = library(&[0.7]);
    let [first, second] = [0, 1].map(|at| estimate(&spec(at), &truth, &window(0.3)));
    assert!((first.mean - 0.7).abs() < 0.1, "{first:?}");
    assert!(
        (first.mean - second.mean).abs() < 1e-12,
        "{first:?} {second:?}"
    );
}
