//! The control step's optimal control problem around dynamics that come from Python.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use egp_core::linearisation::Linearisation;
use egp_core::ocp::{self, Road, Setup, soft_rows};
use egp_core::solver::{self, solve_with_fallback};
use egp_core::{Input, NU, NX, OcpQp, OcpSolution, QpSolver, Settings, State};
use pyo3::prelude::*;

use crate::array::{Cube, Matrix, Vector, fixed, layers, rows, wrong_shape};
use crate::error::{EgpError, raise};
use crate::ocp::{OcpResult, result};
use crate::parameters::VehicleParameters;

/// The control step's optimal control problem, eq. (18), for affine dynamics from any source.
///
/// `settings_toml` holds the settings of a control step, which override those of `vehicle`; `dt` is the period in s,
/// `friction` the surface's coefficient. Cost, bounds and solvers are those of the step. Raises `EgpError` for settings
/// out of range, and for a period or friction that is not a positive number.
#[pyclass(module = "egp_service._core", frozen)]
pub struct AffineOcp {
    settings: Settings,
    vehicle: egp_parameters::VehicleParameters,
    dt: f64,
    friction: f64,
    memory: Mutex<Memory>,
}

struct Memory {
    dynamics: Linearisation,
    qp: OcpQp,
    solvers: Vec<Box<dyn QpSolver + Send>>,
    solution: OcpSolution,
}

#[pymethods]
impl AffineOcp {
    #[new]
    fn new(
        settings_toml: &str,
        vehicle: &VehicleParameters,
        dt: f64,
        friction: f64,
    ) -> PyResult<Self> {
        let settings = Settings::from_toml(settings_toml).map_err(raise)?;
        if !(dt.is_finite() && dt > 0.0) {
            return Err(EgpError::new_err(format!(
                "expected a period dt > 0 s, got {dt}"
            )));
        }
        let horizon = settings.horizon(dt);
        if !(friction.is_finite() && friction > 0.0) {
            return Err(EgpError::new_err(format!(
                "expected a friction coefficient > 0, got {friction}"
            )));
        }
        let qp = OcpQp::new(horizon, soft_rows(&settings.soft));
        let memory = Memory {
            dynamics: Linearisation::new(horizon),
            solvers: solver::solvers(&qp, &settings.solver).map_err(raise)?,
            solution: OcpSolution::new(horizon),
            qp,
        };
        Ok(Self {
            vehicle: settings.vehicle(&vehicle.0),
            settings,
            dt,
            friction,
            memory: Mutex::new(memory),
        })
    }

    /// Solve for x_{t+1} = A x_t + B u_t + c, with positions and yaw relative to a frame near the vehicle.
    ///
    /// Measured state x0 (7,), input now applied u_prev (2,), operating trajectory (T+1, 7) and (T, 2), a (T, 7, 7), b
    /// (T, 7, 2), c (T, 7), reference rows [p_x, p_y, v_x, psi] (T+1, 4) and widths [left, right] (T+1, 2); forces in
    /// N. The result's inputs are scaled to accelerations.
    #[pyo3(signature = (x0, u_prev, operating_x, operating_u, a, b, c, reference, widths = None))]
    #[allow(clippy::too_many_arguments)]
    fn solve(
        &self,
        py: Python<'_>,
        x0: Vector<'_>,
        u_prev: Vector<'_>,
        operating_x: Matrix<'_>,
        operating_u: Matrix<'_>,
        a: Cube<'_>,
        b: Cube<'_>,
        c: Matrix<'_>,
        reference: Matrix<'_>,
        widths: Option<Matrix<'_>>,
    ) -> PyResult<OcpResult> {
        let horizon = self.settings.horizon(self.dt);
        let x0 = State::from(fixed::<NX>("x0", &x0)?);
        let u_prev = Input::from(fixed::<NU>("u_prev", &u_prev)?);
        let operating = stages::<NX>("operating_x", &operating_x, horizon + 1)?;
        let guess: Vec<Input> = stages::<NU>("operating_u", &operating_u, horizon)?
            .into_iter()
            .map(|[force, rate]| Input::new(force / self.vehicle.mass, rate))
            .collect();
        let (a, b) = (layers::<NX, NX>("a", &a)?, layers::<NX, NU>("b", &b)?);
        let c = stages::<NX>("c", &c, horizon)?;
        for (name, found, columns) in [("a", a.len(), NX), ("b", b.len(), NU)] {
            if found != horizon {
                let expected = format!("({horizon}, {NX}, {columns})");
                return Err(wrong_shape(name, &expected, &[found, NX, columns]));
            }
        }
        let reference: Vec<State> = stages::<4>("reference", &reference, horizon + 1)?
            .into_iter()
            .map(|[p_x, p_y, v_x, psi]| State::from([p_x, p_y, v_x, psi, 0.0, 0.0, 0.0]))
            .collect();
        let widths = match widths {
            None => Vec::new(),
            Some(widths) => stages::<2>("widths", &widths, horizon + 1)?,
        };
        // A lock that a panic poisoned can be used, because each call overwrites the whole memory.
        let mut memory = self.memory.lock().unwrap_or_else(PoisonError::into_inner);
        let Memory {
            dynamics,
            qp,
            solvers,
            solution,
        } = &mut *memory;
        for (to, from) in dynamics.x.iter_mut().zip(operating) {
            *to = from.into();
        }
        for (t, stage) in dynamics.stages.iter_mut().enumerate() {
            for i in 0..NX {
                for (j, &value) in a[t][i].iter().enumerate() {
                    stage.a[(i, j)] = value;
                }
                for (j, &value) in b[t][i].iter().enumerate() {
                    stage.b[(i, j)] = value;
                }
            }
            stage.c = c[t].into();
        }
        let road = Road {
            x: &reference,
            widths: &widths,
            friction: self.friction,
        };
        let setup = Setup {
            settings: &self.settings,
            vehicle: &self.vehicle,
            dt: self.dt,
        };
        ocp::assemble(&setup, &x0, &u_prev, dynamics, &road, qp);
        let start = Instant::now();
        let tolerance = self.settings.solver.kkt_tolerance;
        let solver = solve_with_fallback(solvers, qp, &guess, tolerance, solution);
        result(py, solution, solver, start.elapsed().as_secs_f64())
    }
}

/// Rows of an array that must have `count` of them.
fn stages<const N: usize>(name: &str, array: &Matrix<'_>, count: usize) -> PyResult<Vec<[f64; N]>> {
    let rows = rows::<N>(name, array)?;
    if rows.len() == count {
        return Ok(rows);
    }
    Err(wrong_shape(
        name,
        &format!("({count}, {N})"),
        &[rows.len(), N],
    ))
}
