"""Who a process of a secured fleet is: an authority of the fleet's own, and a certificate that it gives to each name.

Names are those of the fleet file: of robots, observers and consoles. The key files are not encrypted, since nobody is
there to be asked when a robot starts; their modes are what keeps them.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from agent.core.config import ConfigError
from agent.process.key_files import EVERYBODY, OWNER_ONLY, write_new

CERTIFICATE, KEY = ".pem", ".key"
AUTHORITY = "ca"
CA_YEARS, LEAF_DAYS = 10, 825
# Boards without a battery start with a clock of years ago, and have to find their neighbours before they find the time.
BEGIN = datetime(2020, 1, 1, tzinfo=UTC)
SERVER, CLIENT = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH


class Pair(NamedTuple):
    """A certificate and the private key that belongs to it."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def certificate_file(folder: Path, name: str) -> Path:
    """Where the certificate of a name lies."""
    return folder / f"{name}{CERTIFICATE}"


def key_file(folder: Path, name: str) -> Path:
    """Where the private key of a certificate lies."""
    return folder / f"{name}{KEY}"


def make_ca(fleet: str, begins: datetime = BEGIN, ends: datetime | None = None) -> Pair:
    """An authority for one fleet: it may give certificates, and nobody whom it gave one may give others."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"aucamp {fleet} CA")])
    ends = ends or datetime.now(UTC) + timedelta(days=365.25 * CA_YEARS)
    built = (
        _dated(name, name, key, begins, ends)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    return Pair(built.sign(key, hashes.SHA256()), key)


def issue(
    ca: Pair,
    name: str,
    hosts: Sequence[str] = (),
    begins: datetime = BEGIN,
    ends: datetime | None = None,
    uses: Sequence[x509.ObjectIdentifier] = (SERVER, CLIENT),
) -> Pair:
    """A certificate for a name of the fleet file. `hosts`: where it may listen, addresses or names; who listens nowhere
    has none. `uses`: of two robots the later name dials, so that each robot is server and client."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    ends = ends or datetime.now(UTC) + timedelta(days=LEAF_DAYS)
    own = ca.certificate.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
    built = (
        _dated(subject, ca.certificate.subject, key, begins, ends)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(own), critical=False)
    )
    if hosts:
        built = built.add_extension(x509.SubjectAlternativeName([_host(host) for host in hosts]), critical=False)
    return Pair(built.sign(ca.key, hashes.SHA256()), key)


def write(folder: Path, name: str, pair: Pair) -> tuple[Path, Path]:
    """NAME.pem for everybody and NAME.key for its owner alone; returns both. Raises ConfigError where one is there."""
    key, certificate = key_file(folder, name), certificate_file(folder, name)
    write_new(key, pair.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()), OWNER_ONLY)
    try:
        write_new(certificate, pair.certificate.public_bytes(Encoding.PEM), EVERYBODY)
    except BaseException:
        key.unlink()  # half a pair would be in the way of the next attempt
        raise
    return certificate, key


def read(folder: Path, name: str) -> Pair:
    """What `write` wrote, or somebody copied there. Raises ConfigError, one line that says what to do."""
    certificate = read_certificate(certificate_file(folder, name))
    path = key_file(folder, name)
    content = _content(path)
    try:
        key = load_pem_private_key(content, password=None)
    except TypeError:
        raise ConfigError(
            f"{path}: it is encrypted, and nobody is there to be asked; take one without a password"
        ) from None
    except (ValueError, UnsupportedAlgorithm):
        raise ConfigError(f"{path}: no private key in PEM; copy the file again, whole") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise ConfigError(f"{path}: does not belong to {name}{CERTIFICATE}; copy both files of one pair")
    return Pair(certificate, key)


def read_certificate(path: Path) -> x509.Certificate:
    """The certificate in a file. Raises ConfigError, one line that says what to do."""
    content = _content(path)
    try:
        return x509.load_pem_x509_certificate(content)
    except ValueError:
        raise ConfigError(f"{path}: no certificate in PEM; copy the file again, whole") from None


def common_name(certificate: x509.Certificate) -> str:
    """Whose certificate it is, as others see it; empty where it does not say."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def hosts_of(certificate: x509.Certificate) -> tuple[str, ...]:
    """Addresses and names where its owner may listen."""
    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    return tuple(str(name.value) for name in found)


def days_left(certificate: x509.Certificate, now: datetime) -> float:
    """Negative once it has expired."""
    return (certificate.not_valid_after_utc - now) / timedelta(days=1)


def _dated(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, begins: datetime, ends: datetime
) -> x509.CertificateBuilder:
    return x509.CertificateBuilder(
        issuer_name=issuer,
        subject_name=subject,
        public_key=key.public_key(),
        serial_number=x509.random_serial_number(),
        not_valid_before=begins,
        not_valid_after=ends,
    )


def _usage(signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; copy it from where aucamp keys made it") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); give this user the right to") from None
