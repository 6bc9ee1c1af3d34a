//! `VehicleParameters`.

use std::collections::BTreeMap;

use egp_gate::Limits;
use egp_plant::VehicleId;
use pyo3::prelude::*;
use serde::Deserialize as _;
use serde::de::value::{Error, MapDeserializer};

use crate::error::InvalidArgumentError;

#[doc = doc!(VehicleParameters)]
#[pyclass(module = "egp_service._core", frozen, eq)]
#[derive(PartialEq)]
pub struct VehicleParameters(pub egp_parameters::VehicleParameters);

/// The methods of `VehicleParameters`, with a getter for each field that is named.
macro_rules! methods {
    ($($field:ident)*) => {
        #[pymethods]
        impl VehicleParameters {
            $(
                #[doc = doc!(VehicleParameters.$field)]
                #[getter]
                fn $field(&self) -> f64 {
                    self.0.$field
                }
            )*

            #[new]
            #[pyo3(signature = (**fields))]
            fn new(fields: Option<BTreeMap<String, f64>>) -> PyResult<Self> {
                let fields = fields.unwrap_or_default();
                let deserializer = MapDeserializer::<_, Error>::new(fields.into_iter());
                let vehicle = egp_parameters::VehicleParameters::deserialize(deserializer)
                    .map_err(|error| InvalidArgumentError::new_err(format!("vehicle parameters: {error}")))?;
                vehicle.validate().map_err(InvalidArgumentError::raise)?;
                Ok(Self(vehicle))
            }

            #[doc = doc!(VehicleParameters.commonroad)]
            #[staticmethod]
            fn commonroad(number: u32) -> PyResult<Self> {
                let id = VehicleId::try_from(number).map_err(InvalidArgumentError::raise)?;
                Ok(Self(id.vehicle()))
            }

            #[doc = doc!(VehicleParameters.ranges)]
            #[staticmethod]
            fn ranges() -> BTreeMap<&'static str, (f64, f64)> {
                let ranges = egp_parameters::VehicleParameters::ranges().into_iter();
                ranges.map(|(name, least, most)| (name, (least, most))).collect()
            }

            #[doc = doc!(VehicleParameters.fields)]
            fn fields(&self) -> BTreeMap<&'static str, f64> {
                let fields = self.0.fields().into_iter();
                fields.map(|(name, _, value)| (name, value)).collect()
            }

            #[doc = doc!(VehicleParameters.scale)]
            #[getter]
            fn scale(&self) -> f64 {
                self.0.scale()
            }

            #[doc = doc!(VehicleParameters.slip_speed)]
            #[getter]
            fn slip_speed(&self) -> f64 {
                self.0.slip_speed()
            }

            #[doc = doc!(VehicleParameters.gate_limits)]
            fn gate_limits(&self) -> BTreeMap<&'static str, f64> {
                let limits = Limits::of(&self.0).fields().into_iter();
                limits.map(|(name, _, value)| (name, value)).collect()
            }

            /// The keywords of `new`, from which pickle makes the same vehicle again.
            fn __getnewargs_ex__(&self) -> ((), BTreeMap<&'static str, f64>) {
                ((), self.fields())
            }

            fn __repr__(&self) -> String {
                let field = |(name, _, value)| format!("{name}={value:?}");
                let fields: Vec<String> = self.0.fields().into_iter().map(field).collect();
                format!("VehicleParameters({})", fields.join(", "))
            }
        }
    };
}

methods! {
    mass yaw_inertia l_f l_r width a_min a_max power a_slew steering_angle steering_rate steering_slew
    peak_slip lateral_grip braking_grip driving_grip
}

#[doc = doc!(slip_speed)]
#[pyfunction]
pub fn slip_speed(wheelbase: f64) -> f64 {
    egp_parameters::slip_speed(wheelbase)
}
