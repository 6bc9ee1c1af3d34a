//! Signatures of libraries (Ed25519): a service with public keys serves no library that others made.

use std::fs;
use std::path::{Path, PathBuf};

use egp_wire::from_hex;
use ring::digest::{SHA256, digest};
use ring::signature::{ED25519, UnparsedPublicKey};
use thiserror::Error;

/// Precedes the SHA-256 of the library in what is signed, so that a signature is of no use for anything else.
const PURPOSE: &[u8] = b"egp.v1 library\0";

/// An Ed25519 signature.
pub(crate) type Signature = [u8; 64];

/// Why a library is not accepted by its signature.
#[derive(Debug, Error)]
pub enum SignatureError {
    /// A file cannot be read.
    #[error(
        "cannot read {path}: {source}; `egp sign` writes the signature of a library, `egp keys` the public key"
    )]
    Read {
        /// The file.
        path: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The file holds something else.
    #[error(
        "{path}, line {line}: expected {bytes} bytes as hexadecimal digits, as `egp keys` writes them into library.pub, and \
         `egp sign` beside a library"
    )]
    Content {
        /// The file.
        path: String,
        /// The expected number of bytes.
        bytes: usize,
        /// The number of the line at fault. Its text may be a secret in a file that was confused with another.
        line: usize,
    },
    /// No line of a file has a public key.
    #[error(
        "{path}: there is no public key in it, so that no library would be accepted; `egp keys` writes library.pub with one"
    )]
    Empty {
        /// The file.
        path: String,
    },
    /// The signature is none of this library by one of the keys.
    #[error(
        "{path} is not signed by any of the {keys} configured keys; sign it with `egp sign`, or add the signer's key"
    )]
    Foreign {
        /// The library.
        path: String,
        /// The number of keys.
        keys: usize,
    },
}

/// The public keys of those who may sign libraries.
pub(crate) struct Signers(Vec<[u8; 32]>);

impl Signers {
    /// Reads a file with one key a line; empty lines and those that begin with `#` are left out.
    ///
    /// # Errors
    /// [`SignatureError`] if the file cannot be read, or has no key or something else.
    pub(crate) fn load(path: &Path) -> Result<Self, SignatureError> {
        let text = read(path)?;
        let lines = (1..).zip(text.lines().map(str::trim));
        let lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        let keys = lines
            .map(|(number, line)| bytes(path, number, line))
            .collect::<Result<Vec<_>, _>>()?;
        if keys.is_empty() {
            let path = path.display().to_string();
            return Err(SignatureError::Empty { path });
        }
        Ok(Self(keys))
    }

    /// Checks the bytes of a library with the signature in the file beside it, and returns that signature.
    ///
    /// # Errors
    /// [`SignatureError`] if there is no signature, or none of these bytes by one of the keys.
    pub(crate) fn check(
        &self,
        library: &Path,
        content: &[u8],
    ) -> Result<Signature, SignatureError> {
        let signature = signature_beside(library)?;
        self.accept(library, content, &signature)?;
        Ok(signature)
    }

    /// Checks the bytes of a library with a signature; `library` names it in the error.
    ///
    /// # Errors
    /// [`SignatureError::Foreign`].
    pub(crate) fn accept(
        &self,
        library: &Path,
        content: &[u8],
        signature: &Signature,
    ) -> Result<(), SignatureError> {
        let signed = [PURPOSE, digest(&SHA256, content).as_ref()].concat();
        let by = |key: &[u8; 32]| {
            let key = UnparsedPublicKey::new(&ED25519, key);
            key.verify(&signed, signature).is_ok()
        };
        if self.0.iter().any(by) {
            return Ok(());
        }
        Err(SignatureError::Foreign {
            path: library.display().to_string(),
            keys: self.0.len(),
        })
    }
}

/// The file in which the signature of a library is.
pub(crate) fn signature_path(library: &Path) -> PathBuf {
    let mut name = library.as_os_str().to_owned();
    name.push(".sig");
    name.into()
}

/// The signature in the file beside a library.
///
/// # Errors
/// [`SignatureError`] if the file cannot be read or holds something else.
pub(crate) fn signature_beside(library: &Path) -> Result<Signature, SignatureError> {
    let path = signature_path(library);
    bytes(&path, 1, read(&path)?.trim())
}

fn read(path: &Path) -> Result<String, SignatureError> {
    fs::read_to_string(path).map_err(|source| SignatureError::Read {
        path: path.display().to_string(),
        source,
    })
}

/// The bytes of a line of hexadecimal digits; `number` names it in the error.
fn bytes<const N: usize>(
    path: &Path,
    number: usize,
    line: &str,
) -> Result<[u8; N], SignatureError> {
    from_hex(line).ok_or_else(|| SignatureError::Content {
        path: path.display().to_string(),
        bytes: N,
        line: number,
    })
}
