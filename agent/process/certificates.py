"""Certificates of a secured fleet: an authority of the fleet's own, one certificate for each name, and what each
process needs of them to start.

Names are those of the fleet file: of robots, observers and consoles. The key files are not encrypted, since nobody is
there to be asked when a robot starts; their modes are what keeps them.
"""

from __future__ import annotations

import ipaddress
import json
import stat
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from shlex import quote
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from agent.core.config import ConfigError, Fleet
from agent.process.keys import EVERYBODY, OWNER_ONLY, keys_folder, write_new
from router_config.settings import ROUTER, tls

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


def make_ca(fleet: str) -> Pair:
    """An authority for one fleet: it may give certificates, and nobody whom it gave one may give others."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"aucamp {fleet} CA")])
    ends = datetime.now(UTC) + timedelta(days=365.25 * CA_YEARS)
    built = (
        _dated(name, name, key, BEGIN, ends)
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


ODD = (x509.InvalidVersion, x509.DuplicateExtension, x509.UnsupportedGeneralNameType)  # kin of no other error


def read_certificate(path: Path) -> x509.Certificate:
    """The certificate in a file. Raises ConfigError, one line that says what to do."""
    content = _content(path)
    try:
        certificate = x509.load_pem_x509_certificate(content)
        common_name(certificate), hosts_of(certificate), certificate.public_key()  # read when they are asked for
    except (ValueError, TypeError, UnsupportedAlgorithm, *ODD):
        raise ConfigError(f"{path}: no certificate in PEM; copy the file again, whole") from None
    return certificate


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


# --- certificates of a fleet ---
# The certificates of a whole fleet: who gets one, what is in it, and what each process needs of them to start.

CONSOLE_FILE = "zenoh-cli.json5"  # for the program `zenoh`, on the computer where it was made
CONSOLE_NAME = "view"  # as whom it looks; else the first observer


def parties(fleet: Fleet) -> list[str]:
    """All who have a certificate: robots, observers, consoles."""
    return [*fleet.robot, *fleet.access.observers, *fleet.access.consoles]


def hosts(fleet: Fleet, name: str) -> tuple[str, ...]:
    """Where a party may be dialled; nobody dials an observer or a console, but for the router on its own computer."""
    if name in fleet.robot:
        return (fleet.robot[name].listen.partition("/")[2].rpartition(":")[0].strip("[]"),)
    return ("127.0.0.1", "localhost") if name == ROUTER else ()


def write_certificates(fleet: Fleet, folder: Path, names: Sequence[str], days: float, ca: Pair) -> list[Path]:
    """A pair for each name, by this authority; returns the files."""
    ends = datetime.now(UTC) + timedelta(days=days)
    made: list[Path] = []
    for name in names:
        made += write(folder, name, issue(ca, name, hosts(fleet, name), ends=ends))
    return made


def new_authority(fleet: Fleet, folder: Path) -> tuple[Pair, list[Path]]:
    """A new authority, and its files. Never a second one in the same folder: ConfigError."""
    ca = make_ca(fleet.fleet)
    return ca, list(write(folder, AUTHORITY, ca))


def authority(folder: Path) -> Pair:
    """The authority whose files lie there. Raises ConfigError, one line, where they do not."""
    if not key_file(folder, AUTHORITY).exists():
        raise ConfigError(
            f"{key_file(folder, AUTHORITY)}: no such file; give --out the folder in which the fleet's keys were made"
        )
    return read(folder, AUTHORITY)


def write_console_file(fleet: Fleet, folder: Path) -> list[Path]:
    """What the program `zenoh` needs to look at the fleet as an observer; none where the fleet has no observer."""
    observers = fleet.access.observers
    if not observers:
        return []
    name = CONSOLE_NAME if CONSOLE_NAME in observers else observers[0]
    path = folder / CONSOLE_FILE
    config = {"transport": {"link": {"tls": tls(folder.resolve(), name)}}}
    write_new(path, (json.dumps(config, indent=2) + "\n").encode(), EVERYBODY)
    return [path]


def credentials(fleet: Fleet, name: str, fleet_path: Path) -> Path | None:
    """The full path of the folder with the certificates of a secured fleet, once `name` has been seen to have what it
    needs there; None of an open one. Raises ConfigError, one line that says what to mend."""
    if not fleet.secured:
        return None
    folder = keys_folder(fleet, fleet_path)
    if folder is None:  # which fleet_rules turn down
        raise ConfigError(f"{fleet_path}: key 'access.keys': robots listen on tls/; name the folder of certificates")
    folder = folder.absolute()
    if name not in parties(fleet):
        raise ConfigError(
            f"{fleet_path}: [access] has no '{name}'; add it to consoles, who order, or to observers, who look, "
            f"and make its certificate with: aucamp keys {quote(str(fleet_path))} --out DIR --only {name}"
        )
    if not certificate_file(folder, AUTHORITY).exists():
        raise ConfigError(f"{certificate_file(folder, AUTHORITY)}: no such file; copy it from where the keys were made")
    check_pair(folder, name)
    return folder


def check_pair(folder: Path, name: str) -> Pair:
    """A party's own pair, as it can be used. Raises ConfigError, one line that says what to mend."""
    path, pair = key_file(folder, name), read(folder, name)
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise ConfigError(f"{path}: others may read this private key (mode {mode:04o}); run: chmod 600 {path}")
    if (said := common_name(pair.certificate)) != name:
        raise ConfigError(f"{certificate_file(folder, name)}: is of '{said}', not of {name}; copy {name}'s own")
    return pair
