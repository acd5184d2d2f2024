"""Certificates: what is in them, what their files may be, and that another implementation of TLS takes them."""

import json
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
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import ConfigError, Fleet
from agent.ground.new_fleet import fleet_keys
from agent.process.certificates import (
    BEGIN,
    CLIENT,
    SERVER,
    common_name,
    credentials,
    days_left,
    hosts_of,
    issue,
    make_ca,
    read,
    write,
)
from agent.robot.fleet_reader import load_fleet
from tests.places import ROOT

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


# --- fleet certificates ---
# `aucamp keys` of a secured fleet: who gets what, one party more, nothing overwritten; what a process needs of it.

TANK = (ROOT / "agent" / "fleets" / "tank.toml").read_text()
ROBOTS = ("r1", "r2", "r3", "r4", "r5")
WATCHERS = ("recorder", "view", "router", "ann", "bob")


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("AUCAMP_KEYS", raising=False)
    path = tmp_path / "fleet.toml"
    path.write_text(TANK.replace("tcp/", "tls/") + '\n[access]\nkeys = "keys"\nconsoles = ["ann", "bob"]\n')
    return path


@pytest.fixture
def made(path: Path) -> tuple[Fleet, Path, Path]:
    fleet, keys = load_fleet(path), path.parent / "keys"
    fleet_keys(fleet, path, keys)
    return fleet, path, keys


def test_everybody_gets_his_own(made: tuple[Fleet, Path, Path]) -> None:
    _, _, keys = made
    private = {f"{name}.key" for name in ("ca", *ROBOTS, *WATCHERS)} | {f"{name}.sign" for name in ROBOTS}
    public = {f"{name}.pem" for name in ("ca", *ROBOTS, *WATCHERS)} | {f"{name}.sign.pub" for name in ROBOTS}
    modes = {file.name: stat.S_IMODE(file.stat().st_mode) for file in keys.iterdir()}
    assert modes == dict.fromkeys(private, 0o600) | dict.fromkeys({*public, "zenoh-cli.json5"}, 0o644)
    ca = read(keys, "ca").certificate
    for name in (*ROBOTS, *WATCHERS):
        leaf = read(keys, name).certificate
        leaf.verify_directly_issued_by(ca)
        assert common_name(leaf) == name
        here = {"router": ("127.0.0.1", "localhost")} | dict.fromkeys(ROBOTS, ("127.0.0.1",))
        assert hosts_of(leaf) == here.get(name, ())
    tls = json.loads((keys / "zenoh-cli.json5").read_text())["transport"]["link"]["tls"]
    assert tls["connect_certificate"] == str(keys / "view.pem") and tls["enable_mtls"] is True


def test_one_more_of_each_kind_by_the_same_authority(made: tuple[Fleet, Path, Path]) -> None:
    fleet, path, keys = made
    before = {file.name: file.read_bytes() for file in keys.iterdir()}
    for name in ("r4", "recorder", "bob"):
        for file in keys.glob(f"{name}.*"):
            file.unlink()
        fleet_keys(fleet, path, keys, only=name)
    after = {file.name: file.read_bytes() for file in keys.iterdir()}
    assert after.keys() == before.keys()
    changed = {name.partition(".")[0] for name in after if after[name] != before[name]}
    assert changed == {"r4", "recorder", "bob"}
    for name in changed:
        read(keys, name).certificate.verify_directly_issued_by(read(keys, "ca").certificate)
    with pytest.raises(ConfigError, match=r"has no 'eve' to make keys for; it has r1, .*, router, ann, bob$"):
        fleet_keys(fleet, path, keys, only="eve")


def test_a_certificate_is_renewed_and_the_signing_keys_stay(made: tuple[Fleet, Path, Path]) -> None:
    fleet, path, keys = made
    word = (keys / "r1.sign").read_bytes()
    for end in ("pem", "key"):
        (keys / f"r1.{end}").unlink()
    lines = fleet_keys(fleet, path, keys, only="r1", days=30)
    assert lines[:2] == [f"{keys}/r1.pem: certificate, to r1", f"{keys}/r1.key: private, to r1 alone"]
    assert 29 < days_left(read(keys, "r1").certificate, datetime.now(UTC)) < 31
    assert (keys / "r1.sign").read_bytes() == word


@pytest.mark.parametrize(
    "there", ["ca.key", "ca.pem", "r3.pem", "ann.key", "r2.sign", "r2.sign.pub", "zenoh-cli.json5"]
)
def test_nothing_is_overwritten_and_nothing_is_half_made(path: Path, there: str) -> None:
    keys = path.parent / "keys"
    keys.mkdir()
    (keys / there).write_text("dear")
    with pytest.raises(ConfigError, match=f"{there}: exists, and keys are never overwritten; give --out a new folder"):
        fleet_keys(load_fleet(path), path, keys)
    assert {file.name: file.read_text() for file in keys.iterdir()} == {there: "dear"}


def test_one_more_needs_the_authority(made: tuple[Fleet, Path, Path]) -> None:
    fleet, path, keys = made
    with pytest.raises(ConfigError, match=r"r1.pem: exists, and keys are never overwritten"):
        fleet_keys(fleet, path, keys, only="r1")
    for name in ("ca.key", "r1.pem", "r1.key"):
        (keys / name).unlink()
    with pytest.raises(ConfigError, match=r"ca.key: no such file; give --out the folder in which the fleet's"):
        fleet_keys(fleet, path, keys, only="r1")


def test_the_command_says_what_goes_where(path: Path) -> None:
    keys = path.parent / "keys"
    done = CliRunner().invoke(app, ["keys", str(path), "--out", str(keys), "--days", "90"])
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    for line in (
        f"{keys}/ca.key: the authority's, to nobody: it stays where certificates are issued",
        f"{keys}/ca.pem: public, to everybody",
        f"{keys}/r3.pem: certificate, to r3",
        f"{keys}/ann.key: private, to ann alone",
        f"{keys}/zenoh-cli.json5: for the program zenoh, on this computer",
        "The authority's ca.key goes nowhere: with it anybody's certificate can be made.",
    ):
        assert line in lines
    assert "[access]" not in lines


def test_a_process_finds_its_own_or_says_what_to_mend(
    made: tuple[Fleet, Path, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fleet, path, keys = made
    assert credentials(fleet, "r1", path) == credentials(fleet, "recorder", path) == keys
    elsewhere = keys.rename(tmp_path / "elsewhere")
    with pytest.raises(ConfigError, match=r"keys/ca.pem: no such file; copy it from where the keys were made"):
        credentials(fleet, "r1", path)
    monkeypatch.setenv("AUCAMP_KEYS", str(elsewhere))
    assert credentials(fleet, "ann", path) == elsewhere
    (elsewhere / "ann.pem").write_bytes((elsewhere / "bob.pem").read_bytes())
    (elsewhere / "ann.key").write_bytes((elsewhere / "bob.key").read_bytes())
    with pytest.raises(ConfigError, match=r"ann.pem: is of 'bob', not of ann; copy ann's own"):
        credentials(fleet, "ann", path)
    open_fleet = path.with_name("open.toml")
    open_fleet.write_text(TANK)
    assert credentials(load_fleet(open_fleet), "r1", open_fleet) is None
