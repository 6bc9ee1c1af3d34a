"""Signatures of libraries (Ed25519), which services check that have the public key."""

# The extra `security` installs `cryptography`, which only `egp keys` and `egp sign` need.
# ruff: noqa: PLC0415

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from egp_service._core import EgpError
from egp_service.files import replacing

if TYPE_CHECKING:
    from pathlib import Path

    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

# Precedes the SHA-256 of the library in what is signed; `rust/service/src/signature.rs` has the
# same.
_PURPOSE = b"egp.v1 library\0"


def new_signing_key() -> str:
    """Return a new private key as PEM."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    key = Ed25519PrivateKey.generate()
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()


def public_line(key_file: Path) -> str:
    """Return the public key of a file with a private key, as the line of a service's file.

    Errors if the file holds no Ed25519 private key.
    """
    return f"{_read_key(key_file).public_key().public_bytes_raw().hex()}\n"


def sign_library(library: Path, key_file: Path) -> Path:
    """Write the signature of a library beside it, with `.sig` behind its name.

    Raises:
        EgpError: if the file of the key holds no Ed25519 private key.
        OSError: if a file cannot be read or written.

    """
    signature = _read_key(key_file).sign(_PURPOSE + hashlib.sha256(library.read_bytes()).digest())
    path = library.with_name(f"{library.name}.sig")
    with replacing(path) as beside:
        beside.write_text(f"{signature.hex()}\n", encoding="ascii")
    return path


def _read_key(file: Path) -> Ed25519PrivateKey:
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(file.read_bytes(), password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise EgpError(f"{file} is no private key: {error}; `egp keys` makes library.key") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise EgpError(f"{file}: expected an Ed25519 key; `egp keys` makes library.key")
    return key
