//! A library: one stored vehicle with its GPs for each surface.
//!
//! Loading means reading (`format`), checking (`verify`) and factoring once; afterwards a [`Library`] never
//! changes. Its identity is the SHA-256 of its bytes, which each request states.

mod data;
mod error;
mod format;
mod limits;
mod member;
mod metadata;
mod subset;
mod verify;

use egp_parameters::VehicleParameters;

pub use data::{LibrarySpec, MemberData};
pub use error::LibraryError;
pub use format::{hash, hex};
pub use limits::{MAX_FILE_BYTES, MAX_HEADER_BYTES};
pub use member::Member;
pub use metadata::{MemberMetadata, Metadata, PriorMean, Signal};
pub use subset::subset;

use crate::Kernel;
use crate::vehicle::Batch;

/// A verified library, ready for predictions.
#[derive(Clone, Debug)]
pub struct Library {
    id: [u8; 32],
    kernel: Kernel,
    metadata: Metadata,
    members: Vec<Member>,
    vehicles: Batch,
}

impl Library {
    /// Reads, verifies and factors a library file.
    ///
    /// # Errors
    /// [`LibraryError`] names the tensor or field, what was expected, what came, and what to do next.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LibraryError> {
        let (metadata, kernel, data) = format::read(bytes)?;
        let mut members = Vec::with_capacity(data.len());
        for (i, data) in data.iter().enumerate() {
            verify::check_values(data, i)?;
            let member = Member::new(data, kernel, metadata.dt).map_err(|singular| {
                LibraryError::NotPositiveDefinite {
                    tensor: format::tensor_name(i, "inputs"),
                    output: singular.output,
                    point: singular.point,
                }
            })?;
            verify::check_alpha(data, &member, i)?;
            verify::check_golden(data, &member, i)?;
            members.push(member);
        }
        let vehicles = members.iter().map(|member| member.vehicle().copied());
        Ok(Self {
            id: hash(bytes),
            kernel,
            vehicles: Batch::new(vehicles, metadata.dt),
            metadata,
            members,
        })
    }

    /// [`hash`] of the file.
    pub fn id(&self) -> [u8; 32] {
        self.id
    }

    /// Period over which the outputs change, s.
    pub fn dt(&self) -> f64 {
        self.metadata.dt
    }

    /// Friction coefficient of the most slippery surface of the members.
    pub fn least_friction(&self) -> f64 {
        let frictions = self.members.iter().map(Member::friction);
        frictions.fold(f64::INFINITY, f64::min)
    }

    /// The vehicle that the library was trained for.
    pub fn vehicle(&self) -> &VehicleParameters {
        &self.metadata.parameters
    }

    /// The kernel of all members.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// The members, in the order of the weights.
    pub fn members(&self) -> &[Member] {
        &self.members
    }

    /// The members' vehicles, in the same order.
    pub(crate) fn vehicles(&self) -> &Batch {
        &self.vehicles
    }

    /// Units, names, vehicle, provenance.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }
}

/// The bytes of a library file; the same specification gives the same bytes.
///
/// They are read back and verified, so that no file is written that [`Library::from_bytes`] would not read.
///
/// # Errors
/// As [`Library::from_bytes`].
pub fn encode(spec: &LibrarySpec) -> Result<Vec<u8>, LibraryError> {
    spec.parameters.validate().map_err(LibraryError::Vehicle)?;
    let bytes = format::write(spec)?;
    Library::from_bytes(&bytes)?;
    Ok(bytes)
}
