//! QP solvers behind one trait. A solver proposes, [`solve_checked`] decides.

mod clarabel;
mod riccati;

pub use self::clarabel::ClarabelSolver;
pub use self::riccati::RiccatiSolver;

use crate::Input;
use crate::qp::{KktResidual, OcpQp, OcpSolution};
use crate::settings::{SolverKind, SolverSettings};

/// What became of a problem. Only [`Status::Solved`] comes with a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Solved, and our own check agrees.
    Solved,
    /// The iteration limit came first.
    IterationLimit,
    /// No point satisfies the hard bounds; cannot happen for problems built by [`crate::ocp`].
    Infeasible,
    /// The solver lost its way, or the problem held a number that is not finite.
    NumericalError,
    /// The solver reported success, our own check did not agree.
    CheckFailed,
}

/// A solver for [`OcpQp`] problems of the pattern it was constructed with.
pub trait QpSolver {
    /// Writes inputs, multipliers and iterations of the proposed solution to `out` and returns the solver's own
    /// opinion. `guess` holds inputs that may be near the solution, one a stage, or nothing. The result depends on
    /// `qp` and `guess` alone, never on problems solved before.
    fn solve(&mut self, qp: &OcpQp, guess: &[Input], out: &mut OcpSolution) -> Status;

    /// Name and version, for replies and reports.
    fn name(&self) -> &'static str;
}

/// Why a solver could not be set up.
#[derive(Debug, thiserror::Error)]
#[error("{solver} refused its set-up: {reason}")]
pub struct SolverSetupError {
    /// The solver's name.
    pub solver: &'static str,
    /// What it said.
    pub reason: String,
}

/// The solvers to ask, in this order, for problems of the pattern of `qp`.
///
/// # Errors
/// [`SolverSetupError`] if one refuses.
pub fn rungs(
    qp: &OcpQp,
    settings: &SolverSettings,
) -> Result<Vec<Box<dyn QpSolver + Send>>, SolverSetupError> {
    let mut rungs: Vec<Box<dyn QpSolver + Send>> = Vec::new();
    if settings.kind == SolverKind::Riccati {
        rungs.push(Box::new(RiccatiSolver::new(qp.horizon(), settings)));
    }
    rungs.push(Box::new(ClarabelSolver::new(qp, settings)?));
    Ok(rungs)
}

/// Asks one solver after the other until a solution passes the check; returns the name of the last one asked.
pub fn solve_first(
    rungs: &mut [Box<dyn QpSolver + Send>],
    qp: &OcpQp,
    guess: &[Input],
    kkt_tolerance: f64,
    out: &mut OcpSolution,
) -> &'static str {
    let mut asked = "";
    for solver in rungs {
        asked = solver.name();
        if solve_checked(solver.as_mut(), qp, guess, kkt_tolerance, out) == Status::Solved {
            break;
        }
    }
    asked
}

/// Solves and checks: `out.status` is [`Status::Solved`] exactly if the KKT residual computed from `qp` is at most
/// `kkt_tolerance`, whatever the solver thought of its result.
pub fn solve_checked(
    solver: &mut dyn QpSolver,
    qp: &OcpQp,
    guess: &[Input],
    kkt_tolerance: f64,
    out: &mut OcpSolution,
) -> Status {
    out.kkt = KktResidual::default();
    out.iterations = 0;
    out.status = Status::NumericalError;
    if !qp.is_well_posed() {
        return out.status;
    }
    out.status = solver.solve(qp, guess, out);
    if out.status == Status::Infeasible {
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
