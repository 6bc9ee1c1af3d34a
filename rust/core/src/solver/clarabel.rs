//! Clarabel, an interior-point solver for sparse conic problems.
//!
//! The solver is set up once and updated in place. Updates require a constant pattern and finite bounds, so presolve
//! and the dropping of zeros are off. Equilibration is off because it would scale every problem by the first one, and
//! the inputs are scaled already. The number of iterations is limited, but not the time: a time limit would make
//! results depend on the machine. The same problem gives the same bits, independently of earlier problems.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, SupportedConeT,
    ZeroConeT,
};

use super::{QpSolver, SolverSetupError, Status};
use crate::Input;
use crate::qp::{Csc, OcpQp, OcpSolution, SparseQp};
use crate::settings::SolverSettings;

/// Name and version; a test compares the version with `Cargo.lock`.
const NAME: &str = "clarabel 0.11";

/// Tolerance of the duality gap relative to the tolerance of the other residuals. It is smaller because the error of a
/// solution with a weakly active bound is as large as the square root of the gap.
const GAP_FACTOR: f64 = 1e-3;

/// Tolerance of the linear systems relative to the tolerance of the problem. With Clarabel's default, problems of large
/// cost end at a residual of 1e-5 for any tolerance.
const REFINEMENT_FACTOR: f64 = 1e-4;

/// One row `sign · (a z) <= sign · bound` of Clarabel's one-sided form.
#[derive(Clone, Copy)]
struct Row {
    source: usize,
    sign: f64,
}

/// Clarabel with the pattern of one [`OcpQp`].
pub struct ClarabelSolver {
    sparse: SparseQp,
    solver: DefaultSolver<f64>,
    /// Clarabel's rows: equalities, then inequalities.
    rows: Vec<Row>,
    /// Clarabel's row for the lower and the upper bound of each row of `sparse`.
    row_of: Vec<[Option<usize>; 2]>,
    /// For each entry of Clarabel's matrix, its source in `sparse.a.values` and its sign.
    entries: Vec<(usize, f64)>,
    a_values: Vec<f64>,
    b: Vec<f64>,
}

impl ClarabelSolver {
    /// A solver for problems with the horizon and soft rows of `pattern`.
    ///
    /// # Errors
    /// [`SolverSetupError`] if Clarabel rejects settings or dimensions.
    pub fn new(pattern: &OcpQp, settings: &SolverSettings) -> Result<Self, SolverSetupError> {
        let sparse = SparseQp::new(pattern);
        let (rows, row_of, equalities) = split_rows(&sparse);
        let (a, entries) = split_matrix(&sparse.a, &row_of, rows.len());
        let cones: [SupportedConeT<f64>; 2] = [
            ZeroConeT(equalities),
            NonnegativeConeT(rows.len() - equalities),
        ];
        let b = vec![0.0; rows.len()];
        let solver = DefaultSolver::new(
            &to_clarabel(&sparse.p),
            &sparse.q,
            &a,
            &b,
            &cones,
            options(settings),
        )
        .map_err(|error| SolverSetupError {
            solver: NAME,
            reason: error.to_string(),
        })?;
        Ok(Self {
            sparse,
            solver,
            rows,
            row_of,
            a_values: vec![0.0; entries.len()],
            entries,
            b,
        })
    }

    /// Passes the values of `self.sparse` to Clarabel; false if Clarabel rejects them.
    fn update(&mut self) -> bool {
        for (value, &(slot, sign)) in self.a_values.iter_mut().zip(&self.entries) {
            *value = sign * self.sparse.a.values[slot];
        }
        for (value, row) in self.b.iter_mut().zip(&self.rows) {
            let bound = if row.sign > 0.0 {
                self.sparse.u[row.source]
            } else {
                self.sparse.l[row.source]
            };
            *value = row.sign * bound;
        }
        self.solver
            .update_data(
                &self.sparse.p.values,
                &self.sparse.q,
                &self.a_values,
                &self.b,
            )
            .is_ok()
    }

    /// Copies inputs and multipliers from Clarabel's vectors.
    fn read(&self, out: &mut OcpSolution) {
        let (x, z) = (&self.solver.solution.x, &self.solver.solution.z);
        let multiplier = |row: usize, side: usize| self.row_of[row][side].map_or(0.0, |k| z[k]);
        self.sparse.read(x, multiplier, out);
    }
}

impl QpSolver for ClarabelSolver {
    fn solve(&mut self, qp: &OcpQp, _guess: &[Input], out: &mut OcpSolution) -> Status {
        self.sparse.update(qp);
        if !self.update() {
            return Status::NumericalError;
        }
        self.solver.solve();
        self.read(out);
        out.iterations = self.solver.solution.iterations;
        match self.solver.solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved => Status::Solved,
            SolverStatus::MaxIterations => Status::IterationLimit,
            SolverStatus::PrimalInfeasible => Status::Infeasible,
            _ => Status::NumericalError,
        }
    }

    fn name(&self) -> &'static str {
        NAME
    }
}

/// Clarabel's rows for the finite sides of `l <= Az <= u`, equalities first; the row of each side; the number of
/// equalities.
fn split_rows(sparse: &SparseQp) -> (Vec<Row>, Vec<[Option<usize>; 2]>, usize) {
    let mut rows = Vec::new();
    let mut row_of = vec![[None, None]; sparse.l.len()];
    let is_equality = |source: usize| sparse.l[source] == sparse.u[source];
    for source in (0..sparse.l.len()).filter(|&row| is_equality(row)) {
        row_of[source][1] = Some(rows.len());
        rows.push(Row { source, sign: 1.0 });
    }
    let equalities = rows.len();
    for source in (0..sparse.l.len()).filter(|&row| !is_equality(row)) {
        for (side, bound, sign) in [(0, sparse.l[source], -1.0), (1, sparse.u[source], 1.0)] {
            if bound.is_finite() {
                row_of[source][side] = Some(rows.len());
                rows.push(Row { source, sign });
            }
        }
    }
    (rows, row_of, equalities)
}

/// The matrix with these rows, and the source and sign of each of its entries.
fn split_matrix(
    a: &Csc,
    row_of: &[[Option<usize>; 2]],
    rows: usize,
) -> (CscMatrix<f64>, Vec<(usize, f64)>) {
    let (mut coordinates, mut sources) = (Vec::new(), Vec::new());
    for column in 0..a.columns {
        for slot in a.column_start[column]..a.column_start[column + 1] {
            for (side, sign) in [(0, -1.0), (1, 1.0)] {
                if let Some(row) = row_of[a.row_index[slot]][side] {
                    coordinates.push((row, column));
                    sources.push((slot, sign));
                }
            }
        }
    }
    let (matrix, slots) = Csc::from_entries(rows, a.columns, &coordinates);
    let mut entries = vec![(0, 0.0); sources.len()];
    for (source, slot) in sources.into_iter().zip(slots) {
        entries[slot] = source;
    }
    (to_clarabel(&matrix), entries)
}

fn to_clarabel(m: &Csc) -> CscMatrix<f64> {
    CscMatrix::new(
        m.rows,
        m.columns,
        m.column_start.clone(),
        m.row_index.clone(),
        m.values.clone(),
    )
}

fn options(settings: &SolverSettings) -> DefaultSettings<f64> {
    let (defaults, refined) = (
        DefaultSettings::default(),
        REFINEMENT_FACTOR * settings.tolerance,
    );
    DefaultSettings {
        verbose: false,
        max_iter: settings.max_iterations,
        tol_gap_abs: GAP_FACTOR * settings.tolerance,
        tol_gap_rel: GAP_FACTOR * settings.tolerance,
        tol_feas: settings.tolerance,
        equilibrate_enable: false,
        presolve_enable: false,
        input_sparse_dropzeros: false,
        max_threads: 1,
        iterative_refinement_reltol: refined.min(defaults.iterative_refinement_reltol),
        iterative_refinement_abstol: refined.min(defaults.iterative_refinement_abstol),
        iterative_refinement_max_iter: 30,
        ..defaults
    }
}

#[cfg(test)]
mod tests {
    use super::NAME;

    #[test]
    fn the_name_has_the_version_that_the_program_is_built_with() {
        let (name, version) = NAME.split_once(' ').unwrap_or_default();
        let locked = format!("name = \"{name}\"\nversion = \"{version}.");
        assert!(include_str!("../../../../Cargo.lock").contains(&locked));
    }
}
