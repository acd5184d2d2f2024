"""The host's half of the conversation with the control module: bytes in, bytes out. No port, no clock, no thread."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from typing import NamedTuple

from agent.core.step_io import SetPoint, Telemetry
from hw.firmware import parameters, wire
from hw.stm32.arming import Arming
from hw.stm32.fields import (
    Greeting,
    Level,
    StatusText,
    TelemetryFrame,
    event_line,
    log_line,
    set_point_fields,
    telemetry_frame,
)
from hw.stm32.orders import NO_BOARD, Order, Orders, Outcome

HELLO_EVERY_NS = 500_000_000

# Telemetry kept for a caller who is late: 5 s at 50 Hz. Lines of text: more is a babbling board.
KEEP_TELEMETRY, KEEP_LINES = 256, 64


class Counters(NamedTuple):
    rx_ok: int = 0  # frames
    rx_bad: int = 0  # broken frames
    lost: int = 0  # frames missing in the board's numbering
    reconnects: int = 0  # times the port was opened again
    dropped: int = 0  # telemetry that nobody fetched in time
    latency_ns: int | None = None  # newest: from handing over a set-point to telemetry that shows it
    board_rx_ok: int = 0  # frames that the board got from us
    board_rx_bad: int = 0  # broken ones
    board_late: int = 0  # cycles that the board has missed since it booted, modulo 65536


class HostProtocol:
    """State of one conversation. It outlives the port: a board that comes back with a new boot id is not armed again.

    `now_ns` counts on any one clock.
    """

    def __init__(self, host_boot: int) -> None:
        self._arming = Arming()
        self.telemetry: deque[Telemetry] = deque()
        self.lines: deque[StatusText] = deque(maxlen=KEEP_LINES)
        self._host_boot = host_boot
        self._writer = wire.Writer()
        self.greeting: Greeting | None = None  # of the newest boot
        self._boot_id: int | None = None
        self._orders = Orders()
        self._set: dict[int, float] = {}  # parameters set and not saved: a board that restarts gets them again
        self._counts = {"rx_ok": 0, "rx_bad": 0, "lost": 0, "reconnects": -1, "dropped": 0}
        self._latency_ns: int | None = None
        self._board_rx, self._board_late = (0, 0), 0
        self._last_text = ""
        self._begin()

    def _begin(self) -> None:
        self._framer = wire.Framer(self._on_frame)
        self._hello = False
        self._version = wire.OLDEST  # of the protocol that is greeted in: a board tells whether it knows the next
        self._agreed = False  # that it is this one
        self._hello_due_ns: int | None = None
        self._orders.drop(NO_BOARD)
        self._arming.begin()
        self._next_seq: int | None = None
        self._sent_ns: dict[int, int] = {}  # set-points under way, by their sequence number
        self._events: deque[int] = deque(maxlen=8)  # numbers of events already told: each comes three times
        self._now_ns = 0

    def connected(self) -> None:
        """A port was opened: greet first, and believe nothing that lay in its buffers."""
        self._counts["rx_ok"] += self._framer.rx_ok
        self._counts["rx_bad"] += self._framer.rx_bad
        self._counts["reconnects"] += 1
        self._begin()

    @property
    def wants_armed(self) -> bool:
        """Falls by itself when the board disarms, restarts, or refuses for good."""
        return self._arming.wanted

    @property
    def armed(self) -> bool:
        """What the board said last."""
        return self._arming.armed

    @property
    def counters(self) -> Counters:
        ok, bad = self._framer.rx_ok, self._framer.rx_bad
        total = self._counts | {"rx_ok": self._counts["rx_ok"] + ok, "rx_bad": self._counts["rx_bad"] + bad}
        return Counters(
            **total | {"reconnects": max(0, total["reconnects"])},
            latency_ns=self._latency_ns,
            board_rx_ok=self._board_rx[0],
            board_rx_bad=self._board_rx[1],
            board_late=self._board_late,
        )

    # --- to the board ---------------------------------------------------------------------------------------------

    def set_point(self, asked: SetPoint, now_ns: int) -> bytes:
        """The frame of a set-point; what is beyond the wire's range is clipped."""
        self._sent_ns[self._writer.seq] = now_ns
        return self._frame(wire.SETPOINT, *set_point_fields(asked, now_ns))

    def arm(self) -> None:
        """Ask for arming as soon as the board can; refused for a reason that waiting cannot cure, the wish ends."""
        self._arming.want()

    def stop(self, kind: int, *fields: float) -> None:
        """DISARM, ESTOP, or MODE to surface, ahead of any other command."""
        self._arming.wanted = False
        self._orders.overtake(Order(kind, fields))

    def ask(self, kind: int, *fields: float) -> Future[Outcome]:
        """Any other order of wire.TABLE, with its fields after req_id and boot_id; without a board it ends at once."""
        order = Order(kind, fields)
        if self._hello:
            return self._orders.ask(order)
        order.end(NO_BOARD)
        return order.future

    def hung_up(self) -> None:
        """The port has gone, and with it what was asked."""
        self._hello = self._agreed = False
        self._version = wire.OLDEST
        self._orders.drop(NO_BOARD)

    def is_answered(self) -> bool:
        """No order waits for its answer."""
        return self._orders.current is None

    def due(self, now_ns: int) -> bytes:
        """The frames that it is time to send, perhaps none."""
        out = b""
        greeted = self._hello and self._agreed
        if not greeted and (self._hello_due_ns is None or now_ns >= self._hello_due_ns):
            # a zero first, so that noise before it does not swallow the frame
            out += b"\0" + self._frame(wire.HELLO, self._version, wire.schema_crc(self._version), self._host_boot)
            self._hello_due_ns = now_ns + HELLO_EVERY_NS
        current = self._orders.current
        idle = self._hello and self._orders.idle
        if idle and self._arming.due(now_ns):
            self._orders.ask(Order(wire.ARM))
        order = self._orders.due(now_ns, ready=self._hello)
        if order is not None:
            out += self._frame(order.kind, order.req_id, self._boot_id or 0, *order.fields)
        elif current is not None and self._orders.current is None and current.kind == wire.ARM:
            self._arming.later(now_ns)
        return out

    def _frame(self, kind: int, *fields: float) -> bytes:
        return bytes(self._writer.frame(kind, *fields))

    # --- from the board -------------------------------------------------------------------------------------------

    def receive(self, chunk: bytes, now_ns: int) -> None:
        """Take bytes that arrived at now_ns."""
        self._now_ns = now_ns
        self._framer.feed(chunk, len(chunk))

    def _on_frame(self, kind: int, seq: int, payload: memoryview) -> None:
        if self._next_seq is not None:
            self._counts["lost"] += (seq - self._next_seq) & 0xFF
        self._next_seq = (seq + 1) & 0xFF
        if kind == wire.HELLO_ACK:
            self._on_hello_ack(*wire.unpack(kind, payload))
        elif not self._hello:
            return  # from before the greeting: perhaps seconds old
        elif kind == wire.TELEM_1:
            self._on_telemetry(telemetry_frame(wire.unpack(kind, payload), self._now_ns))
        elif kind == wire.TELEM:
            *fields, rate_cdeg_s = wire.unpack(kind, payload)
            self._on_telemetry(telemetry_frame(fields, self._now_ns, rate_cdeg_s))
        elif kind == wire.ACK:
            self._on_ack(*wire.unpack(kind, payload))
        elif kind == wire.PARAM_VALUE:
            self._on_value(*wire.unpack(kind, payload))
        elif kind == wire.STATUS:
            self._board_rx, self._board_late = (fields := wire.unpack(kind, payload))[5:7], fields[8]
        elif kind == wire.EVENT:
            self._on_event(*wire.unpack(kind, payload))
        elif kind == wire.LOG:
            self._say(log_line(*wire.unpack(kind, payload)))

    def _on_hello_ack(
        self, protocol: int, schema: int, build: bytes, uid: bytes, boot_id: int, cause: int, _state: int, *rest: int
    ) -> None:
        crc, count, capabilities = rest
        known_protocol = wire.OLDEST <= protocol <= wire.PROTOCOL and schema == wire.schema_crc(protocol)
        if not known_protocol or count != len(parameters.TABLE):
            self.say("error", "the board speaks another protocol; flash the firmware of this release")
            return
        self._agreed = protocol == wire.PROTOCOL or not capabilities & wire.CAN_VERSION_2
        if not self._agreed and self._version != wire.PROTOCOL:
            self._version, self._hello_due_ns = wire.PROTOCOL, None  # it knows more: greet again, now
        if self._hello and boot_id == self._boot_id:
            return  # it has been told already who this is
        known = self.greeting
        name = build.decode(errors="replace")
        self.greeting = Greeting(name, uid.hex(), boot_id, cause, crc, capabilities)
        if boot_id != self._boot_id and self._boot_id is not None:
            self._say(self._arming.give_up("the board has restarted; arm again"))
        self._boot_id = boot_id
        self._hello = True
        self.say("info", f"board {name}, boot {boot_id:08x}")
        if known is not None and known.boot_id != boot_id:
            self._events.clear()  # numbered anew
            again = self._set if known.uid == self.greeting.uid else {}
            self._set = {}
            for i, value in again.items():
                self.ask(wire.PARAM_SET, i, parameters.TABLE[i][4], 0, value)

    def _on_telemetry(self, frame: TelemetryFrame) -> None:
        telemetry, greeted, set_point_seq = frame
        if not greeted:  # it has restarted behind our back
            self.hung_up()
            return
        self._say(self._arming.seen(telemetry.armed))
        sent_ns = self._sent_ns.pop(set_point_seq, None)
        if sent_ns is not None:
            self._latency_ns = self._now_ns - sent_ns
        if len(self.telemetry) == KEEP_TELEMETRY:
            self.telemetry.popleft()
            self._counts["dropped"] += 1
        self.telemetry.append(telemetry)

    def _on_ack(self, req_id: int, kind: int, result: int, _boot_id: int) -> None:
        if self._orders.on_ack(req_id, kind, result, self._now_ns) is None:
            return
        if result == wire.STALE_BOOT:
            self._hello = self._agreed = False
        if kind == wire.ARM:
            self._arming.answered(result == wire.OK, self._now_ns)
        elif kind in (wire.DISARM, wire.ESTOP):
            self._arming.armed = False  # by our own order: nothing to report
        elif kind == wire.PARAM_SAVE and result == wire.OK:
            self._set = {}

    def _on_value(self, req_id: int, _boot_id: int, i: int, _type: int, _flags: int, value: float) -> None:
        order = self._orders.on_value(req_id, i, value)
        if order is not None and order.kind == wire.PARAM_SET:
            self._set[i] = value

    def _on_event(self, _t_us: int, code: int, before: int, after: int, severity: int, arg: int, count: int) -> None:
        if count in self._events:
            return
        self._events.append(count)
        if code == wire.EV_ARM_REFUSED:
            self._say(self._arming.refused(arg))
        else:
            self._say(event_line(code, before, after, severity, arg))

    def _say(self, line: StatusText | None) -> None:
        if line is not None:
            self.say(*line)

    def say(self, level: Level, text: str) -> None:
        """Add a line, unless it is the one said last."""
        if text != self._last_text:
            self.lines.append(StatusText(level, text))
        self._last_text = text
