//! The properties of a replica that a client needs to use it.

use egp_parameters::VehicleParameters;
use prost::Message as _;

use crate::error::printable;
use crate::proto::{self, VehicleParameters as VehicleMessage};
use crate::{GpInput, Invalid, LibraryId, VERSION, check, limits};

/// Answer of a replica's `ready` key.
#[derive(Clone, Debug, PartialEq)]
pub struct Ready {
    /// False while the replica drains.
    pub ready: bool,
    /// The library that vehicles which start now are to state in their requests; the fields below describe it.
    pub library: LibraryId,
    /// Further libraries that are served to requests that state them, at most [`Ready::MAX_OTHERS`].
    pub others: Vec<LibraryId>,
    /// Control period, s, from 1e-4 to 1.
    pub dt: f64,
    /// Inputs in a plan, T.
    pub horizon: u32,
    /// Largest useful number of transitions in a request, K.
    pub history: u32,
    /// The members' surfaces, in the order of the weights. [`Ready::decode`] replaces control characters.
    pub members: Vec<String>,
    /// Smallest and largest GP input `[v_x, v_y, omega, delta, F_x, delta_dot]` in the members' training data.
    pub envelope: [GpInput; 2],
    /// The vehicle that plans are made for: the library's, with the settings' mass and `l_f` in place of its own.
    /// Absent in the answers of older services.
    pub vehicle: Option<VehicleParameters>,
    /// Whether the replica answers only requests with the seal of a vehicle's key.
    pub sealed: bool,
}

impl Ready {
    /// Largest number of further libraries.
    pub const MAX_OTHERS: usize = 63;

    /// All libraries that are served, the described one first.
    pub fn libraries(&self) -> Vec<LibraryId> {
        let others = self.others.iter().copied();
        std::iter::once(self.library).chain(others).collect()
    }

    /// Whether the replica answers requests that state this library.
    pub fn serves(&self, library: &LibraryId) -> bool {
        self.library == *library || self.others.contains(library)
    }

    /// Bytes of an `egp.v1.Ready`.
    pub fn encode(&self) -> Vec<u8> {
        proto::Ready {
            version: VERSION,
            ready: self.ready,
            library: self.library.to_vec(),
            dt: self.dt,
            horizon: self.horizon,
            history: self.history,
            members: self.members.clone(),
            envelope: Some(proto::Tensor {
                shape: vec![2, 6],
                data: encode_values(self.envelope.as_flattened()),
            }),
            vehicle: self.vehicle.as_ref().map(vehicle_to_proto),
            others: self.others.iter().map(|id| id.to_vec()).collect(),
            sealed: self.sealed,
        }
        .encode_to_vec()
    }

    /// Reads and validates an `egp.v1.Ready`.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault.
    pub fn decode(bytes: &[u8]) -> Result<Self, Invalid> {
        check::size(bytes, limits::MESSAGE_BYTES)?;
        let raw = proto::Ready::decode(bytes)?;
        check::version(raw.version)?;
        if !(1e-4..=1.0).contains(&raw.dt) {
            return Err(Invalid::field(
                "dt",
                format!("expected seconds from 1e-4 to 1, got {}", raw.dt),
            ));
        }
        check::count("horizon", raw.horizon as usize, limits::HORIZON)?;
        check::count("members", raw.members.len(), limits::MEMBERS)?;
        check::at_most(
            "history",
            raw.history as usize,
            limits::HISTORY,
            "the limit of this side",
        )?;
        check::at_most(
            "others",
            raw.others.len(),
            Self::MAX_OTHERS,
            "further libraries",
        )?;
        let others = raw.others.iter().map(|id| check::library(id));
        Ok(Self {
            ready: raw.ready,
            library: check::library(&raw.library)?,
            others: others.collect::<Result<_, _>>()?,
            dt: raw.dt,
            horizon: raw.horizon,
            history: raw.history,
            members: raw.members.iter().map(|name| printable(name)).collect(),
            envelope: envelope(raw.envelope)?,
            vehicle: raw.vehicle.as_ref().map(vehicle_from_proto).transpose()?,
            sealed: raw.sealed,
        })
    }
}

fn encode_values(values: &[f64]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

/// Errors unless the envelope has two rows of finite numbers and every component's first is below its second.
fn envelope(tensor: Option<proto::Tensor>) -> Result<[GpInput; 2], Invalid> {
    const FIELD: &str = "envelope";
    let tensor = tensor.ok_or_else(|| Invalid::field(FIELD, "is required and absent"))?;
    let (values, rest) = tensor.data.as_chunks();
    let values: Vec<f64> = values.iter().copied().map(f64::from_le_bytes).collect();
    let (rows, []) = (values.as_chunks().0, rest) else {
        return Err(Invalid::field(
            FIELD,
            "its data are not a whole number of f64",
        ));
    };
    let (Ok(rows), [2, 6]) = (<[GpInput; 2]>::try_from(rows), tensor.shape.as_slice()) else {
        return Err(Invalid::field(
            FIELD,
            format!("expected shape [2, 6], got {:?}", tensor.shape),
        ));
    };
    let [low, high] = &rows;
    let ordered = |(low, high): (&f64, &f64)| low < high && (high - low).is_finite();
    if low.iter().zip(high).all(ordered) {
        Ok(rows)
    } else {
        Err(Invalid::field(
            FIELD,
            "expected finite numbers, each of row 0 below that of row 1",
        ))
    }
}

/// A struct of the given type with the parameters of `$vehicle`. Message and [`VehicleParameters`] have the same fields, and
/// the compiler reports one that is missing here.
macro_rules! with_parameters_of {
    ($vehicle:expr, $into:ident) => {
        $into {
            mass: $vehicle.mass,
            yaw_inertia: $vehicle.yaw_inertia,
            l_f: $vehicle.l_f,
            l_r: $vehicle.l_r,
            width: $vehicle.width,
            a_min: $vehicle.a_min,
            a_max: $vehicle.a_max,
            power: $vehicle.power,
            a_slew: $vehicle.a_slew,
            steering_angle: $vehicle.steering_angle,
            steering_rate: $vehicle.steering_rate,
            steering_slew: $vehicle.steering_slew,
            peak_slip: $vehicle.peak_slip,
            lateral_grip: $vehicle.lateral_grip,
            braking_grip: $vehicle.braking_grip,
            driving_grip: $vehicle.driving_grip,
        }
    };
}

fn vehicle_to_proto(vehicle: &VehicleParameters) -> VehicleMessage {
    with_parameters_of!(vehicle, VehicleMessage)
}

fn vehicle_from_proto(raw: &VehicleMessage) -> Result<VehicleParameters, Invalid> {
    let vehicle = with_parameters_of!(raw, VehicleParameters);
    match vehicle.validate() {
        Ok(()) => Ok(vehicle),
        Err(error) => Err(Invalid::field("vehicle", error.to_string())),
    }
}
