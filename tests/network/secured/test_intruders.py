"""Four things that anybody could do to an open fleet, tried on a secured one.

And on an open one, so that each test can fail. Real sessions, a real recorder's ears, and whatever certificate a
stranger can have.
"""

import contextlib
import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace

from agent.core import topics
from agent.core.codec import encode, encoding
from agent.core.config import Fleet
from agent.core.messages import LogLine, State
from agent.process.certificates import CLIENT, SERVER, Pair, authority, issue, make_ca, write
from agent.process.transport import Observer, Transport
from replay.recorder import Arrivals, receiving
from router_config.settings import observer_config, peer_config
from tests.network.conftest import unused_port
from tests.network.secured.conftest import Secured
from tests.network.secured.parties import CHAIN, HERE, STRANGER, Ear, client, listener, opened, peer, say_everything
from tests.waiting import until

SETTLED_S = 0.7  # within it the same reaches an open fleet
GHOSTS = 400


@pytest.fixture(params=["open", "secured"])
def either(request: pytest.FixtureRequest, make_fleet: Callable[..., Fleet]) -> tuple[Fleet, Path | None]:
    """A fleet, and the folder of its keys; None of an open one."""
    if request.param == "open":
        return make_fleet(CHAIN), None
    secured: Secured = request.getfixturevalue("secured")
    return secured


@contextlib.contextmanager
def dialling(fleet: Fleet, keys: Path | None, at: str, names: Sequence[str]) -> Iterator[list[zenoh.Session]]:
    """Strangers at a robot's port, with certificates of these names; one without any, where he is let in."""
    with contextlib.ExitStack() as stack:
        sessions = [stack.enter_context(opened(client(fleet.robot[at].listen, keys, n))) for n in names if keys]
        if keys is None:
            sessions.append(stack.enter_context(opened(client(fleet.robot[at].listen, None))))
        yield sessions


def in_its_place(
    fleet: Fleet, keys: Path | None, robot: str, name: str
) -> contextlib.AbstractContextManager[zenoh.Session]:
    """A stranger who listens where a robot that is off would, so that all who look dial him."""
    return opened(listener(fleet.robot[robot].listen, keys, name))


def test_nobody_holds_the_token_of_a_robot_that_is_off(either: tuple[Fleet, Path | None]) -> None:
    fleet, keys = either
    token, arrivals = topics.ALIVE.format(fleet="test", robot="r2", session="abc"), Arrivals(time.time_ns)
    with contextlib.ExitStack() as stack:
        robots = [stack.enter_context(Transport(fleet, name, time.time_ns, keys)) for name in ("r1", "r3")]
        stack.enter_context(receiving(fleet, arrivals, "recorder", keys))
        liars = [stack.enter_context(in_its_place(fleet, keys, "r2", STRANGER))]
        for at in ("r1", "r3"):
            liars += stack.enter_context(
                dialling(fleet, keys, at, (STRANGER, "recorder", "r3" if at == "r1" else "r1"))
            )
        kept = [session.liveliness().declare_token(token) for session in liars]

        def heard() -> set[str]:
            list(arrivals.drain())
            return arrivals.robots

        until(lambda: heard() >= ({"r1", "r3"} if keys else {"r1", "r2", "r3"}))
        time.sleep(SETTLED_S if keys else 0)
        assert heard() == ({"r1", "r3"} if keys else {"r1", "r2", "r3"})
        known = [bool(robot._tokens._since_s["r2"]) for robot in robots]
        assert known == ([False, False] if keys else [True, True])
        del kept


def test_nobody_shows_a_state_or_a_log_line_of_another(
    either: tuple[Fleet, Path | None], state: Callable[..., State]
) -> None:
    """r3 is off. r2, taken over, and a stranger in r3's place say that it is stopped, and that its board is."""
    fleet, keys = either
    forged = [(topics.STATE, state("r3")), (topics.LOG, LogLine(robot="r3", sent_ns=1, level="info", text="armed"))]
    with contextlib.ExitStack() as stack:
        r1 = stack.enter_context(Transport(fleet, "r1", time.time_ns, keys))
        watch = stack.enter_context(Observer(fleet, time.time_ns, (topics.STATE, topics.LOG), keys=keys))
        liars = [
            stack.enter_context(in_its_place(fleet, keys, "r3", STRANGER)),
            stack.enter_context(in_its_place(fleet, keys, "r2", "r2")),
            *stack.enter_context(dialling(fleet, keys, "r1", (STRANGER, "r2", "recorder"))),
        ]
        seen: set[tuple[str, str]] = set()

        def shown(enough: set[tuple[str, str]]) -> bool:
            r1.show(state("r1"))
            for session in liars:
                for row, message in forged:
                    key = topics.key(row, fleet="test", robot="r3")
                    session.put(key, encode(message), encoding=encoding(row.message))
            seen.update((got.topic.name, got.chunks["robot"]) for got in watch.drain())
            return seen >= enough

        until(lambda: shown({("state", "r1")} if keys else {("state", "r1"), ("state", "r3"), ("log", "r3")}))
        if keys:
            until(lambda: _matching(liars[1], "aucamp/test/robot/r2/state"))  # r2's own word would be heard
            began_s = time.monotonic()
            until(lambda: shown(set()) and time.monotonic() - began_s > SETTLED_S)
            assert seen == {("state", "r1")}


def test_nobody_fills_a_recorder_with_robots_that_do_not_exist(
    either: tuple[Fleet, Path | None], state: Callable[..., State]
) -> None:
    """r2, taken over, shows the states of 400 others, and says that they are up. A recorder has r2, and nobody else."""
    fleet, keys = either
    arrivals, ghosts = Arrivals(time.time_ns), [f"x{number}" for number in range(GHOSTS)]
    with contextlib.ExitStack() as stack:
        liar = stack.enter_context(in_its_place(fleet, keys, "r2", "r2"))
        stack.enter_context(receiving(fleet, arrivals, "recorder", keys))
        until(lambda: _matching(liar, "aucamp/test/robot/r2/state"))
        kept = []
        for name in (*ghosts, "r2"):
            key = topics.key(topics.STATE, fleet="test", robot=name)
            liar.put(
                key, encode(state(name)), encoding=encoding(State), congestion_control=zenoh.CongestionControl.BLOCK
            )
            kept.append(liar.liveliness().declare_token(topics.ALIVE.format(fleet="test", robot=name, session="a")))
        wanted = {"r2"} if keys else {"r2", *ghosts}

        def heard() -> set[str]:
            list(arrivals.drain())
            return arrivals.robots

        until(lambda: heard() >= wanted and arrivals.counts["state"] and arrivals.counts["alive"])
        time.sleep(SETTLED_S)
        assert heard() == wanted
        assert arrivals.counts["state"] == (1 if keys else GHOSTS + 1) == arrivals.counts["alive"]
        del kept


def test_nobody_but_a_console_reads_who_is_linked_with_whom(either: tuple[Fleet, Path | None]) -> None:
    fleet, keys = either
    with contextlib.ExitStack() as stack:
        stack.enter_context(Transport(fleet, "r1", time.time_ns, keys))
        strangers = stack.enter_context(dialling(fleet, keys, "r1", (STRANGER, "r2", "r3", "recorder")))
        answers = [_ask(session) for session in strangers]
        assert [len(got) for got in answers] == [0, 0, 0, 0] if keys else all(answers)
        if keys:
            looks = stack.enter_context(opened(observer_config(fleet, "view", keys)))
            orders = stack.enter_context(opened(observer_config(fleet, "ann", keys)))
            until(lambda: _ask(orders))
            assert not _ask(looks)
            sessions = json.loads(_ask(orders)[0])["sessions"]
            assert sessions and "links" in sessions[0]


def test_people_are_told_of_those_who_are_linked_and_have_no_business_here(secured: Secured) -> None:
    """What the rules turn away they turn away in silence; whom they turn it away from can be named."""
    fleet, keys = secured
    with Transport(fleet, "r1", time.time_ns, keys) as r1:
        where = fleet.robot["r1"].listen
        with opened(client(where, keys, "r2")), opened(client(where, keys, "recorder")):
            with opened(client(where, keys, STRANGER)), opened(client(where, keys, "r3")):
                until(lambda: len(r1.faults()) == 2)
                eve, r3 = r1.faults()
                assert eve.startswith("stranger: eve is linked to us, is believed nothing and told nothing: its cert")
                assert r3.startswith("stranger: r3 is linked to us, is believed nothing and told nothing, for it is no")
            until(lambda: r1.faults() == ())


def _ask(session: zenoh.Session) -> list[str]:
    return [reply.ok.payload.to_string() for reply in session.get("@/*/peer", timeout=0.5) if reply.ok]


def _matching(session: zenoh.Session, key: str) -> bool:
    publisher = session.declare_publisher(key)
    matching = publisher.matching_status.matching
    publisher.undeclare()
    return bool(matching)


# --- bad credentials ---
# Who has no good certificate is linked to nobody, whether it dials or is dialled. Real sessions on loopback.

NOW, DAY = datetime.now(UTC), timedelta(days=1)
LINKED_S = 1.5  # a good one is linked in less than 0.1 s

Bad = Callable[[Pair], Pair]  # the fleet's own authority -> what somebody has in its stead

BAD: dict[str, Bad] = {
    "foreign authority": lambda ca: issue(make_ca("lake"), "r2", HERE),
    "authority of the same name": lambda ca: issue(make_ca("test"), "r2", HERE),
    "expired": lambda ca: issue(ca, "r2", HERE, ends=NOW - DAY),
    "of the future": lambda ca: issue(ca, "r2", HERE, begins=NOW + DAY),
}
BAD_TO_DIAL = BAD | {"for servers alone": lambda ca: issue(ca, "r2", HERE, uses=[SERVER])}
BAD_TO_BE_DIALLED = BAD | {
    "for clients alone": lambda ca: issue(ca, "r2", HERE, uses=[CLIENT]),
    "of another host": lambda ca: issue(ca, "r2", ["192.168.7.12"]),
    "of no host": lambda ca: issue(ca, "r2"),
}


def folder(secured: Secured, make: Bad, name: str) -> Path:
    """A folder of keys in which r2's pair is the bad one, and the authority is the fleet's."""
    bad = secured.keys / name
    bad.mkdir()
    (bad / "ca.pem").write_bytes((secured.keys / "ca.pem").read_bytes())
    write(bad, "r2", make(authority(secured.keys)))
    return bad


def elsewhere(fleet: Fleet, name: str) -> Fleet:
    """The same fleet, one of whose robots listens on a port of this test's own."""
    robot = replace(fleet.robot[name], listen=f"tls/127.0.0.1:{unused_port()}")
    return replace(fleet, robot={**fleet.robot, name: robot})


def all_at_once(check: Callable[[str], None], cases: Iterable[str]) -> None:
    """Each case waits for what must not come; they wait side by side."""
    with ThreadPoolExecutor(len(list(cases))) as pool:
        outcomes = {case: pool.submit(check, case) for case in cases}
    failed = {case: repr(error) for case, outcome in outcomes.items() if (error := outcome.exception())}
    assert not failed


def transports(session: zenoh.Session) -> int:
    """To how many others it is linked, clients included."""
    return len(list(session.info.transports()))


def refused(receiver: zenoh.Session, as_client: zenoh.Config, as_peer: zenoh.Config) -> None:
    """Nothing comes through of one who says everything as soon as he is in. A client ends, a peer tries again."""
    ear = Ear(receiver)
    with opened(as_peer) as session:
        kept = say_everything(session, "bad")
        with pytest.raises(zenoh.ZError), opened(as_client) as let_in:
            kept += say_everything(let_in, "bad")
        time.sleep(LINKED_S)
        assert transports(session) == 0
    assert transports(receiver) == 0 and ear.heard == set()
    del kept


def test_who_dials_with_a_bad_certificate_is_not_let_in(secured: Secured) -> None:
    def check(why: str) -> None:
        bad, fleet = folder(secured, BAD_TO_DIAL[why], why), elsewhere(secured.fleet, "r1")
        where = fleet.robot["r1"].listen
        with opened(peer_config(fleet, "r1", secured.keys)) as r1:
            refused(r1, client(where, bad, "r2"), peer(where, bad, "r2"))
            with opened(client(where, secured.keys, "r2")):  # with the good one it is
                until(lambda: transports(r1))

    all_at_once(check, BAD_TO_DIAL)


def test_who_dials_without_a_certificate_is_not_let_in(secured: Secured) -> None:
    def check(how: str) -> None:
        fleet = elsewhere(secured.fleet, "r1")
        where = fleet.robot["r1"].listen
        where = where if how == "no certificate" else where.replace("tls/", "tcp/")
        configs = client(where, None), peer(where, None)
        for config in configs if how == "no certificate" else ():  # it knows the authority, which is public
            config.insert_json5("transport/link/tls/root_ca_certificate", f'"{secured.keys / "ca.pem"}"')
        with opened(peer_config(fleet, "r1", secured.keys)) as r1:
            refused(r1, *configs)

    all_at_once(check, ("no certificate", "plain tcp"))


def test_who_is_dialled_with_a_bad_certificate_is_left_alone(secured: Secured) -> None:
    """At r2's address stands another: r3 dials it and does not stay, and takes r2 when it is there."""

    def check(why: str) -> None:
        bad = folder(secured, BAD_TO_BE_DIALLED[why], why)
        fleet = elsewhere(elsewhere(secured.fleet, "r2"), "r3")
        with opened(peer_config(fleet, "r3", secured.keys)) as r3:
            ear = Ear(r3)
            with opened(listener(fleet.robot["r2"].listen, bad, "r2")) as stranger:
                kept = say_everything(stranger, "bad")
                time.sleep(LINKED_S)
                assert transports(r3) == 0 and transports(stranger) == 0 and ear.heard == set()
                del kept
            with opened(peer_config(fleet, "r2", secured.keys)):
                until(lambda: transports(r3))

    all_at_once(check, BAD_TO_BE_DIALLED)
