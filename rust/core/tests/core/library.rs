//! The library file as bytes. Python tests check the errors for invalid files with an independent writer.
#![allow(clippy::unwrap_used)]

use egp_core::library::{
    LibraryError, LibrarySpec, MAX_FILE_BYTES, MAX_HEADER_BYTES, encode, subset,
};
use egp_core::settings::WeightSettings;
use egp_core::vehicle::{ModelParameters, Resistance, SINGLE_TRACK_PARAMETERS, VehicleModel};
use egp_core::weights::WindowNoise;
use egp_core::{
    Ensemble, GpJacobian, GpOutput, Kernel, Library, MixtureScratch, NY, NZ, Sequential,
    VarianceScratch, VehicleParameters,
};
use egp_testing::libraries;
use proptest::prelude::*;
use sha2::{Digest, Sha256};

use crate::mixture::variance;

const SINGLE_TRACK: ModelParameters = ModelParameters::SingleTrack([
    1225.0, 0.87, 1.52, 1.6, 0.45, 0.5, 0.8, 1.9, 1.2, 0.9, 15.0, 1.6, 0.3, 1.1, 1.1, 20.0, 1.2,
]);
const KINEMATIC: ModelParameters = ModelParameters::Kinematic([1225.0, 0.87, 1.52]);

fn bytes() -> Vec<u8> {
    encode(&libraries::spec(Kernel::Rbf, &[0.5, 1.1], 20, 0)).unwrap()
}

#[test]
fn the_same_content_gives_the_same_bytes_and_identity() {
    let library = Library::from_bytes(&bytes()).unwrap();
    assert_eq!(bytes(), bytes());
    assert_eq!(library.id(), <[u8; 32]>::from(Sha256::digest(bytes())));
    assert_eq!(library.dt(), 0.05);
    assert_eq!(library.kernel(), Kernel::Rbf);
    let labels: Vec<_> = library
        .members()
        .iter()
        .map(egp_core::Member::label)
        .collect();
    assert_eq!(labels, ["friction 0.5", "friction 1.1"]);
}

#[test]
fn a_vehicle_is_added_to_the_gps() {
    let mut spec = libraries::spec(Kernel::Rbf, &[0.5], 20, 0);
    let alone = Library::from_bytes(&encode(&spec).unwrap()).unwrap();
    let vehicle = VehicleModel::new(&SINGLE_TRACK, spec.dt);
    let data = &mut spec.members[0];
    data.vehicle = Some(SINGLE_TRACK);
    for (y, z) in data.targets.iter_mut().zip(&data.inputs) {
        *y = (GpOutput::from(*y) + vehicle.change(&(*z).into())).into();
    }
    for g in 0..data.golden_z.len() {
        let (change, slopes) = vehicle.change_jacobian(&data.golden_z[g].into());
        for o in 0..NY {
            data.golden_mean[g][o] += change[o];
            for d in 0..NZ {
                data.golden_jacobian[g][o][d] += slopes[(o, d)];
            }
        }
    }
    let golden = data.golden_z.clone();
    let library = Library::from_bytes(&encode(&spec).unwrap()).unwrap();
    let (with, without) = (&library.members()[0], &alone.members()[0]);
    assert_eq!(with.vehicle().unwrap().parameters(), SINGLE_TRACK);
    assert!(without.vehicle().is_none());
    let mut differs = false;
    for z in golden {
        let z = z.into();
        assert_eq!(with.mean(&z), vehicle.change(&z) + without.mean(&z));
        let mut jacobian = GpJacobian::zeros();
        let mean = with.mean_jacobian(&z, &mut jacobian);
        assert!((mean - with.mean(&z)).amax() < 1e-12);

        // Plans have the value of the GPs and the slopes of the vehicle.
        let mut slopes = GpJacobian::zeros();
        let only_this = Ensemble::new(&library, &[1.0]);
        assert!((only_this.tangent(&z, &mut slopes) - mean).amax() < 1e-12);
        assert_eq!(slopes, vehicle.change_jacobian(&z).1);
        differs |= slopes != jacobian;
    }
    assert!(differs, "the GPs have slopes of their own");
    spec.members[0].vehicle = Some(ModelParameters::SingleTrack([0.0; SINGLE_TRACK_PARAMETERS]));
    assert!(matches!(
        encode(&spec),
        Err(LibraryError::NotPositive { .. })
    ));
}

/// A library whose first member is a vehicle without GPs; the second one has GPs.
fn with_vehicle_alone(parameters: ModelParameters) -> LibrarySpec {
    let mut spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 20, 0);
    let vehicle = VehicleModel::new(&parameters, spec.dt);
    let data = &mut spec.members[0];
    data.vehicle = Some(parameters);
    data.inputs.clear();
    data.targets.clear();
    data.alpha = Default::default();
    (data.target_mean, data.constant, data.outputscale) = ([0.0; NY], [0.0; NY], [0.0; NY]);
    for (g, z) in data.golden_z.iter().enumerate() {
        let (change, slopes) = vehicle.change_jacobian(&(*z).into());
        data.golden_mean[g] = change.into();
        data.golden_jacobian[g] = std::array::from_fn(|o| std::array::from_fn(|d| slopes[(o, d)]));
        data.golden_variance[g] = [0.0; NY];
    }
    spec
}

#[test]
fn a_vehicle_alone_is_a_member_whose_variance_is_its_noise() {
    for parameters in [SINGLE_TRACK, KINEMATIC] {
        let spec = with_vehicle_alone(parameters);
        let vehicle = VehicleModel::new(&parameters, spec.dt);
        let library = Library::from_bytes(&encode(&spec).unwrap()).unwrap();
        let member = &library.members()[0];
        assert_eq!(member.n_points(), 0);
        assert_eq!(member.vehicle().unwrap().parameters(), parameters);
        let golden: Vec<_> = spec.members[0].golden_z.iter().map(|&z| z.into()).collect();
        let noise = member.noise_std().map(|std| std * std);
        assert!(noise.min() > 0.0);
        let mut scratch = VarianceScratch::default();
        let (one, both) = ([1.0, 0.0], [0.4, 0.6]);
        let alone = Ensemble::new(&library, &one);
        for z in &golden {
            assert_eq!(member.mean(z), vehicle.change(z));
            assert_eq!(alone.mean(z), vehicle.change(z));
            assert_eq!(member.variance(z, &mut scratch), GpOutput::zeros());
            assert_eq!(variance(library.members(), &one, z), noise);
        }
        // Beside a member with GPs its variance over a horizon is bounded like that of any member.
        let mixed = Ensemble::new(&library, &both);
        for (ensemble, weights) in [(alone, one), (mixed, both)] {
            let mut bounds = vec![GpOutput::zeros(); golden.len()];
            let mut memory = MixtureScratch::default();
            Ensemble::mixture_bounds(|_| ensemble, &golden, &mut memory, &mut bounds, &Sequential);
            for (z, bound) in golden.iter().zip(bounds) {
                let exact = variance(library.members(), &weights, z);
                assert!((bound - exact * (1.0 - 1e-12)).min() >= 0.0);
                assert!((exact * 1.1 - bound).min() >= 0.0);
            }
        }
    }
}

#[test]
fn a_fitted_vehicle_has_a_slip_bound_of_its_own_and_other_members_that_of_their_friction() {
    let bounds = |parameters| -> Vec<f64> {
        let bytes = encode(&with_vehicle_alone(parameters)).unwrap();
        let library = Library::from_bytes(&bytes).unwrap();
        let car = VehicleParameters {
            peak_slip: 0.2,
            ..VehicleParameters::FORD_ESCORT
        };
        let members = library.members().iter();
        members.map(|member| member.slip_bound(&car)).collect()
    };
    // The front axle of `SINGLE_TRACK` has B = 15 and C = 1.6; the second members have a friction of 1.1 and no vehicle.
    let fitted = bounds(SINGLE_TRACK);
    assert!((fitted[0] - 0.9 * 1.4966 / 15.0).abs() < 1e-5, "{fitted:?}");
    assert_eq!(fitted[1], 0.9 * (0.2 * 1.1));
    assert_eq!(bounds(KINEMATIC), [0.9 * (0.2 * 0.5), 0.9 * (0.2 * 1.1)]);
}

#[test]
fn a_resistance_slows_the_vehicle_and_needs_one() {
    let (rolling, drag) = (0.15, 4e-4);
    let mut spec = with_vehicle_alone(SINGLE_TRACK);
    let free = VehicleModel::new(&SINGLE_TRACK, spec.dt);
    let vehicle = free.with_resistance(Resistance { rolling, drag });
    let data = &mut spec.members[0];
    data.resistance = Some([rolling, drag]);
    for (g, z) in data.golden_z.iter().enumerate() {
        let (change, slopes) = vehicle.change_jacobian(&(*z).into());
        data.golden_mean[g] = change.into();
        data.golden_jacobian[g] = std::array::from_fn(|o| std::array::from_fn(|d| slopes[(o, d)]));
    }
    let bytes = encode(&spec).unwrap();
    let library = Library::from_bytes(&bytes).unwrap();
    let Some(VehicleModel::SingleTrack(read)) = library.members()[0].vehicle() else {
        unreachable!();
    };
    assert_eq!(read.resistance(), Resistance { rolling, drag });
    let z = [20.0, 0.0, 0.0, 0.0, 0.0, 0.0].into();
    let slower = library.members()[0].mean(&z)[0] - free.change(&z)[0];
    assert!((slower + spec.dt * (0.15 + 0.16)).abs() < 1e-12, "{slower}");
    // A part of the library keeps it.
    let part = Library::from_bytes(&subset(&bytes, &[0]).unwrap()).unwrap();
    assert_eq!(part.members()[0].mean(&z), library.members()[0].mean(&z));
    spec.members[0].resistance = Some([rolling, 0.0]);
    assert!(matches!(
        encode(&spec),
        Err(LibraryError::NotPositive { .. })
    ));
    let mut rolls = with_vehicle_alone(KINEMATIC);
    rolls.members[0].resistance = Some([rolling, drag]);
    assert!(matches!(
        encode(&rolls),
        Err(LibraryError::UnexpectedTensor { .. })
    ));
}

#[test]
fn the_force_is_limited_by_the_fitted_tyres_or_by_the_vehicle() {
    let bytes = encode(&with_vehicle_alone(SINGLE_TRACK)).unwrap();
    let library = Library::from_bytes(&bytes).unwrap();
    let car = VehicleParameters::FORD_ESCORT;
    let limits: Vec<_> = library
        .members()
        .iter()
        .map(|m| m.tyre_limits(&car))
        .collect();
    let ModelParameters::SingleTrack(fitted) = SINGLE_TRACK else {
        unreachable!();
    };
    let [drive, brake] = [fitted[5], fitted[6]].map(|grip| 1.5 * 9.81 * grip);
    assert!((limits[0].drive - drive).abs() < 1e-12, "{limits:?}");
    assert!((limits[0].brake - brake).abs() < 1e-12, "{limits:?}");
    assert_eq!((limits[1].drive, limits[1].brake), (car.a_max, -car.a_min));
}

#[test]
fn a_member_without_points_needs_a_vehicle_and_points_need_a_prior_variance() {
    let mut spec = with_vehicle_alone(KINEMATIC);
    spec.members[0].outputscale[1] = -1.0;
    assert!(matches!(
        encode(&spec),
        Err(LibraryError::NotPositive { .. })
    ));
    // A quotient by such a scale is infinite.
    let mut tiny = with_vehicle_alone(KINEMATIC);
    tiny.members[0].input_std[2] = 1e-320;
    assert!(matches!(
        encode(&tiny),
        Err(LibraryError::NotPositive { .. })
    ));
    spec.members[0].vehicle = None;
    assert!(matches!(encode(&spec), Err(LibraryError::Count { .. })));
    let mut spec = libraries::spec(Kernel::Rbf, &[0.5], 20, 0);
    spec.members[0].outputscale[1] = 0.0;
    assert!(matches!(
        encode(&spec),
        Err(LibraryError::NotPositive { .. })
    ));
}

#[test]
fn too_large_a_file_is_an_error_before_parsing() {
    // Zeroed pages that are never accessed use no memory.
    let huge = vec![0; MAX_FILE_BYTES + 1];
    // A reader may have stopped one byte beyond the limit, so that the error does not state the size of the file.
    let error = Library::from_bytes(&huge).unwrap_err();
    let limit = MAX_FILE_BYTES;
    assert_eq!(error, LibraryError::TooLarge { limit });
    assert!(
        error
            .to_string()
            .starts_with("file has more than 536870912 bytes")
    );
    let header = [&u64::MAX.to_le_bytes()[..], &[b'{'; 100]].concat();
    assert_eq!(
        Library::from_bytes(&header).err(),
        Some(LibraryError::HeaderTooLarge {
            bytes: u64::MAX,
            limit: MAX_HEADER_BYTES
        })
    );
}

#[test]
fn invalid_content_is_not_written() {
    let mut spec = libraries::spec(Kernel::Rbf, &[0.5], 20, 0);
    spec.members[0].alpha[1].pop();
    assert!(matches!(
        encode(&spec),
        Err(LibraryError::Malformed { .. } | LibraryError::Shape { .. })
    ));
    let mut spec = libraries::spec(Kernel::Rbf, &[0.5], 20, 0);
    spec.members[0].golden_mean[0][2] += 1e-6;
    assert!(matches!(encode(&spec), Err(LibraryError::Golden { .. })));
    spec.members.clear();
    assert!(matches!(encode(&spec), Err(LibraryError::Count { .. })));
}

#[test]
fn vehicles_of_one_library_have_the_same_number_of_steps() {
    let mut spec = libraries::spec(Kernel::Rbf, &[0.5, 0.7, 1.1], 20, 0);
    for (member, steps) in spec.members.iter_mut().step_by(2).zip([2, 3]) {
        libraries::leave_vehicle(member, SINGLE_TRACK);
        member.euler_steps = steps;
    }
    let error = encode(&spec).unwrap_err();
    assert_eq!(error.code(), "euler_steps");
    let told = error.to_string();
    assert!(
        told.contains("\"friction 1.1\" is 3, and 2 of another member"),
        "{told}"
    );
    spec.members[2].euler_steps = 2; // The member without a vehicle has one step.
    assert!(encode(&spec).is_ok());
}

proptest! {
    #[test]
    fn any_flipped_bit_is_an_error(position in 0..bytes().len(), bit in 0..8_u8) {
        let mut bytes = bytes();
        bytes[position] ^= 1 << bit;
        prop_assert!(Library::from_bytes(&bytes).is_err());
    }

    #[test]
    fn arbitrary_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), length in 0..200_u64) {
        prop_assert!(Library::from_bytes(&bytes).is_err());
        let framed = [&length.to_le_bytes()[..], &bytes].concat();
        prop_assert!(Library::from_bytes(&framed).is_err());
    }
}

#[test]
fn the_library_states_the_measurement_noise_unless_the_settings_do() {
    let noise = [0.007, 0.0017, 0.0008];
    let mut spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 20, 0);
    let without = Library::from_bytes(&encode(&spec).unwrap()).unwrap();
    spec.measurement_noise = Some(noise);
    let with = Library::from_bytes(&encode(&spec).unwrap()).unwrap();
    let rows = |library: &Library, measurement| {
        let settings = WeightSettings {
            measurement,
            ..WeightSettings::default()
        };
        format!("{:?}", WindowNoise::of(library, &settings))
    };
    assert_eq!(rows(&with, None), rows(&without, Some(noise)));
    assert_ne!(rows(&with, None), rows(&without, None));
    let stated = Some([0.1, 0.2, 0.3]);
    assert_eq!(rows(&with, stated), rows(&without, stated));
}
