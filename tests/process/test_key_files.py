"""Keys as files: who may read them, what is never overwritten, and what is said of files that are no such keys."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec, x25519
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)
from msgspec.structs import replace
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import Access, ConfigError, dump
from agent.core.ranging.camera_model import Calibration
from agent.core.trust import verify_signature
from agent.ground.new_fleet import fleet_keys, make_keys
from agent.process.command import shipped_fleet
from agent.process.keys import NO_KEYS, UnusableKeyError, keys_folder, read_private, read_public, robot_keys
from agent.robot.fleet_reader import load_fleet
from tests.known_lens import CAMERA, PLAIN
from tests.places import ROOT

TANK = ROOT / "agent" / "fleets" / "tank.toml"
FLEET = load_fleet(TANK)
SIGNED = replace(FLEET, access=Access(keys="keys"))


@pytest.fixture(autouse=True)
def no_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AUCAMP_KEYS", raising=False)


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    make_keys(FLEET.robot, tmp_path / "keys")
    return tmp_path / "keys"


def test_a_private_key_is_never_open_to_others_not_even_while_it_is_made(tmp_path, monkeypatch) -> None:
    """A mode that is set after the file was made leaves a moment in which anybody can open it."""
    opened = {}

    def noting(path, flags, mode=0o777, **rest):
        opened[Path(path).name] = (flags & (os.O_CREAT | os.O_EXCL), mode)
        return real(path, flags, mode, **rest)

    real = os.open
    monkeypatch.setattr(os, "open", noting)
    make_keys(["r1"], tmp_path / "keys")
    exclusive = os.O_CREAT | os.O_EXCL
    assert opened == {"r1.sign": (exclusive, 0o600), "r1.sign.pub": (exclusive, 0o644)}


def test_both_files_are_halves_of_one_pair_and_no_two_pairs_are_the_same(keys: Path) -> None:
    publics = [read_public(keys / f"{name}.sign.pub") for name in FLEET.robot]
    assert len(set(publics)) == len(publics) and {len(key) for key in publics} == {32}
    for name, public in zip(FLEET.robot, publics, strict=True):
        assert verify_signature(public, read_private(keys / f"{name}.sign").sign(b"said"), b"said")


def test_a_failure_half_way_leaves_nothing_in_the_way_of_the_next_attempt(tmp_path, monkeypatch) -> None:
    def full(path, flags, mode=0o777, **rest):
        if Path(path).name == "r2.sign.pub":
            raise OSError(28, "No space left on device")
        return real(path, flags, mode, **rest)

    real = os.open
    monkeypatch.setattr(os, "open", full)
    with pytest.raises(ConfigError, match=r"r2.sign.pub: cannot be written \(No space left on device\); give --out"):
        make_keys(["r1", "r2"], tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_one_robot_more(keys: Path, tmp_path: Path) -> None:
    for half in ("r4.sign", "r4.sign.pub"):
        (keys / half).unlink()
    before = {path.name: path.read_bytes() for path in keys.iterdir()}
    fleet_keys(SIGNED, TANK, keys, only="r4")
    after = {path.name: path.read_bytes() for path in keys.iterdir()}
    assert after.keys() - before.keys() == {"r4.sign", "r4.sign.pub"}
    assert {name: after[name] for name in before} == before
    with pytest.raises(ConfigError, match=r"has no 'r9' to make keys for; it has r1, r2, r3, r4, r5$"):
        fleet_keys(FLEET, TANK, keys, only="r9")


def test_the_command_says_what_goes_where_and_what_the_fleet_file_needs(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(TANK.read_text())
    done = CliRunner().invoke(app, ["keys", str(fleet), "--out", str(tmp_path / "secrets")])
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    assert f"{tmp_path}/secrets/r3.sign: private, to r3 alone" in lines
    assert f"{tmp_path}/secrets/r3.sign.pub: public, to every robot" in lines
    assert lines[-2:] == ["[access]", 'keys = "secrets"']
    fleet.write_text("\n".join([TANK.read_text(), *lines[-2:]]))
    loaded = load_fleet(fleet)
    assert robot_keys(loaded, "r1", fleet) is not NO_KEYS
    assert not any("[access]" in line for line in fleet_keys(loaded, fleet, tmp_path / "more"))


def test_a_fleet_without_the_table_signs_nothing_whatever_the_variable_says(keys: Path, monkeypatch) -> None:
    monkeypatch.setenv("AUCAMP_KEYS", str(keys))
    assert robot_keys(FLEET, "r1", TANK) is NO_KEYS


def test_the_variable_goes_before_the_fleet_files_folder(keys: Path, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "elsewhere" / "fleet.toml"
    with pytest.raises(ConfigError, match=r"elsewhere/keys/r1.sign: no such file"):
        robot_keys(SIGNED, "r1", path)
    monkeypatch.setenv("AUCAMP_KEYS", str(keys))
    told = robot_keys(SIGNED, "r1", path).changed(0)
    assert told == {name: read_public(keys / f"{name}.sign.pub") for name in FLEET.robot}


def pem(key, encryption=None) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption or NoEncryption())


def public_pem(key) -> bytes:
    return key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


ED, OTHER = Ed25519PrivateKey.generate(), Ed25519PrivateKey.generate()
ELLIPTIC, EXCHANGE = ec.generate_private_key(ec.SECP256R1()), x25519.X25519PrivateKey.generate()
WRONG = {
    "of another kind": ("r1.sign", pem(ELLIPTIC), "only Ed25519 signs here"),
    "for exchanging keys": ("r1.sign", pem(EXCHANGE), "only Ed25519 signs here"),
    "with a password": ("r1.sign", pem(ED, BestAvailableEncryption(b"x")), "take a key without a password"),
    "the public half": ("r1.sign", public_pem(ED), "no private key in PEM; copy the file again"),
    "garbage": ("r1.sign", os.urandom(300), "no private key in PEM; copy the file again"),
    "empty": ("r1.sign", b"", "no private key in PEM; copy the file again"),
    "not a pair": ("r1.sign", pem(OTHER), "not the public half of r1.sign; copy both files of one pair"),
    "public of another kind": ("r3.sign.pub", public_pem(ELLIPTIC), "only Ed25519 signs here"),
    "public garbage": ("r3.sign.pub", b"-----BEGIN PUBLIC KEY-----\n", "no public key in PEM; copy the file again"),
    "private in its place": ("r3.sign.pub", pem(ED), "no public key in PEM; copy the file again"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_file_that_is_no_such_key_is_one_line(case: str, keys: Path, tmp_path: Path) -> None:
    name, content, expected = WRONG[case]
    (keys / name).write_bytes(content)
    with pytest.raises(ConfigError) as error:
        robot_keys(SIGNED, "r1", tmp_path / "fleet.toml")
    assert expected in str(error.value) and "\n" not in str(error.value)
    assert str(error.value).startswith(str(keys))


def test_a_private_key_that_others_may_read_is_refused_with_the_remedy(keys: Path, tmp_path: Path) -> None:
    for permissions in (0o640, 0o604, 0o620, 0o644):
        (keys / "r1.sign").chmod(permissions)
        with pytest.raises(ConfigError, match=f"mode 0{permissions:o}.*; run: chmod 600 .*r1.sign$"):
            robot_keys(SIGNED, "r1", tmp_path / "fleet.toml")
    (keys / "r1.sign").chmod(0o400)
    robot_keys(SIGNED, "r1", tmp_path / "fleet.toml")


def test_another_robots_missing_key_stops_nobody_but_ones_own_does(keys: Path, tmp_path: Path) -> None:
    (keys / "r3.sign.pub").unlink()
    assert "r3" not in robot_keys(SIGNED, "r1", tmp_path / "fleet.toml").changed(0)
    (keys / "r1.sign.pub").unlink()
    with pytest.raises(ConfigError, match=r"r1.sign.pub: no such file; copy it from where r1.sign was made"):
        robot_keys(SIGNED, "r1", tmp_path / "fleet.toml")
    (keys / "r1.sign").unlink()
    with pytest.raises(ConfigError, match=r"r1.sign: no such file; .* aucamp keys .* --only r1$"):
        robot_keys(SIGNED, "r1", tmp_path / "fleet.toml")


def test_one_key_for_two_robots_is_refused(keys: Path, tmp_path: Path) -> None:
    (keys / "r4.sign.pub").write_bytes((keys / "r2.sign.pub").read_bytes())
    with pytest.raises(ConfigError, match=r"r4.sign.pub: the same key as r2.sign.pub; give each robot its own"):
        robot_keys(SIGNED, "r1", tmp_path / "fleet.toml")


def test_neither_a_pipe_nor_a_folder_is_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "r1.sign.pub")
    (tmp_path / "r2.sign.pub").mkdir()
    for name in ("r1", "r2"):
        with pytest.raises(UnusableKeyError, match="no file; put a key there"):
            read_public(tmp_path / f"{name}.sign.pub")


def test_an_agent_without_its_key_ends_in_one_line_before_anything_is_opened(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(TANK.read_text() + '[access]\nkeys = "keys"\n')
    calibration = Calibration(robot="r1", made="2026-01-01", source="a test", focus=PLAIN, camera=CAMERA)
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "r1.toml").write_text(dump(calibration))
    before = set(tmp_path.rglob("*"))
    done = subprocess.run(
        [sys.executable, "-m", "agent", "agent", "fleet.toml", "--robot", "r1"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("aucamp: keys/r1.sign: no such file; ") and done.stderr.count("\n") == 1
    assert set(tmp_path.rglob("*")) == before


def test_the_keys_of_a_demo_that_runs_are_beside_its_twin(tmp_path: Path) -> None:
    """Its run's folder has none: they are good for nothing else."""
    fleet = load_fleet(shipped_fleet())
    fleet = replace(fleet, access=Access(keys="keys"), twin=replace(fleet.twin, dir=str(tmp_path / "twin")))
    path = tmp_path / "run" / "fleet.toml"
    assert keys_folder(fleet, path) == tmp_path / "run" / "keys"
    (tmp_path / "twin" / "keys").mkdir(parents=True)
    assert keys_folder(fleet, path) == tmp_path / "twin" / "keys"
    (tmp_path / "run" / "keys").mkdir(parents=True)
    assert keys_folder(fleet, path) == tmp_path / "run" / "keys", "the file's own go first"
