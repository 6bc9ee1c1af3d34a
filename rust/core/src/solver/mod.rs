//! QP solvers behind one trait. [`solve_checked`] accepts a solution only if its KKT residual is small.

mod clarabel;
mod riccati;

pub use self::clarabel::ClarabelSolver;
pub use self::riccati::RiccatiSolver;

use crate::Input;
use crate::qp::{KktResidual, OcpQp, OcpSolution};
use crate::settings::{SolverKind, SolverSettings};

/// Outcome of a solve. Only [`Status::Solved`] comes with a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Solved, and the KKT residual is within the tolerance.
    Solved,
    /// The iteration limit was reached before convergence.
    IterationLimit,
    /// No sequence of inputs satisfies the hard bounds. Problems built by [`crate::ocp`] have such a sequence.
    Infeasible,
    /// The solver broke down, it found a feasible problem infeasible, or the problem contains a number that is not finite.
    NumericalError,
    /// The solver reported success, but the KKT residual exceeds the tolerance, or the plan has states that no message may
    /// contain.
    CheckFailed,
}

/// A solver for [`OcpQp`] problems of the pattern it was constructed with.
pub trait QpSolver {
    /// Writes inputs, multipliers and iterations of the solution to `out` and returns the status that the solver
    /// reports. `guess` contains inputs near the solution, one for each stage, or is empty. The result depends on `qp`
    /// and `guess` alone, never on problems solved before.
    fn solve(&mut self, qp: &OcpQp, guess: &[Input], out: &mut OcpSolution) -> Status;

    /// Name, for replies and reports.
    fn name(&self) -> &'static str;
}

/// A solver that could not be set up.
#[derive(Debug, thiserror::Error)]
#[error("the QP solver {solver} cannot be set up: {reason}")]
pub struct SolverSetupError {
    /// The solver's name.
    pub solver: &'static str,
    /// Reason given by the solver.
    pub reason: String,
}

/// The chosen solver followed by its fallback solvers, for problems with the pattern of `qp`.
///
/// # Errors
/// [`SolverSetupError`] if a solver cannot be set up.
pub fn solvers(
    qp: &OcpQp,
    settings: &SolverSettings,
) -> Result<Vec<Box<dyn QpSolver + Send>>, SolverSetupError> {
    let mut solvers: Vec<Box<dyn QpSolver + Send>> = Vec::new();
    if settings.kind == SolverKind::Riccati {
        solvers.push(Box::new(RiccatiSolver::new(qp.horizon(), settings)));
    }
    solvers.push(Box::new(ClarabelSolver::new(qp, settings)?));
    Ok(solvers)
}

/// Runs the solvers in their order until a solution passes the check. Returns the name of the last solver run.
pub fn solve_with_fallback(
    solvers: &mut [Box<dyn QpSolver + Send>],
    qp: &OcpQp,
    guess: &[Input],
    kkt_tolerance: f64,
    out: &mut OcpSolution,
) -> &'static str {
    let mut last = "";
    for solver in solvers {
        last = solver.name();
        if solve_checked(solver.as_mut(), qp, guess, kkt_tolerance, out) == Status::Solved {
            break;
        }
    }
    last
}

/// Solves and checks: unless the solver reports [`Status::Infeasible`], `out.status` is [`Status::Solved`] exactly if the KKT
/// residual computed from `qp` is at most `kkt_tolerance`. A solver may report this of a badly scaled problem, too; only if no
/// sequence of inputs satisfies the hard bounds it is the status. Solver and `out` must have the horizon of `qp`.
pub fn solve_checked(
    solver: &mut dyn QpSolver,
    qp: &OcpQp,
    guess: &[Input],
    kkt_tolerance: f64,
    out: &mut OcpSolution,
) -> Status {
    out.kkt = KktResidual::default();
    out.cost = f64::INFINITY;
    out.iterations = 0;
    out.status = Status::NumericalError;
    if !qp.is_well_posed() {
        return out.status;
    }
    out.status = solver.solve(qp, guess, out);
    if out.status == Status::Infeasible {
        if qp.has_feasible_inputs() {
            out.status = Status::NumericalError;
        }
        return out.status;
    }
    qp.check(out);
    if out.kkt.worst() <= kkt_tolerance {
        out.status = Status::Solved;
    } else if out.status == Status::Solved {
        out.status = Status::CheckFailed;
    }
    out.status
}
