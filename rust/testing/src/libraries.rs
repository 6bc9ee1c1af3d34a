//! Libraries for tests: GPs on samples of a smooth function, with predictions of an independent dense implementation.
//!
//! The dense formulas share no code with the crate. They give the golden predictions that are checked at loading.

use std::collections::BTreeMap;

use egp_core::library::{LibrarySpec, MemberData, encode};
use egp_core::vehicle::ModelParameters;
use egp_core::{Kernel, Library, NY, NZ, VehicleParameters};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Centre of the box from which GP inputs are sampled.
pub const CENTRE: [f64; NZ] = [15.0, 0.0, 0.0, 0.0, 0.0, 0.0];
/// Half width of that box.
pub const HALF_WIDTH: [f64; NZ] = [10.0, 1.0, 0.8, 0.3, 8000.0, 0.4];

/// A library of one member for each friction coefficient.
pub fn library(kernel: Kernel, frictions: &[f64], n: usize, seed: u64) -> Library {
    Library::from_bytes(&encode(&spec(kernel, frictions, n, seed)).unwrap()).unwrap()
}

/// The content of [`library`], with one kernel for all outputs as in trained libraries.
pub fn spec(kernel: Kernel, frictions: &[f64], n: usize, seed: u64) -> LibrarySpec {
    spec_of(&Outputs::OneKernel, kernel, frictions, n, seed)
}

/// Which outputs share their kernel's hyperparameters.
pub enum Outputs {
    /// All outputs share one kernel.
    OneKernel,
    /// The first two outputs share one kernel.
    TwoKernels,
    /// Each output has its own kernel.
    OwnKernels,
}

/// [`spec`] with a choice of shared kernels.
pub fn spec_of(
    outputs: &Outputs,
    kernel: Kernel,
    frictions: &[f64],
    n: usize,
    seed: u64,
) -> LibrarySpec {
    let member = |(i, &friction)| member(outputs, kernel, friction, n, seed + i as u64);
    LibrarySpec {
        dt: 0.05,
        kernel,
        vehicle: "commonroad-1".to_owned(),
        parameters: VehicleParameters::FORD_ESCORT,
        measurement_noise: None,
        measurement_delay: None,
        provenance: BTreeMap::from([("source".to_owned(), "tests".to_owned())]),
        members: frictions.iter().enumerate().map(member).collect(),
    }
}

/// Makes the member a vehicle alone, without Gaussian processes.
pub fn leave_vehicle(member: &mut MemberData, vehicle: ModelParameters) {
    member.vehicle = Some(vehicle);
    (member.inputs, member.targets, member.alpha) = (vec![], vec![], Default::default());
    (member.target_mean, member.constant, member.outputscale) = ([0.0; NY], [0.0; NY], [0.0; NY]);
    (member.golden_z, member.golden_mean) = (vec![], vec![]);
    (member.golden_jacobian, member.golden_variance) = (vec![], vec![]);
}

/// A GP input, uniform in the sampled box widened by `spread`.
pub fn gp_input(rng: &mut ChaCha8Rng, spread: f64) -> [f64; NZ] {
    std::array::from_fn(|d| CENTRE[d] + spread * HALF_WIDTH[d] * rng.random_range(-1.0..1.0))
}

/// Change of a simplified vehicle over one period; its lateral force saturates in the slip angle by the friction.
fn change(z: &[f64; NZ], friction: f64) -> [f64; NY] {
    let [v_x, v_y, omega, delta, force, delta_dot] = *z;
    let front = friction * (5.0 * (delta - (v_y + 0.9 * omega) / v_x)).tanh();
    let rear = friction * (-5.0 * (v_y - 1.5 * omega) / v_x).tanh();
    [
        0.05 * (force / 1226.0 + v_y * omega - 2.0 * front * delta),
        0.05 * (4.0 * (front + rear) - v_x * omega) + 0.002 * delta_dot,
        0.05 * (6.0 * front - 7.0 * rear),
    ]
}

fn member(outputs: &Outputs, kernel: Kernel, friction: f64, n: usize, seed: u64) -> MemberData {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let inputs: Vec<[f64; NZ]> = (0..n).map(|_| gp_input(&mut rng, 1.0)).collect();
    let targets = inputs
        .iter()
        .map(|z| change(z, friction).map(|change| change + 0.005 * rng.random_range(-1.0..1.0)));
    let mut data = MemberData {
        label: format!("friction {friction}"),
        friction,
        dataset: "none".to_owned(),
        targets: targets.collect(),
        input_mean: CENTRE,
        input_std: HALF_WIDTH.map(|width| width / 3.0_f64.sqrt()),
        target_mean: [0.01, -0.02, 0.03],
        target_std: [0.2, 0.3, 0.25],
        lengthscales: std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(1.0..4.0))),
        outputscale: [1.5, 0.8, 1.1],
        noise: [1e-3, 2e-3, 5e-3],
        constant: [0.1, 0.0, -0.2],
        vehicle: None,
        resistance: None,
        euler_steps: 1,
        alpha: Default::default(),
        envelope: [
            std::array::from_fn(|d| CENTRE[d] - HALF_WIDTH[d]),
            std::array::from_fn(|d| CENTRE[d] + HALF_WIDTH[d]),
        ],
        golden_z: (0..6)
            .map(|i| gp_input(&mut rng, if i < 3 { 1.0 } else { 10.0 }))
            .collect(),
        golden_mean: Vec::new(),
        golden_jacobian: Vec::new(),
        golden_variance: Vec::new(),
        inputs,
    };
    let alike = match outputs {
        Outputs::OneKernel => 1..NY,
        Outputs::TwoKernels => 1..2,
        Outputs::OwnKernels => 1..1,
    };
    for o in alike {
        data.lengthscales[o] = data.lengthscales[0];
        data.outputscale[o] = data.outputscale[0];
        data.noise[o] = data.noise[0];
    }
    let dense: [Dense; NY] = std::array::from_fn(|o| Dense::new(kernel, &data, o));
    data.alpha = std::array::from_fn(|o| dense[o].alpha.as_slice().to_vec());
    for z in &data.golden_z {
        data.golden_mean
            .push(std::array::from_fn(|o| dense[o].mean(&data, z)));
        data.golden_jacobian
            .push(std::array::from_fn(|o| dense[o].gradient(&data, z)));
        data.golden_variance
            .push(std::array::from_fn(|o| dense[o].variance(&data, z)));
    }
    data
}

/// One output by textbook formulas on dense matrices.
struct Dense {
    kernel: Kernel,
    output: usize,
    covariance: Cholesky<f64, Dyn>,
    alpha: DVector<f64>,
}

impl Dense {
    fn new(kernel: Kernel, data: &MemberData, output: usize) -> Self {
        let n = data.inputs.len();
        let k = |i: usize, j: usize| {
            kernel_value(kernel, data, output, &data.inputs[i], &data.inputs[j])
        };
        let covariance = DMatrix::from_fn(n, n, k) + DMatrix::identity(n, n) * data.noise[output];
        let scaled =
            |y: &[f64; NY]| (y[output] - data.target_mean[output]) / data.target_std[output];
        let y = data
            .targets
            .iter()
            .map(|y| scaled(y) - data.constant[output]);
        let y = DVector::from_iterator(n, y);
        let cholesky = covariance.cholesky().unwrap();
        Self {
            kernel,
            output,
            alpha: cholesky.solve(&y),
            covariance: cholesky,
        }
    }

    fn covariances(&self, data: &MemberData, z: &[f64; NZ]) -> DVector<f64> {
        let k = data
            .inputs
            .iter()
            .map(|x| kernel_value(self.kernel, data, self.output, z, x));
        DVector::from_iterator(data.inputs.len(), k)
    }

    fn mean(&self, data: &MemberData, z: &[f64; NZ]) -> f64 {
        let o = self.output;
        let scaled = data.constant[o] + self.covariances(data, z).dot(&self.alpha);
        data.target_mean[o] + data.target_std[o] * scaled
    }

    /// Rasmussen & Williams' gradients with `r` itself, not `r²`.
    fn gradient(&self, data: &MemberData, z: &[f64; NZ]) -> [f64; NZ] {
        let o = self.output;
        std::array::from_fn(|d| {
            let terms = data.inputs.iter().zip(self.alpha.iter()).map(|(x, alpha)| {
                let r = distance(data, o, z, x);
                let length = data.lengthscales[o][d] * data.input_std[d];
                let slope_over_r = match self.kernel {
                    Kernel::Rbf => -(-0.5 * r * r).exp(),
                    Kernel::Matern52 => {
                        -5.0 / 3.0 * (1.0 + 5.0_f64.sqrt() * r) * (-5.0_f64.sqrt() * r).exp()
                    }
                };
                alpha * data.outputscale[o] * slope_over_r * (z[d] - x[d]) / (length * length)
            });
            data.target_std[o] * terms.sum::<f64>()
        })
    }

    fn variance(&self, data: &MemberData, z: &[f64; NZ]) -> f64 {
        let o = self.output;
        let k = self.covariances(data, z);
        data.target_std[o].powi(2) * (data.outputscale[o] - k.dot(&self.covariance.solve(&k)))
    }
}

fn distance(data: &MemberData, output: usize, a: &[f64; NZ], b: &[f64; NZ]) -> f64 {
    let term = |d: usize| (a[d] - b[d]) / data.input_std[d] / data.lengthscales[output][d];
    (0..NZ).map(|d| term(d).powi(2)).sum::<f64>().sqrt()
}

fn kernel_value(
    kernel: Kernel,
    data: &MemberData,
    output: usize,
    a: &[f64; NZ],
    b: &[f64; NZ],
) -> f64 {
    let r = distance(data, output, a, b);
    let root5 = 5.0_f64.sqrt();
    data.outputscale[output]
        * match kernel {
            Kernel::Rbf => (-0.5 * r * r).exp(),
            Kernel::Matern52 => (1.0 + root5 * r + 5.0 * r * r / 3.0) * (-root5 * r).exp(),
        }
}
