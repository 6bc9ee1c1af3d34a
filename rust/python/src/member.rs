//! `Member`.

use egp_core::gp::Hyperparameters;
use egp_core::vehicle::{ModelParameters, Resistance, VehicleModel};
use egp_core::{NY, NZ};
use pyo3::prelude::*;

use crate::array::{NewMatrix, NewVector, array, vector};
use crate::library::Library;
use crate::text::quoted;

#[doc = doc!(Member)]
#[pyclass(module = "egp_service._core", frozen)]
pub struct Member {
    pub library: Py<Library>,
    pub index: usize,
}

impl Member {
    fn get(&self) -> &egp_core::Member {
        &self.whole().members()[self.index]
    }

    fn whole(&self) -> &egp_core::Library {
        &self.library.get().inner
    }

    fn each<'py>(&self, py: Python<'py>, value: fn(&Hyperparameters) -> f64) -> NewVector<'py> {
        vector(py, self.get().hyperparameters().iter().map(value))
    }
}

#[pymethods]
impl Member {
    #[doc = doc!(Member.label)]
    #[getter]
    fn label(&self) -> &str {
        self.get().label()
    }

    #[doc = doc!(Member.friction)]
    #[getter]
    fn friction(&self) -> f64 {
        self.get().friction()
    }

    #[doc = doc!(Member.slip_bound)]
    #[getter]
    fn slip_bound(&self) -> f64 {
        self.get().slip_bound(self.whole().vehicle())
    }

    #[doc = doc!(Member.lateral_grip)]
    #[getter]
    fn lateral_grip(&self) -> f64 {
        self.get().lateral_grip(self.whole().vehicle())
    }

    #[doc = doc!(Member.dataset)]
    #[getter]
    fn dataset(&self) -> &str {
        self.get().dataset()
    }

    #[doc = doc!(Member.n_points)]
    #[getter]
    fn n_points(&self) -> usize {
        self.get().n_points()
    }

    #[doc = doc!(Member.envelope)]
    #[getter]
    fn envelope<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        let (min, max) = self.get().envelope();
        array(py, min.iter().chain(max.iter()).copied().collect(), [2, NZ])
    }

    #[doc = doc!(Member.lengthscales)]
    #[getter]
    fn lengthscales<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        array(
            py,
            self.get()
                .hyperparameters()
                .iter()
                .flat_map(|hyper| hyper.lengthscales)
                .collect(),
            [NY, NZ],
        )
    }

    #[doc = doc!(Member.outputscale)]
    #[getter]
    fn outputscale<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        self.each(py, |hyper| hyper.outputscale)
    }

    #[doc = doc!(Member.noise)]
    #[getter]
    fn noise<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        self.each(py, |hyper| hyper.noise)
    }

    #[doc = doc!(Member.constant)]
    #[getter]
    fn constant<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        self.each(py, |hyper| hyper.constant)
    }

    #[doc = doc!(Member.single_track)]
    #[getter]
    fn single_track<'py>(&self, py: Python<'py>) -> Option<NewVector<'py>> {
        match self.get().vehicle()?.parameters() {
            ModelParameters::SingleTrack(parameters) => Some(vector(py, parameters)),
            ModelParameters::Kinematic(_) => None,
        }
    }

    #[doc = doc!(Member.euler_steps)]
    #[getter]
    fn euler_steps(&self) -> u32 {
        match self.get().vehicle() {
            Some(VehicleModel::SingleTrack(vehicle)) => vehicle.steps(),
            Some(VehicleModel::Kinematic(_)) | None => 1,
        }
    }

    #[doc = doc!(Member.resistance)]
    #[getter]
    fn resistance<'py>(&self, py: Python<'py>) -> Option<NewVector<'py>> {
        match self.get().vehicle()? {
            VehicleModel::SingleTrack(vehicle) => {
                let Resistance { rolling, drag } = vehicle.resistance();
                Some(vector(py, [rolling, drag]))
            }
            VehicleModel::Kinematic(_) => None,
        }
    }

    #[doc = doc!(Member.kinematic)]
    #[getter]
    fn kinematic<'py>(&self, py: Python<'py>) -> Option<NewVector<'py>> {
        match self.get().vehicle()?.parameters() {
            ModelParameters::Kinematic(parameters) => Some(vector(py, parameters)),
            ModelParameters::SingleTrack(_) => None,
        }
    }

    #[doc = doc!(Member.noise_std)]
    #[getter]
    fn noise_std<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.get().noise_std().iter().copied())
    }

    /// The method and the index with which pickle makes the member again from its library.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (usize,))> {
        let library = self.library.bind(py);
        Ok((library.getattr("_member")?, (self.index,)))
    }

    /// The member itself, which does not change.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// The member itself, which does not change.
    #[pyo3(signature = (_memo, /))]
    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let (label, friction) = (quoted(py, self.label())?, self.friction());
        let n_points = self.n_points();
        Ok(format!(
            "Member(label={label}, friction={friction:?}, n_points={n_points})"
        ))
    }
}
