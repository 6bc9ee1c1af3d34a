//! Whether a reply may be used: it is checked against the request and the library before anything of it is kept.

use egp_wire::{Invalid, Ready, Reply, Request, Status};

/// Largest distance between the vehicle and any position of its plan, m.
const MAX_REACH: f64 = 1000.0;

/// Decodes the reply to `request` from a replica that serves what `served` says.
///
/// # Errors
/// [`Invalid`] naming the first field that is malformed, outside its domain, or not an answer to this request.
pub(crate) fn decode(bytes: &[u8], request: &Request, served: &Ready) -> Result<Reply, Invalid> {
    let reply = Reply::decode(bytes)?;
    if reply.library != served.library {
        return Err(Invalid::field(
            "library",
            "the reply comes from another library",
        ));
    }
    if reply.sequence != request.sequence {
        return Err(Invalid::field(
            "sequence",
            format!(
                "expected the reply to request {}, got the one to request {}",
                request.sequence, reply.sequence
            ),
        ));
    }
    let members = served.members.len();
    count("weights", reply.weights.len(), members)?;
    if !reply.history_f.is_empty() {
        count("history_f", reply.history_f.members, members)?;
        count("history_f", reply.history_f.len(), request.history_z.len())?;
    }
    if !reply.sigma.is_empty() {
        count("sigma", reply.sigma.len(), served.horizon as usize + 1)?;
    }
    if reply.status == Status::Solved {
        plan(&reply, request, served)?;
    }
    Ok(reply)
}

fn plan(reply: &Reply, request: &Request, served: &Ready) -> Result<(), Invalid> {
    count("plan_u", reply.plan_u.len(), served.horizon as usize)?;
    if reply.plan_x.first() != Some(&request.x) {
        return Err(Invalid::field(
            "plan_x",
            "row 0 is not the measured state of the request",
        ));
    }
    let [p_x, p_y, ..] = request.x;
    let distance = |row: &egp_wire::State| (row[0] - p_x).hypot(row[1] - p_y);
    match reply
        .plan_x
        .iter()
        .position(|row| distance(row) > MAX_REACH)
    {
        Some(row) => Err(Invalid::field(
            "plan_x",
            format!("row {row} lies more than {MAX_REACH} m from the vehicle"),
        )),
        None => Ok(()),
    }
}

fn count(field: &'static str, got: usize, expected: usize) -> Result<(), Invalid> {
    if got == expected {
        return Ok(());
    }
    Err(Invalid::field(
        field,
        format!("expected {expected} as the library and the request have, got {got}"),
    ))
}
