//! The control step: from a measured state to a plan, as one pure function.
//!
//! There is no clock, no randomness and no state between calls: the same library, settings and request give the same
//! bits with any workspace. `NOTATION.md` lists the symbols.

mod delay;
mod deviations;
mod planning;
mod request;
mod validate;
mod workspace;

pub use request::{StepReply, StepRequest};
pub use validate::StepError;
pub use workspace::{SetupError, Workspace};

use planning::{ensembles, plan, unscaled};
use validate::ValidRequest;

use egp_parameters::STATE_IN_MESSAGES;

use crate::VehicleParameters;
use crate::executor::{Executor, for_each};
use crate::solver::Status;
use crate::vehicle::{Frame, P_X, P_Y, PSI, V_X, wrap};
use crate::weights::blend_error;
use crate::{GpInput, GpOutput, Library, Member, NY, NZ, Settings, State};

/// Speed, m/s, below which a vehicle counts as standing.
const STANDING: f64 = 0.5;
/// Force of the drive per mass, m/s², from which on a slow vehicle is about to move: the most slippery surface transmits it.
const LEAST_DRIVE: f64 = 1.0;
/// Largest error of a model's slip angle, rad, with which a transition is used. Up to this slip angle tyres transmit nearly the
/// same force on all surfaces.
const LARGEST_SLIP_ERROR: f64 = 0.02;

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
    plan(library, settings, &rows, used, &disturbance, ws, reply);
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
/// With a measurement delay the inputs that caused the oldest transitions are not in the request, so that their predictions
/// may have been computed with the inputs of another row. The reply contains them because it has one row for each transition,
/// but no estimate uses them. If the inputs of a transition are in this request, they were also in the request for which the
/// transition was predicted, because that history had the same older rows or the full length of the window.
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

/// Estimates weights and friction, and returns the number of transitions that were used. These are the transitions whose
/// inputs are in the request and that are newer than the newest one for which [`is_outside_model`] is true. Weights change
/// only if the transitions distinguish the members. Without excitation the members' predictions differ by less than the
/// noise, and the weights would follow the noise.
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
        .position(|z| is_outside_model(z, &ws.vehicle))
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
    let penalty = settings.weights.member_penalty(library.least_friction());
    ws.estimator.select(penalty, &mut reply.weights);
    reply.friction = ws
        .friction
        .estimate(&history_z[..used], predictions, measured);
    if settings.weights.whiten && !ws.estimator.informed(&reply.weights) {
        reply.weights.copy_from_slice(&ws.previous);
    }
    used
}

/// Whether a transition lies outside the range of the vehicle models. A vehicle that stands with a drive below [`LEAST_DRIVE`] is
/// held by its brakes, which the models do not contain. Below its [slip speed](VehicleParameters::slip_speed) `v_s` the models
/// compute a slip angle of `(1 - v_x / v_s) delta` that does not exist. Both look like very low friction to the estimator.
fn is_outside_model(z: &[f64; NZ], vehicle: &VehicleParameters) -> bool {
    let [v_x, _, _, delta, force, _] = *z;
    let stands = v_x < STANDING && force < LEAST_DRIVE * vehicle.mass;
    stands || (1.0 - v_x / vehicle.slip_speed()) * delta.abs() > LARGEST_SLIP_ERROR
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
