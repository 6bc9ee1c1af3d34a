//! A library of some of another one's members.

use super::{LibraryError, LibrarySpec, encode, format, hash, hex};

/// The bytes of a library file with the given members of the library in `bytes`, in the given order.
///
/// A member taken more than once, to measure how time grows, gets a number behind its label. GPs are taken over
/// bit for bit; the provenance gains `subset_of`, the other library's SHA-256.
///
/// # Errors
/// [`LibraryError::NoMember`] for a member that isn't there, otherwise as
/// [`Library::from_bytes`](super::Library::from_bytes).
pub fn subset(bytes: &[u8], members: &[usize]) -> Result<Vec<u8>, LibraryError> {
    let (metadata, kernel, data) = format::read(bytes)?;
    let pick = |(place, &index): (usize, &usize)| {
        let count = data.len();
        let mut member = data
            .get(index)
            .cloned()
            .ok_or(LibraryError::NoMember { index, count })?;
        let before = members[..place].iter().filter(|&&m| m == index).count();
        if before > 0 {
            member.label = format!("{} ({})", member.label, before + 1);
        }
        Ok(member)
    };
    let mut provenance = metadata.provenance.clone();
    provenance.insert("subset_of".to_owned(), hex(&hash(bytes)));
    encode(&LibrarySpec {
        dt: metadata.dt,
        kernel,
        vehicle: metadata.vehicle.clone(),
        parameters: metadata.parameters,
        measurement_noise: metadata.measurement_noise,
        measurement_delay: metadata.measurement_delay,
        provenance,
        members: members
            .iter()
            .enumerate()
            .map(pick)
            .collect::<Result<_, _>>()?,
    })
}
