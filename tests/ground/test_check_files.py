"""`aucamp check` on certificates: what others would refuse is said before a dive, in a line that says what to do."""

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from agent.ground import check_files
from agent.ground.check_files import certificate_findings, watchers_here
from agent.ground.new_fleet import make_all, write_fleet
from agent.process.certificates import Pair, authority, issue, make_ca, write
from agent.robot.fleet_reader import load_fleet

NOW, DAY = datetime.now(UTC), timedelta(days=1)


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A fleet file of two robots of this computer, and its keys."""
    monkeypatch.delenv("AUCAMP_KEYS", raising=False)
    path = tmp_path / "fleet.toml"
    write_fleet(path, 2, twin=True)
    text = path.read_text().replace("tcp/", "tls/")
    path.write_text(f'{text}\n[access]\nkeys = "keys"\nconsoles = ["ann"]\n')
    make_all(load_fleet(path), tmp_path / "keys")
    return path


def said(path: Path, name: str = "r1") -> list[str]:
    return [f"{finding.level} {finding.text}" for finding in certificate_findings(load_fleet(path), name, path)]


def put(path: Path, name: str, pair: Pair) -> None:
    """Another pair in the place of one of the folder."""
    for end in ("pem", "key"):
        (path.parent / "keys" / f"{name}.{end}").unlink()
    write(path.parent / "keys", name, pair)


def test_what_the_command_made_is_well_for_everybody(path: Path) -> None:
    fleet = load_fleet(path)
    names = (*fleet.robot, *fleet.access.observers, *fleet.access.consoles)
    assert len(names) == 6
    for name in names:
        (line,) = said(path, name)
        assert re.fullmatch(f"ok certificate by aucamp {fleet.fleet} CA, 82[45] days left", line)
    assert watchers_here(fleet, path) == ["recorder", "view", "router", "ann"]
    (path.parent / "keys" / "view.pem").unlink()
    assert watchers_here(fleet, path) == ["recorder", "router", "ann"]


def ca_of(path: Path) -> Pair:
    return authority(path.parent / "keys")


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda ca: issue(ca, "r2", ["127.0.0.1"]), "wrong .*r1.pem: is of 'r2', not of r1; copy r1's own"),
        (lambda ca: issue(ca, "r1", ["10.0.0.1"]), "wrong .*good at 10.0.0.1, and r1 listens at 127.0.0.1; make it"),
        (lambda ca: issue(ca, "r1"), "wrong .*good at nowhere, and r1 listens at 127.0.0.1; make it"),
        (lambda ca: issue(ca, "r1", ["127.0.0.1"], ends=NOW - DAY), "wrong .*r1.pem: ended on .*; make it again"),
        (lambda ca: issue(ca, "r1", ["127.0.0.1"], begins=NOW + DAY), "wrong .*begins on .*clock says .*; set it"),
        (lambda ca: issue(make_ca("twin"), "r1", ["127.0.0.1"]), "wrong .*r1.pem: not by the authority in ca.pem"),
        (lambda ca: issue(ca, "r1", ["127.0.0.1"], ends=NOW + 9.5 * DAY), "warning .*r1.pem: ends in 9 days; make"),
    ],
)
def test_what_others_would_refuse(path: Path, make, line: str) -> None:
    put(path, "r1", make(ca_of(path)))
    assert re.match(line, said(path)[-1]), said(path)


def test_files_that_are_not_there_or_open_to_others(path: Path) -> None:
    keys = path.parent / "keys"
    (keys / "r1.key").chmod(0o640)
    others = "others may read this private key (mode 0640); run: chmod 600"
    assert said(path) == [f"wrong {keys}/r1.key: {others} {keys}/r1.key"]
    (keys / "r1.key").unlink()
    assert said(path) == [f"wrong {keys}/r1.key: no such file; copy it from where aucamp keys made it"]
    (keys / "ca.pem").unlink()
    assert said(path) == [f"wrong {keys}/ca.pem: no such file; copy it from where the keys were made"]
    line = f"wrong {path}: [access] has no 'eve'; add it to consoles, who order, or to observers, who look, and"
    assert said(path, "eve")[0].startswith(f"{line} make its certificate with: aucamp keys")


def test_keys_that_have_no_business_on_a_robots_computer(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    r2 = load_fleet(path).robot["r2"].listen
    monkeypatch.setattr(check_files, "is_here", lambda listen: listen != r2)  # another computer's
    keys = path.parent / "keys"
    assert said(path)[1:] == [
        f"warning {keys}/ca.key: makes anybody's certificate; keep it on no robot's computer",
        f"warning {keys}: holds NAME.key of r2, for whom this computer can speak; remove them",
    ]


def test_an_open_fleet_has_none(path: Path) -> None:
    path.write_text(path.read_text().replace("tls/", "tcp/"))
    assert said(path) == [] and watchers_here(load_fleet(path), path) == []
