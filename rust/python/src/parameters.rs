//! `VehicleParameters`.

use std::collections::BTreeMap;

use egp_gate::Limits;
use egp_plant::VehicleId;
use pyo3::prelude::*;
use serde::Deserialize as _;
use serde::de::value::{Error, MapDeserializer};

use crate::error::raise;

/// What one vehicle is and what its actuators may be asked for.
#[pyclass(module = "egp_service._core", frozen, eq)]
#[derive(PartialEq)]
pub struct VehicleParameters(pub egp_parameters::VehicleParameters);

#[pymethods]
impl VehicleParameters {
    #[new]
    #[pyo3(signature = (**fields))]
    fn new(fields: Option<BTreeMap<String, f64>>) -> PyResult<Self> {
        let fields = fields.unwrap_or_default();
        let deserializer = MapDeserializer::<_, Error>::new(fields.into_iter());
        let vehicle = egp_parameters::VehicleParameters::deserialize(deserializer)
            .map_err(|error| raise(format!("vehicle parameters: {error}")))?;
        vehicle.validate().map_err(raise)?;
        Ok(Self(vehicle))
    }

    #[staticmethod]
    fn commonroad(number: u32) -> PyResult<Self> {
        let id = VehicleId::try_from(number).map_err(raise)?;
        Ok(Self(id.vehicle()))
    }

    fn fields(&self) -> BTreeMap<&'static str, f64> {
        let fields = self.0.fields().into_iter();
        fields.map(|(name, _, value)| (name, value)).collect()
    }

    fn gate_limits(&self) -> BTreeMap<&'static str, f64> {
        let limits = Limits::of(&self.0).fields().into_iter();
        limits.map(|(name, _, value)| (name, value)).collect()
    }

    #[getter]
    fn mass(&self) -> f64 {
        self.0.mass
    }

    #[getter]
    fn yaw_inertia(&self) -> f64 {
        self.0.yaw_inertia
    }

    #[getter]
    fn l_f(&self) -> f64 {
        self.0.l_f
    }

    #[getter]
    fn l_r(&self) -> f64 {
        self.0.l_r
    }

    #[getter]
    fn width(&self) -> f64 {
        self.0.width
    }

    #[getter]
    fn a_min(&self) -> f64 {
        self.0.a_min
    }

    #[getter]
    fn a_max(&self) -> f64 {
        self.0.a_max
    }

    #[getter]
    fn power(&self) -> f64 {
        self.0.power
    }

    #[getter]
    fn a_slew(&self) -> f64 {
        self.0.a_slew
    }

    #[getter]
    fn steering_angle(&self) -> f64 {
        self.0.steering_angle
    }

    #[getter]
    fn steering_rate(&self) -> f64 {
        self.0.steering_rate
    }

    #[getter]
    fn steering_slew(&self) -> f64 {
        self.0.steering_slew
    }

    #[getter]
    fn peak_slip(&self) -> f64 {
        self.0.peak_slip
    }

    #[getter]
    fn lateral_grip(&self) -> f64 {
        self.0.lateral_grip
    }

    #[getter]
    fn braking_grip(&self) -> f64 {
        self.0.braking_grip
    }

    #[getter]
    fn driving_grip(&self) -> f64 {
        self.0.driving_grip
    }

    fn __repr__(&self) -> String {
        let field = |(name, _, value)| format!("{name}={value:?}");
        let fields: Vec<String> = self.0.fields().into_iter().map(field).collect();
        format!("VehicleParameters({})", fields.join(", "))
    }
}

/// Adds this file's class and constants to the module.
///
/// # Errors
/// Errors if the module does not accept the name.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("GRAVITY", egp_parameters::GRAVITY)?;
    module.add("STANDARD_GRAVITY", egp_parameters::STANDARD_GRAVITY)?;
    module.add_class::<VehicleParameters>()
}
