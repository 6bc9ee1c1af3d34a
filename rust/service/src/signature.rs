//! Signatures of libraries (Ed25519): a service with public keys serves no library that others made.

use std::path::{Path, PathBuf};
use std::{fs, io};

use egp_core::library;
use egp_wire::{Replacement, from_hex, read_regular, read_text, replaceable, sync_folder};
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
        source: io::Error,
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
    /// None of the keys verifies the signature for this library.
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
    /// [`SignatureError`] if there is no signature, or if none of the keys verifies it for these bytes.
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

/// A file that cannot be written, and the reason.
pub(crate) type Unwritten = (PathBuf, io::Error);

/// Makes an [`Unwritten`] of this file.
fn unwritten(path: &Path) -> impl Fn(io::Error) -> Unwritten {
    |source| (path.to_owned(), source)
}

/// Checks that a library and its signature may be written to their files.
///
/// # Errors
/// [`Unwritten`] as of [`replaceable`].
pub(crate) fn check_replaceable(library: &Path) -> Result<(), Unwritten> {
    for file in [library, &signature_path(library)] {
        replaceable(file).map_err(unwritten(file))?;
    }
    Ok(())
}

/// A library and its signature, written beside the files that they are to replace.
pub(crate) struct NewLibrary {
    file: PathBuf,
    library: Replacement,
    /// The file of the signature, to which the path beside the library may lead as a link.
    signature_file: PathBuf,
    /// The file of the new signature; none if the library has none, and no file may then be beside it.
    signature: Option<Replacement>,
    /// The file of the signature as it is now; none if there is none.
    before: Option<Replacement>,
}

impl NewLibrary {
    /// Writes all that [`NewLibrary::replace`] may need, so that it only renames files.
    ///
    /// # Errors
    /// [`Unwritten`] if a file cannot be written, or the present signature cannot be read; no file is replaced then.
    pub(crate) fn write(
        file: &Path,
        bytes: &[u8],
        signature: Option<Signature>,
    ) -> Result<Self, Unwritten> {
        let named = signature_path(file);
        let beside = replaceable(&named).map_err(unwritten(&named))?;
        let library = Replacement::write(file, bytes).map_err(unwritten(file))?;
        let write = |bytes: &[u8]| Replacement::write(&beside, bytes).map_err(unwritten(&beside));
        let line = signature.map(|signature| format!("{}\n", library::hex(&signature)));
        let signature = line.map(|line| write(line.as_bytes())).transpose()?;
        let before = present(&beside).map_err(unwritten(&beside))?;
        let before = before.map(|bytes| write(&bytes)).transpose()?;
        Ok(Self {
            file: file.to_owned(),
            library,
            signature_file: beside,
            signature,
            before,
        })
    }

    /// Replaces the signature and after it the library, so that a service that watches the library finds its signature.
    ///
    /// # Errors
    /// [`Unwritten`]. Both files are as before, unless only the last step failed, which writes the folder's entries to the
    /// disk, or the error says that the signature of before could not be put back. A process that is killed between the two
    /// replacements leaves the old library with the new signature, too.
    pub(crate) fn replace(self) -> Result<(), Unwritten> {
        let beside = self.signature_file;
        let is_signed = self.signature.is_some();
        let changed = match (self.signature, &self.before) {
            (Some(signature), _) => signature.rename(),
            // It is the signature of what the file held before.
            (None, Some(_)) => fs::remove_file(&beside),
            (None, None) => Ok(()),
        };
        changed.map_err(unwritten(&beside))?;
        // As a link, the library may lead into another folder than that of its signature.
        let library = self.library.path().to_owned();
        if let Err(source) = self.library.rename() {
            let put_back = match self.before {
                Some(before) => before.rename(),
                None if is_signed => fs::remove_file(&beside),
                None => Ok(()),
            };
            let source = match put_back {
                Ok(()) => source,
                Err(second) => not_put_back(&source, &beside, &second),
            };
            return Err((self.file, source));
        }
        sync_folder(&beside).map_err(unwritten(&beside))?;
        sync_folder(&library).map_err(unwritten(&self.file))
    }
}

/// The error of a library that could not be replaced after its signature was.
fn not_put_back(source: &io::Error, beside: &Path, second: &io::Error) -> io::Error {
    let beside = beside.display();
    io::Error::other(format!(
        "{source}; the signature in {beside} is no longer that of this library, because it could not be put back: {second}; \
         sign the library again"
    ))
}

/// The bytes of the file of a signature; none if there is no such file.
fn present(path: &Path) -> io::Result<Option<Vec<u8>>> {
    /// A line with a signature has 129 bytes.
    const MOST: u64 = 1 << 16;
    match read_regular(path, MOST + 1) {
        Ok(bytes) if bytes.len() as u64 > MOST => {
            let reason = "it has too many bytes for a signature; remove it";
            Err(io::Error::new(io::ErrorKind::InvalidData, reason))
        }
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
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
    read_text(path).map_err(|source| SignatureError::Read {
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

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const OLD: &[u8] = b"the old signature\n";

    /// A folder with a library and this file of a signature, and the library.
    fn folder(test: &str, signature: Option<&[u8]>) -> (PathBuf, PathBuf) {
        let folder = std::env::temp_dir().join(format!("egp-{test}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let file = folder.join("library");
        fs::write(&file, "old").unwrap();
        if let Some(bytes) = signature {
            fs::write(signature_path(&file), bytes).unwrap();
        }
        (folder, file)
    }

    /// The contents of a library and of its signature, of which the latter may be missing.
    fn contents(file: &Path) -> (Vec<u8>, Option<Vec<u8>>) {
        (fs::read(file).unwrap(), fs::read(signature_path(file)).ok())
    }

    #[test]
    fn a_library_is_replaced_together_with_its_signature() {
        let line = |digits: &str| Some(format!("{}\n", digits.repeat(64)).into_bytes());
        for (before, new, expected) in [
            (None, None, None),
            (None, Some([7; 64]), line("07")),
            (Some(OLD), None, None),
            (Some(OLD), Some([0xa8; 64]), line("a8")),
        ] {
            let (folder, file) = folder("signed", before);
            let written = NewLibrary::write(&file, b"new", new).unwrap();
            assert_eq!(contents(&file), (b"old".to_vec(), before.map(Vec::from)));
            written.replace().unwrap();
            assert_eq!(contents(&file), (b"new".to_vec(), expected.clone()));
            let files = 1 + usize::from(expected.is_some());
            assert_eq!(fs::read_dir(&folder).unwrap().count(), files);
            fs::remove_dir_all(&folder).unwrap();
        }
    }

    #[test]
    fn a_library_that_cannot_be_replaced_keeps_its_signature() {
        for before in [None, Some(OLD)] {
            for new in [None, Some([7; 64])] {
                let (folder, file) = folder("unsigned", before);
                let written = NewLibrary::write(&file, b"new", new).unwrap();
                let part = format!("library.{}.0.part", std::process::id());
                fs::remove_file(folder.join(part)).unwrap();
                let (path, error) = written.replace().err().unwrap();
                assert_eq!(
                    (path, error.kind()),
                    (file.clone(), io::ErrorKind::NotFound)
                );
                assert_eq!(contents(&file), (b"old".to_vec(), before.map(Vec::from)));
                let files = 1 + usize::from(before.is_some());
                assert_eq!(fs::read_dir(&folder).unwrap().count(), files);
                fs::remove_dir_all(&folder).unwrap();
            }
        }
    }

    #[test]
    fn a_signature_behind_a_link_is_put_back_behind_the_link() {
        for before in [None, Some(OLD)] {
            for new in [None, Some([7; 64])] {
                let (folder, file) = folder("linked", None);
                let target = folder.join("signatures");
                if let Some(bytes) = before {
                    fs::write(&target, bytes).unwrap();
                }
                std::os::unix::fs::symlink(&target, signature_path(&file)).unwrap();
                let written = NewLibrary::write(&file, b"new", new).unwrap();
                fs::remove_file(&file).unwrap();
                fs::create_dir(&file).unwrap();
                assert!(written.replace().is_err());
                assert_eq!(fs::read(&target).ok(), before.map(Vec::from));
                assert!(fs::read_link(signature_path(&file)).is_ok());
                fs::remove_dir_all(&folder).unwrap();
            }
        }
    }

    #[test]
    fn the_error_says_if_the_signature_could_not_be_put_back() {
        let (folder, file) = folder("lost", Some(OLD));
        let written = NewLibrary::write(&file, b"new", Some([7; 64])).unwrap();
        let id = std::process::id();
        for part in ["library", "library.sig"] {
            let number = u8::from(part == "library.sig");
            fs::remove_file(folder.join(format!("{part}.{id}.{number}.part"))).unwrap();
        }
        let (_, error) = written.replace().err().unwrap();
        let error = error.to_string();
        assert!(error.contains("sign the library again"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_file_that_is_no_signature_is_not_replaced() {
        let (folder, file) = folder("large", Some(&vec![b'x'; (1 << 16) + 1]));
        let (path, error) = NewLibrary::write(&file, b"new", None).err().unwrap();
        assert_eq!(path, signature_path(&file));
        assert!(error.to_string().contains("too many bytes"), "{error}");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2);
        fs::remove_dir_all(&folder).unwrap();
    }
}
