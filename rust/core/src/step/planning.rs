//! From the weights of the stages and the previous plan to the solution of the optimal control problem.

use std::mem;

use super::delay::Delay;
use super::validate::ValidRequest;
use super::{StepReply, Workspace};
use crate::linearisation::Domain;
use crate::ocp::{self, Road, Setup};
use crate::preview::StageWeights;
use crate::solver::{Status, solve_with_fallback};
use crate::trajectory::Guess;
use crate::vehicle::{DELTA_DOT, FORCE, P_X, P_Y, PSI, TyreLimits};
use crate::{Ensemble, GpOutput, Input, Library, Settings, State};

/// Standard deviations between the mean and the 95 % quantile of a normal distribution.
const UPPER_QUANTILE: f64 = 1.645;
/// Largest difference between the operating trajectory and the ensemble's predictions along it, m/s and rad/s, with which a
/// plan is not repeated while the window fills. With the weights of the true surface it was below 0.02 in all steps of a lap at
/// 90 % of the grip, on dry tarmac and on ice.
const LARGEST_DEFECT: f64 = 0.1;
/// Largest number of repetitions of a plan; five bring no more than three.
const MOST_REPETITIONS: usize = 3;

/// The ensemble of each stage.
pub(super) fn ensembles<'a>(
    library: &'a Library,
    stages: &'a StageWeights,
) -> impl Fn(usize) -> Ensemble<'a> {
    |t: usize| Ensemble::new(library, stages.stage(t))
}

/// Linearises about the guess and solves the QP. While the window of the weights fills, it repeats both about the plan that it
/// found, at most [`MOST_REPETITIONS`] times, as long as the states of the last linearisation differ by more than
/// [`LARGEST_DEFECT`] from the ensemble's predictions. A repetition that is not solved is left out. `used` is the number of
/// transitions from which the weights were estimated.
///
/// After a cold start the weights move within a few periods from equal ones to those of the road. The previous plan was then
/// made with the model of another vehicle, and the solution of one QP about it is no plan that the vehicle can follow.
pub(super) fn plan(
    library: &Library,
    settings: &Settings,
    rows: &ValidRequest,
    used: usize,
    disturbance: &GpOutput,
    ws: &mut Workspace,
    reply: &mut StepReply,
) {
    let window = settings.weights.window(library);
    let full = ws.delay.map_or(window, |delay| delay.known(window));
    let fills = (1..full).contains(&used);
    let plan = |ws: &mut Workspace| {
        let x0 = linearise(library, settings, rows, disturbance, ws);
        assemble(library, settings, rows, &x0, ws);
        solve(settings, ws);
    };
    plan(ws);
    for _ in 0..MOST_REPETITIONS {
        let again = fills && ws.dynamics.defect > LARGEST_DEFECT;
        if !again || ws.solution.status != Status::Solved {
            break;
        }
        let mass = ws.vehicle.mass;
        let inputs = ws.solution.u.iter().map(|u| unscaled(u, mass));
        ws.guess.take(&ws.solution.x, inputs);
        mem::swap(&mut ws.solution, &mut ws.last_solved);
        let solver_name = ws.solver_name;
        plan(ws);
        if ws.solution.status != Status::Solved {
            mem::swap(&mut ws.solution, &mut ws.last_solved);
            ws.solver_name = solver_name;
            break;
        }
    }
    reply.status = ws.solution.status;
    reply.iterations = ws.solution.iterations;
    reply.kkt_residual = ws.solution.kkt.worst();
}

/// Linearises the ensemble along the operating trajectory, and returns the state at which it starts, in the vehicle's frame.
fn linearise(
    library: &Library,
    settings: &Settings,
    rows: &ValidRequest,
    disturbance: &GpOutput,
    ws: &mut Workspace,
) -> State {
    let ensembles = ensembles(library, &ws.stages);
    let present = |delay: Delay| delay.present(rows, &ensembles(0), disturbance);
    let x0 = local_state(&ws.delay.map_or(rows.x, present));
    let operating = &settings.operating;
    let domain = Domain::new(operating, settings.soft.v_x_max, &ws.vehicle);
    ws.dynamics.along(
        |t| (ensembles(t), ws.offsets[t]),
        library.dt(),
        &x0,
        &ws.guess,
        operating,
        &domain,
    );
    x0
}

/// Writes the QP of eq. (18), with bounds that are tightened by the uncertainty of the plan if the settings ask for it.
fn assemble(
    library: &Library,
    settings: &Settings,
    rows: &ValidRequest,
    x0: &State,
    ws: &mut Workspace,
) {
    blend_tyre_limits(
        &ws.tyres,
        &ws.stages,
        rows.road_friction,
        &mut ws.stage_tyres,
    );
    let road = Road {
        x: &ws.reference,
        widths: rows.widths,
        tyres: &ws.stage_tyres,
    };
    let setup = Setup {
        settings,
        vehicle: &ws.vehicle,
        dt: library.dt(),
    };
    ocp::assemble(
        &setup,
        x0,
        &rows.u_prev,
        &ws.dynamics,
        &ws.guess,
        &road,
        &mut ws.qp,
    );
    if settings.soft.caution > 0.0 {
        let operating = ws.dynamics.x.iter().zip(&ws.guess.u);
        let uncertainties = ws.deviations.uncertainties(
            library.members(),
            &ws.stages,
            ensembles(library, &ws.stages),
            rows.road_friction,
            operating.map(|(x, u)| (*x, *u)),
            &*ws.executor,
        );
        ws.caution
            .tighten(settings.soft.caution, uncertainties, &mut ws.qp);
    }
}

/// Solves the QP.
fn solve(settings: &Settings, ws: &mut Workspace) {
    warm_start(&ws.guess, ws.vehicle.mass, &mut ws.warm);
    ws.solver_name = solve_with_fallback(
        &mut ws.solvers,
        &ws.qp,
        &ws.warm,
        settings.solver.kkt_tolerance,
        &mut ws.solution,
    );
}

/// The tyre limits of each stage: those of the members, blended with the weights of the stage. Where the road is expected
/// to have less friction than all members, the largest forces are smaller.
fn blend_tyre_limits(
    members: &[TyreLimits],
    stages: &StageWeights,
    road: &[[f64; 2]],
    blends: &mut [TyreLimits],
) {
    for (t, blend) in blends.iter_mut().enumerate() {
        *blend = TyreLimits {
            braking: 1.0,
            ..TyreLimits::default()
        };
        for (limits, weight) in members.iter().zip(stages.stage(t)) {
            blend.add(*weight, limits);
        }
        if let Some([friction, std]) = road.get(t + 1) {
            let most = friction + UPPER_QUANTILE * std;
            *blend = blend.on_less_friction(most / stages.least_friction());
        }
    }
}

/// The inputs of the previous plan as the solver scales them; none without a plan.
fn warm_start(guess: &Guess, mass: f64, warm: &mut Vec<Input>) {
    warm.clear();
    if !guess.x.is_empty() {
        let scaled = |u: &Input| Input::new(u[FORCE] / mass, u[DELTA_DOT]);
        warm.extend(guess.u.iter().map(scaled));
    }
}

/// A state at the measured pose in the vehicle's frame.
fn local_state(x: &State) -> State {
    let mut local = *x;
    (local[P_X], local[P_Y], local[PSI]) = (0.0, 0.0, 0.0);
    local
}

/// An input of the solver in newtons.
pub(super) fn unscaled(u: &Input, mass: f64) -> Input {
    Input::new(u[FORCE] * mass, u[DELTA_DOT])
}
