"""Links that heal: one that a stop leaves mute, dials that come to nothing, and those that are let be."""

import contextlib
import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace

from agent.core.config import Fleet
from router_config import session
from router_config.session import LinkWatchdog, Session
from router_config.settings import client_config, observer_config, peer_config
from tests.network.mute_link import provoked
from tests.network.secured.parties import secure
from tests.waiting import until

PAIR = {"r1": ("r2",), "r2": ("r1",)}
PATIENCE_S = 60.0
LATER_S = 2.0  # a link that does not heal is mute then, too


@pytest.mark.parametrize("kind", ["tcp over IPv6", "tls"])
def test_a_stop_in_the_middle_of_a_handshake_leaves_a_link_that_is_heard(
    make_fleet: Callable[..., Fleet], tmp_path: Path, kind: str
) -> None:
    fleet = make_fleet(PAIR)
    if kind == "tcp over IPv6":
        robots = {
            name: replace(one, listen=one.listen.replace("127.0.0.1", "[::1]")) for name, one in fleet.robot.items()
        }
        fleet = replace(fleet, robot=robots)
    keys = tmp_path / "keys" if kind == "tls" else None
    with provoked(fleet if keys is None else secure(fleet, keys), keys) as pair:
        assert pair.healed_s(PATIENCE_S) is not None


@pytest.mark.slow
def test_a_link_that_is_mute_is_ended_and_made_anew(make_fleet: Callable[..., Fleet]) -> None:
    with provoked(make_fleet(PAIR), short=True) as pair:
        assert pair.healed_s(PATIENCE_S) is not None


@pytest.mark.slow
def test_without_either_it_is_mute(make_fleet: Callable[..., Fleet]) -> None:
    """Or the two above show nothing: a Zenoh without the fault needs no watchdog."""

    def is_mute() -> bool:
        with provoked(make_fleet(PAIR), short=True, watched=False) as pair:
            return pair.healed_s(LATER_S) is None

    assert any(is_mute() for _ in range(5))


@pytest.fixture
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "LOOK_S", 0.02)


def dialled(port: int) -> set[int]:
    """From which ports of this process connections to that one are open, or under way."""
    return {ours[1] for _, (ours, theirs) in session._connections() if theirs[1] == port}


@contextlib.contextmanager
def one_who_says_nothing(backlog: int) -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0), backlog=backlog) as door:
        yield door


def dialling(fleet: Fleet, door: socket.socket) -> Session:
    """An observer of r1, where nobody answers."""
    listen = f"tcp/127.0.0.1:{door.getsockname()[1]}"
    robots = {"r1": replace(fleet.robot["r1"], neighbours=(), listen=listen)}
    return Session(observer_config(replace(fleet, robot=robots)), "a test")


@pytest.mark.usefixtures("looks_often")
@pytest.mark.parametrize("taken", [True, False])
def test_a_dial_that_comes_to_nothing_is_ended_and_tried_again(make_fleet: Callable[..., Fleet], taken: bool) -> None:
    """By one whose call is taken and not answered, and by one whose call is not even taken."""
    with one_who_says_nothing(backlog=8 if taken else 0) as door, contextlib.ExitStack() as stack:
        port = door.getsockname()[1]
        if not taken:  # the queue of those who wait to be taken is full
            stack.enter_context(socket.create_connection(door.getsockname()))
        filling = dialled(port)
        with dialling(make_fleet(PAIR), door):
            seen: set[int] = set()
            until(lambda: seen.update(dialled(port) - filling) or len(seen) > 2)


def test_a_session_that_dials_in_vain_closes_at_once(make_fleet: Callable[..., Fleet]) -> None:
    with one_who_says_nothing(backlog=8) as door:
        with dialling(make_fleet(PAIR), door):
            until(lambda: dialled(door.getsockname()[1]))
        assert not dialled(door.getsockname()[1])  # Zenoh's own close() gives up after ten seconds


@pytest.mark.usefixtures("looks_often")
def test_who_dials_a_robot_and_says_nothing_is_shown_out(make_fleet: Callable[..., Fleet]) -> None:
    fleet = make_fleet({"r1": ()})
    host, port = fleet.robot["r1"].listen.partition("/")[2].split(":")
    with Session(peer_config(fleet, "r1"), "a test"), socket.create_connection((host, int(port))) as mute:
        mute.settimeout(PATIENCE_S)
        assert mute.recv(1) == b""


@pytest.mark.usefixtures("looks_often")
def test_links_that_are_well_are_let_be(make_fleet: Callable[..., Fleet]) -> None:
    """Those of other sessions of the process, too, of which one has not reached whom it dials."""
    fleet = make_fleet(PAIR)
    only_r2 = replace(fleet, robot={"r2": replace(fleet.robot["r2"], neighbours=())})
    port = int(fleet.robot["r1"].listen.rpartition(":")[2])
    with (
        Session(peer_config(fleet, "r1"), "a test"),
        Session(observer_config(fleet), "a test") as both,
        Session(observer_config(fleet), "a test"),
    ):
        until(lambda: len(dialled(port)) == 2)
        before = dialled(port)
        with Session(peer_config(only_r2, "r2"), "a test"):
            until(lambda: len(both.links()) == 2)
        time.sleep(4 * session.DIAL_LOOKS * session.LOOK_S)
        assert dialled(port) == before


def test_links_of_somebody_elses_session_in_this_process_are_let_be(make_fleet: Callable[..., Fleet]) -> None:
    """It dials the same robot as a session of ours, as a lab's own program may."""
    fleet = make_fleet(PAIR)
    with contextlib.ExitStack() as stack:
        stack.enter_context(Session(peer_config(fleet, "r1"), "r1"))
        foreign = stack.enter_context(zenoh.open(zenoh.Config.from_json5(observer_config(fleet))))
        stack.enter_context(Session(observer_config(fleet), "a console"))
        until(lambda: foreign.info.links())
        before = {str(link) for link in foreign.info.links()}
        time.sleep(2 * session.DIAL_LOOKS * session.LOOK_S)
        assert {str(link) for link in foreign.info.links()} == before


def test_what_is_dialled_may_be_anything_that_zenoh_takes() -> None:
    for router, ports in (("tcp/[fe80::1%eth0]:7447#iface=eth0", {7447}), ("udp/host:1", set()), ("tls/host:2", {2})):
        watchdog = LinkWatchdog(json.loads(client_config(router)))
        assert watchdog._dials == ports and not watchdog._listens
