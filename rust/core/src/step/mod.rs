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
use validate::Rows;

use crate::executor::for_each;
use crate::ocp::{self, Road, Setup};
use crate::preview::StageWeights;
use crate::solver::{Status, solve_with_fallback};
use crate::trajectory::Guess;
use crate::vehicle::{DELTA_DOT, FORCE, Frame, P_X, P_Y, PSI, TyreLimits, V_X, wrap};
use crate::{Ensemble, GpInput, GpOutput, Input, Library, Member, NY, Settings, State};

/// One control step: weights, eq. (6); residual; linearisation, eqs. (15)-(17); optimal control problem, eq. (18).
///
/// After the first call with a workspace nothing is allocated here, but the QP solver and a parallel executor may
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
    estimate_weights(library, settings, &rows, ws, reply);
    let disturbance = estimate_residual(&rows, ws, reply);

    let frame = Frame::of(&rows.x);
    localise_reference(&frame, &rows, &mut ws.reference);
    ws.guess
        .shift(&frame, rows.plan_x, rows.plan_u, rows.plan_shift);

    reply.dropped_mass = ws
        .stages
        .fill(&reply.weights, rows.road_friction, &settings.weights);
    let now = Ensemble::new(library, ws.stages.stage(0), 0.0).map_err(StepError::Ensemble)?;
    let present = |delay: Delay| delay.present(&rows, &now, &disturbance);
    let x0 = local_state(&ws.delay.map_or(rows.x, present));
    let ensembles = |t: usize| now.with_weights(ws.stages.stage(t));
    let edges = [settings.soft.v_x_max, ws.vehicle.steering_angle];
    ws.dynamics.along(
        |t| (ensembles(t), ws.offsets[t]),
        library.dt(),
        &x0,
        &ws.guess,
        &settings.operating,
        edges,
    );
    blend_tyre_limits(&ws.tyres, &ws.stages, &mut ws.stage_tyres);
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
        &x0,
        &rows.u_prev,
        &ws.dynamics,
        &ws.guess,
        &road,
        &mut ws.qp,
    );
    if settings.soft.caution > 0.0 {
        let transitions = ws
            .dynamics
            .x
            .iter()
            .copied()
            .zip(ws.guess.u.iter().copied());
        let disturbances = ws.deviations.disturbances(
            library.members(),
            &ws.stages,
            ensembles,
            rows.road_friction,
            transitions,
            &*ws.executor,
        );
        ws.caution
            .tighten(settings.soft.caution, disturbances, &mut ws.qp);
    }

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
    if reply.status == Status::Solved {
        write_plan(&frame, &rows, ws, reply);
        if request.want_sigma {
            ws.deviations.write(ensembles, &*ws.executor, reply);
        }
    }
    Ok(())
}

/// The tyre limits of each stage: those of the members, blended with the weights of the stage.
fn blend_tyre_limits(members: &[TyreLimits], stages: &StageWeights, blends: &mut [TyreLimits]) {
    for (t, blend) in blends.iter_mut().enumerate() {
        *blend = TyreLimits::default();
        for (limits, weight) in members.iter().zip(stages.stage(t)) {
            *blend += *limits * *weight;
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
fn localise_reference(frame: &Frame, rows: &Rows, out: &mut [State]) {
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

/// Estimates weights and friction from the window. Weights change only if the window distinguishes the members:
/// without excitation they differ by less than the noise, which the weights would follow. Predictions that the request
/// lacks are computed for all members and returned.
fn estimate_weights(
    library: &Library,
    settings: &Settings,
    rows: &Rows,
    ws: &mut Workspace,
    reply: &mut StepReply,
) {
    let members = library.members();
    let width = members.len() * NY;
    let history_z = match ws.delay {
        Some(delay) => {
            delay.align(rows.history_z, &mut ws.aligned);
            &ws.aligned
        }
        None => rows.history_z,
    };
    let missing = &history_z[..history_z.len() - rows.history_f.len() / width];
    reply.history_f.resize(missing.len() * width, 0.0);
    let points: usize = members.iter().map(Member::n_points).sum();
    let parts = reply.history_f.chunks_exact_mut(width).zip(missing);
    for_each(&*ws.executor, missing.len() * points, parts, |(row, z)| {
        let z = GpInput::from(*z);
        for (out, member) in row.as_chunks_mut().0.iter_mut().zip(members) {
            *out = <[f64; NY]>::from(member.mean(&z));
        }
    });
    reply.history_f.extend_from_slice(rows.history_f);
    validate::starting_weights(rows.weights, &mut ws.previous);
    reply.weights.resize(members.len(), 0.0);
    ws.estimator.estimate(
        &reply.history_f,
        rows.history_y,
        &ws.noise,
        settings.weights.prior,
        &ws.previous,
        &mut reply.weights,
    );
    // With a measurement delay the inputs of the oldest rows are not in the request. The friction is estimated without these
    // rows, because `Delay::align` fills them with the inputs of another row. The weights use the members' predictions that
    // the request carries, which were computed while the inputs were in the window.
    let known = ws
        .delay
        .map_or(history_z.len(), |delay| delay.known(history_z.len()));
    reply.friction = ws.friction.estimate(
        &history_z[..known],
        &reply.history_f,
        rows.history_y,
        &ws.previous,
    );
    if settings.weights.whiten && !ws.estimator.informed(&reply.weights) {
        reply.weights.copy_from_slice(&ws.previous);
    }
}

/// Writes what the residual adds to the ensemble's prediction at each stage, with its variances, and returns its
/// disturbance; zero without a residual.
fn estimate_residual(rows: &Rows, ws: &mut Workspace, reply: &StepReply) -> GpOutput {
    let Some(filter) = &ws.residual else {
        return GpOutput::zeros();
    };
    let predictions = reply.history_f.as_chunks::<NY>().0;
    let transitions = predictions.chunks_exact(reply.weights.len());
    let errors = transitions.zip(rows.history_y).map(|(members, measured)| {
        let blend = members.iter().zip(&reply.weights);
        blend.fold(GpOutput::from(*measured), |error, (f, w)| {
            error - GpOutput::from(*f) * *w
        })
    });
    let residual = filter.estimate(errors.rev());
    ws.deviations.residual.clear();
    for (offset, (change, variance)) in ws.offsets.iter_mut().zip(residual.ahead()) {
        *offset = change;
        ws.deviations.residual.push(variance);
    }
    residual.disturbance()
}

/// Writes the plan in map coordinates and newtons.
fn write_plan(frame: &Frame, rows: &Rows, ws: &Workspace, reply: &mut StepReply) {
    reply.plan_x.extend_from_slice(rows.x.as_slice()); // row 0 equals the measurement to the bit
    for x in &ws.solution.x[1..] {
        reply.plan_x.extend_from_slice(frame.to_map(x).as_slice());
    }
    for u in &ws.solution.u {
        reply
            .plan_u
            .extend([u[FORCE] * ws.vehicle.mass, u[DELTA_DOT]]);
    }
}
