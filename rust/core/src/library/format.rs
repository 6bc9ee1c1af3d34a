//! The library file: a safetensors container sealed by a digest.
//!
//! Tensors are `members.{i}.{name}`, all `F64`, with the names and shapes of [`MemberData`]; the metadata are one
//! JSON string under the key `egp`. The safetensors crate checks offsets and sizes; size of the header, content and values
//! are checked here.

use std::collections::{BTreeSet, HashMap};

use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, TensorView};
use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::LibraryError;
use super::data::{LibrarySpec, MemberData};
use super::limits::{MAX_FILE_BYTES, MAX_HEADER_BYTES, SCHEMA_VERSION};
use super::metadata::Metadata;
use crate::Kernel;

/// Key of the JSON text among the container's metadata.
const METADATA_KEY: &str = "egp";
/// Bytes of the header's length field.
const LENGTH_BYTES: usize = 8;
/// Hexadecimal digits of the seal.
pub(super) const DIGITS: usize = 64;

/// The metadata that are read first: the version of the format and the seal.
#[derive(Deserialize)]
struct Preamble {
    schema: u32,
    sha256: String,
}

/// Writes a file; nothing of the content is checked here.
pub(super) fn write(spec: &LibrarySpec) -> Result<Vec<u8>, LibraryError> {
    let mut metadata = Metadata::new(spec);
    let unsealed = container(&metadata, &spec.members)?;
    metadata.sha256 = hex(&Sha256::digest(unsealed));
    container(&metadata, &spec.members)
}

/// Reads a file, with the kernel that its metadata name: container, seal, schema version, metadata, and names, types and shapes
/// of the tensors, in this order.
pub(super) fn read(bytes: &[u8]) -> Result<(Metadata, Kernel, Vec<MemberData>), LibraryError> {
    let header_end = check_lengths(bytes)?;
    let (_, header) = SafeTensors::read_metadata(bytes)
        .map_err(|error| container_error(error, bytes, header_end))?;
    let text = header
        .metadata()
        .as_ref()
        .and_then(|metadata| metadata.get(METADATA_KEY));
    let text = text.ok_or_else(|| malformed(format!("metadata have no key \"{METADATA_KEY}\"")))?;
    let preamble: Preamble = serde_json::from_str(text).map_err(malformed)?;
    check_seal(bytes, header_end, &preamble.sha256)?;
    if preamble.schema != SCHEMA_VERSION {
        return Err(LibraryError::SchemaVersion {
            found: preamble.schema,
            supported: SCHEMA_VERSION,
        });
    }
    let metadata: Metadata =
        serde_json::from_str(text).map_err(|error| LibraryError::Metadata {
            reason: error.to_string(),
        })?;
    let kernel = metadata.validate()?;

    let tensors = SafeTensors::deserialize(bytes).map_err(malformed)?;
    let mut unread = tensors.names().into_iter().collect();
    let mut members = Vec::with_capacity(metadata.members.len());
    for (i, member) in metadata.members.iter().enumerate() {
        members.push(MemberData::read(
            member,
            &mut Source {
                tensors: &tensors,
                unread: &mut unread,
                member: i,
            },
        )?);
    }
    match unread.first() {
        Some(&tensor) => Err(LibraryError::UnexpectedTensor {
            tensor: tensor.to_owned(),
        }),
        None => Ok((metadata, kernel, members)),
    }
}

/// The name of a member's tensor in the file.
pub(super) fn tensor_name(member: usize, name: &str) -> String {
    format!("members.{member}.{name}")
}

/// SHA-256 of a library file, by which requests name their library.
pub fn hash(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

/// Lower-case hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes
        .iter()
        .fold(String::with_capacity(2 * bytes.len()), |digits, byte| {
            digits + &format!("{byte:02x}")
        })
}

/// The tensors of one member inside a file.
pub(super) struct Source<'a, 'b> {
    tensors: &'a SafeTensors<'a>,
    unread: &'b mut BTreeSet<&'a str>,
    member: usize,
}

impl<'a> Source<'a, '_> {
    fn view(&self, name: &'static str) -> Result<TensorView<'a>, LibraryError> {
        let tensor = tensor_name(self.member, name);
        self.tensors
            .tensor(&tensor)
            .map_err(|_| LibraryError::MissingTensor { tensor })
    }

    /// Whether there is such a tensor.
    pub fn has(&self, name: &'static str) -> bool {
        self.view(name).is_ok()
    }

    /// The first dimension of a tensor.
    pub fn leading(&self, name: &'static str) -> Result<usize, LibraryError> {
        Ok(self.view(name)?.shape().first().copied().unwrap_or(0))
    }

    /// The numbers of a tensor, which must have that shape.
    pub fn take(&mut self, name: &'static str, shape: &[usize]) -> Result<Vec<f64>, LibraryError> {
        let view = self.view(name)?;
        let tensor = tensor_name(self.member, name);
        self.unread.remove(tensor.as_str());
        if view.dtype() != Dtype::F64 {
            return Err(LibraryError::DataType {
                tensor,
                found: view.dtype().to_string(),
            });
        }
        if view.shape() != shape {
            return Err(LibraryError::Shape {
                tensor,
                expected: shape.to_vec(),
                found: view.shape().to_vec(),
            });
        }
        let (numbers, _) = view.data().as_chunks::<8>();
        Ok(numbers
            .iter()
            .map(|&bytes| f64::from_le_bytes(bytes))
            .collect())
    }
}

/// The container with these metadata as they are.
fn container(metadata: &Metadata, members: &[MemberData]) -> Result<Vec<u8>, LibraryError> {
    let mut tensors = Vec::new();
    for (i, member) in members.iter().enumerate() {
        for (name, shape, values) in member.tensors() {
            let bytes: Vec<u8> = values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect();
            tensors.push((tensor_name(i, name), shape, bytes));
        }
    }
    let mut views = Vec::with_capacity(tensors.len());
    for (name, shape, bytes) in &tensors {
        views.push((
            name,
            TensorView::new(Dtype::F64, shape.clone(), bytes).map_err(malformed)?,
        ));
    }
    let text = serde_json::to_string(metadata).map_err(malformed)?;
    // One key only: the order of several would differ from run to run.
    safetensors::serialize(
        views,
        Some(HashMap::from([(METADATA_KEY.to_owned(), text)])),
    )
    .map_err(malformed)
}

/// Where the header ends, before anything of it is parsed.
fn check_lengths(bytes: &[u8]) -> Result<usize, LibraryError> {
    let found = bytes.len();
    if found > MAX_FILE_BYTES {
        return Err(LibraryError::TooLarge {
            limit: MAX_FILE_BYTES,
        });
    }
    let length = bytes.first_chunk().ok_or(LibraryError::Length {
        expected: LENGTH_BYTES,
        found,
    })?;
    if length.starts_with(b"PAR1") {
        return Err(LibraryError::Parquet);
    }
    let claimed = u64::from_le_bytes(*length);
    let header = usize::try_from(claimed)
        .ok()
        .filter(|&header| header <= MAX_HEADER_BYTES)
        .ok_or(LibraryError::HeaderTooLarge {
            bytes: claimed,
            limit: MAX_HEADER_BYTES,
        })?;
    let expected = LENGTH_BYTES + header;
    if found < expected {
        return Err(LibraryError::Length { expected, found });
    }
    Ok(expected)
}

/// Compares the content with the digest it was sealed with.
fn check_seal(bytes: &[u8], header_end: usize, expected: &str) -> Result<(), LibraryError> {
    let (header, data) = bytes.split_at(header_end);
    let mut unsealed = header.to_vec();
    // Present, since the string was parsed out of this header; should an escape hide it, the digests differ.
    if let Some(start) = header
        .windows(DIGITS)
        .position(|digits| digits == expected.as_bytes())
    {
        unsealed[start..start + DIGITS].fill(b'0');
    }
    let found = hex(&Sha256::new()
        .chain_update(unsealed)
        .chain_update(data)
        .finalize());
    if found == expected {
        return Ok(());
    }
    Err(LibraryError::Corrupt {
        expected: expected.to_owned(),
        found,
    })
}

// By value, because that is how `map_err` hands the error over.
#[allow(clippy::needless_pass_by_value)]
fn malformed(reason: impl ToString) -> LibraryError {
    LibraryError::Malformed {
        reason: reason.to_string(),
    }
}

/// The error for a file that the container's parser does not accept. A wrong total length has an error of its own.
fn container_error(error: SafeTensorError, bytes: &[u8], header_end: usize) -> LibraryError {
    /// End of a tensor's bytes after the header.
    #[derive(Deserialize)]
    struct Offsets {
        data_offsets: (usize, usize),
    }
    if !matches!(error, SafeTensorError::MetadataIncompleteBuffer) {
        return malformed(error);
    }
    let header: HashMap<String, serde_json::Value> =
        serde_json::from_slice(&bytes[LENGTH_BYTES..header_end]).unwrap_or_default();
    let ends = header
        .into_values()
        .filter_map(|value| serde_json::from_value::<Offsets>(value).ok());
    let data = ends
        .map(|offsets| offsets.data_offsets.1)
        .max()
        .unwrap_or(0);
    LibraryError::Length {
        expected: header_end + data,
        found: bytes.len(),
    }
}
