//! What a client keeps between steps, as Python sees it.

use std::borrow::Cow;

use egp_wire::{Limits, State};
use pyo3::prelude::*;

use crate::array::{Matrix, NewVector, Vector, fixed, rows, vector};
use crate::error::raise;

/// What a client keeps between steps: history, weights, plan, last input.
#[pyclass(module = "egp_service._core")]
struct Carry(egp_wire::Carry);

#[pymethods]
impl Carry {
    #[new]
    #[pyo3(signature = (library, history = 25))]
    fn new(library: [u8; 32], history: usize) -> Self {
        Self(egp_wire::Carry::new(library, history))
    }

    #[pyo3(signature = (x, reference, widths = None, *, budget_us, want_sigma = false))]
    fn request(
        &mut self,
        x: Vector<'_>,
        reference: Matrix<'_>,
        widths: Option<Matrix<'_>>,
        budget_us: u32,
        want_sigma: bool,
    ) -> PyResult<Cow<'static, [u8]>> {
        let x: State = fixed("x", &x)?;
        let reference = rows("reference", &reference)?;
        let widths = widths.map_or_else(|| Ok(Vec::new()), |widths| rows("widths", &widths))?;
        let mut request = self.0.request(x, reference, widths, budget_us);
        request.want_sigma = want_sigma;
        request.validate(&Limits::default()).map_err(raise)?;
        Ok(request.encode().into())
    }

    fn accept(&mut self, reply: &[u8]) -> PyResult<bool> {
        let reply = egp_wire::Reply::decode(reply, &Limits::default()).map_err(raise)?;
        self.0.accept(&reply).map_err(raise)
    }

    fn applied(&mut self, u: [f64; 2]) {
        self.0.applied(u);
    }

    fn reset(&mut self) {
        self.0.reset();
    }

    #[getter]
    fn sequence(&self) -> u64 {
        self.0.sequence()
    }

    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.0.weights().iter().copied())
    }

    #[setter]
    fn set_weights(&mut self, weights: Vector<'_>) {
        self.0
            .set_weights(weights.as_array().iter().copied().collect());
    }
}

/// Adds the class to the module.
///
/// # Errors
/// When Python refuses it.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Carry>()
}
