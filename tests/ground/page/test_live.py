"""What a page asks for, and what becomes of it: orders through whoever gives them, a recording of its own."""

import asyncio
import json
import threading
from threading import Event

import pytest

from agent.clock.clock import SystemClock
from agent.core.codec import Refusal
from agent.core.config import ConfigError
from agent.core.topics import KEYFRAME, LINK, LOG, STATE
from agent.ground.console import OrderConsole
from agent.ground.page.live import UNDER_WAY, Live, Recording, Reply, give
from agent.ground.page.rows import Board
from agent.process.transport import Received
from tests.ground.page.shown import FLEET, NOW_NS, keyframe, log, row, state
from tests.sample_messages import estimate
from tests.waiting import until

STOP = {"order": {"robots": ["r1", "r2"], "verb": "stop"}}


def lines(board: Board) -> list[dict]:
    """What a page that is opened now is told in lines."""
    viewer = board.join()
    board.leave(viewer)
    return [line for message in map(json.loads, board.next_for(viewer)) for line in message.get("lines", ())]


async def given(live: Live) -> None:
    """All orders that are under way."""
    await asyncio.gather(*(task for tasks in live._under_way.values() for task in tasks))


def heard(live: Live, *messages: dict) -> None:
    """What pages say, until all of it is done."""

    async def say() -> None:
        for message in messages:
            await live.heard(message)
        await given(live)
        await asyncio.sleep(0)

    asyncio.run(say())


def test_an_order_is_given_and_every_robot_is_accounted_for() -> None:
    board, given = Board(), []

    def gives(*order):
        given.append(order)
        yield Reply("r1", True, "", "17")
        yield Reply("r2", None, "did not answer within 1 s; the order may still act", "")

    wish = {"robots": ["r1", "r2"], "verb": "hold", "args": {"depth_m": 0.3}, "seen": {"r1": ["5", str(NOW_NS)]}}
    heard(Live(FLEET, board, SystemClock(), gives), {"order": wish})
    assert given == [(["r1", "r2"], "hold", {"depth_m": 0.3}, {"r1": (5, NOW_NS)})]
    order, first, second = lines(board)
    assert (order["k"], order["verb"], order["asked"]) == ("order", "hold", ["r1", "r2"])
    assert (first["n"], first["robot"], first["ok"], first["id"]) == (order["n"], "r1", True, "17")
    assert (second["robot"], second["ok"]) == ("r2", None) and "did not answer" in second["why"]
    assert order["at_ms"] <= first["at_ms"] <= second["at_ms"], "a page tells by it what has changed since"


def test_what_cannot_be_ordered_is_said() -> None:
    board = Board()

    def refuses(*order):
        raise Refusal("content", "no verb 'fly'")
        yield

    heard(Live(FLEET, board, SystemClock(), refuses), STOP)
    assert lines(board)[1]["trouble"] == "no verb 'fly'"


@pytest.mark.parametrize(
    "nonsense",
    [
        {"order": 7},
        {"order": {"robots": ["r9"], "verb": "stop"}},
        {"order": {"robots": [], "verb": "stop"}},
        {"order": {"robots": ["r1"]}},
        {"order": {"robots": ["r1"], "verb": "stop", "seen": {"r1": ["x", "y"]}}},
        {"order": {"robots": ["r1"], "verb": "stop", "args": {"a": [1]}}},
        {"record": "yes"},
        {},
    ],
)
def test_what_no_page_of_ours_says_is_passed_over(nonsense) -> None:
    board = Board()

    def never(*order):
        raise AssertionError(order)

    heard(Live(FLEET, board, SystemClock(), never), nonsense)
    assert lines(board) == []


def test_who_only_looks_orders_nothing() -> None:
    board = Board()
    heard(Live(FLEET, board, SystemClock()), STOP, {"record": True})
    assert lines(board) == []


def test_orders_that_wait_are_limited_and_a_stop_does_not_wait_for_them() -> None:
    board, go, stops = Board(), threading.Event(), []

    def waits(robots, verb, args, seen):
        if verb == "stop":
            stops.append(verb)
        else:
            go.wait(30)
        yield Reply("r1", True, "", "1")

    live = Live(FLEET, board, SystemClock(), waits)

    async def floods() -> None:
        for _ in range(UNDER_WAY + 5):
            await live.heard({"order": {"robots": ["r1"], "verb": "clock"}})
        await live.heard(STOP)
        while not stops:
            await asyncio.sleep(0.01)
        go.set()
        await given(live)

    asyncio.run(floods())
    verbs = [line["verb"] for line in lines(board) if line["k"] == "order"]
    assert verbs == ["clock"] * UNDER_WAY + ["stop"]


@pytest.mark.parametrize("value", [2**63, 10**20, -(10**30)])
def test_a_number_that_no_message_holds_has_an_outcome(value: int) -> None:
    board = Board()

    def gives(robots, verb, args, seen):
        with OrderConsole(FLEET, "ann") as console:
            yield from give(console, robots, verb, args, seen)

    for verb, name in (("hold", "depth_m"), ("target_box", "frame")):
        heard(
            Live(FLEET, board, SystemClock(), gives), {"order": {"robots": ["r1"], "verb": verb, "args": {name: value}}}
        )
        assert "more than 64 bits" in lines(board)[-1]["trouble"]


class Console:
    """Has heard r1's newest state, and notes what is ordered."""

    def __init__(self, newest) -> None:
        self.given: list[str] = []
        self._newest = newest
        self.robots, self.everybody, self.seen = frozenset({"r1", "r2"}), False, {}

    def states(self):
        return {"r1": self._newest}

    def orders(self, robots, verb, args, everybody, seen):
        self.given.append(verb)
        self.everybody, self.seen = everybody, seen
        return iter(())


def test_an_order_by_a_page_that_was_frozen_does_not_go_out_but_a_stop_does() -> None:
    console = Console(state(sent_ns=NOW_NS + 4_000_000_000))
    looked_at = {"r1": (NOW_NS - 5, NOW_NS)}
    with pytest.raises(Refusal, match="r1 as it was seconds ago"):
        list(give(console, ["r1"], "arm", {}, looked_at))
    assert console.given == []
    list(give(console, ["r1"], "stop", {}, looked_at))
    list(give(console, ["r1"], "arm", {}, {"r1": (NOW_NS - 5, NOW_NS + 2_000_000_000)}))
    assert console.given == ["stop", "arm"]
    assert console.seen == {"r1": (NOW_NS - 5, NOW_NS + 2_000_000_000)}, "the robot, too, goes by what the page showed"
    with pytest.raises(Refusal):  # it has started again meanwhile
        list(give(console, ["r1"], "arm", {}, {"r1": (NOW_NS - 99, NOW_NS + 4_000_000_000)}))


def test_a_stop_for_all_of_the_page_is_for_all_that_there_are() -> None:
    console = Console(state())
    for robots, verb, everybody in (
        (["r1"], "stop", False),
        (["r1", "r2"], "stop", True),
        (["r1", "r2"], "arm", False),
    ):
        list(give(console, robots, verb, {}, {}))
        assert console.everybody is everybody


class Observer:
    def __init__(self, *received) -> None:
        self._received = list(received)

    def drain(self):
        found, self._received = self._received, []
        return found


def test_what_arrives_is_shown_and_what_is_none_is_counted() -> None:
    board, stop, said = Board(), Event(), estimate("r1", "r2", fleet="test")
    arrived = [
        Received(*row(state(), STATE, robot="r1", target="ball"), 1),
        Received(*row(log(), LOG, robot="r1"), 2),
        Received(LOG, {"fleet": "test", "robot": "r1"}, b"garbage", 3),
        Received(*row(said, LINK, src="r1", dst="r2", target="ball"), 1_000_000_000),
        Received(*row(said, LINK, src="r1", dst="r2", target="ball"), 1_100_000_000),
    ]
    live = Live(FLEET, board, SystemClock())

    async def runs() -> None:
        running = asyncio.create_task(live.run(Observer(*arrived), stop))
        await asyncio.sleep(0.05)
        stop.set()
        await running

    asyncio.run(runs())
    shown = {message["k"]: message for message in map(json.loads, board.next_for(board.join()))}
    assert shown["state/r1/ball"]["arrived_ms"] == pytest.approx(1e-6), "however late a page asks for it"
    assert set(shown) == {"state/r1/ball", "link/r1/ball", "clock", "lines"} and board.refused == 1


def test_a_recording_is_begun_ended_and_its_trouble_is_told(tmp_path) -> None:
    began = threading.Event()

    def records(file, stop) -> None:
        file.write_bytes(b"so far")
        began.set()
        stop.wait(30)

    recording = Recording(records, tmp_path, "test")
    assert recording.note() == {"on": False, "file": "", "trouble": ""}
    recording.start()
    recording.start()  # twice is once
    assert began.wait(30) and recording.note()["on"]
    recording.stop()
    until(lambda: not recording.note()["on"])
    first = recording.note()["file"]
    assert recording.note() == {"on": False, "file": first, "trouble": ""}
    recording.start()
    recording.close()
    assert recording.note()["file"] != first and len(list(tmp_path.iterdir())) == 2

    def fails(file, stop) -> None:
        raise ConfigError("the disk is full")

    failing = Recording(fails, tmp_path, "test")
    failing.start()
    failing.close()
    assert failing.note()["trouble"] == "the disk is full"


def test_what_a_sweep_showed_is_shown_when_it_is_first_told_and_once() -> None:
    board = Board()
    live, viewer = Live(FLEET, board, SystemClock()), board.join()
    taken = []
    for k, src in enumerate(("r1", "r2", "r1")):  # r2 passes it on
        live._take(Received(*row(keyframe(src), KEYFRAME, src=src, dst="r2"), NOW_NS + k))
        shown = [json.loads(message)["k"] for message in board.next_for(viewer)]
        viewer.got(shown)
        taken.append(shown)
    assert taken == [["surface/r1/7/3"], [], []]
