//! The requests of a recorded run.

use std::collections::BTreeSet;
use std::path::Path;

use egp_wire::keys::Name;
use egp_wire::{Ready, Request, read_regular};
use thiserror::Error;

use crate::Failure;

/// Largest number of bytes of a file of requests.
const MOST_BYTES: u64 = 4 << 30;

/// Why a recording cannot be replayed at the replicas that were found.
#[derive(Debug, PartialEq, Error)]
pub(crate) enum UnfitRecording {
    /// A replica does not serve a library of the recording.
    #[error(
        "replica {0} serves another library; replay a recording that was made with a library that is served"
    )]
    Unserved(Name),
    /// A replica answers only sealed requests, and a seal cannot be used twice.
    #[error(
        "replica {0} answers only vehicles with a secret key, and recorded requests cannot be sealed again; replay them at a \
         service without `vehicle_keys`"
    )]
    Sealed(Name),
    /// A library of the recording is not the one that a replica describes, so that its control period is not known.
    #[error(
        "replicas serve the library of the recording beside the one that they describe, and do not state its control period; \
         start a service whose `library` is that of the recording, or replay a recording of the library that it describes"
    )]
    Undescribed,
    /// Replicas state different control periods for the libraries of the recording, s.
    #[error(
        "replicas state control periods of {0} s and of {1} s for the libraries of the recording; replay recordings of one \
         library at a time"
    )]
    Periods(f64, f64),
}

/// The control period of the libraries of a recording, s, by the descriptions of the replicas. A description states the period
/// of the replica's own library only.
///
/// # Errors
/// [`UnfitRecording`] if a replica does not serve a library of the recording or answers only sealed requests, no replica
/// describes one, or their periods differ.
pub(crate) fn period(
    replicas: &[(Name, Ready)],
    recorded: &[Request],
) -> Result<f64, UnfitRecording> {
    let libraries: BTreeSet<_> = recorded.iter().map(|request| request.library).collect();
    for (replica, ready) in replicas {
        if !libraries.iter().all(|library| ready.serves(library)) {
            return Err(UnfitRecording::Unserved(replica.clone()));
        }
        if ready.sealed {
            return Err(UnfitRecording::Sealed(replica.clone()));
        }
    }
    let mut periods = Vec::new();
    for library in &libraries {
        let describes = |ready: &&Ready| ready.library == *library;
        let mut described = replicas.iter().map(|(_, ready)| ready).filter(describes);
        let first = described.next().ok_or(UnfitRecording::Undescribed)?;
        periods.push(first.dt);
        periods.extend(described.map(|ready| ready.dt));
    }
    let first = periods.first().copied();
    let first = first.ok_or(UnfitRecording::Undescribed)?;
    match periods.into_iter().find(|period| *period != first) {
        Some(other) => Err(UnfitRecording::Periods(first, other)),
        None => Ok(first),
    }
}

/// Requests in the order in which they were sent, from a file that holds for each its length as a varint and its bytes, which
/// is protobuf's delimited form. `egp load --replay run.mcap` makes such a file of a recording.
///
/// # Errors
/// A message if the file cannot be read, or holds no request or one that is not valid.
pub(crate) fn read(path: &Path) -> Result<Vec<Request>, Failure> {
    let name = path.display();
    let bytes = read_regular(path, MOST_BYTES + 1);
    let bytes = bytes.map_err(|error| format!("cannot read {name}: {error}"))?;
    if bytes.len() as u64 > MOST_BYTES {
        return Err(format!("{name}: expected at most 4 GiB of requests; replay a part").into());
    }
    let mut rest = bytes.as_slice();
    let mut requests = Vec::new();
    while !rest.is_empty() {
        let length = prost::decode_length_delimiter(&mut rest)
            .ok()
            .filter(|length| *length <= rest.len())
            .ok_or_else(|| format!("{name}: expected requests in protobuf's delimited form"))?;
        let (message, others) = rest.split_at(length);
        let request = Request::decode(message);
        requests.push(request.map_err(|error| format!("{name}: a request: {error}"))?);
        rest = others;
    }
    if requests.is_empty() {
        return Err(format!("{name}: no requests").into());
    }
    Ok(requests)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use egp_testing::messages;

    use super::*;

    /// A replica that describes a library with a period, and serves others beside it. A library is 32 times its number.
    fn replica(name: &str, library: u8, dt: f64, others: &[u8]) -> (Name, Ready) {
        let ready = Ready {
            library: [library; 32],
            dt,
            others: others.iter().map(|number| [*number; 32]).collect(),
            ..messages::ready()
        };
        (name.parse().unwrap(), ready)
    }

    fn request(library: u8) -> Request {
        Request {
            library: [library; 32],
            ..messages::cold_request()
        }
    }

    #[test]
    fn the_period_is_that_of_the_library_of_the_recording() {
        let (old, new) = (replica("a", 1, 0.02, &[2]), replica("b", 2, 0.05, &[1]));
        let both = [old.clone(), new.clone()];
        assert_eq!(period(&both, &[request(1), request(1)]), Ok(0.02));
        assert_eq!(period(&both, &[request(2)]), Ok(0.05));
        // The description of a replica states nothing about the libraries that it serves beside its own.
        assert_eq!(
            period(std::slice::from_ref(&old), &[request(2)]),
            Err(UnfitRecording::Undescribed)
        );
        assert_eq!(
            period(&both, &[request(1), request(2)]),
            Err(UnfitRecording::Periods(0.02, 0.05))
        );
        let (name, ready) = old;
        let sealed = Ready {
            sealed: true,
            ..ready
        };
        assert_eq!(
            period(&[(name.clone(), sealed)], &[request(1)]),
            Err(UnfitRecording::Sealed(name))
        );
        let alike = [replica("a", 1, 0.02, &[2]), replica("b", 2, 0.02, &[1])];
        assert_eq!(period(&alike, &[request(1), request(2)]), Ok(0.02));
        let differing = [replica("a", 1, 0.02, &[]), replica("b", 1, 0.05, &[])];
        assert_eq!(
            period(&differing, &[request(1)]),
            Err(UnfitRecording::Periods(0.02, 0.05))
        );
        let foreign = replica("c", 3, 0.02, &[]);
        assert_eq!(
            period(&[new, foreign.clone()], &[request(2)]),
            Err(UnfitRecording::Unserved(foreign.0))
        );
    }
}
