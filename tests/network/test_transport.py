"""Links between robots: real sessions over TCP on this machine, several in one process. On the wall: links are its."""

import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Iterator

import msgspec
import pytest
import zenoh
from msgspec.structs import replace

from agent.core import topics
from agent.core.codec import decode, encode, encoding
from agent.core.config import ConfigError, Fleet, Navigation
from agent.core.messages import MAX_PAYLOAD, Estimate, Presence, State
from agent.core.step_io import Heard, Said
from agent.core.topics import LINK, NEAR
from agent.process.transport import Transport
from router_config.settings import peer_config
from tests.sample_messages import presence
from tests.waiting import until

PAIR = {"r1": ("r2",), "r2": ("r1",)}
CHAIN = {"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)}
FULL = {"r1": ("r2", "r3"), "r2": ("r1", "r3"), "r3": ("r1", "r2")}

Fleets = Callable[..., Fleet]
Says = Callable[..., Estimate]


class Ear:
    """Collects what a transport hands out over several drains."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.heard: list[Heard] = []
        self.refused: dict[str, int] = {}

    def listen(self) -> "Ear":
        heard, refused = self.transport.drain()
        self.heard += heard
        for row in refused:
            self.refused[row.reason] = self.refused.get(row.reason, 0) + row.count
        return self


@contextlib.contextmanager
def all_up(fleet: Fleet, *names: str) -> Iterator[list[Transport]]:
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(Transport(fleet, name, time.time_ns)) for name in names]


def linked(estimate: Says, a: Transport, b: Transport, src: str, dst: str) -> None:
    """Wait until b hears a, and has heard all that a said."""
    said, heard = itertools.count(1), [0]

    def newest() -> int:
        heard.extend(decode(item.payload, Estimate).seq for item in b.drain()[0] if item.src == src)
        return max(heard)

    def hears() -> bool:
        a.say(estimate(src, dst, next(said)))
        return newest() > 0

    until(hears)
    last = next(said)
    a.say(estimate(src, dst, last))
    until(lambda: newest() == last)


def test_only_the_addressed_neighbour_hears(make_fleet: Fleets, estimate: Says) -> None:
    with all_up(make_fleet(FULL), "r1", "r2", "r3") as (r1, r2, r3):
        linked(estimate, r1, r2, "r1", "r2")
        linked(estimate, r1, r3, "r1", "r3")
        before_ns = time.time_ns()
        said = [estimate("r1", "r2", seq) for seq in range(20)]
        ear = Ear(r2)
        for count, message in enumerate(said, start=1):
            r1.say(message)
            until(lambda count=count: len(ear.listen().heard) == count)
        assert [decode(heard.payload, Estimate) for heard in ear.heard] == said
        assert all(heard.src == "r1" for heard in ear.heard)
        assert all(before_ns <= heard.arrived_ns <= time.time_ns() for heard in ear.heard)
        assert Ear(r3).listen().heard == []
        assert ear.refused == {}


def test_robots_that_swim_hear_where_others_are_but_for_what_is_lost(make_fleet: Fleets) -> None:
    fleet, said = replace(make_fleet(PAIR, loss=0.3), navigation=Navigation()), itertools.count()
    with all_up(fleet, "r1", "r2") as (r1, r2):
        ear = Ear(r2)

        def heard() -> int:
            message = presence("r1", "r2", fleet="test", seq=next(said))
            r1.say(Said(topic=NEAR.name, to="r2", payload=encode(message)))
            return len(ear.listen().heard)

        until(lambda: heard() > 20)
        assert {(item.src, item.topic) for item in ear.heard} == {("r1", "near")} and ear.refused == {}
        numbers = [decode(item.payload, Presence).seq for item in ear.heard]
        assert numbers == sorted(numbers)
        assert 0.1 < r1.lost / next(said) < 0.5


def test_a_link_that_is_not_in_the_fleet_file_does_not_exist(make_fleet: Fleets, estimate: Says) -> None:
    fleet = make_fleet(CHAIN)
    config = zenoh.Config.from_json5(peer_config(fleet, "r1"))
    with all_up(fleet, "r2", "r3") as (r2, r3), zenoh.open(config) as r1:
        linked(estimate, r2, r3, "r2", "r3")
        far, near = Ear(r3), Ear(r2)

        def say_to_both() -> bool:
            for dst in ("r3", "r2"):
                key = topics.key(LINK, fleet="test", src="r1", dst=dst)
                r1.put(key, encode(estimate("r1", dst)), encoding=encoding(Estimate))
            return len(near.listen().heard) > 3

        until(say_to_both)
        far.listen()
        assert (far.heard, far.refused) == ([], {})


def test_what_cannot_be_a_message_is_turned_away_and_counted(make_fleet: Fleets, estimate: Says) -> None:
    fleet = make_fleet(PAIR)
    config = zenoh.Config.from_json5(peer_config(fleet, "r1"))
    good = encode(estimate("r1", "r2"))
    key = topics.key(LINK, fleet="test", src="r1", dst="r2")
    block = zenoh.CongestionControl.BLOCK
    with Transport(fleet, "r2", time.time_ns) as r2, zenoh.open(config) as r1:
        ear = Ear(r2)

        def say() -> bool:
            r1.put(key, good, encoding=encoding(Estimate))
            return bool(ear.listen().heard)

        until(say)
        r1.put(key, bytes(60_000), encoding=encoding(Estimate), congestion_control=block)
        r1.put(key, bytes(MAX_PAYLOAD + 1), encoding=encoding(Estimate), congestion_control=block)
        r1.put(key, good, congestion_control=block)
        r1.put(key, good, encoding=encoding(State), congestion_control=block)
        r1.put(topics.key(LINK, fleet="test", src="r9", dst="r2"), good, encoding=encoding(Estimate))
        r1.put(topics.key(LINK, fleet="test", src="r2", dst="r2"), good, encoding=encoding(Estimate))
        r1.delete(key, congestion_control=block)
        until(lambda: sum(ear.listen().refused.values()) == 7)
        assert ear.refused == {"too large": 2, "wrong encoding": 2, "unknown sender": 2, "not a put": 1}
        heard = len(ear.heard)
        r1.put(key, bytes(MAX_PAYLOAD), encoding=encoding(Estimate))  # just small enough, and not ours to decode
        until(lambda: len(ear.listen().heard) > heard)
        assert len(ear.heard[-1].payload) == MAX_PAYLOAD


def test_loss_is_drawn_from_the_seed(make_fleet: Fleets, estimate: Says) -> None:
    def lost(loss: float, seed: int, robot: str = "r1") -> list[bool]:
        fleet = make_fleet(PAIR, loss=loss, loss_seed=seed)
        other = "r2" if robot == "r1" else "r1"
        with Transport(fleet, robot, time.time_ns) as transport:
            counts = []
            for seq in range(1000):
                transport.say(estimate(robot, other, seq))
                counts.append(transport.lost)
        return [b > a for a, b in zip([0, *counts], counts, strict=False)]

    first = lost(0.3, 5)
    assert 240 < sum(first) < 360  # 4 sigma around 300
    assert first == lost(0.3, 5)
    assert first != lost(0.3, 6)
    assert first != lost(0.3, 5, "r2")
    assert not any(lost(0.0, 5))


def test_a_neighbour_that_is_down_holds_up_nobody(make_fleet: Fleets, estimate: Says) -> None:
    started = time.monotonic()
    with Transport(make_fleet(FULL), "r1", time.time_ns) as r1:
        r1.say(estimate("r1", "r2"))
    assert time.monotonic() - started < 5  # waiting for the neighbour would be for ever


def test_a_neighbour_that_comes_late_or_again_is_linked(make_fleet: Fleets, estimate: Says) -> None:
    fleet = make_fleet(PAIR)
    with Transport(fleet, "r1", time.time_ns) as r1:
        time.sleep(0.3)  # r1 has long been up
        for _ in range(2):
            with Transport(fleet, "r2", time.time_ns) as r2:
                linked(estimate, r1, r2, "r1", "r2")
                linked(estimate, r2, r1, "r2", "r1")


def test_an_address_in_use_is_one_line(make_fleet: Fleets) -> None:
    fleet = make_fleet(PAIR)
    with Transport(fleet, "r1", time.time_ns):
        with pytest.raises(ConfigError) as caught, Transport(fleet, "r1", time.time_ns):
            pass
        text = str(caught.value)
        assert text.startswith(f"robot 'r1': {fleet.robot['r1'].listen}: the address is in use")
        assert "\n" not in text


def test_an_address_that_does_not_exist_is_one_line(make_fleet: Fleets) -> None:
    fleet = make_fleet(PAIR)
    fleet.robot["r1"] = msgspec.structs.replace(fleet.robot["r1"], listen="tcp/192.0.2.1:18000")
    with pytest.raises(ConfigError) as caught, Transport(fleet, "r1", time.time_ns):
        pass
    assert str(caught.value).startswith("robot 'r1': tcp/192.0.2.1:18000: no address of this computer")
    assert ".rs:" not in str(caught.value)


def test_leaving_under_a_flood_does_not_hang(make_fleet: Fleets, estimate: Says) -> None:
    fleet = make_fleet(PAIR)
    stop = threading.Event()
    with Transport(fleet, "r1", time.time_ns) as r1:

        def flood() -> None:
            while not stop.is_set():
                r1.say(estimate("r1", "r2"))

        thread = threading.Thread(target=flood)
        thread.start()
        try:
            for _ in range(5):
                with Transport(fleet, "r2", time.time_ns) as r2:
                    until(lambda r2=r2: r2.drain()[0])
        finally:
            stop.set()
            thread.join(60)
        assert not thread.is_alive()


def test_a_robot_is_listed_while_it_is_up(make_fleet: Fleets) -> None:
    fleet = make_fleet(PAIR)
    config = zenoh.Config.from_json5(peer_config(fleet, "r2"))
    key = topics.ALIVE.format(fleet="test", robot="*", session="*")
    with zenoh.open(config) as r2:

        def listed() -> list[str]:
            replies = [str(reply.ok.key_expr) for reply in r2.liveliness().get(key) if reply.ok]
            return [topics.chunks(topics.ALIVE, text)["robot"] for text in replies]

        with Transport(fleet, "r1", time.time_ns):
            until(lambda: listed() == ["r1"])
        until(lambda: listed() == [])
