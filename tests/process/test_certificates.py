"""Certificates: what is in them, what their files may be, and that another implementation of TLS takes them."""

import os
import socket
import ssl
import stat
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.exceptions import InvalidSignature

from agent.core.config import ConfigError
from agent.process.certificates import (
    BEGIN,
    CLIENT,
    SERVER,
    common_name,
    days_left,
    hosts_of,
    issue,
    make_ca,
    read,
    write,
)

NOW = datetime.now(UTC)


def extension(certificate: x509.Certificate, kind):
    return certificate.extensions.get_extension_for_class(kind)


def test_an_authority_may_sign_certificates_and_nothing_below_it_may() -> None:
    ca = make_ca("tank").certificate
    assert common_name(ca) == "aucamp tank CA" and ca.issuer == ca.subject
    constraints, usage = extension(ca, x509.BasicConstraints), extension(ca, x509.KeyUsage)
    assert constraints.critical and constraints.value == x509.BasicConstraints(ca=True, path_length=0)
    assert usage.critical and usage.value.key_cert_sign and usage.value.crl_sign and usage.value.digital_signature
    assert 3650 < days_left(ca, NOW) < 3654


def test_a_certificate_says_who_where_and_how_long() -> None:
    ca = make_ca("tank")
    leaf = issue(ca, "r1", ["192.168.7.11", "robot-one.local"]).certificate
    assert common_name(leaf) == "r1" and leaf.issuer == ca.certificate.subject
    assert hosts_of(leaf) == ("192.168.7.11", "robot-one.local")
    constraints, usage = extension(leaf, x509.BasicConstraints), extension(leaf, x509.KeyUsage)
    assert constraints.critical and constraints.value == x509.BasicConstraints(ca=False, path_length=None)
    assert usage.critical and usage.value.digital_signature and not usage.value.key_cert_sign
    assert set(extension(leaf, x509.ExtendedKeyUsage).value) == {SERVER, CLIENT}
    own = extension(ca.certificate, x509.SubjectKeyIdentifier).value.digest
    assert extension(leaf, x509.AuthorityKeyIdentifier).value.key_identifier == own
    assert leaf.not_valid_before_utc == BEGIN and 824 < days_left(leaf, NOW) < 826
    leaf.verify_directly_issued_by(ca.certificate)
    with pytest.raises(InvalidSignature):
        leaf.verify_directly_issued_by(make_ca("tank").certificate)  # of the same name
    assert hosts_of(issue(ca, "recorder").certificate) == ()


def test_key_files_are_their_owners_from_the_first_moment_on(tmp_path: Path, monkeypatch) -> None:
    opened = {}

    def noting(path, flags, mode=0o777, **rest):
        opened[Path(path).name] = (bool(flags & os.O_EXCL), mode)
        return real(path, flags, mode, **rest)

    real = os.open
    monkeypatch.setattr(os, "open", noting)
    before = os.umask(0)
    try:
        write(tmp_path, "ca", make_ca("tank"))
    finally:
        os.umask(before)
    assert opened == {"ca.key": (True, 0o600), "ca.pem": (True, 0o644)}
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("ca.key", "ca.pem")] == [0o600, 0o644]


@pytest.mark.parametrize("there", ["ca.key", "ca.pem"])
def test_nothing_is_overwritten_and_no_half_is_left(there: str, tmp_path: Path) -> None:
    (tmp_path / there).write_text("dear")
    with pytest.raises(ConfigError, match=f"{there}: exists, and keys are never overwritten"):
        write(tmp_path, "ca", make_ca("tank"))
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {there: "dear"}


def test_files_are_read_back_or_refused_with_what_to_do(tmp_path: Path) -> None:
    ca = make_ca("tank")
    for name in ("r1", "r2"):
        write(tmp_path, name, issue(ca, name))
    pair = read(tmp_path, "r1")
    assert common_name(pair.certificate) == "r1"
    with pytest.raises(ConfigError, match=r"r3.pem: no such file; copy it"):
        read(tmp_path, "r3")
    (tmp_path / "r1.key").write_bytes((tmp_path / "r2.key").read_bytes())
    with pytest.raises(ConfigError, match=r"r1.key: does not belong to r1.pem; copy both"):
        read(tmp_path, "r1")
    (tmp_path / "r1.key").write_bytes(b"half")
    with pytest.raises(ConfigError, match=r"r1.key: no private key in PEM; copy the file again"):
        read(tmp_path, "r1")
    (tmp_path / "r1.pem").write_bytes(b"half")
    with pytest.raises(ConfigError, match=r"r1.pem: no certificate in PEM; copy the file again"):
        read(tmp_path, "r1")


def shaken(tmp_path: Path, server: str, client: str, host: str = "127.0.0.1") -> str:
    """What a handshake between two names comes to: the client's name, or why one of them refused."""
    told = []
    theirs = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    theirs.verify_mode = ssl.CERT_REQUIRED
    ours = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    for context, name in ((theirs, server), (ours, client)):
        context.verify_flags |= getattr(ssl, "VERIFY_X509_STRICT", 0)
        context.load_verify_locations(tmp_path / "ca.pem")
        context.load_cert_chain(tmp_path / f"{name}.pem", tmp_path / f"{name}.key")
    near, far = socket.socketpair()

    def serve() -> None:
        try:
            with theirs.wrap_socket(far, server_side=True) as link:
                told.append(dict(pair[0] for pair in link.getpeercert()["subject"])["commonName"])
                link.send(b"!")
        except ssl.SSLError as error:
            told.append(str(getattr(error, "verify_message", error)))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        with ours.wrap_socket(near, server_hostname=host) as link:
            link.recv(1)
    except ssl.SSLError as error:
        return str(getattr(error, "verify_message", error))
    finally:
        near.close()
        thread.join()
    return str(told[0])


def test_strict_tls_of_another_maker_takes_them_and_only_them(tmp_path: Path) -> None:
    ca, day = make_ca("tank"), timedelta(days=1)
    write(tmp_path, "ca", ca)
    here = ["127.0.0.1"]
    for name, pair in {
        "r1": issue(ca, "r1", here),
        "ann": issue(ca, "ann"),
        "old": issue(ca, "old", here, ends=NOW - day),
        "new": issue(ca, "new", here, begins=NOW + day),
        "server": issue(ca, "server", here, uses=[SERVER]),
        "namesake": issue(make_ca("tank"), "namesake", here),
        "elsewhere": issue(ca, "elsewhere", ["192.168.7.1"]),
    }.items():
        write(tmp_path, name, pair)
    assert shaken(tmp_path, "r1", "ann") == "ann"
    assert "expired" in shaken(tmp_path, "old", "ann")
    assert "not yet valid" in shaken(tmp_path, "new", "ann")
    assert "mismatch" in shaken(tmp_path, "elsewhere", "ann")
    assert shaken(tmp_path, "namesake", "ann") != "ann"
    for stranger in ("old", "new", "server", "namesake"):
        assert shaken(tmp_path, "r1", stranger) != stranger
