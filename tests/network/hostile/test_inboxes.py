"""What is kept of each neighbour between two steps, and what a neighbour that speaks too often can take from others."""

import os
import time
from collections.abc import Callable
from contextlib import ExitStack

import pytest
from msgspec import UNSET
from msgspec.structs import replace

from agent.core import topics
from agent.core.codec import Refusal, decode, encode, encoding
from agent.core.config import Fleet, Navigation, Target
from agent.core.messages import MAX_PAYLOAD, Estimate, Presence
from agent.core.topics import LINK
from agent.process.links import BURST, FASTEST_HZ, FOREIGN, LASTING_S, SESSIONS, Inboxes, Tokens, unlisted
from agent.process.transport import Transport
from tests.network.conftest import unused_port
from tests.network.hostile.payloads import MANY, kinds
from tests.network.rogue import Rogue
from tests.waiting import until

FULL = {"r1": ("r2", "r3", "r4"), "r2": ("r1",), "r3": ("r1",), "r4": ("r1",)}
STEP_NS = 50_000_000

Fleets = Callable[..., Fleet]
Says = Callable[..., Estimate]


class Arriving:
    """A sample as the door hands it over."""

    is_put = True

    def __init__(self, src: str, data: bytes = b"x", rest: str = "", encoding: str = encoding(Estimate)) -> None:
        self.key, self._data, self.encoding = f"aucamp/test/link/{src}/r1{rest}", data, encoding

    @property
    def size(self) -> int:
        return len(self._data)

    def payload(self) -> bytes:
        return self._data


@pytest.fixture
def inboxes(make_fleet: Fleets) -> Inboxes:
    return Inboxes(make_fleet(FULL), "r1")


def heard(inboxes: Inboxes, now_ns: int = 0) -> list[tuple[str, bytes]]:
    return [(item.src, item.payload) for item in inboxes.drain(now_ns)[0]]


def refused(inboxes: Inboxes, now_ns: int = 0) -> dict[tuple[str, str], int]:
    return {(row.reason, row.src or ""): row.count for row in inboxes.drain(now_ns)[1]}


def test_the_two_newest_of_each_and_all_in_turn(inboxes: Inboxes) -> None:
    for k in range(9):
        inboxes.put(Arriving("r4", b"%d" % k), k)
    inboxes.put(Arriving("r2", b"late"), 10)
    inboxes.put(Arriving("r2", b"later"), 11)
    inboxes.put(Arriving("r3", b"last"), 12)
    assert heard(inboxes) == [("r2", b"late"), ("r3", b"last"), ("r4", b"7"), ("r2", b"later"), ("r4", b"8")]
    assert heard(inboxes) == []


def test_each_target_has_places_of_its_own(make_fleet: Fleets) -> None:
    fleet = replace(make_fleet(FULL), target={"ball": Target(radius_m=0.07), "buoy": Target(radius_m=0.07)})
    inboxes = Inboxes(fleet, "r1")
    for k in range(3):
        inboxes.put(Arriving("r2", b"%d" % k, "/ball"), k)
    inboxes.put(Arriving("r2", b"buoy", "/buoy"), 9)
    inboxes.put(Arriving("r3", b"buoy", "/buoy"), 9)
    assert heard(inboxes) == [("r2", b"1"), ("r2", b"buoy"), ("r3", b"buoy"), ("r2", b"2")]


def test_where_a_neighbour_swims_has_places_of_its_own_and_is_named(make_fleet: Fleets) -> None:
    fleet = make_fleet(FULL)
    swims = Inboxes(replace(fleet, navigation=Navigation()), "r1")
    arriving = Arriving("r2", b"here", encoding=encoding(Presence))
    arriving.key = topics.key(topics.NEAR, fleet="test", src="r2", dst="r1")
    for inboxes, kept in ((swims, [(b"here", "near"), (b"ball", UNSET)]), (Inboxes(fleet, "r1"), [(b"ball", UNSET)])):
        inboxes.drain(0)
        inboxes.put(Arriving("r2", b"ball"), 1)
        for _ in range(len(kept) - 1):
            inboxes.put(arriving, 2)
        arriving_too_large = Arriving("r2", bytes(topics.NEAR.limit + 1), encoding=encoding(Presence))
        arriving_too_large.key = arriving.key
        inboxes.put(arriving_too_large, 3)
        got, turned_away = inboxes.drain(STEP_NS)
        assert sorted([(item.payload, item.topic) for item in got], key=lambda k: k[0], reverse=True) == kept
        assert [row.reason for row in turned_away] == ["too large" if len(kept) == 2 else "unknown sender"]
    for _ in range(5000):
        swims.put(arriving, 4)
    got, turned_away = swims.drain(2 * STEP_NS)
    assert len(got) == 2 and [(row.reason, row.src) for row in turned_away] == [("flood", "r2")]


def test_a_target_that_our_file_lacks_is_for_the_step_to_refuse(inboxes: Inboxes) -> None:
    for k in range(1000):
        inboxes.put(Arriving("r2", b"%d" % k, f"/thing{k}"), k)
    inboxes.put(Arriving("r2", b"ball"), 0)
    assert heard(inboxes) == [("r2", b"ball"), ("r2", b"998"), ("r2", b"999")]


def test_reasons_are_few_and_name_the_neighbour(inboxes: Inboxes) -> None:
    for k in range(500):
        inboxes.put(Arriving("r2", bytes(MAX_PAYLOAD + 1)), k)
        inboxes.put(Arriving("r2", b"x", encoding=f"text/{k}"), k)
        inboxes.put(Arriving(f"x{k}"), k)
        inboxes.put(Arriving("r3", rest=f"/a/b{k}"), k)
    want = {("too large", "r2"): 500, ("wrong encoding", "r2"): 500, ("unknown sender", ""): 1000}
    assert refused(inboxes) == want
    assert refused(inboxes) == {}


def test_a_payload_is_copied_only_where_it_can_be_a_message(inboxes: Inboxes, monkeypatch: pytest.MonkeyPatch) -> None:
    copied = []
    monkeypatch.setattr(Arriving, "payload", lambda self: copied.append(self.key) or b"")
    for bad in (Arriving("r9"), Arriving("r2", bytes(MAX_PAYLOAD + 1)), Arriving("r2", encoding="x")):
        inboxes.put(bad, 0)
    assert copied == []
    inboxes.put(Arriving("r2"), 0)
    assert len(copied) == 1


@pytest.mark.parametrize("late_s", [0.5, 3.0, 60.0])
def test_a_step_that_comes_late_makes_no_flood(inboxes: Inboxes, late_s: float) -> None:
    now_ns = 0
    for _ in range(20):
        for k in range(round(late_s * 20)):  # as often as a fleet file may ask for
            inboxes.put(Arriving("r2", b"%d" % k), now_ns)
        now_ns += round(late_s * 1e9)
        got, turned_away = inboxes.drain(now_ns)
        assert [item.payload for item in got] == [b"%d" % (late_s * 20 - 2), b"%d" % (late_s * 20 - 1)]
        assert turned_away == ()


def test_a_flood_is_counted_but_for_what_a_neighbour_may_say(inboxes: Inboxes) -> None:
    count = 0
    inboxes.drain(0)
    for step in range(100):
        for _ in range(500):
            inboxes.put(Arriving("r3"), step)
        inboxes.put(Arriving("r2"), step)
        counts = refused(inboxes, step * STEP_NS)
        assert counts.keys() == {("flood", "r3")}
        count += counts["flood", "r3"]
    assert count == pytest.approx(500 * 100 - BURST - FASTEST_HZ * 99 * 0.05, abs=10)


def test_through_real_sessions_one_that_shouts_takes_nobodys_place(make_fleet: Fleets, estimate: Says) -> None:
    fleet = make_fleet(FULL)
    with (
        Transport(fleet, "r1", time.time_ns) as r1,
        Transport(fleet, "r2", time.time_ns) as r2,
        Rogue(fleet, "r3") as rogue,
    ):
        rogue.linked("r1")

        def hears(seq: int, again: bool) -> bool:
            if again:
                r2.say(estimate("r2", "r1", seq))
            return seq in [decode(item.payload, Estimate).seq for item in r1.drain()[0]]

        until(lambda: hears(1, again=True))
        r2.say(estimate("r2", "r1", 2))
        until(lambda: hears(2, again=False))  # so all before it has come
        said, began_s = 5000, time.monotonic()
        for seq in range(1, said + 1):
            rogue.say("r1", encode(estimate("r3", "r1", seq)))
            if seq in (1, said // 2):
                r2.say(estimate("r2", "r1", seq))
        until(lambda: sum(inbox.arrived for inbox in r1._inboxes._inboxes) >= said + 2)
        got, turned_away = r1.drain()
        seqs = [(item.src, decode(item.payload, Estimate).seq) for item in got]
        assert seqs[:2] == [("r2", 1), ("r3", said - 1)]
        assert seqs[2:] == [("r2", said // 2), ("r3", said)]
        assert [(row.reason, row.src) for row in turned_away] == [("flood", "r3")]
        allowed = BURST + FASTEST_HZ * (time.monotonic() - began_s)
        assert said - 2 - allowed <= turned_away[0].count <= said - 2


def test_a_key_is_judged_as_the_table_of_topics_spells_it(inboxes: Inboxes) -> None:
    inboxes.put(Arriving("r2"), 0)
    assert topics.key(LINK, fleet="test", src="r2", dst="r1") == Arriving("r2").key
    assert heard(inboxes) == [("r2", b"x")]


# --- tokens ---
# Two agents of one name, and robots of another fleet, are told to whoever stands at the tank. Real sessions.

TOKENS_FULL = {"r1": ("r2", "r3"), "r2": ("r1", "r3"), "r3": ("r1", "r2")}


def elsewhere(fleet: Fleet, name: str) -> Fleet:
    """The same file on another computer, where the address of `name` is free."""
    robot = replace(fleet.robot[name], listen=f"tcp/127.0.0.1:{unused_port()}")
    return replace(fleet, robot={**fleet.robot, name: robot})


def test_a_second_agent_of_a_name_is_told_to_its_neighbours_and_to_the_first(make_fleet: Fleets) -> None:
    fleet = make_fleet(TOKENS_FULL)
    with ExitStack() as stack:
        r1, r2, r3 = (stack.enter_context(Transport(fleet, name, time.time_ns)) for name in TOKENS_FULL)
        with Transport(elsewhere(fleet, "r3"), "r3", time.time_ns) as second:
            until(lambda: r1.faults() == ("two agents: two linked to us are called r3; end one",))
            until(lambda: r2.faults() == ("two agents: two linked to us are called r3; end one",))
            both = tuple(f"two agents: {name} is linked to two called r3; end one" for name in ("r1", "r2"))
            until(lambda: r1.faults() and r2.faults() and r3.faults() == second.faults() == both)
        until(lambda: not any([r1.faults(), r2.faults(), r3.faults()]))


def test_an_agent_of_our_own_name_that_is_linked_to_us(make_fleet: Fleets) -> None:
    fleet = make_fleet(TOKENS_FULL)
    with Transport(fleet, "r1", time.time_ns) as r1, Rogue(fleet, "r1") as rogue:
        rogue.token(topics.ALIVE.format(fleet="test", robot="r1", session="abc"))
        until(lambda: r1.faults() == ("two agents: another one called r1 is linked to us; end one",))


def test_a_robot_of_another_fleet_at_a_neighbours_address(make_fleet: Fleets) -> None:
    fleet = make_fleet(TOKENS_FULL)
    with Transport(fleet, "r2", time.time_ns) as r2:
        with Transport(replace(fleet, fleet="lake"), "r1", time.time_ns) as r1:
            says = "another fleet: {} is of fleet {}, not {}; write one name in both fleet files"
            until(lambda: r2.faults() == (says.format("r1", "lake", "test"),))
            until(lambda: r1.faults() == (says.format("r2", "test", "lake"),))
        until(lambda: r2.faults() == ())


def test_a_robot_that_our_file_lacks_is_named_while_it_is_linked(make_fleet: Fleets) -> None:
    fleet = make_fleet(TOKENS_FULL)
    near = {"r1": ("r2",), "r2": ("r1",)}
    two = replace(fleet, robot={name: replace(fleet.robot[name], neighbours=of) for name, of in near.items()})
    with Transport(two, "r1", time.time_ns) as r1:
        with Transport(fleet, "r3", time.time_ns):
            says = "another file: r3 of our fleet is linked to us, and is not in our file; give all robots one file"
            until(lambda: r1.faults() == (says,))
            assert unlisted(r1.faults()) == {"r3"}
        until(lambda: r1.faults() == ())


def test_a_restart_is_no_second_agent(make_fleet: Fleets) -> None:
    fleet = make_fleet(TOKENS_FULL)
    with Transport(fleet, "r1", time.time_ns) as r1:
        for _ in range(3):
            with Transport(fleet, "r2", time.time_ns):
                until(lambda: r1._tokens._since_s["r2"])
        assert r1.faults() == ()


class Token:
    is_put = True

    def __init__(self, key: str) -> None:
        self.key = key


def alive(fleet: str = "test", robot: str = "r2", session: str = "a") -> Token:
    return Token(topics.ALIVE.format(fleet=fleet, robot=robot, session=session))


@pytest.fixture
def tokens(make_fleet: Fleets) -> Tokens:
    return Tokens(make_fleet(TOKENS_FULL), "r1")


def told(tokens: Tokens, now_s: float) -> tuple[str, ...]:
    return tokens.faults("00", lambda key: lambda: None, now_s)


def test_two_are_two_only_when_a_lost_link_cannot_be_the_reason(tokens: Tokens) -> None:
    tokens.token(alive(session="a"), 0.0)
    tokens.token(alive(session="b"), 10.0)
    assert told(tokens, 9.9 + LASTING_S) == ()
    assert len(told(tokens, 10.0 + LASTING_S)) == 1


def test_a_thousand_tokens_take_no_room(tokens: Tokens) -> None:
    for k in range(1000):
        tokens.token(alive(session=f"{k:x}"), 0.0)
        tokens.token(alive(fleet=f"f{k}"), 0.0)
        tokens.token(alive(robot=f"x{k}"), 0.0)
        tokens.token(alive(fleet="f" * 1000), 0.0)
        tokens.token(Token(topics.TWICE.format(fleet="test", robot="r1", witness=f"x{k}")), 0.0)
    assert {name: len(since_s) for name, since_s in tokens._since_s.items()} == {"r1": 0, "r2": SESSIONS, "r3": 0}
    assert len(tokens._foreign) == FOREIGN
    assert len(told(tokens, LASTING_S)) == 1 + FOREIGN
    assert all(len(text) < 120 for text in told(tokens, LASTING_S))


def test_what_no_agent_would_announce_is_nothing(tokens: Tokens) -> None:
    for text in ("", "x", "aucamp/test/alive/r2", f"aucamp/test/alive/r2/{os.urandom(4)!r}", "aucamp/A B/alive/r2/a"):
        tokens.token(Token(text), 0.0)
    assert told(tokens, LASTING_S) == ()


# --- payloads ---
# The rogue's payloads are what they are said to be: a flood of what nobody would look at tests nothing.


@pytest.fixture
def fleet(make_fleet: Callable[..., Fleet]) -> Fleet:
    return make_fleet({"r1": ("r2", "r3"), "r2": ("r1", "r3"), "r3": ("r1", "r2")})


@pytest.mark.parametrize("kind", ["heartbeat", "entries", "signed", "incarnations", "samples", "epochs"])
def test_a_neighbour_could_have_said_it(fleet: Fleet, kind: str) -> None:
    make = kinds(fleet, "r3", "r1")[kind]
    first, later = (decode(make(k), Estimate) for k in (1, 300_000))
    assert (first.src, first.dst, first.seq, later.seq) == ("r3", "r1", 1, 300_000)
    assert first.gossip is None or first.gossip != later.gossip
    if kind == "heartbeat":
        return
    many = later.gossip.samples if kind == "samples" else later.gossip.entries
    assert len(many) == MANY
    assert {item.origin for item in many} == set(fleet.robot)
    if kind != "epochs":
        before = first.gossip.samples if kind == "samples" else first.gossip.entries
        assert not set(many) & set(before)  # all of it is news


@pytest.mark.parametrize(("kind", "refused"), [("random", "garbage"), ("stuffed", "content")])
def test_as_long_as_may_be_and_no_message(fleet: Fleet, kind: str, refused: str) -> None:
    make = kinds(fleet, "r3", "r1")[kind]
    assert len(make(1)) == MAX_PAYLOAD
    with pytest.raises(Refusal) as caught:
        decode(make(1), Estimate)
    assert caught.value.kind == refused
    assert make(1) != make(2)
