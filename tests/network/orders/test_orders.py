"""Orders over real sessions: kept until the loop takes them, answered once, and nobody waits in vain."""

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace

from agent.clock import machine
from agent.core import topics
from agent.core.codec import decode, encode, encoding
from agent.core.config import Access, ConfigError, Fleet, dump
from agent.core.messages import MAX_ORDER, Answer, Order
from agent.core.topics import ANSWER
from agent.ground.console import OrderConsole, _Asked, give, typed, verdict
from agent.process.links import ALL_WAITING, WAITING
from agent.process.transport import Observer
from router_config.settings import observer_config
from tests.killing import killed_after
from tests.network.orders.answering import Loop
from tests.network.secured.parties import client
from tests.places import ROOT
from tests.waiting import until

PAIR = {"r1": ("r2",), "r2": ("r1",)}
SLOW_S = 30.0  # of the wall: a machine may be busy


@pytest.fixture
def loops(make_fleet: Callable[..., Fleet]) -> Iterator[dict[str, Loop]]:
    fleet = make_fleet(PAIR)
    loops = {name: Loop(fleet, name) for name in fleet.robot}
    with contextlib.ExitStack() as stack:
        for loop in loops.values():
            stack.enter_context(loop.transport)
            loop.start()
        yield loops
        for loop in loops.values():
            loop.ends.set()
            loop.join()


def fleet_of(loops: dict[str, Loop]) -> Fleet:
    return loops["r1"].transport._fleet


@contextlib.contextmanager
def console(loops: dict[str, Loop], name: str = "ann") -> Iterator[OrderConsole]:
    """One that hears both."""
    with OrderConsole(fleet_of(loops), name) as console:
        until(lambda: len(console.states()) == len(loops))
        yield console


@contextlib.contextmanager
def stranger(fleet: Fleet) -> Iterator[zenoh.Session]:
    """A session of somebody's own program, linked to all, which knows that all take orders."""
    with zenoh.open(zenoh.Config.from_json5(observer_config(fleet))) as session:
        until(lambda: len(list(session.info.peers_zid())) == len(fleet.robot))
        for name in fleet.robot:  # a question before a robot has said so would go to nobody
            querier = session.declare_querier(order_key(name))
            until(lambda querier=querier: querier.matching_status.matching)
            querier.undeclare()
        yield session


def ask(session: zenoh.Session, key: str, payload: bytes, kind: str = encoding(Order), timeout_s: float = 5.0) -> list:
    return list(
        session.get(
            key,
            payload=payload,
            encoding=kind,
            timeout=timeout_s,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
    )


def order_key(robot: str, console: str = "ann") -> str:
    return topics.ORDER.format(fleet="test", robot=robot, console=console)


STOP = encode(Order(id=1, verb="stop"))


def test_all_answer_and_the_order_says_which_state_was_seen(loops) -> None:
    with console(loops) as ann:
        outcomes = ann.order(["r1", "r2"], "hold", {"depth_m": 0.2})
        assert all(outcome.ok for outcome in outcomes.values()) and set(outcomes) == {"r1", "r2"}
        assert all(outcome.answer.robot == name for name, outcome in outcomes.items())
        for loop in loops.values():
            (ordered,) = loop.taken
            order = decode(ordered.payload, Order)
            assert ordered.console == "ann" and (order.verb, order.args) == ("hold", {"depth_m": 0.2})
            assert order.seen[0] == 1 and abs(order.seen[1] - ordered.arrived_ns) < 5e9
        again = ann.order(["r1"], "stop")
        assert again["r1"].answer.id > outcomes["r1"].answer.id


def test_an_order_goes_by_the_state_that_a_person_saw_however_late_it_leaves(loops) -> None:
    looked_at = (1, 5)
    with console(loops) as ann:
        list(ann.orders(["r1"], "hold", {"depth_m": 0.2}, seen={"r1": looked_at}))
        (ordered,) = loops["r1"].taken
        assert decode(ordered.payload, Order).seen == looked_at
    asked = _Asked()
    assert asked.begin(0.0, (1, 7)) and asked.seen == (1, 7)
    asked.over(0.1)
    assert asked.begin(0.5, (1, 8)) and asked.seen == (1, 7), "asked again, it is the order that it was"


def test_what_a_computer_slept_over_is_not_asked(loops, monkeypatch: pytest.MonkeyPatch) -> None:
    with console(loops) as ann:
        clock = iter([0.0])
        monkeypatch.setattr(machine, "since_boot_s", lambda: next(clock, 10.0))
        outcomes = ann.order(["r1"], "hold", {"depth_m": 0.2})
        assert outcomes["r1"].answer is None and "was told nothing: order again" in outcomes["r1"].why
    assert loops["r1"].taken == []


def test_one_that_hangs_is_named_and_holds_up_nobody(loops) -> None:
    loops["r2"].works.clear()
    with console(loops) as ann:
        start_s = time.monotonic()
        outcomes = ann.order(["r1", "r2"], "stop")
        assert time.monotonic() - start_s < SLOW_S
        assert outcomes["r1"].ok
        assert outcomes["r2"].answer is None and "did not answer within 1 s" in outcomes["r2"].why
        loops["r2"].works.set()
        until(lambda: loops["r2"].taken)  # it may still act: whoever wakes stops


def test_of_two_agents_of_one_name_one_was_told_nothing(loops) -> None:
    loops["r1"].faults = ("two agents: two linked to us are called r2; end one",)
    with console(loops) as ann:
        until(lambda: ann.states()["r1"].faults)
        outcomes = ann.order(["r2"], "stop")
    assert verdict(outcomes) == "1 of 2"
    assert outcomes["another r2"].why == "two agents are called r2, and one was told nothing; end one"


def test_one_that_is_not_there_is_named(loops) -> None:
    fleet = fleet_of(loops)
    with_third = replace(fleet, robot={**fleet.robot, "r3": replace(fleet.robot["r1"], listen="tcp/127.0.0.1:29499")})
    with OrderConsole(with_third, "ann") as ann:
        outcomes = ann.order(["r3"], "stop", heard_s=0.3)
        assert "was not heard in 0.3 s, and was told nothing" in outcomes["r3"].why


@pytest.mark.parametrize("verb", ["stop", "resume"])
def test_an_order_to_all_says_whom_the_fleet_file_lacks(loops, verb: str, tmp_path: Path) -> None:
    """It is told nothing: no link leads there."""
    loops["r1"].hears = ("r2",)
    alone = replace(fleet_of(loops), robot={"r1": replace(fleet_of(loops).robot["r1"], neighbours=())})
    order = typed(alone, tmp_path / "fleet.toml", verb, ["all"])
    outcomes = dict(give(alone, tmp_path / "fleet.toml", "ann", order))
    assert outcomes["r1"].ok and verdict(outcomes) == "1 of 2"
    assert outcomes["r2"].why.startswith("r1 hears it, and this fleet file lacks it: it was told nothing; order by")
    assert list(dict(give(alone, tmp_path / "fleet.toml", "ann", order._replace(everybody=False)))) == ["r1"]


def test_a_stop_for_all_names_a_robot_that_no_file_of_those_that_are_heard_has(loops) -> None:
    loops["r1"].faults = (
        "another file: r3 of our fleet is linked to us, and is not in our file; give all robots one file",
    )
    with console(loops) as ann:
        until(lambda: ann.states()["r1"].faults)
        outcomes = dict(ann.orders(["r1", "r2"], "stop", everybody=True))
    assert verdict(outcomes) == "2 of 3"
    assert outcomes["r3"].why.startswith("r1 is linked to it, and this fleet file lacks it: it was told nothing")


def test_a_stop_for_all_goes_to_who_is_linked_and_not_in_the_file(loops) -> None:
    pair = fleet_of(loops).robot
    renamed = replace(fleet_of(loops), robot={"r1": pair["r1"], "r9": pair["r2"]})
    with OrderConsole(renamed, "ann") as ann:
        until(lambda: len(ann.states()) == 2)
        outcomes = dict(ann.orders(["r1", "r9"], "resume", heard_s=0.3, everybody=True))
        assert outcomes["r2"].why.startswith("it is heard, and this fleet file lacks it: it was told nothing")
        outcomes = dict(ann.orders(["r1", "r9"], "stop", heard_s=0.3, everybody=True))
        assert outcomes["r1"].ok and outcomes["r2"].ok and outcomes["r9"].answer is None
    assert [decode(ordered.payload, Order).verb for ordered in loops["r2"].taken] == ["stop"]


def test_a_stop_needs_no_state(loops) -> None:
    for loop in loops.values():
        loop.shows = False
    with OrderConsole(fleet_of(loops), "ann") as ann:
        outcomes = ann.order(["r1", "r2"], "stop", heard_s=SLOW_S)
        assert all(outcome.ok for outcome in outcomes.values())


def test_a_wildcard_reaches_all_and_each_answers_on_its_own_key(loops) -> None:
    with stranger(fleet_of(loops)) as session:
        replies = ask(session, order_key("*"), STOP)
    assert sorted(str(reply.ok.key_expr) for reply in replies) == [order_key("r1"), order_key("r2")]


def test_whoever_looks_sees_the_answer(loops) -> None:
    with Observer(fleet_of(loops), time.time_ns, (ANSWER,)) as observer, console(loops) as ann:
        seen: list = []

        def shown() -> set[str]:
            ann.order(["r1"], "stop")
            seen.extend(observer.drain())
            return {item.chunks["console"] for item in seen}

        assert until(shown) == {"ann"}
        assert decode(seen[0].payload, Answer).order == "stop"


def test_what_is_no_order_is_turned_away_at_once_and_counted(loops) -> None:
    with stranger(fleet_of(loops)) as session:
        for key, payload, kind, why in (
            (order_key("r1"), STOP, "text/plain", "order in a wrong encoding"),
            (order_key("r1"), bytes(MAX_ORDER + 1), encoding(Order), "order too large"),
            (order_key("r1", "Ann"), STOP, encoding(Order), "order of nobody"),
            (order_key("r1", "*"), STOP, encoding(Order), "order of nobody"),
        ):
            start_s = time.monotonic()
            replies = ask(session, key, payload, kind, SLOW_S)
            assert [bytes(reply.err.payload).decode() for reply in replies] == [why]
            assert time.monotonic() - start_s < SLOW_S / 2
            refused = {row.reason: row.count for row in loops["r1"].transport.drain()[1]}
            assert refused == {why: 1}
    assert loops["r1"].taken == []


def test_a_console_cannot_fill_the_robot(loops) -> None:
    loops["r1"].works.clear()
    errors: list[str] = []
    over = threading.Semaphore(0)
    with stranger(fleet_of(loops)) as session:
        for i in range(WAITING + 4):
            session.get(
                order_key("r1"),
                zenoh.handlers.Callback(
                    lambda reply: errors.append(bytes(reply.err.payload).decode()) if reply.err else None,
                    over.release,
                    indirect=False,
                ),
                payload=encode(Order(id=i, verb="stop")),
                encoding=encoding(Order),
                timeout=SLOW_S,
            )
        until(lambda: len(errors) >= 4, what=lambda: errors)
        assert errors == 4 * ["too many orders at once"]
        assert ask(session, order_key("r1", "bob"), encode(Order(id=1, verb="clock")))[0].ok  # others are heard
        loops["r1"].works.set()
        for _ in range(WAITING + 4):
            assert over.acquire(timeout=SLOW_S)  # and all are let go
    assert len(loops["r1"].taken) == WAITING


def test_a_flood_under_many_names_takes_no_place_of_a_stop(loops) -> None:
    loops["r1"].works.clear()
    refused = threading.Semaphore(0)
    with stranger(fleet_of(loops)) as session:
        for i in range(6 * WAITING):
            session.get(
                order_key("r1", f"c{i % 6}"),
                zenoh.handlers.Callback(
                    lambda reply: refused.release() if reply.err else None, lambda: None, indirect=False
                ),
                payload=encode(Order(id=i, verb="resume")),
                encoding=encoding(Order),
                timeout=SLOW_S,
            )
        for _ in range(6 * WAITING - ALL_WAITING):
            assert refused.acquire(timeout=SLOW_S)
        # The other five names stop, too: each has places of its own.
        asked = [
            threading.Thread(target=lambda i=i: stopped.extend(ask(session, order_key("r1", f"c{i}"), STOP)))
            for i in range(6)
        ]
        stopped: list = []
        for thread in asked:
            thread.start()
        until(lambda: len(loops["r1"].transport._box._urgent) == 6)
        loops["r1"].works.set()
        for thread in asked:
            thread.join()
    assert len(stopped) == 6 and all(reply.ok for reply in stopped)
    verbs = [decode(ordered.payload, Order).verb for ordered in loops["r1"].taken]
    assert verbs == ["stop"] * 6 + ["resume"] * ALL_WAITING


@pytest.mark.parametrize(
    ("key", "robot", "off"), [("r2", "r1", 0), ("r2", "r2", 1), ("*", "r2", 0)], ids=["robot", "id", "key"]
)
def test_who_answers_in_anothers_place_is_not_believed(loops, key: str, robot: str, off: int) -> None:
    """A client of r1, while r2 hangs."""
    loops["r2"].works.clear()
    told = threading.Event()

    def lies(query: zenoh.Query) -> None:
        order = decode(query.payload.to_bytes(), Order)
        answer = Answer(robot=robot, console="ann", id=order.id + off, order="stop", ok=True, arrived_ns=1, sent_ns=2)
        query.reply(order_key(key), encode(answer), encoding=encoding(Answer))
        query.drop()
        told.set()

    with console(loops) as ann, zenoh.open(client(fleet_of(loops).robot["r1"].listen, None)) as liar:
        liar.declare_queryable(order_key("r2", "*"), zenoh.handlers.Callback(lies, indirect=False))

        def lied() -> bool:
            assert (outcome := ann.order(["r2"], "stop", answer_s=0.3)["r2"]).answer is None, outcome
            return told.is_set()

        until(lied)


def test_a_step_that_breaks_leaves_nobody_waiting(loops) -> None:
    """The next step drops the queries of the one before."""
    loops["r1"].works.clear()
    with stranger(fleet_of(loops)) as session:
        asked = threading.Thread(target=lambda: replies.extend(ask(session, order_key("r1"), STOP, timeout_s=SLOW_S)))
        replies: list = []
        start_s = time.monotonic()
        asked.start()
        assert until(loops["r1"].transport.orders)
        loops["r1"].transport.orders()
        asked.join()
        assert replies == [] and time.monotonic() - start_s < SLOW_S / 2


def test_what_time_it_is_needs_no_step(loops) -> None:
    for loop in loops.values():
        loop.works.clear()
    with console(loops) as ann:
        before_ns = time.time_ns()
        outcomes = ann.order(["r1", "r2"], "clock")
        for outcome in outcomes.values():
            assert outcome.ok
            assert before_ns <= outcome.answer.arrived_ns <= outcome.answer.sent_ns <= time.time_ns()


@pytest.mark.parametrize(
    ("listen", "consoles", "why"),
    [("tcp/192.168.7.11:17401", (), "secure the fleet"), ("tcp/127.0.0.1:17401", ("bob",), "names bob")],
)
def test_a_console_that_may_not_order_does_not_even_try(make_fleet, listen: str, consoles, why: str) -> None:
    fleet = make_fleet({"r1": ()})
    fleet = replace(fleet, robot={"r1": replace(fleet.robot["r1"], listen=listen)}, access=Access(consoles=consoles))
    with pytest.raises(ConfigError, match=why), OrderConsole(fleet, "ann"):
        pass


# --- hung robot ---
# Three robots as processes, of which one hangs: the others answer at once, it is named, and stops when it wakes.

FULL = {"r1": ("r2", "r3"), "r2": ("r1", "r3"), "r3": ("r1", "r2")}
PATIENCE_S = 120.0


@pytest.mark.slow
def test_a_stop_for_all_reaches_those_that_run(make_fleet, tmp_path: Path) -> None:
    fleet = make_fleet(FULL)
    own = {name: replace(r, serial=f"/dev/{name}", camera=f"v4l2:/dev/{name}") for name, r in fleet.robot.items()}
    fleet, path = replace(fleet, robot=own), tmp_path / "fleet.toml"  # on the system's clock: none waits for another
    path.write_text(dump(fleet))
    processes: dict[str, subprocess.Popen[bytes]] = {}
    with (
        killed_after(processes),
        OrderConsole(fleet, "ann") as ann,
        Observer(fleet, time.time_ns, (ANSWER,)) as observer,
    ):
        for name in fleet.robot:
            command = [sys.executable, "-m", "tests.network.scripted_agent", str(path), name, str(tmp_path)]
            processes[name] = subprocess.Popen(command, cwd=ROOT)
        until(lambda: len(ann.states()) == 3, PATIENCE_S)
        until(lambda: all(outcome.ok for outcome in ann.order(FULL, "stop").values()), PATIENCE_S)
        processes["r2"].send_signal(signal.SIGSTOP)
        outcomes = ann.order(FULL, "stop")
        assert outcomes["r1"].ok and outcomes["r3"].ok
        assert outcomes["r2"].answer is None and "did not answer within 1 s" in outcomes["r2"].why
        assert max(outcomes["r1"].took_s, outcomes["r3"].took_s) < outcomes["r2"].took_s
        observer.drain()
        processes["r2"].send_signal(signal.SIGCONT)
        woken: list[str] = []

        def answered() -> bool:
            woken.extend(item.chunks["robot"] for item in observer.drain())
            return "r2" in woken

        until(answered, PATIENCE_S)
        for process in processes.values():
            process.terminate()
            assert process.wait(PATIENCE_S) == 0
