"""Who looks at a fleet: observers and routers see what they ask for, and no robot hears of them. On the wall."""

import contextlib
import threading
import time
from collections.abc import Callable

import pytest
import zenoh

import replay.recorder
from agent.core import topics
from agent.core.codec import decode
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Estimate, LogLine, State
from agent.core.topics import STATE
from agent.process.launch import run_router
from agent.process.transport import Observer, Transport
from router_config.settings import peer_config
from tests.waiting import until

Fleets = Callable[..., Fleet]
Says = Callable[..., Estimate]
Shows = Callable[..., State]


def test_an_observer_sees_all_and_is_heard_by_nobody(make_fleet: Fleets, estimate: Says, state: Shows) -> None:
    fleet = make_fleet({"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)})
    line = LogLine(robot="r3", sent_ns=1, level="info", text="here")
    with (
        Observer(fleet, time.time_ns) as watch,
        Transport(fleet, "r1", time.time_ns) as r1,
        Transport(fleet, "r2", time.time_ns) as r2,
        Transport(fleet, "r3", time.time_ns) as r3,
    ):
        seen = set()

        def complete() -> bool:
            r1.show(state("r1"))
            r3.show(line)
            r2.say(estimate("r2", "r3"))
            for topic, chunks, payload, arrived_ns in watch.drain():
                decode(payload, topic.message)
                assert arrived_ns > 1
                seen.add((topic.name, *chunks.values()))
            return len(seen) == 3

        until(complete)
        assert seen == {("state", "test", "r1"), ("log", "test", "r3"), ("link", "test", "r2", "r3")}
        assert r1.drain() == ((), ())


def test_an_observer_hears_the_rows_it_asked_for(make_fleet: Fleets, estimate: Says, state: Shows) -> None:
    fleet = make_fleet({"r1": ("r2",), "r2": ("r1",)})
    with (
        Transport(fleet, "r1", time.time_ns) as r1,
        Transport(fleet, "r2", time.time_ns),
        Observer(fleet, time.time_ns, rows=(STATE,)) as watch,
    ):
        seen = []

        def enough() -> bool:
            r1.say(estimate("r1", "r2"))
            r1.show(state("r1"))
            seen.extend(watch.drain())
            return len(seen) > 5

        until(enough)
        assert {item.topic for item in seen} == {STATE}


def console_config(endpoint: str) -> zenoh.Config:
    """As `zenoh --mode client --connect ENDPOINT`."""
    return zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"], timeout_ms: 60000}}}}')


def test_a_console_at_a_robot_sees_it_and_its_neighbours_and_nobody_else(
    make_fleet: Fleets, estimate: Says, state: Shows
) -> None:
    fleet = make_fleet({"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2", "r4"), "r4": ("r3",)})
    with contextlib.ExitStack() as stack:
        agents = {name: stack.enter_context(Transport(fleet, name, time.time_ns)) for name in fleet.robot}
        console = stack.enter_context(zenoh.open(console_config(fleet.robot["r2"].listen)))
        seen = console.declare_subscriber(topics.EVERY_FLEET, zenoh.handlers.RingChannel(1000))
        states, links = set(), set()

        def all_seen() -> bool:
            for name, agent in agents.items():
                agent.show(state(name))
                for neighbour in fleet.robot[name].neighbours:
                    agent.say(estimate(name, neighbour))
            while sample := seen.try_recv():
                topic, chunks = topics.match(str(sample.key_expr))
                (states if topic is STATE else links).add(chunks.get("robot") or (chunks["src"], chunks["dst"]))
            return states >= {"r1", "r2", "r3"} and len(links) >= 5

        until(all_seen, what=lambda: (states, links))
        assert states == {"r1", "r2", "r3"}  # those that are linked to r2, which forwards nothing for r4
        assert links == {("r1", "r2"), ("r2", "r1"), ("r2", "r3"), ("r3", "r2"), ("r3", "r4")}


def test_a_router_shows_all_and_joins_nobody(
    make_fleet: Fleets, estimate: Says, state: Shows, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay.recorder, "SILENCE_S", 0.0)
    fleet = make_fleet({"r1": (), "r2": ()})  # no link between them
    stop, endpoint, said = threading.Event(), f"tcp/127.0.0.1:{free_port}", []
    router = threading.Thread(target=run_router, args=(fleet, stop, endpoint, said.append))
    client = console_config(endpoint)
    with contextlib.ExitStack() as stack:
        r1 = stack.enter_context(Transport(fleet, "r1", time.time_ns))
        r2 = stack.enter_context(zenoh.open(zenoh.Config.from_json5(peer_config(fleet, "r2"))))
        foreign = r2.declare_subscriber(topics.ALL.format(fleet="test"), zenoh.handlers.RingChannel(10))
        router.start()
        stack.callback(router.join, 60)
        stack.callback(stop.set)
        console = stack.enter_context(zenoh.open(client))
        seen = console.declare_subscriber(topics.EVERY_FLEET, zenoh.handlers.RingChannel(100))
        keys = set()

        def both() -> bool:
            r1.show(state("r1"))
            r2.put(topics.key(STATE, fleet="test", robot="r2"), b"")
            while sample := seen.try_recv():
                keys.add(str(sample.key_expr))
            return len(keys) == 2

        until(both)
        until(lambda: any("heard yet: r2 at tcp/" in line or "not heard: r2 at tcp/" in line for line in said))
        with pytest.raises(ConfigError, match=f"--listen {endpoint}: the address is in use"):
            run_router(fleet, stop, endpoint)
        heard = foreign.try_recv()
        while heard is not None:
            assert "r1" not in str(heard.key_expr)  # r2 hears itself, and the router brought nothing from r1
            heard = foreign.try_recv()
    assert not router.is_alive()
    assert said[-1].startswith("never heard: r2 at tcp/"), "it has a session, and no agent"
