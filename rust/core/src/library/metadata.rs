//! What a library file says about itself, besides its tensors.

use std::collections::BTreeMap;

use egp_parameters::VehicleParameters;
use serde::{Deserialize, Serialize};

use super::LibraryError;
use super::data::LibrarySpec;
use super::format::DIGITS;
use super::limits::{MAX_DT, MAX_EULER_STEPS, MAX_MEMBERS, MAX_POINTS, MIN_DT, SCHEMA_VERSION};
use crate::settings::{Settings, WeightSettings};
use crate::vehicle::ModelParameters;
use crate::{Kernel, NY};

/// Names and units of the inputs of the GPs.
pub(super) const INPUTS: [(&str, &str); crate::NZ] = [
    ("v_x", "m/s"),
    ("v_y", "m/s"),
    ("omega", "rad/s"),
    ("delta", "rad"),
    ("F_x", "N"),
    ("delta_dot", "rad/s"),
];
const OUTPUTS: [(&str, &str); NY] = [("dv_x", "m/s"), ("dv_y", "m/s"), ("domega", "rad/s")];

/// A named quantity and its unit.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Signal {
    /// Name as in the vehicle equations; a leading `d` means the change over `dt`.
    pub name: String,
    /// SI unit.
    pub unit: String,
}

/// What a member's GPs are added to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PriorMean {
    /// A constant for each output, as in the paper.
    Constant,
    /// A [`SingleTrack`](crate::vehicle::SingleTrack), usually fitted to the same data.
    SingleTrack,
    /// A [`Kinematic`](crate::vehicle::Kinematic).
    Kinematic,
}

/// What is known about a member besides its numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MemberMetadata {
    /// The surface's name.
    pub label: String,
    /// Nominal friction coefficient of the surface.
    pub friction: f64,
    /// SHA-256 of the dataset the member was trained on, hexadecimal.
    pub dataset: String,
    /// Number of training points kept; a vehicle alone has none.
    pub n: usize,
    /// What its GPs are added to.
    pub mean: PriorMean,
    /// Number of steps of the Euler method with which a single-track vehicle predicts a period. It is 1 for other members
    /// and where this entry is missing.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub euler_steps: u32,
}

fn one() -> u32 {
    1
}

#[allow(clippy::trivially_copy_pass_by_ref)] // serde calls it with a reference
fn is_one(steps: &u32) -> bool {
    *steps == 1
}

/// The metadata of a library, stored as one JSON string.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metadata {
    /// Version of the file format.
    pub schema: u32,
    /// SHA-256 of the whole file with these 64 digits written as zeros, hexadecimal.
    pub sha256: String,
    /// Period over which the outputs change, s.
    pub dt: f64,
    /// Name of the kernel.
    pub kernel: String,
    /// GP inputs, in order.
    pub inputs: Vec<Signal>,
    /// GP outputs, in order.
    pub outputs: Vec<Signal>,
    /// Name of the vehicle that the data come from.
    pub vehicle: String,
    /// That vehicle's parameters.
    pub parameters: VehicleParameters,
    /// Standard deviations of the white noise of the measured `[v_x, v_y, omega]`, in m/s, m/s and rad/s, in the logs
    /// that the library was trained on. `None` if it was trained on simulated data or before this entry existed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurement_noise: Option<[f64; NY]>,
    /// Time in s by which the measured `[v_x, v_y, omega]` are late, as found in the logs. `None` as for the noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurement_delay: Option<f64>,
    /// Members, in order.
    pub members: Vec<MemberMetadata>,
    /// How the library was made: versions, settings, seeds.
    pub provenance: BTreeMap<String, String>,
}

impl Metadata {
    /// The metadata of a library still to be written, without a digest.
    pub(super) fn new(spec: &LibrarySpec) -> Self {
        let member = |member: &super::MemberData| MemberMetadata {
            label: member.label.clone(),
            friction: member.friction,
            dataset: member.dataset.clone(),
            n: member.inputs.len(),
            mean: match member.vehicle {
                None => PriorMean::Constant,
                Some(ModelParameters::SingleTrack(_)) => PriorMean::SingleTrack,
                Some(ModelParameters::Kinematic(_)) => PriorMean::Kinematic,
            },
            euler_steps: member.euler_steps,
        };
        Self {
            schema: SCHEMA_VERSION,
            sha256: "0".repeat(DIGITS),
            dt: spec.dt,
            kernel: spec.kernel.name().to_owned(),
            inputs: signals(&INPUTS),
            outputs: signals(&OUTPUTS),
            vehicle: spec.vehicle.clone(),
            parameters: spec.parameters,
            measurement_noise: spec.measurement_noise,
            measurement_delay: spec.measurement_delay,
            members: spec.members.iter().map(member).collect(),
            provenance: spec.provenance.clone(),
        }
    }

    /// The kernel, after every field was checked.
    pub(super) fn validate(&self) -> Result<Kernel, LibraryError> {
        for (found, expected) in [
            (&self.inputs, signals(&INPUTS)),
            (&self.outputs, signals(&OUTPUTS)),
        ] {
            if *found != expected {
                return Err(LibraryError::Signals {
                    found: listing(found),
                    expected: listing(&expected),
                });
            }
        }
        if !(MIN_DT..=MAX_DT).contains(&self.dt) {
            return Err(LibraryError::TimeStep {
                found: self.dt,
                min: MIN_DT,
                max: MAX_DT,
            });
        }
        self.parameters.validate().map_err(LibraryError::Vehicle)?;
        if let Some(found) = self.measurement_noise
            && !found.into_iter().all(WeightSettings::is_noise)
        {
            return Err(LibraryError::MeasurementNoise { found });
        }
        if let Some(found) = self.measurement_delay
            && !Settings::is_delay(found)
        {
            return Err(LibraryError::MeasurementDelay { found });
        }
        check_count("members", self.members.len(), MAX_MEMBERS)?;
        let mut common_steps = None;
        for (i, member) in self.members.iter().enumerate() {
            let label = member.label.clone();
            if label.is_empty() || self.members[..i].iter().any(|other| other.label == label) {
                return Err(LibraryError::Label { label });
            }
            if !(member.friction.is_finite() && member.friction > 0.0) {
                return Err(LibraryError::Friction {
                    label,
                    found: member.friction,
                });
            }
            let steps = 1..=if member.mean == PriorMean::SingleTrack {
                MAX_EULER_STEPS
            } else {
                1
            };
            if !steps.contains(&member.euler_steps) {
                return Err(LibraryError::EulerSteps {
                    label,
                    found: member.euler_steps,
                    limit: *steps.end(),
                });
            }
            if member.mean == PriorMean::SingleTrack {
                let first = *common_steps.get_or_insert(member.euler_steps);
                if member.euler_steps != first {
                    return Err(LibraryError::DifferentEulerSteps {
                        label,
                        found: member.euler_steps,
                        first,
                    });
                }
            }
            if member.n > 0 || member.mean == PriorMean::Constant {
                let what = format!("points of member \"{label}\"");
                check_count(&what, member.n, MAX_POINTS)?;
            }
        }
        Kernel::from_name(&self.kernel).ok_or_else(|| LibraryError::UnknownKernel {
            found: self.kernel.clone(),
        })
    }
}

/// Errors unless `1 <= found <= limit`.
pub(super) fn check_count(what: &str, found: usize, limit: usize) -> Result<(), LibraryError> {
    if (1..=limit).contains(&found) {
        return Ok(());
    }
    Err(LibraryError::Count {
        what: what.to_owned(),
        found,
        limit,
    })
}

fn signals(list: &[(&str, &str)]) -> Vec<Signal> {
    list.iter()
        .map(|&(name, unit)| Signal {
            name: name.to_owned(),
            unit: unit.to_owned(),
        })
        .collect()
}

fn listing(signals: &[Signal]) -> String {
    signals
        .iter()
        .map(|Signal { name, unit }| format!("{name} [{unit}]"))
        .collect::<Vec<_>>()
        .join(", ")
}
