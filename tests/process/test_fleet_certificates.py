"""`aucamp keys` of a secured fleet: who gets what, one party more, nothing overwritten; what a process needs of it."""

import json
import stat
from datetime import UTC, datetime
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import ConfigError, Fleet
from agent.ground.new_fleet import fleet_keys
from agent.process.certificates import common_name, credentials, days_left, hosts_of, read
from agent.robot.fleet_reader import load_fleet
from tests.places import ROOT

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
    with pytest.raises(ConfigError, match="no robot 'eve'; the file has r1"):
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


@pytest.mark.parametrize("there", ["ca.key", "ca.pem", "r3.pem", "ann.key", "r2.sign", "zenoh-cli.json5"])
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
        f"{keys}/ca.key: the authority's, to nobody: it stays with whoever issues certificates",
        f"{keys}/ca.pem: public, to everybody",
        f"{keys}/r3.pem: certificate, to r3",
        f"{keys}/ann.key: private, to ann alone",
        f"{keys}/zenoh-cli.json5: for the program zenoh, on this computer",
        "The authority's ca.key goes nowhere: whoever has it can make anybody's certificate.",
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
