//! One surface's vehicle and the GPs that are added to it, in physical units.

use egp_parameters::{GRAVITY, VehicleParameters};

use super::data::MemberData;
use crate::gp::{Gp, HorizonScratch, Hyperparameters, SingularCovariance};
use crate::scaler::Scaler;
use crate::vehicle::{Resistance, TyreLimits, VehicleModel};
use crate::{GpInput, GpJacobian, GpOutput, Kernel, NY, NZ, VarianceScratch};

/// Distance between the wheels of an axle as a share of the vehicle's width. It is 0.83, 0.86 and 0.85 at the front of
/// CommonRoad's Ford Escort, BMW 320i and VW Vanagon.
const TRACK: f64 = 0.83;

/// Share of the slip at the peak of the front force to which plans bound the slip of the front tyres. The fitted force is
/// there at least 0.99 of its peak and still rises. At the peak the linearisation says that steering has no effect, and beyond
/// it that more steering turns the vehicle less.
const SHARE_OF_PEAK_SLIP: f64 = 0.9;

/// The vehicle and the GPs of one surface. All arguments and results are in physical units; the GPs are evaluated in the
/// z-scored space. Without a vehicle the GPs learn the whole change; without training points the vehicle is the whole
/// prediction.
#[derive(Clone, Debug)]
pub struct Member {
    label: String,
    friction: f64,
    dataset: String,
    envelope: (GpInput, GpInput),
    input_scaler: Scaler<NZ>,
    target_scaler: Scaler<NY>,
    hyperparameters: [Hyperparameters; NY],
    gp: Gp,
    vehicle: Option<VehicleModel>,
}

impl Member {
    /// Scales and factors the data of a member, whose values were checked before.
    pub(super) fn new(
        data: &MemberData,
        kernel: Kernel,
        dt: f64,
    ) -> Result<Self, SingularCovariance> {
        let input_scaler = Scaler::new(data.input_mean, data.input_std);
        let hyperparameters = std::array::from_fn(|o| Hyperparameters {
            lengthscales: data.lengthscales[o],
            outputscale: data.outputscale[o],
            noise: data.noise[o],
            constant: data.constant[o],
        });
        let inputs: Vec<GpInput> = data
            .inputs
            .iter()
            .map(|&z| input_scaler.scale(&z.into()))
            .collect();
        let gp = Gp::new(kernel, &inputs, &hyperparameters, &data.alpha)?;
        let [rolling, drag] = data.resistance.unwrap_or_default();
        let resistance = Resistance { rolling, drag };
        Ok(Self {
            label: data.label.clone(),
            friction: data.friction,
            dataset: data.dataset.clone(),
            envelope: (data.envelope[0].into(), data.envelope[1].into()),
            input_scaler,
            target_scaler: Scaler::new(data.target_mean, data.target_std),
            hyperparameters,
            gp,
            vehicle: data.vehicle.map(|parameters| {
                VehicleModel::new(&parameters, dt)
                    .with_resistance(resistance)
                    .with_steps(data.euler_steps)
            }),
        })
    }

    /// The surface's name.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// Nominal friction coefficient of the surface.
    pub fn friction(&self) -> f64 {
        self.friction
    }

    /// Slip angle in rad to which plans bound that of the front tyres on this surface, by default: 0.9 of that at the peak
    /// of the fitted axle's force, [`SingleTrack::peak_slip`](crate::vehicle::SingleTrack::peak_slip).
    ///
    /// A member without a single-track vehicle has no tyres of its own. Those of `vehicle` take their place, whose peak
    /// is taken to move in proportion to the friction, as if the stiffness were the same on all surfaces (Pacejka, *Tire
    /// and Vehicle Dynamics*, 3rd ed., section 1.2.1).
    pub fn slip_bound(&self, vehicle: &VehicleParameters) -> f64 {
        let peak = match &self.vehicle {
            Some(VehicleModel::SingleTrack(fitted)) => fitted.peak_slip(),
            Some(VehicleModel::Kinematic(_)) | None => vehicle.peak_slip * self.friction,
        };
        SHARE_OF_PEAK_SLIP * peak
    }

    /// Largest lateral acceleration of a steady bend on this surface, as a fraction of `mu g`: that of the fitted vehicle,
    /// [`SingleTrack::largest_lateral_acceleration`](crate::vehicle::SingleTrack::largest_lateral_acceleration), without the
    /// member's Gaussian processes. A member without a single-track vehicle has the `lateral_grip` of `vehicle`.
    pub fn lateral_grip(&self, vehicle: &VehicleParameters) -> f64 {
        match &self.vehicle {
            Some(VehicleModel::SingleTrack(fitted)) => {
                fitted.largest_lateral_acceleration() / self.friction
            }
            Some(VehicleModel::Kinematic(_)) | None => vehicle.lateral_grip,
        }
    }

    /// What the tyres transmit on this surface, for the bounds of the OCP: those of the fitted vehicle. A member without a
    /// single-track vehicle has [`Self::slip_bound`] and the largest accelerations of `vehicle`. Its lateral force has no
    /// coupling with the longitudinal one if the wheels roll without slip; otherwise the coupling is that of a friction
    /// circle: at `|F_x| / m = sqrt(½) mu g` half of the squared lateral force remains. The load that moves to
    /// the outside of a bend is `2 h / (g b)` for each m/s², with the fitted height `h` and the track `b`, which is 0.83 of the
    /// width of `vehicle`; without a fitted height none moves.
    pub fn tyre_limits(&self, vehicle: &VehicleParameters) -> TyreLimits {
        let [drive, brake] = match &self.vehicle {
            Some(VehicleModel::SingleTrack(fitted)) => fitted.largest_accelerations(),
            Some(VehicleModel::Kinematic(_)) | None => [vehicle.a_max, -vehicle.a_min],
        };
        let coupling = match &self.vehicle {
            Some(VehicleModel::SingleTrack(fitted)) => fitted.couplings(),
            Some(VehicleModel::Kinematic(_)) => [0.0; 2],
            None => [2.0 * (self.friction * GRAVITY).powi(-2); 2],
        };
        let transfer = match &self.vehicle {
            Some(VehicleModel::SingleTrack(fitted)) => {
                2.0 * fitted.height() / (GRAVITY * TRACK * vehicle.width)
            }
            Some(VehicleModel::Kinematic(_)) | None => 0.0,
        };
        TyreLimits {
            friction: self.friction,
            slip: self.slip_bound(vehicle),
            drive,
            brake,
            coupling,
            transfer,
            lateral: GRAVITY * self.friction * self.lateral_grip(vehicle),
            braking: 1.0,
        }
    }

    /// SHA-256 of the dataset the member was trained on, hexadecimal.
    pub fn dataset(&self) -> &str {
        &self.dataset
    }

    /// Smallest and largest inputs for which the member is meant: those of the data it was fitted to.
    pub fn envelope(&self) -> (GpInput, GpInput) {
        self.envelope
    }

    /// Number of training points; 0 for a vehicle alone.
    pub fn n_points(&self) -> usize {
        self.gp.n_points()
    }

    /// Hyperparameters of each output in the z-scored space.
    pub fn hyperparameters(&self) -> &[Hyperparameters; NY] {
        &self.hyperparameters
    }

    /// From physical to z-scored inputs.
    pub(crate) fn input_scaler(&self) -> &Scaler<NZ> {
        &self.input_scaler
    }

    /// From physical to z-scored targets.
    pub fn target_scaler(&self) -> &Scaler<NY> {
        &self.target_scaler
    }

    /// Standard deviation of the targets' noise, in output units: what inputs do not determine, and, if the training
    /// data were measured, their noise.
    pub fn noise_std(&self) -> GpOutput {
        GpOutput::from_fn(|o, _| self.hyperparameters[o].noise.sqrt() * self.target_scaler.std()[o])
    }

    /// The vehicle that the GPs are added to, if any.
    pub fn vehicle(&self) -> Option<&VehicleModel> {
        self.vehicle.as_ref()
    }

    /// The predictive mean at `z`, in output units: the vehicle's, if any, plus the GPs'.
    pub fn mean(&self, z: &GpInput) -> GpOutput {
        let learned = self.learned(z);
        match &self.vehicle {
            None => learned,
            Some(known) => known.change(z) + learned,
        }
    }

    /// The predictive mean at `z` and its Jacobian, both in physical units.
    pub fn mean_jacobian(&self, z: &GpInput, jacobian: &mut GpJacobian) -> GpOutput {
        let known = self.vehicle.as_ref().map(|known| known.change_jacobian(z));
        self.mean_jacobian_beside(known, z, jacobian)
    }

    /// Like [`Self::mean_jacobian`], with the change and the Jacobian of the member's vehicle, if it has one.
    ///
    /// For the GPs by the chain rule `∂y_o/∂z_d = target_std_o / input_std_d · ∂ŷ_o/∂ẑ_d`.
    fn mean_jacobian_beside(
        &self,
        known: Option<(GpOutput, GpJacobian)>,
        z: &GpInput,
        jacobian: &mut GpJacobian,
    ) -> GpOutput {
        let scaled = self.gp.mean_jacobian(&self.input_scaler.scale(z), jacobian);
        for o in 0..NY {
            for d in 0..NZ {
                jacobian[(o, d)] *= self.target_scaler.std()[o] / self.input_scaler.std()[d];
            }
        }
        let learned = self.target_scaler.unscale(&scaled);
        let Some((change, slopes)) = known else {
            return learned;
        };
        *jacobian += slopes;
        change + learned
    }

    /// The predictive mean at `z` and the slopes with which plans are linearised, both in physical units, with the change and
    /// the Jacobian of the member's vehicle, if it has one.
    ///
    /// The slopes are those of a single-track vehicle without the GPs, and otherwise the Jacobian of the mean. GPs learn the
    /// values of transitions over one period. Their slopes mislead plans over many periods, above all that of `v_y` and `omega`
    /// over `F_x`: within a period the wheels' speeds, the tyres and the suspension have hardly followed the force, and what it
    /// costs in a bend shows only later, in states that the model does not have. `docs/problem.md`, section 5, has the figures.
    pub(crate) fn tangent(
        &self,
        known: Option<(GpOutput, GpJacobian)>,
        z: &GpInput,
        slopes: &mut GpJacobian,
    ) -> GpOutput {
        match (&self.vehicle, known) {
            (Some(VehicleModel::SingleTrack(_)), Some((change, own))) => {
                *slopes = own;
                change + self.learned(z)
            }
            _ => self.mean_jacobian_beside(known, z, slopes),
        }
    }

    /// What the GPs add to the member's vehicle, in output units.
    fn learned(&self, z: &GpInput) -> GpOutput {
        let scaled = self.gp.mean(&self.input_scaler.scale(z));
        self.target_scaler.unscale(&scaled)
    }

    /// The variance of the latent function at `z`, in squared output units.
    pub fn variance(&self, z: &GpInput, scratch: &mut VarianceScratch) -> GpOutput {
        let std = self.target_scaler.std();
        self.gp
            .variance(&self.input_scaler.scale(z), scratch)
            .component_mul(&std.component_mul(std))
    }

    /// Upper bounds of the variances of the latent function at `z`, in squared output units, for reports that add
    /// at least `floor` and the noise to them; see [`Gp::variance_bounds`].
    pub(crate) fn variance_bounds(
        &self,
        z: &[GpInput],
        floor: &[GpOutput],
        scratch: &mut HorizonScratch,
        scaled_floor: &mut Vec<GpOutput>,
        out: &mut [GpOutput],
    ) {
        let std = self.target_scaler.std();
        let square = std.component_mul(std);
        let noise = GpOutput::from_fn(|o, _| self.hyperparameters[o].noise);
        scratch.z.clear();
        scratch
            .z
            .extend(z.iter().map(|z| self.input_scaler.scale(z)));
        scaled_floor.clear();
        scaled_floor.extend(
            floor
                .iter()
                .map(|floor| floor.component_div(&square) + noise),
        );
        self.gp.variance_bounds(scaled_floor, scratch, out);
        for out in out {
            out.component_mul_assign(&square);
        }
    }
}
