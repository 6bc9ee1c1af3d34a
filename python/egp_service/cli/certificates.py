"""A certificate authority for the services, vehicles and operators of a fleet.

Certificates are X.509 with keys on the curve P-256. A service's certificate names the hosts under
which it is reached and may be used on both ends of a TLS link; all others are for the connecting
end only, so that a vehicle's certificate cannot be used to listen in a service's place.
"""

# The extra `security` installs `cryptography`, which only `egp keys` needs.
# ruff: noqa: PLC0415

from __future__ import annotations

import ipaddress
import re
from base64 import b64encode
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Self

from egp_service._core import EgpError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

_CLOCK_DIFFERENCE = timedelta(hours=1)
_LABEL = r"(?!-)[A-Za-z0-9_-]{1,63}(?<!-)"
_HOST_NAME = re.compile(rf"{_LABEL}(\.{_LABEL})*")
_LONGEST_HOST = 253


@dataclass(frozen=True, slots=True)
class Identity:
    """A certificate with its private key, both as PEM."""

    certificate: bytes
    private_key: bytes

    def tls(self, end: str) -> dict[str, str]:
        """Give zenoh's settings for this identity on the end `listen` or `connect` of a link."""
        return {
            f"{end}_certificate_base64": b64encode(self.certificate).decode(),
            f"{end}_private_key_base64": b64encode(self.private_key).decode(),
        }


def check_hosts(hosts: Sequence[str]) -> None:
    """Raise `EgpError` for a host that a certificate cannot name."""
    for host in hosts:
        try:
            address = ipaddress.ip_address(host)
        except ValueError:
            if len(host) > _LONGEST_HOST or not _HOST_NAME.fullmatch(host):
                raise EgpError(
                    f"host {host!r}: expected an IPv4 address, or a name of at most "
                    f"{_LONGEST_HOST} characters whose parts between dots have 1 to 63 letters "
                    "(A-Z a-z), digits, hyphens and underscores, without a hyphen at either end; "
                    "--port gives the port, and a name with other letters is written in its form "
                    "that begins with xn--"
                ) from None
        else:
            if isinstance(address, ipaddress.IPv6Address):
                raise EgpError(
                    f"host {host}: zenoh does not compare an IPv6 address with a certificate; give "
                    "a host name that resolves to it"
                )


def listening_hosts(certificate: bytes) -> list[str]:
    """Return the hosts at which the owner of a certificate (PEM) may listen.

    Raises:
        ValueError: if it is no certificate, or names no hosts.

    """
    from cryptography import x509

    try:
        read = _read(certificate)
        names = read.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (
        x509.ExtensionNotFound,
        x509.DuplicateExtension,
        x509.UnsupportedGeneralNameType,
    ) as error:
        raise ValueError(str(error)) from error
    return [str(name.value) for name in names]


def _read(certificate: bytes) -> x509.Certificate:
    """Read a certificate (PEM); `ValueError` if it cannot be read."""
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(certificate)
    except x509.InvalidVersion as error:
        raise ValueError(str(error)) from error


class Authority:
    """A certificate authority."""

    def __init__(self, identity: Identity) -> None:
        """Use the authority's own certificate and private key.

        `ValueError` or `TypeError` if one of them cannot be read.
        """
        from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
        from cryptography.hazmat.primitives.serialization import load_pem_private_key

        self.identity = identity
        self._certificate = _read(identity.certificate)
        key = load_pem_private_key(identity.private_key, None)
        if not isinstance(key, EllipticCurvePrivateKey):
            raise TypeError("expected the private key of an authority that `egp keys` made")
        self._key = key

    @classmethod
    def new(cls, days: int) -> Self:
        """Make an authority whose certificate is valid for `days`."""
        from cryptography.hazmat.primitives.asymmetric import ec

        key = ec.generate_private_key(ec.SECP256R1())
        builder = _builder("egp authority", _after(days), key, None)
        return cls(_signed(builder, key, key))

    @property
    def end(self) -> datetime:
        """End of the authority's validity."""
        end: datetime = self._certificate.not_valid_after_utc
        return end

    def issue(self, name: str, days: int, hosts: Sequence[str] = ()) -> Identity:
        """Make a certificate for `name` of at most 64 characters, which may listen at `hosts`.

        It is valid for `days`, and not beyond the authority's end.
        """
        from cryptography import x509
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.x509.oid import ExtendedKeyUsageOID

        key = ec.generate_private_key(ec.SECP256R1())
        builder = _builder(name, min(_after(days), self.end), key, self._certificate.subject)
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if hosts:
            uses.append(ExtendedKeyUsageOID.SERVER_AUTH)
            names = x509.SubjectAlternativeName([_host(host) for host in hosts])
            builder = builder.add_extension(names, critical=False)
        builder = builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        return _signed(builder, key, self._key)


def read_authority(
    certificate: Path, private: Path, days: int, report: Callable[[str], None]
) -> Authority | None:
    """Read the authority of two files, or return None if neither is there.

    `report` is told if certificates cannot be valid for `days`.

    Raises:
        EgpError: if one file is missing or cannot be read, and if the authority has expired.

    """
    if not certificate.exists():
        if private.exists():
            raise EgpError(
                f"{certificate} is missing: copy the authority's certificate there, which each "
                ".json5 file of the fleet has as root_ca_certificate_base64, or move ca.key away "
                "to begin with a new authority"
            )
        return None
    if not private.exists():
        raise EgpError(
            f"{private} is missing: copy the authority's private key there to make more keys"
        )
    try:
        authority = Authority(Identity(certificate.read_bytes(), private.read_bytes()))
    except (ValueError, TypeError) as error:
        raise EgpError(
            f"{certificate} or {private} is not as `egp keys` wrote it ({error}): restore both "
            "from a copy"
        ) from error
    now = datetime.now(UTC)
    remedy = "move ca.pem and ca.key away, leave the other files there, and name every vehicle"
    if authority.end <= now:
        raise EgpError(
            f"{certificate}: the authority expired on {authority.end:%Y-%m-%d}; for a new one "
            f"{remedy}; then replace all .json5 files where they are used"
        )
    if authority.end < now + timedelta(days=days):
        report(
            f"The new certificates expire with the authority on {authority.end:%Y-%m-%d}, before "
            f"the end of {days} days. For a new authority {remedy}."
        )
    return authority


def _after(days: int) -> datetime:
    return datetime.now(UTC) + timedelta(days=days)


def _builder(
    name: str, end: datetime, key: EllipticCurvePrivateKey, issuer: x509.Name | None
) -> x509.CertificateBuilder:
    """Begin a certificate; without an issuer it is that of an authority."""
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    authority = issuer is None
    constraints = x509.BasicConstraints(ca=authority, path_length=0 if authority else None)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if issuer is None else issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.now(UTC) - _CLOCK_DIFFERENCE)
        .not_valid_after(end)
        .add_extension(constraints, critical=True)
        .add_extension(_key_usage(authority=authority), critical=True)
    )


def _signed(
    builder: x509.CertificateBuilder,
    key: EllipticCurvePrivateKey,
    authority: EllipticCurvePrivateKey,
) -> Identity:
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    certificate = builder.sign(authority, SHA256()).public_bytes(Encoding.PEM)
    private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return Identity(certificate, private)


def _host(host: str) -> x509.GeneralName:
    from cryptography import x509

    with suppress(ValueError):
        return x509.IPAddress(ipaddress.ip_address(host))
    return x509.DNSName(host)


def _key_usage(*, authority: bool) -> x509.KeyUsage:
    from cryptography import x509

    return x509.KeyUsage(
        digital_signature=not authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=authority,
        crl_sign=authority,
        encipher_only=False,
        decipher_only=False,
    )
