//! Surfaces with a shape of their own: the factors scale the tyre, and the presets peak where `docs/surfaces.md` says.

#![allow(missing_docs, clippy::unwrap_used)]

use egp_plant::{Contact, Plant, Surface, TyreParameters, Uniform, VehicleId, VehicleState};
use proptest::prelude::*;

const TYRE: TyreParameters = TyreParameters::ADAMS;
const TABLE: &str = include_str!("../../../docs/surfaces.md");

fn contact(slip: f64, slip_angle: f64, surface: &Surface) -> Contact<'_> {
    Contact {
        slip,
        slip_angle,
        camber: 0.0,
        load: 3000.0,
        surface,
    }
}

proptest! {
    #[test]
    fn factors_scale_the_coefficients_of_the_tyre(
        slip in -1.0..1.0f64, slip_angle in -0.5..0.5f64, camber in -0.1..0.1f64, peak in 0.05..1.2f64,
        stiffness in 0.05..3.0f64, shape in 0.75..1.2f64, curvature in 0.0..2.0f64,
    ) {
        let scaled = TyreParameters {
            p_kx1: stiffness * TYRE.p_kx1,
            p_ky1: stiffness * TYRE.p_ky1,
            p_cx1: shape * TYRE.p_cx1,
            p_cy1: shape * TYRE.p_cy1,
            p_ex1: curvature * TYRE.p_ex1,
            p_ey1: curvature * TYRE.p_ey1,
            ..TYRE
        };
        let surface = Surface::new(peak, stiffness, shape, curvature);
        let (own, number) = (contact(slip, slip_angle, &surface), peak.into());
        let number = contact(slip, slip_angle, &number);
        let on = |contact| Contact { camber, ..contact };
        prop_assert_eq!(TYRE.force(&on(own)), scaled.force(&on(number)));
    }
}

#[test]
fn lateral_factors_act_across_the_wheel_alone() {
    let mut surface = Surface::from(0.6);
    surface.lateral.stiffness = 0.5;
    let (before, after) = (Surface::from(0.6), surface);
    let along = |surface: Surface| TYRE.force(&contact(0.02, 0.0, &surface)).x;
    assert_eq!(along(before), along(after));
    // Half the slope at zero slip.
    let across = |surface: Surface| TYRE.force(&contact(0.0, 1e-5, &surface)).y;
    assert!((across(after) / across(before) - 0.5).abs() < 1e-3);
}

/// Slip of the largest force on a grid of 1e-4, and that force per load.
fn peak(force: impl Fn(f64) -> f64) -> (f64, f64) {
    (0..10_000)
        .map(|i| 1e-4 * f64::from(i))
        .map(|slip| (slip, force(slip).abs() / 3000.0))
        .fold((0.0, 0.0), |best, at| if at.1 > best.1 { at } else { best })
}

#[test]
fn the_documented_peaks_are_those_of_the_presets() {
    let rows = Surface::PRESETS
        .into_iter()
        .map(|(name, surface)| (name.to_owned(), surface))
        .chain([0.3, 0.1].map(|mu| (format!("number {mu}"), Surface::from(mu))));
    for (name, surface) in rows {
        let (slip, longitudinal) = peak(|slip| TYRE.force(&contact(slip, 0.0, &surface)).x);
        let (angle, lateral) = peak(|angle| TYRE.force(&contact(0.0, angle, &surface)).y);
        let locked = TYRE.force(&contact(1.0, 0.0, &surface)).x.abs() / 3000.0 / longitudinal;
        assert!((longitudinal / surface.longitudinal.peak - 1.0).abs() < 1e-3);
        assert!((lateral / surface.lateral.peak - 1.0).abs() < 1e-3);
        let row = format!(
            "| {name} | {longitudinal:.2} | {slip:.3} | {locked:.2} | {lateral:.2} | {angle:.3} |"
        );
        assert!(TABLE.contains(&row), "docs/surfaces.md lacks the row {row}");
    }
}

#[test]
fn a_stiffer_surface_shortens_the_substeps_and_a_vehicle_brakes_on_all_presets() {
    let start = VehicleState {
        v_x: 8.0,
        ..VehicleState::default()
    };
    let mut stops = Vec::new();
    for surface in [
        Surface::new(1.0, 10.0, 1.0, 1.0),
        Surface::DRY,
        Surface::WET,
        Surface::SNOW,
        Surface::ICE,
    ] {
        let mut plant = Plant::new(VehicleId::FordEscort.parameters());
        plant.reset(&start).unwrap();
        let brake = [
            -0.5 * surface.friction() * 9.81 * plant.parameters().mass,
            0.0,
        ];
        let road = Uniform::new(surface).unwrap();
        while plant.vehicle_state().v_x > 0.0 && stops.len() < 5 {
            plant.step(brake, 0.05, &road).unwrap();
        }
        stops.push(plant.vehicle_state().p_x);
    }
    // v² / (2 * 0.5 mu g), and what the wheels' inertia adds.
    for (stop, mu) in stops.into_iter().zip([1.0, 1.0, 0.82, 0.3, 0.1]) {
        let expected = 64.0 / (mu * 9.81);
        assert!(
            (stop / expected - 1.0).abs() < 0.1,
            "{mu} {stop} {expected}"
        );
    }
}
