"""`aucamp doctor` on fleets that run, of which something is wrong: one line for each thing, about whom it concerns."""

import contextlib
import json
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core import topics
from agent.core.codec import encode, encoding
from agent.core.config import Access, Fleet
from agent.core.messages import NeighbourState, State
from agent.ground import check, doctor_facts
from agent.ground.doctor import Diagnosis, examine, probe_all, who_looks
from agent.ground.doctor_facts import LISTEN_S, Facts, Looker, _Ears, listen
from agent.process.certificates import certificate_file, key_file
from router_config.settings import observer_config
from tests.network.conftest import unused_port
from tests.network.doctor.robots import CHAIN, HOUR_NS, ahead, file_of, robot, robots, secure

MakeFleet = Callable[..., Fleet]


def bad(diagnosis: Diagnosis) -> list[str]:
    """All that is not well, in the order in which it is said."""
    lines = [str(finding) for finding in diagnosis.findings if finding.level != "ok"]
    assert all("\n" not in line and ("; " in line or "says" in line) for line in lines), "each says what to do"
    return lines


def only(lines: list[str], *beginnings: str) -> bool:
    """Whether these are the lines, and there are no others."""
    assert len(lines) == len(beginnings), lines
    for line, beginning in zip(lines, beginnings, strict=True):
        assert " ".join(line.split()).startswith(beginning), line
    return True


@pytest.fixture
def chain(make_fleet: MakeFleet, tmp_path: Path) -> Fleet:
    """r1 - r2 - r3, secured, with all keys on this computer; its file is fleet.toml."""
    fleet = secure(make_fleet(CHAIN), tmp_path)
    file_of(fleet, tmp_path)
    return fleet


def test_a_fleet_that_is_well(chain: Fleet, tmp_path: Path) -> None:
    path, runner = tmp_path / "fleet.toml", CliRunner()
    with robots(chain, tmp_path / "keys"):
        done = runner.invoke(app, ["doctor", str(path)])
        assert done.exit_code == 0, done.output
        assert done.output.splitlines()[-1] == "well"
        told = [line for line in done.output.splitlines() if "is linked and heard; hears" in line]
        assert [line.split()[1] for line in told] == ["r1:", "r2:", "r3:"]
        assert all("there and back" in line and "; clock " in line and "a state takes" in line for line in told)
        asked = json.loads(runner.invoke(app, ["doctor", str(path), "--as", "view", "--json"]).output)
        assert asked["well"] and asked["as"] == "view"
        heard = [finding["text"] for finding in asked["findings"] if "is linked and heard" in finding["text"]]
        assert len(heard) == 3 and not any("there and back" in text for text in heard)
        assert "ports and certificates alone" in runner.invoke(app, ["doctor", str(path), "--as", "r2"]).output
    wrong = runner.invoke(app, ["doctor", str(path), "--as", "eve"])
    assert type(wrong.exception).__name__ == "ConfigError" and "no such robot, observer or console" in str(
        wrong.exception
    )


def test_a_dead_robot_another_fleet_file_and_a_wrong_clock(chain: Fleet, tmp_path: Path) -> None:
    other, keys = replace(chain, estimation=replace(chain.estimation, iteration_s=2.0)), tmp_path / "keys"
    with robot(chain, "r1", keys, ahead(HOUR_NS)), robot(other, "r2", keys):
        for name, beside in (("ann", ["wrong r2: has another fleet file (its digest is "]), ("view", [])):
            lines = bad(examine(tmp_path / "fleet.toml", name, tmp_path))
            dead = f"wrong r3: {chain.robot['r3'].listen}: nobody listens there; start its agent"
            assert only(lines, dead, *beside, "warning r1: its clock is 3600 s ahead of this computer's")


def test_rules_that_do_not_know_us_others_and_a_loop_that_stands(chain: Fleet, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    stranger = replace(chain, access=Access(keys="keys"))
    more = replace(chain, access=replace(chain.access, consoles=("ann", "bob")))
    with robot(chain, "r1", keys, mute=True), robot(stranger, "r2", keys), robot(more, "r3", keys):
        lines = bad(examine(tmp_path / "fleet.toml", "ann", tmp_path))
    nothing = f"is linked, but showed nothing in {LISTEN_S:.0f} s"
    assert only(
        lines,
        f"wrong r1: {nothing}: its loop hangs, or is about to begin; look again",
        f"wrong r2: {nothing}: its rules do not know us",
        "wrong r3: has other access rules (their digest is ",
    )


def test_neighbours_that_do_not_hear_each_other(chain: Fleet, tmp_path: Path) -> None:
    keys, elsewhere = tmp_path / "keys", f"tls/127.0.0.1:{unused_port()}"
    lost = replace(chain, robot={**chain.robot, "r2": replace(chain.robot["r2"], listen=elsewhere)})
    with (
        robot(chain, "r1", keys),
        robot(chain, "r2", keys, deaf_to=("r1", "r3")),
        robot(lost, "r3", keys, deaf_to=("r2",)),
    ):
        lines = bad(examine(tmp_path / "fleet.toml", "ann", tmp_path))
        as_observer = bad(examine(tmp_path / "fleet.toml", "view", tmp_path))
    dials = f"no link: r3 dials r2 at {chain.robot['r2'].listen}; look from r3's computer: aucamp doctor FLEET --as r3"
    assert only(
        lines,
        "wrong r1: r2 does not hear r1: their link is mute, and r2 dials r1 again each second",
        f"wrong r2: r2 and r3 do not hear each other: {dials}",
    )
    unseen = "they have no link, or other rules; look from"
    assert only(
        as_observer, f"wrong r1: r2 does not hear r1: {unseen}", f"wrong r2: r2 and r3 do not hear each other: {unseen}"
    )


def test_certificates_in_the_wrong_place(chain: Fleet, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    first, second = chain.robot["r1"].listen, chain.robot["r2"].listen
    swapped = {"r1": replace(chain.robot["r1"], listen=second), "r2": replace(chain.robot["r2"], listen=first)}
    path = file_of(replace(chain, robot={**chain.robot, **swapped}), tmp_path)
    with robots(chain, keys):
        lines = bad(examine(path, "view", tmp_path))
        shown = "shows the certificate of"
        assert only(lines, f"wrong r1: {second}: {shown} 'r2'", f"wrong r2: {first}: {shown} 'r1'")
        file_of(chain, tmp_path)
        key_file(keys, "ann").unlink()
        lines = bad(examine(path, "ann", tmp_path))
        assert only(lines, f"wrong ann: {key_file(keys, 'ann')}: no such file; copy it")
        certificate_file(keys, "ca").unlink()
        assert all("ca.pem: no such file; copy it" in line for line in bad(examine(path, "view", tmp_path)))
        plain = {name: replace(one, listen=one.listen.replace("tls/", "tcp/")) for name, one in chain.robot.items()}
        lines = bad(examine(file_of(replace(chain, robot=plain, access=Access()), tmp_path), None, tmp_path))
    assert only(
        lines, *(f"wrong {name}: {plain[name].listen}: listens on tls/, and our file has tcp/" for name in CHAIN)
    )


def test_an_open_fleet(make_fleet: MakeFleet, tmp_path: Path) -> None:
    """It is said to be open, which is no ill. Somebody of another fleet, another version and a program that is no agent
    have the robots' ports."""
    fleet = make_fleet(CHAIN)
    path, port = file_of(fleet, tmp_path), int(fleet.robot["r3"].listen.rpartition(":")[2])
    foreign = replace(fleet, fleet="sea")
    with contextlib.ExitStack() as stack:
        stack.enter_context(robot(fleet, "r1", schema=99))
        stack.enter_context(robot(foreign, "r2"))
        stack.enter_context(socket.create_server(("127.0.0.1", port)))
        diagnosis = examine(path, None, tmp_path)
    assert "open: who reaches a port" in diagnosis.findings[0].text and diagnosis.findings[0].level == "ok"
    lines = bad(diagnosis)
    assert only(
        lines,
        "wrong r1: its states cannot be read (schema 99, ours is 3)",
        f"wrong r2: r2 of fleet 'sea' listens at {fleet.robot['r2'].listen}; write one name",
        "wrong r2: has another fleet file",
        "wrong r3: its port answers, but no link came about",
    )
    with robots(fleet):
        diagnosis = examine(path, None, tmp_path)
        assert diagnosis.well, diagnosis
        assert sum("there and back" in finding.text for finding in diagnosis.findings) == 3  # loopback: anybody may ask


def test_what_robots_say_of_themselves(make_fleet: MakeFleet, tmp_path: Path) -> None:
    fleet = make_fleet(CHAIN)
    path = file_of(fleet, tmp_path)
    with robot(fleet, "r1", faults=("no camera: plug it in",)), robot(fleet, "r2", mode="degraded"), robot(fleet, "r3"):
        lines = bad(examine(path, None, tmp_path))
    assert only(lines, "warning r1: says of itself: no camera: plug it in", "warning r2: says that it is degraded")


def test_all_robots_are_asked_at_the_same_time(make_fleet: MakeFleet, tmp_path: Path) -> None:
    """Ten that take the call and say nothing cost as much as one."""
    with contextlib.ExitStack() as stack:
        ports = [stack.enter_context(socket.create_server(("127.0.0.1", 0))).getsockname()[1] for _ in range(10)]
        fleet = secure(make_fleet({f"r{k}": () for k in range(1, 11)}), tmp_path)
        places = {
            name: replace(one, listen=f"tls/127.0.0.1:{port}")
            for (name, one), port in zip(fleet.robot.items(), ports, strict=True)
        }
        who = who_looks(fleet, file_of(fleet, tmp_path), None)
        began_s = time.monotonic()
        probed = probe_all(replace(fleet, robot=places), who)
        assert time.monotonic() - began_s < 2.0
    assert all("no handshake follows" in (one.cause or "") for one in probed.values())


def test_of_an_open_fleet_anybody_looks(make_fleet: MakeFleet, tmp_path: Path) -> None:
    fleet = make_fleet(CHAIN)
    assert who_looks(fleet, file_of(fleet, tmp_path), "ann").name == "ann"


def test_an_agent_says_before_a_dive_what_will_go_wrong(chain: Fleet, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "fleet.toml"
    assert check.before_dive(chain, "r1", path, tmp_path) is None
    monkeypatch.setattr(check, "disk_finding", lambda folder: check.Finding("warning", "disk", "0.5 hours left"))
    away = replace(chain.robot["r1"], camera="v4l2:/dev/video_none")
    told = check.before_dive(replace(chain, robot={**chain.robot, "r1": away}), "r1", path, tmp_path)
    assert told is not None and "/dev/video_none" in told and told.endswith("; 0.5 hours left") and "\n" not in told


# --- listening ---
# How long is listened, and what is put down of states that arrive.


class Arriving:
    """A sample of the door's."""

    is_put, encoding = True, encoding(State)

    def __init__(self, state: State) -> None:
        self.key, self._payload = topics.key(topics.STATE, fleet="test", robot=state.robot), encode(state)
        self.size = len(self._payload)

    def payload(self) -> bytes:
        return self._payload


def test_states_are_put_down(state: Callable[..., State]) -> None:
    now_ns = iter((1000, 2000, 3000, 4000))
    ears = _Ears(lambda: next(now_ns))

    def shows(sent_ns: int, gaps: int, target: str = "ball", **changed: object) -> None:
        near = (NeighbourState(robot="r2", gaps=gaps),)
        said = replace(state("r1"), sent_ns=sent_ns, target=target, neighbours=near, **changed)
        ears.state(Arriving(said))
        ears.read()

    shows(500, gaps=7)
    shows(1700, gaps=9)
    shows(2000, gaps=4, target="ring")  # counted by themselves
    assert ears.late_ns == {"r1": 300} and ears.states["r1"].target == "ring"
    assert dict(ears.missed()) == {("r1", "r2"): 2}
    shows(2000, gaps=99, schema=1)
    assert ears.unreadable == {"r1": "schema 1, ours is 3"} and ears.missed()["r1", "r2"] == 2


@pytest.mark.parametrize(("pace", "least_s"), [(1.0, 0.3), (10.0, 0.3), (0.5, 0.6), (0.0, 0.9)])
def test_a_dive_in_the_twin_is_listened_to_by_its_own_time(
    pace: float, least_s: float, make_fleet: Callable[..., Fleet], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_facts, "LISTEN_S", 0.3)
    monkeypatch.setattr(doctor_facts, "SLOWEST_S", 0.9)
    fleet = make_fleet({"r1": ()})
    looker = Looker(observer_config(fleet), "view", asks=False, orders=False)
    began_s = time.monotonic()
    facts = listen(fleet, looker, ["r1"], lambda: int((time.monotonic() - began_s) * 1e9 * pace))
    assert time.monotonic() - began_s >= least_s
    assert facts == Facts({}, {}, frozenset(), {}, {}, {}, {}, {}, {})
