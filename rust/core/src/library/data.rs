//! The content of a library as plain numbers: what a trainer hands over and what a file holds.

use std::collections::BTreeMap;

use egp_parameters::VehicleParameters;

use super::LibraryError;
use super::format::Source;
use super::limits::MAX_GOLDEN;
use super::metadata::{MemberMetadata, PriorMean, check_count};
use crate::vehicle::{KINEMATIC_PARAMETERS, ModelParameters, SINGLE_TRACK_PARAMETERS};
use crate::{Kernel, NY, NZ};

/// Everything a library file is written from.
#[derive(Clone, Debug)]
pub struct LibrarySpec {
    /// Period over which the outputs change, s.
    pub dt: f64,
    /// The kernel of all members.
    pub kernel: Kernel,
    /// Name of the vehicle that the data come from.
    pub vehicle: String,
    /// That vehicle's parameters.
    pub parameters: VehicleParameters,
    /// Standard deviations of the noise of the measured `[v_x, v_y, omega]`, m/s, m/s and rad/s, if it is known.
    pub measurement_noise: Option<[f64; NY]>,
    /// Time in s by which the measured `[v_x, v_y, omega]` are late, if it is known.
    pub measurement_delay: Option<f64>,
    /// How the library was made: versions, settings, seeds.
    pub provenance: BTreeMap<String, String>,
    /// One member for each surface.
    pub members: Vec<MemberData>,
}

/// One surface's vehicle and GPs. Inputs, targets, scalers, vehicle, envelope and golden predictions are in physical
/// units; everything else lives in the z-scored space. `M` points, `G` golden points.
///
/// A member with a vehicle may have no training points, and then needs no golden ones. With the `outputscale` 0 its
/// variance is that of the noise.
#[derive(Clone, Debug, PartialEq)]
pub struct MemberData {
    /// The surface's name.
    pub label: String,
    /// Nominal friction coefficient of the surface.
    pub friction: f64,
    /// SHA-256 of the dataset the member was trained on, hexadecimal.
    pub dataset: String,
    /// Training inputs, `[M, 6]`.
    pub inputs: Vec<[f64; NZ]>,
    /// Training targets, `[M, 3]`.
    pub targets: Vec<[f64; NY]>,
    /// Means of the inputs for z-scoring, `[6]`.
    pub input_mean: [f64; NZ],
    /// Standard deviations of the inputs for z-scoring, `[6]`.
    pub input_std: [f64; NZ],
    /// Means of the targets, less the vehicle's part, for z-scoring, `[3]`.
    pub target_mean: [f64; NY],
    /// Standard deviations of the same, `[3]`.
    pub target_std: [f64; NY],
    /// Lengthscales, `[3, 6]`.
    pub lengthscales: [[f64; NZ]; NY],
    /// Prior variances, `[3]`; without training points they may be zero.
    pub outputscale: [f64; NY],
    /// Noise variances, `[3]`.
    pub noise: [f64; NY],
    /// Prior means, `[3]`; on top of the vehicle's prediction.
    pub constant: [f64; NY],
    /// The vehicle that the GPs are added to, if any.
    pub vehicle: Option<ModelParameters>,
    /// Rolling resistance (m/s²) and drag (1/m) of a single-track vehicle, `[2]`, both positive, if it has any.
    pub resistance: Option<[f64; 2]>,
    /// Number of steps of the Euler method with which a single-track vehicle predicts a period, 1 to 100.
    pub euler_steps: u32,
    /// `(K + s² I)⁻¹ (y - m)`, `[3, M]`.
    pub alpha: [Vec<f64>; NY],
    /// Smallest and largest inputs for which the member is meant: those of the data it was fitted to, `[2, 6]`.
    pub envelope: [[f64; NZ]; 2],
    /// Where the trainer predicted, `[G, 6]`.
    pub golden_z: Vec<[f64; NZ]>,
    /// The trainer's means, `[G, 3]`.
    pub golden_mean: Vec<[f64; NY]>,
    /// The trainer's Jacobians, `[G, 3, 6]`.
    pub golden_jacobian: Vec<[[f64; NZ]; NY]>,
    /// The trainer's latent variances, `[G, 3]`.
    pub golden_variance: Vec<[f64; NY]>,
}

/// A tensor to be written: name inside the member, shape, numbers in row-major order.
pub(super) type Tensor = (&'static str, Vec<usize>, Vec<f64>);

impl MemberData {
    /// The tensors of this member, in the order of the format's description.
    pub(super) fn tensors(&self) -> Vec<Tensor> {
        let alpha = self.alpha.concat();
        let mut tensors = Vec::new();
        let mut add = |name, shape: &[usize], values: &[f64]| {
            tensors.push((name, shape.to_vec(), values.to_vec()));
        };
        add(
            "inputs",
            &[self.inputs.len(), NZ],
            self.inputs.as_flattened(),
        );
        add(
            "targets",
            &[self.targets.len(), NY],
            self.targets.as_flattened(),
        );
        add("input_mean", &[NZ], &self.input_mean);
        add("input_std", &[NZ], &self.input_std);
        add("target_mean", &[NY], &self.target_mean);
        add("target_std", &[NY], &self.target_std);
        add("lengthscales", &[NY, NZ], self.lengthscales.as_flattened());
        add("outputscale", &[NY], &self.outputscale);
        add("noise", &[NY], &self.noise);
        add("constant", &[NY], &self.constant);
        add("alpha", &[NY, alpha.len() / NY], &alpha);
        add("envelope", &[2, NZ], self.envelope.as_flattened());
        add(
            "golden_z",
            &[self.golden_z.len(), NZ],
            self.golden_z.as_flattened(),
        );
        add(
            "golden_mean",
            &[self.golden_mean.len(), NY],
            self.golden_mean.as_flattened(),
        );
        add(
            "golden_jacobian",
            &[self.golden_jacobian.len(), NY, NZ],
            self.golden_jacobian.as_flattened().as_flattened(),
        );
        add(
            "golden_variance",
            &[self.golden_variance.len(), NY],
            self.golden_variance.as_flattened(),
        );
        match &self.vehicle {
            None => {}
            Some(ModelParameters::SingleTrack(p)) => {
                add("single_track", &[p.len()], p);
            }
            Some(ModelParameters::Kinematic(p)) => {
                add("kinematic", &[p.len()], p);
            }
        }
        if let Some(resistance) = self.resistance {
            add("resistance", &[2], &resistance);
        }
        tensors
    }

    /// Reads one member; shapes are checked by the source, values by the verification.
    pub(super) fn read(
        metadata: &MemberMetadata,
        source: &mut Source,
    ) -> Result<Self, LibraryError> {
        let m = metadata.n;
        let g = source.leading("golden_z")?;
        if g > 0 || m > 0 {
            let what = format!("golden points of member \"{}\"", metadata.label);
            check_count(&what, g, MAX_GOLDEN)?;
        }
        let inputs = rows(&source.take("inputs", &[m, NZ])?);
        let targets = rows(&source.take("targets", &[m, NY])?);
        let mut vector_z = |name| Ok(row(&source.take(name, &[NZ])?));
        let (input_mean, input_std) = (vector_z("input_mean")?, vector_z("input_std")?);
        let mut vector_y = |name| Ok(row(&source.take(name, &[NY])?));
        let (target_mean, target_std) = (vector_y("target_mean")?, vector_y("target_std")?);
        let (outputscale, noise, constant) = (
            vector_y("outputscale")?,
            vector_y("noise")?,
            vector_y("constant")?,
        );
        let alpha = source.take("alpha", &[NY, m])?;
        let vehicle = match metadata.mean {
            PriorMean::Constant => None,
            PriorMean::SingleTrack => {
                let parameters = source.take("single_track", &[SINGLE_TRACK_PARAMETERS])?;
                Some(ModelParameters::SingleTrack(row(&parameters)))
            }
            PriorMean::Kinematic => {
                let parameters = source.take("kinematic", &[KINEMATIC_PARAMETERS])?;
                Some(ModelParameters::Kinematic(row(&parameters)))
            }
        };
        let resistance = if metadata.mean == PriorMean::SingleTrack && source.has("resistance") {
            Some(row(&source.take("resistance", &[2])?))
        } else {
            None
        };
        Ok(Self {
            label: metadata.label.clone(),
            friction: metadata.friction,
            dataset: metadata.dataset.clone(),
            inputs,
            targets,
            input_mean,
            input_std,
            target_mean,
            target_std,
            lengthscales: row(&rows(&source.take("lengthscales", &[NY, NZ])?)),
            outputscale,
            noise,
            constant,
            vehicle,
            resistance,
            euler_steps: metadata.euler_steps,
            alpha: std::array::from_fn(|o| alpha[o * m..(o + 1) * m].to_vec()),
            envelope: row(&rows(&source.take("envelope", &[2, NZ])?)),
            golden_z: rows(&source.take("golden_z", &[g, NZ])?),
            golden_mean: rows(&source.take("golden_mean", &[g, NY])?),
            golden_jacobian: rows(&rows(&source.take("golden_jacobian", &[g, NY, NZ])?)),
            golden_variance: rows(&source.take("golden_variance", &[g, NY])?),
        })
    }
}

/// Groups of `C` consecutive elements; the count was checked with the shape.
fn rows<T: Copy, const C: usize>(flat: &[T]) -> Vec<[T; C]> {
    flat.as_chunks().0.to_vec()
}

/// The first `C` elements; the count was checked with the shape.
fn row<T: Copy, const C: usize>(flat: &[T]) -> [T; C] {
    std::array::from_fn(|i| flat[i])
}
