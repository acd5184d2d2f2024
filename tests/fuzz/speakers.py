"""Whoever speaks to a running fleet, and to who looks at it: orders, answers, samples, a page, a ground station."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import msgpack
import msgspec
from msgspec import UNSET
from websockets.http11 import Request
from websockets.server import ServerProtocol

from agent.clock.clock import SystemClock
from agent.core import topics
from agent.core.codec import encode, encoding
from agent.core.config import Fleet
from agent.core.messages import Message, Order
from agent.core.step_io import Inputs
from agent.core.verbs import VERBS
from agent.ground.console import OrderConsole, _Asked, line
from agent.ground.doctor_facts import _ask_once, _Ears, _shown
from agent.ground.page.live import Live, Reply
from agent.ground.page.replayed import Replayed
from agent.ground.page.rows import Board
from agent.ground.page.server import Site
from agent.process.links import ALL_WAITING, Inboxes, OrderBox, Tokens
from agent.process.transport import Observer
from agent.robot.step import Agent
from hw.twin.calibration_bench import _answer
from replay.recorder import Arrivals
from router_config import session
from tests.fuzz.decoder import JSON, MSGPACK, Decoder
from tests.fuzz.kernel.swarm import Scene, fleet_of
from tests.fuzz.values import TEXTS, integer, of_type
from tests.network.scripted_agent import CALIBRATION

START_NS = 10**18
ME, CONSOLES = "r1", ("ann", "bob", "view", "r2", "", "*", "x" * 17)
TOKEN, PORT = "a-token", 8766


def decoders() -> tuple[Decoder, ...]:
    fleet = fleet_of(Scene())
    pages = Pages(fleet)
    return (
        # A payload is up to 90 steps of a robot, each a millisecond.
        Decoder("orders", partial(_orders, fleet), _sequence, MSGPACK, share=0.5, slow_s=1.0),
        Decoder("answers", partial(_answers, fleet), _replies, MSGPACK),
        Decoder("samples", partial(_samples, fleet), _keyed, MSGPACK),
        Decoder("sessions", lambda data: _shown([data]), _session, JSON),
        Decoder("page.http", partial(_http, pages), _request),
        Decoder("page.said", partial(_said, pages), _from_page, JSON),
        Decoder("bench", _bench, _bench_line, JSON),
        *((Decoder("mavlink", partial(_mavlink, fleet), _datagram),) if find_spec("pymavlink") else ()),
    )


def _listed(payload: bytes, width: int) -> list[list[Any]]:
    """The rows of a payload that is a list of such rows; else none."""
    try:
        rows = msgpack.unpackb(payload)
    except (ValueError, RecursionError, msgpack.UnpackException):
        return []
    rows = rows if isinstance(rows, list) else []
    return [row for row in rows if isinstance(row, list) and len(row) == width]


def _bytes(value: object) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode("utf-8", errors="replace")


def _text(value: object) -> str:
    """As Zenoh gives it: it lets no other text through."""
    return value.encode("utf-8", errors="replace").decode() if isinstance(value, str) else str(value)


# --- orders, one after the other, through the box into a robot -------------------------------------------------------


def ordered(rng: Random) -> bytes:
    """An order with about the right arguments."""
    verb = rng.choice(tuple(VERBS))
    args = {
        field.name: rng.choice((integer(rng), rng.uniform(-1.0, 2.0), "ball", "sweeps", True))
        for field in msgspec.structs.fields(VERBS[verb])
        if rng.random() < 0.9
    }
    return encode(Order(id=rng.randrange(100), verb=verb, args=args, seen=(1, 10**9)))


class Query:
    """What was asked, and what became of it."""

    def __init__(self, key: str, kind: str, payload: bytes) -> None:
        self.key, self.encoding, self._payload, self.size = key, kind, payload, len(payload)
        self.replies = self.dropped = 0

    def payload(self) -> bytes:
        return self._payload

    def reply(self, kind: type[Message], key: str, payload: bytes) -> None:
        assert len(payload) <= topics.ANSWER.limit, "an answer that nobody takes in"
        self.replies += 1

    def refuse(self, why: str) -> None:
        assert why.isprintable(), "breaks the line"
        self.replies += 1

    def drop(self) -> None:
        self.dropped += 1


def _sequence(rng: Random) -> bytes:
    """(console, order, milliseconds until the next) in turn; a robot makes a step every 50 ms."""
    consoles = rng.choices(CONSOLES, weights=(9, 9, 1, 1, 1, 1, 1), k=2)
    known = [ordered(rng) for _ in range(rng.choice((1, 5, 40)))]
    count = rng.choice((1, 3, 30, 200))
    return bytes(msgpack.packb([
        [rng.choice(consoles), rng.choice(known), rng.choice((0, 0, 0, 5, 60, 5000))] for _ in range(count)
    ]))  # fmt: skip


def _orders(fleet: Fleet, payload: bytes) -> None:
    agent, now_ns = Agent(fleet, ME, CALIBRATION, 1), 10**9
    box, asked = OrderBox(fleet, ME, lambda: now_ns), []
    for console, said, ms in _listed(payload, 3):
        key = topics.ORDER.format(fleet=fleet.fleet, robot=ME, console=_text(console))
        asked.append(Query(key, encoding(Order), _bytes(said)))
        box.asked(cast("session.Query", asked[-1]))
        assert max(len(box._urgent), len(box._others)) <= ALL_WAITING, "more than wait"
        if isinstance(ms, int) and ms > 0:
            now_ns = min(now_ns + ms * 10**6, 2**62)
            _step(agent, box, now_ns)
    _step(agent, box, now_ns)
    box.close()
    assert all(query.dropped == 1 for query in asked), "waits for ever"
    assert all(query.replies == 1 for query in asked), "no answer, or two"


def _step(agent: Agent, box: OrderBox, now_ns: int) -> None:
    taken = box.take()
    outputs = agent.step(Inputs(orders=taken or UNSET), now_ns)
    fault = agent.transaction.fault(now_ns)
    assert fault is None, f"{fault:.80}"
    answers = outputs.answers or ()
    assert len(answers) == len(taken), "orders without an answer"
    box.answer(answers)


# --- what answers an order of a person ------------------------------------------------------------------------------


class Answering:
    """A session in which anybody may answer."""

    def __init__(self, replies: list[session.Reply]) -> None:
        self._replies = replies

    def ask(
        self, kind: type, key: str, payload: bytes, within_s: float, replied: Callable[[session.Reply], None], over: Any
    ) -> None:
        for reply in self._replies:
            replied(reply)
        over()


def _replies(rng: Random) -> bytes:
    rows = []
    for _ in range(rng.randrange(1, 5)):
        key = topics.ORDER.format(fleet="tank", robot=rng.choice((ME, ME, "r2")), console="ann")
        words = rng.choice(("stop", "hold", *TEXTS))[:40]
        answer = {
            "schema": 2,
            "robot": rng.choice((ME, ME, "r2")),
            "console": "ann",
            "id": rng.choice((7, 7, 8)),
            "order": words,
            "ok": rng.random() < 0.5,
            "why": words,
            "arrived_ns": 5,
            "sent_ns": START_NS,
        }
        try:
            rows.append([key, msgpack.packb(answer), ""])
        except ValueError:  # a text that UTF-8 has not
            rows.append(["", b"", "Timeout"])
    return bytes(msgpack.packb(rows))


def _answers(fleet: Fleet, payload: bytes) -> None:
    replies = [session.Reply(_text(key), _bytes(data), _text(error)) for key, data, error in _listed(payload, 3)]
    console, asked = OrderConsole(fleet, "ann"), _Asked()
    console._session = cast("session.Session", Answering(replies))
    asked.begin(1.0, ())
    console._ask(ME, Order(id=7, verb="stop"), asked, 1.0)
    asked.give_up(9.0, 0.0, 1.0, 1.0)
    outcome = asked.outcome
    assert outcome is not None, "no end"
    assert outcome.answer is None or (outcome.answer.robot, outcome.answer.id) == (ME, 7), "another's answer"
    assert line(ME, outcome).isprintable(), "breaks the line"
    _ask_once(cast("session.Session", Answering(replies)), fleet, "ann", (ME, "r2"), lambda: 7)


# --- what arrives on keys: messages and tokens ----------------------------------------------------------------------


class Sample:
    """As the session hands it over."""

    def __init__(self, key: str, kind: str, is_put: bool, payload: bytes) -> None:
        self.key, self.encoding, self.is_put, self._payload, self.size = key, kind, is_put, payload, len(payload)

    def payload(self) -> bytes:
        return self._payload


def _keyed(rng: Random) -> bytes:
    """Tokens of agents that come and go, and messages on the keys that they belong to."""
    return bytes(msgpack.packb([_row(rng) for _ in range(rng.choice((1, 3, 20)))]))


def _row(rng: Random) -> list[Any]:
    def name() -> str:
        return rng.choice((ME, "r2", "r3", "stranger", "X" * 40, "\x1b[2J", "ann"))

    where = {"fleet": rng.choice(("tank", "tank", "pool")), "robot": name(), "src": name(), "dst": ME, "console": "ann"}
    pick = rng.random()
    if pick < 0.3:
        session_id = rng.choice(("1a", f"{rng.randrange(16**6):x}", "zz", "f" * 40))
        return [topics.ALIVE.format(**where, session=session_id), "", rng.random() < 0.7, b""]
    if pick < 0.4:
        return [topics.TWICE.format(**{**where, "robot": ME}, witness=name()), "", rng.random() < 0.7, b""]
    topic = rng.choice(topics.TOPICS)
    try:
        payload = msgpack.packb(of_type(topic.message, rng, rng.choice((0.0, 0.05))))
    except (OverflowError, ValueError):
        payload = b""
    kind = encoding(topic.message) if rng.random() < 0.9 else "text/plain"
    return [topics.key(topic, **where), kind, rng.random() < 0.95, payload]


def _samples(fleet: Fleet, payload: bytes) -> None:
    tokens, inboxes = Tokens(fleet, ME), Inboxes(fleet, ME)
    arrivals, ears = Arrivals(lambda: START_NS), _Ears(lambda: START_NS)
    console, observer = OrderConsole(fleet, "ann"), Observer(fleet, lambda: START_NS)
    announced: list[str] = []

    def announce(key: str) -> Callable[[], None]:
        announced.append(key)
        return lambda: None

    for k, (key, kind, is_put, data) in enumerate(_listed(payload, 4)):
        sample = cast("session.Sample", Sample(_text(key), _text(kind), bool(is_put), _bytes(data)))
        tokens.token(sample, 0.1 * k)
        inboxes.put(sample, START_NS)
        arrivals.stranger(sample)
        arrivals.token(sample)
        for topic in topics.TOPICS:
            if (row := topics.match(sample.key)) is not None and row[0] is topic:
                arrivals.message(topic, sample)
        ears.state(sample)
        ears.token(sample)
        console._heard(sample)
        console._token(sample)
        observer._arrived(sample)
    for now_s in (0.5, 100.0):
        for fault in tokens.faults("1a", announce, now_s):
            assert fault.isprintable() and len(fault) < 200, "no line"
    inboxes.drain(START_NS)
    ears.read()
    ears.missed()
    list(arrivals.drain())
    json.loads(arrivals.not_recorded())
    assert not arrivals.raised, f"{next(iter(arrivals.raised))}"
    for received in observer.drain():
        assert received.chunks, "nobody's"


def _session(rng: Random) -> bytes:
    """What a session says of itself and who is linked to it."""
    peers = [{"peer": f"{rng.randrange(16**8):x}", "links": []} for _ in range(rng.randrange(4))]
    return json.dumps({"zid": "1a", "metadata": {"robot": ME, "version": "1"}, "sessions": peers}).encode()


# --- a browser, or whoever else finds the port ---------------------------------------------------------------------


class Reel:
    """A recording of nothing."""

    times_ns = (START_NS, START_NS + 10**10)

    def __init__(self, fleet: Fleet) -> None:
        self.fleet = fleet

    def nothing(self, *about: Any) -> tuple[()]:
        return ()

    between = newest = lines = nothing


class Pages:
    """One page of a fleet and one of a recording, in a loop that runs for what arrives."""

    def __init__(self, fleet: Fleet) -> None:
        self.loop = asyncio.new_event_loop()
        self.given: list[tuple[list[str], str]] = []
        self.board, self.replayed_board = Board(), Board()
        self.live = Live(fleet, self.board, SystemClock(), self._give)
        self.replayed = Replayed(cast(Any, Reel(fleet)), self.replayed_board)
        self.sites = (
            Site(self.board, self.live.heard, PORT, TOKEN),
            Site(self.replayed_board, self.replayed.heard, PORT, TOKEN),
        )

    def _give(self, robots: list[str], verb: str, args: Any, seen: Any) -> Any:
        self.given.append((robots, verb))
        yield from (Reply(robot, True, "", "1") for robot in robots)


def _request(rng: Random) -> bytes:
    path = rng.choice(("/", f"/ws?token={TOKEN}", f"/ws?token={TOKEN}", "/ws", "/x", "//[", "/ws?token=%ff", "*"))
    host = rng.choice((f"127.0.0.1:{PORT}", f"127.0.0.1:{PORT}", f"localhost:{PORT}", "evil.example", "["))
    head = {
        "Host": host,
        "Origin": f"http://127.0.0.1:{PORT}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version": "13",
    }
    lines = [f"GET {path} HTTP/1.1", *(f"{name}: {value}" for name, value in head.items() if rng.random() < 0.97)]
    masked = b"\x81" + bytes([0x80 | 2]) + b"\0\0\0\0{}"
    return "\r\n".join((*lines, "", "")).encode() + masked * rng.randrange(3)


def _http(pages: Pages, data: bytes) -> None:
    """As websockets.asyncio.server has it: a request, the site's word on it, then frames."""
    protocol = ServerProtocol(origins=cast(Any, [f"http://127.0.0.1:{PORT}"]), max_size=2**16)
    connection = SimpleNamespace(respond=protocol.reject)
    protocol.receive_data(data)
    site = pages.sites[0]
    for event in protocol.events_received():
        if isinstance(event, Request):
            response = site.answer(connection, event)
            if not protocol.eof_sent:  # frames of no shape came with the request
                protocol.send_response(response or protocol.accept(event))
        elif event.opcode.name in ("TEXT", "BINARY"):
            pages.loop.run_until_complete(site._take(pages.board.join(), bytes(event.data)))
    protocol.data_to_send()
    pages.board._viewers.clear()


def _from_page(rng: Random) -> bytes:
    order = {
        "robots": rng.sample((ME, "r2", "r3", "r9"), rng.randrange(4)),
        "verb": rng.choice((*VERBS, "dance")),
        "args": rng.choice(({}, {"depth_m": 0.3}, {"x_m": integer(rng), "name": rng.choice(TEXTS)})),
        "seen": {ME: ["1", rng.choice(("2", str(START_NS), "9" * 5000, "x"))]},
    }
    said = rng.choice((
        {"got": rng.choice((["clock"], ["over", "lines"], 3, [[]], "clock"))},
        {"order": order},
        {"play": {"paused": False, "speed": rng.choice((1.0, 1e300, -1)), "at_ms": rng.choice((0, 1e12, -1e308))}},
        {"record": True},
    ))  # fmt: skip
    return json.dumps(said).encode()


def _said(pages: Pages, data: bytes) -> None:
    async def take() -> None:
        for site in pages.sites:
            viewer = site._board.join()
            try:
                text = data.decode()
            except UnicodeDecodeError:
                text = data  # type: ignore[assignment]
            await site._take(viewer, text)
            while tasks := asyncio.all_tasks() - {asyncio.current_task()}:
                await asyncio.gather(*tasks)
            for shown in site._board.next_for(viewer):
                json.loads(shown)
            site._board.leave(viewer)

    pages.given.clear()
    pages.loop.run_until_complete(take())
    for robots, _ in pages.given:
        assert robots and set(robots) <= {"r1", "r2", "r3"}, "robots that there are not"


# --- a bench, and a ground station -----------------------------------------------------------------------------------


def _bench_line(rng: Random) -> bytes:
    return json.dumps({"board_m": rng.choice((None, [0.3, 0.4, 0.2])), "servo_us": [1500.0, 1400.0]}).encode()


def _bench(data: bytes) -> None:
    json.dumps(_answer(cast(Any, SimpleNamespace(place=lambda board_m, servo_us: None, wait=lambda seconds: 0)), data))


def _datagram(rng: Random) -> bytes:
    from tests.ground.bridges.test_hostile_station import datagrams

    return b"".join(datagrams(rng, rng.choice((1, 2, 5))))


def _mavlink(fleet: Fleet, data: bytes) -> None:
    from agent.ground.bridges.mavlink import mavlink
    from tests.ground.bridges.states import START_NS as NOW_NS
    from tests.ground.bridges.states import state
    from tests.ground.bridges.station import Station, answer

    station, reader = Station(fleet), mavlink.MAVLink(None)
    reader.robust_parsing = True
    station.gateway.shown(state(ME), NOW_NS, NOW_NS)
    for message in reader.parse_buffer(data) or ():
        station.gateway.heard(message, NOW_NS, NOW_NS)
        if getattr(message, "target_system", None) == 0:
            assert {verb for _, verb, _ in station.given} <= {"disarm", "surface"}, "all at once"
        for robot, _, done in station.given:
            done(answer(robot))
        station.given.clear()
        station.gateway.tick(NOW_NS, NOW_NS)
    station.hears()
