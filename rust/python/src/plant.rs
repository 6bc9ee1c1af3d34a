//! `Plant`, `FrictionMap` and the functions on many states at once.

use egp_plant::{BatchItem, Map, NX, Parameters, StateVector, Uniform, VehicleId, VehicleState};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, ToPyArray,
};
use pyo3::prelude::*;

use crate::error::{EgpError, raise};

/// A batch after one period: the states, and which plants made it.
type Stepped<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<bool>>);

/// A simulated vehicle.
#[pyclass(module = "egp_service._core")]
struct Plant(egp_plant::Plant);

#[pymethods]
impl Plant {
    #[new]
    #[pyo3(signature = (vehicle = 1))]
    fn new(vehicle: u32) -> PyResult<Self> {
        Ok(Self(egp_plant::Plant::new(parameters(vehicle)?)))
    }

    #[pyo3(signature = (x, y, yaw, v, yaw_rate = 0.0, v_y = 0.0, delta = 0.0))]
    #[allow(clippy::too_many_arguments)]
    fn reset(
        &mut self,
        x: f64,
        y: f64,
        yaw: f64,
        v: f64,
        yaw_rate: f64,
        v_y: f64,
        delta: f64,
    ) -> PyResult<()> {
        let state = VehicleState {
            p_x: x,
            p_y: y,
            v_x: v,
            psi: yaw,
            v_y,
            omega: yaw_rate,
            delta,
        };
        self.0.reset(&state).map_err(raise)
    }

    fn step(
        &mut self,
        u: PyReadonlyArray1<'_, f64>,
        dt: f64,
        friction: Surface<'_>,
    ) -> PyResult<()> {
        let input = fixed("u", &u)?;
        match friction {
            Surface::Uniform(mu) => {
                let surface = Uniform::new(mu).map_err(raise)?;
                self.0.step(input, dt, &surface)
            }
            Surface::Map(map) => self.0.step(input, dt, &map.get().0),
        }
        .map_err(raise)
    }

    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.0.state().to_pyarray(py)
    }

    #[setter]
    fn set_state(&mut self, state: PyReadonlyArray1<'_, f64>) -> PyResult<()> {
        self.0.set_state(&fixed("state", &state)?).map_err(raise)
    }

    #[getter]
    fn vehicle_state<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.0.vehicle_state().to_array().to_pyarray(py)
    }

    #[getter]
    fn mass(&self) -> f64 {
        self.0.parameters().mass
    }

    #[getter]
    fn lateral_acceleration(&self) -> f64 {
        self.0.lateral_acceleration()
    }
}

/// Friction on a grid.
#[pyclass(module = "egp_service._core", frozen)]
struct FrictionMap(Map);

#[pymethods]
impl FrictionMap {
    #[new]
    fn new(values: PyReadonlyArray2<'_, f64>, origin: (f64, f64), cell: f64) -> PyResult<Self> {
        let values = values.as_array();
        let (rows, columns) = values.dim();
        Map::new(
            [origin.0, origin.1],
            cell,
            [rows, columns],
            values.iter().copied().collect(),
        )
        .map(Self)
        .map_err(raise)
    }
}

/// What a plant can drive on.
#[derive(FromPyObject)]
enum Surface<'py> {
    Uniform(f64),
    Map(Bound<'py, FrictionMap>),
}

/// One coefficient, or one for each wheel.
#[derive(FromPyObject)]
enum WheelFriction<'py> {
    Uniform(f64),
    Wheels(PyReadonlyArray1<'py, f64>),
}

#[pyfunction]
#[pyo3(signature = (state, u, friction, vehicle = 1))]
fn plant_derivative<'py>(
    py: Python<'py>,
    state: PyReadonlyArray1<'py, f64>,
    u: PyReadonlyArray1<'py, f64>,
    friction: WheelFriction<'py>,
    vehicle: u32,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let friction = match friction {
        WheelFriction::Uniform(mu) => [mu; 4],
        WheelFriction::Wheels(mu) => fixed("friction", &mu)?,
    };
    egp_plant::derivative(
        &parameters(vehicle)?,
        &fixed("state", &state)?,
        fixed("u", &u)?,
        friction,
    )
    .map(|slope| slope.to_pyarray(py))
    .map_err(raise)
}

#[pyfunction]
#[pyo3(signature = (vehicle_states, vehicle = 1))]
fn plant_initial_states<'py>(
    py: Python<'py>,
    vehicle_states: PyReadonlyArray2<'py, f64>,
    vehicle: u32,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let parameters = parameters(vehicle)?;
    let states = rows::<7>("vehicle_states", &vehicle_states)?
        .into_iter()
        .map(|row| {
            egp_plant::initial_state(&parameters, &VehicleState::from_array(row)).map_err(raise)
        })
        .collect::<PyResult<Vec<_>>>()?;
    matrix(py, states)
}

#[pyfunction]
#[pyo3(signature = (states, u, dt, friction, vehicle = 1))]
fn plant_step_batch<'py>(
    py: Python<'py>,
    states: PyReadonlyArray2<'py, f64>,
    u: PyReadonlyArray2<'py, f64>,
    dt: f64,
    friction: PyReadonlyArray1<'py, f64>,
    vehicle: u32,
) -> PyResult<Stepped<'py>> {
    let parameters = parameters(vehicle)?;
    let states = rows::<NX>("states", &states)?;
    let inputs = rows::<2>("u", &u)?;
    let friction = friction.as_array();
    for (name, count) in [("u", inputs.len()), ("friction", friction.len())] {
        if count != states.len() {
            let expected = states.len();
            return Err(EgpError::new_err(format!(
                "expected {expected} rows of {name}, one per state, got {count}"
            )));
        }
    }
    let mut items = (states.iter().zip(inputs).zip(friction))
        .map(|((state, input), &mu)| {
            let mut plant = egp_plant::Plant::new(parameters.clone());
            plant.set_state(state)?;
            Ok(BatchItem {
                plant,
                input,
                friction: Uniform::new(mu)?,
            })
        })
        .collect::<Result<Vec<_>, egp_plant::PlantError>>()
        .map_err(raise)?;
    let results = py
        .detach(|| egp_plant::step_batch(&mut items, dt))
        .map_err(raise)?;
    let completed: Vec<bool> = results.iter().map(Result::is_ok).collect();
    Ok((
        matrix(py, items.iter().map(|item| *item.plant.state()).collect())?,
        completed.into_pyarray(py),
    ))
}

fn parameters(vehicle: u32) -> PyResult<Parameters> {
    VehicleId::try_from(vehicle)
        .map(VehicleId::parameters)
        .map_err(raise)
}

/// A vector of known length.
fn fixed<const N: usize>(name: &str, array: &PyReadonlyArray1<'_, f64>) -> PyResult<[f64; N]> {
    let values: Vec<f64> = array.as_array().iter().copied().collect();
    let count = values.len();
    values
        .try_into()
        .map_err(|_| EgpError::new_err(format!("expected {name} of shape ({N},), got ({count},)")))
}

/// The rows of a matrix with a known number of columns.
fn rows<const N: usize>(name: &str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; N]>> {
    let array = array.as_array();
    let (count, columns) = array.dim();
    if columns != N {
        return Err(EgpError::new_err(format!(
            "expected {name} of shape (n, {N}), got ({count}, {columns})"
        )));
    }
    Ok(array
        .rows()
        .into_iter()
        .map(|row| std::array::from_fn(|i| row[i]))
        .collect())
}

fn matrix(py: Python<'_>, states: Vec<StateVector>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let count = states.len();
    states
        .into_flattened()
        .into_pyarray(py)
        .reshape([count, NX])
}

/// Adds this file's classes and functions to the module.
///
/// # Errors
/// When Python refuses one.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Plant>()?;
    module.add_class::<FrictionMap>()?;
    module.add_function(wrap_pyfunction!(plant_derivative, module)?)?;
    module.add_function(wrap_pyfunction!(plant_initial_states, module)?)?;
    module.add_function(wrap_pyfunction!(plant_step_batch, module)?)
}
