//! The control step: from a measured state to a plan, as one pure function.
//!
//! There is no clock, no randomness and no state between calls: the same library, settings and request give the same
//! bits with any workspace. `NOTATION.md` lists the symbols.

mod delay;
mod deviations;
mod request;
mod validate;
mod workspace;

pub use request::{StepReply, StepRequest};
pub use validate::StepError;
pub use workspace::{SetupError, Workspace};

use delay::Delay;
use validate::ValidRequest;

use egp_parameters::STATE_IN_MESSAGES;

use crate::executor::{Executor, for_each};
use crate::linearisation::Domain;
use crate::ocp::{self, Road, Setup};
use crate::preview::StageWeights;
use crate::solver::{Status, solve_with_fallback};
use crate::trajectory::Guess;
use crate::vehicle::{
    DELTA_DOT, FORCE, Frame, MIN_SLIP_SPEED, P_X, P_Y, PSI, TyreLimits, V_X, wrap,
};
use crate::weights::blend_error;
use crate::{Ensemble, GpInput, GpOutput, Input, Library, Member, NY, NZ, Settings, State};

/// Speed, m/s, below which a vehicle counts as standing.
const STANDING: f64 = 0.5;
/// Force of the drive per mass, m/s², from which on a slow vehicle is about to move: the most slippery surface transmits it.
const LEAST_DRIVE: f64 = 1.0;
/// Standard deviations between the mean and the 95 % quantile of a normal distribution.
const UPPER_QUANTILE: f64 = 1.645;
/// Largest error of a model's slip angle, rad, with which a transition is used. Up to this slip angle tyres transmit nearly the
/// same force on all surfaces.
const LARGEST_SLIP_ERROR: f64 = 0.02;
/// Difference between a guessed and a predicted state, m/s and rad/s, from which on a plan is repeated while the window fills.
/// With the weights of the true surface it was below 0.02 in all steps of laps at 90 % of the grip on dry tarmac and on ice.
const LARGEST_DEFECT: f64 = 0.1;
/// Largest number of repetitions of a plan. Five in place of three bring no more.
const MOST_REPETITIONS: usize = 3;

/// One control step: weights, eq. (6); residual; linearisation, eqs. (15)-(17); optimal control problem, eq. (18).
///
/// After the first request of each shape nothing is allocated here, but the QP solver and a parallel executor may
/// allocate. A reply whose status is not [`Status::Solved`] contains weights and history for the next request but no
/// plan.
///
/// # Errors
/// [`StepError`] if the request is malformed, or if the workspace belongs to another library or to other settings. The
/// reply is then empty.
pub fn step(
    library: &Library,
    settings: &Settings,
    request: &StepRequest,
    ws: &mut Workspace,
    reply: &mut StepReply,
) -> Result<(), StepError> {
    reply.clear();
    ws.belongs_to(library, settings)?;
    let rows = validate::validate(library, settings, ws.vehicle.mass, request)?;
    let used = estimate_weights(library, settings, &rows, ws, reply);
    let disturbance = estimate_residual(&rows, used, ws, reply);
    let frame = Frame::of(&rows.x);
    localise_reference(&frame, &rows, &mut ws.reference);
    ws.guess
        .shift(&frame, rows.plan_x, rows.plan_u, rows.plan_shift);
    reply.dropped_mass = ws
        .stages
        .fill(&reply.weights, rows.road_friction, &settings.weights);
    plan(library, settings, &rows, &disturbance, ws, reply);
    if reply.status == Status::Solved && !fits_into_messages(&frame, &ws.solution.x) {
        reply.status = Status::CheckFailed;
    }
    if reply.status == Status::Solved {
        write_plan(&frame, &rows, ws, reply);
        if request.want_sigma {
            let ensembles = ensembles(library, &ws.stages);
            let solution = ws.solution.x.iter().zip(&ws.solution.u);
            let transitions = solution.map(|(x, u)| (*x, unscaled(u, ws.vehicle.mass)));
            ws.deviations
                .write(ensembles, transitions, &*ws.executor, reply);
        }
    }
    Ok(())
}

/// The ensemble of each stage.
fn ensembles<'a>(library: &'a Library, stages: &'a StageWeights) -> impl Fn(usize) -> Ensemble<'a> {
    |t: usize| Ensemble::of(library, stages.stage(t))
}

/// Plans about the guess. While the window of the weights fills, it plans again, at most [`MOST_REPETITIONS`] times, about the
/// plan that it found, as long as the trajectory of the last linearisation contradicts the ensemble by more than
/// [`LARGEST_DEFECT`].
///
/// After a cold start the weights change within a few periods from one friction for all members to that of the road. The
/// previous plan then belongs to another vehicle, and one QP about it is no step towards a plan that the vehicle can follow.
fn plan(
    library: &Library,
    settings: &Settings,
    rows: &ValidRequest,
    disturbance: &GpOutput,
    ws: &mut Workspace,
    reply: &mut StepReply,
) {
    let transitions = rows.history_z.len();
    let fills = transitions > 0 && transitions < settings.weights.window(library.dt());
    for _ in 0..=MOST_REPETITIONS {
        let x0 = linearise(library, settings, rows, disturbance, ws);
        assemble(library, settings, rows, &x0, ws);
        solve(settings, ws, reply);
        let again = fills && ws.dynamics.defect > LARGEST_DEFECT;
        if !again || reply.status != Status::Solved {
            break;
        }
        let mass = ws.vehicle.mass;
        let inputs = ws.solution.u.iter().map(|u| unscaled(u, mass));
        ws.guess.take(&ws.solution.x, inputs);
    }
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
    let domain = Domain::new(operating, settings.soft.v_x_max, ws.vehicle.steering_angle);
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

/// Solves the QP, and writes how that ended.
fn solve(settings: &Settings, ws: &mut Workspace, reply: &mut StepReply) {
    warm_start(&ws.guess, ws.vehicle.mass, &mut ws.warm);
    ws.solver_name = solve_with_fallback(
        &mut ws.solvers,
        &ws.qp,
        &ws.warm,
        settings.solver.kkt_tolerance,
        &mut ws.solution,
    );
    reply.status = ws.solution.status;
    reply.iterations = ws.solution.iterations;
    reply.kkt_residual = ws.solution.kkt.worst();
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

/// Writes the reference in the vehicle's frame. Its yaw starts within half a turn of the vehicle's and is continuous.
fn localise_reference(frame: &Frame, rows: &ValidRequest, out: &mut [State]) {
    let mut psi = 0.0;
    for (t, (row, x)) in rows.reference.iter().zip(out).enumerate() {
        psi = match t.checked_sub(1) {
            None => frame.yaw_to_local(row[3]),
            Some(before) => psi + wrap(row[3] - rows.reference[before][3]),
        };
        [x[P_X], x[P_Y]] = frame.position_to_local(row[0], row[1]);
        (x[V_X], x[PSI]) = (row[2], psi);
    }
}

/// Writes the members' predictions of the window's transitions into the reply: those that the request lacks are computed.
///
/// With a measurement delay the inputs of the oldest transitions are not in the request, and their predictions may belong to
/// the inputs of another row: the request does not tell whether their inputs were known when they were predicted. They are
/// in the reply because it has one row for each transition, and no estimate uses them. A transition that is known was also
/// known when it was predicted: the history then had the same older rows, or was full.
fn predict_history(
    members: &[Member],
    rows: &ValidRequest,
    history_z: &[[f64; NZ]],
    executor: &dyn Executor,
    reply: &mut StepReply,
) {
    let width = members.len() * NY;
    let missing = &history_z[..history_z.len() - rows.history_f.len() / width];
    reply.history_f.resize(missing.len() * width, 0.0);
    let points: usize = members.iter().map(Member::n_points).sum();
    let parts = reply.history_f.chunks_exact_mut(width).zip(missing);
    for_each(executor, missing.len() * points, parts, |(row, z)| {
        let z = GpInput::from(*z);
        for (out, member) in row.as_chunks_mut().0.iter_mut().zip(members) {
            *out = <[f64; NY]>::from(member.mean(&z));
        }
    });
    reply.history_f.extend_from_slice(rows.history_f);
}

/// Estimates weights and friction from the newest transitions of the window, and returns how many were used: those whose
/// inputs are in the request, without the last one that [`is_outside_model`] and all before it. Weights change only if the
/// transitions distinguish the members. Without excitation the members' predictions differ by less than the noise, and the
/// weights would follow the noise.
fn estimate_weights(
    library: &Library,
    settings: &Settings,
    rows: &ValidRequest,
    ws: &mut Workspace,
    reply: &mut StepReply,
) -> usize {
    let members = library.members();
    let (history_z, known) = match ws.delay {
        Some(delay) => {
            delay.align(rows.history_z, &mut ws.aligned);
            (&*ws.aligned, delay.known(rows.history_z.len()))
        }
        None => (rows.history_z, rows.history_z.len()),
    };
    predict_history(members, rows, history_z, &*ws.executor, reply);
    validate::starting_weights(rows.weights, &mut ws.previous);
    reply.weights.resize(members.len(), 0.0);
    let used = history_z[..known]
        .iter()
        .position(|z| is_outside_model(z, ws.vehicle.mass))
        .unwrap_or(known);
    let predictions = &reply.history_f[..used * members.len() * NY];
    let measured = &rows.history_y[..used];
    ws.estimator.estimate(
        predictions,
        measured,
        &ws.noise,
        settings.weights.prior,
        &ws.previous,
        &mut reply.weights,
    );
    ws.estimator.select(ws.member_penalty, &mut reply.weights);
    reply.friction = ws
        .friction
        .estimate(&history_z[..used], predictions, measured);
    if settings.weights.whiten && !ws.estimator.informed(&reply.weights) {
        reply.weights.copy_from_slice(&ws.previous);
    }
    used
}

/// Whether a transition of a vehicle with this mass (kg) lies outside the range of the vehicle models. A vehicle that stands
/// with a drive below [`LEAST_DRIVE`] is held by its brakes, which the models do not contain. Below [`MIN_SLIP_SPEED`] the
/// models compute a slip angle of `(1 - v_x / MIN_SLIP_SPEED) delta` that does not exist. Both look like very low friction to
/// the estimator.
fn is_outside_model(z: &[f64; NZ], mass: f64) -> bool {
    let [v_x, _, _, delta, force, _] = *z;
    let stands = v_x < STANDING && force < LEAST_DRIVE * mass;
    stands || (1.0 - v_x / MIN_SLIP_SPEED) * delta.abs() > LARGEST_SLIP_ERROR
}

/// Writes what the residual adds to the ensemble's prediction at each stage, with its variances, and returns its
/// disturbance; zero without a residual. It is estimated from the `used` newest transitions.
fn estimate_residual(
    rows: &ValidRequest,
    used: usize,
    ws: &mut Workspace,
    reply: &StepReply,
) -> GpOutput {
    let Some(filter) = &ws.residual else {
        return GpOutput::zeros();
    };
    let width = reply.weights.len() * NY;
    let transitions = reply.history_f[..used * width].chunks_exact(width);
    let errors = transitions
        .zip(&rows.history_y[..used])
        .map(|(predicted, measured)| blend_error(predicted, measured, &reply.weights));
    let residual = filter.estimate(errors.rev());
    ws.deviations.residual.clear();
    for (offset, (change, variance)) in ws.offsets.iter_mut().zip(residual.ahead()) {
        *offset = change;
        ws.deviations.residual.push(variance);
    }
    residual.disturbance()
}

/// Whether messages may contain the states of a plan. A plan of a vehicle that spins far outside the members' data can have
/// speeds that no vehicle reaches.
fn fits_into_messages(frame: &Frame, plan: &[State]) -> bool {
    let within = |(value, most): (&f64, &f64)| value.abs() <= *most;
    plan.iter().all(|x| {
        let x = frame.to_map(x);
        x.iter().zip(&STATE_IN_MESSAGES).all(within)
    })
}

/// Writes the plan in map coordinates and newtons.
fn write_plan(frame: &Frame, rows: &ValidRequest, ws: &Workspace, reply: &mut StepReply) {
    reply.plan_x.extend_from_slice(rows.x.as_slice()); // row 0 equals the measurement to the bit
    for x in &ws.solution.x[1..] {
        reply.plan_x.extend_from_slice(frame.to_map(x).as_slice());
    }
    for u in &ws.solution.u {
        let u = unscaled(u, ws.vehicle.mass);
        reply.plan_u.extend_from_slice(u.as_slice());
    }
}

/// An input of the solver in newtons.
fn unscaled(u: &Input, mass: f64) -> Input {
    Input::new(u[FORCE] * mass, u[DELTA_DOT])
}
