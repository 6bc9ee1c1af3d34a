//! Programs of the workspace that are commands of the Python package, whose wheel carries no other programs.

use std::ffi::OsString;
use std::path::PathBuf;

use pyo3::prelude::*;

/// Run the load generator as `egp load` with these arguments, without the GIL, and return its exit code.
#[pyfunction]
pub fn run_load(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| egp_load::main(named("egp load", arguments)))
}

/// Run the simulation with faults as `egp simulate` with these arguments, without the GIL, and return its exit code. Vehicles
/// ask for `library`, and some of them for `other`.
#[pyfunction]
pub fn run_simulation(
    py: Python<'_>,
    library: PathBuf,
    other: PathBuf,
    arguments: Vec<OsString>,
) -> u8 {
    let arguments = named("egp simulate", arguments);
    py.detach(|| egp_simulate::main_with_libraries(arguments, &library, &other))
}

/// The arguments behind the name of the program.
fn named(name: &str, arguments: Vec<OsString>) -> impl Iterator<Item = OsString> {
    std::iter::once(name.into()).chain(arguments)
}
