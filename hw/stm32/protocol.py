"""The host's half of the conversation with the control module: bytes in, bytes out. No port, no clock, no thread."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from types import MappingProxyType
from typing import Literal, NamedTuple

from msgspec import UNSET
from msgspec.structs import replace

from agent.core.step_io import SetPoint, Telemetry
from hw.firmware import failsafe, parameters, wire
from hw.module import FLAGGED, Arming, Level, StatusText

# --- orders: asked, sent, repeated, answered ---

ATTEMPTS = 4  # without an answer; they reach 99.4 % at 15 % loss each way
REPEAT_AFTER_NS = 100_000_000
LIST_AFTER_NS = 500_000_000  # a whole list takes the board 200 ms
POLL_AFTER_NS = 500_000_000  # the board is at it, and said so; a tare takes 2 s

# Results beside those of the board, which are wire.RESULTS
NO_BOARD, NO_ANSWER, OVERTAKEN = "no board", "no answer", "overtaken by a stop"


class Outcome(NamedTuple):
    """What came of an order: result "ok", or why not; and the parameters that the answer brought, by name."""

    result: str
    values: Mapping[str, float] = MappingProxyType({})

    @property
    def ok(self) -> bool:
        return bool(self.result == wire.RESULTS[wire.OK])


class Order:
    """One order, and when it is to be said again."""

    def __init__(self, kind: int, fields: tuple[float, ...] = ()) -> None:
        self.kind, self.fields = kind, fields
        self.req_id = 0
        self.future: Future[Outcome] = Future()
        self.values: dict[str, float] = {}
        self.attempts_left = ATTEMPTS
        self.due_ns = 0

    def sent(self, now_ns: int) -> None:
        self.attempts_left -= 1
        self.due_ns = now_ns + (LIST_AFTER_NS if self.kind == wire.PARAM_LIST else REPEAT_AFTER_NS)

    def running(self, now_ns: int) -> None:
        if self.kind != wire.PARAM_LIST:  # whose values are its answer, and follow at once
            self.attempts_left = ATTEMPTS
            self.due_ns = now_ns + POLL_AFTER_NS

    def end(self, result: str) -> None:
        if self.future.set_running_or_notify_cancel():
            self.future.set_result(Outcome(result, MappingProxyType(self.values)))


class Orders:
    """One order is under way at a time, the others wait their turn."""

    def __init__(self) -> None:
        self.current: Order | None = None
        self._waiting: deque[Order] = deque()
        self._req_id = 0
        self.parameters = len(parameters.NAMES)  # that the board has

    @property
    def idle(self) -> bool:
        return self.current is None and not self._waiting

    def ask(self, order: Order) -> Future[Outcome]:
        """Put an order at the end of the queue."""
        self._waiting.append(order)
        return order.future

    def overtake(self, order: Order) -> None:
        """Put an order before all others, which end here: a stop leaves nothing to be done."""
        self.drop(OVERTAKEN)
        self._begin(order)

    def drop(self, result: str) -> None:
        """End all orders with this result."""
        orders = [*([self.current] if self.current else []), *self._waiting]
        self.current = None
        self._waiting.clear()
        for order in orders:
            order.end(result)

    def due(self, now_ns: int, ready: bool) -> Order | None:
        """The order that it is time to say, new ones only if `ready`. One without an answer ends here."""
        if self.current is None and ready and self._waiting:
            self._begin(self._waiting.popleft())
        order = self.current
        if order is None or now_ns < order.due_ns:
            return None
        if order.attempts_left:
            order.sent(now_ns)
            return order
        self.current = None
        order.end(NO_ANSWER)
        return None

    def on_ack(self, req_id: int, kind: int, result: int, now_ns: int) -> Order | None:
        """Take an acknowledgement; the order that it ends, if it ends one."""
        order = self.current
        if order is None or (req_id, kind) != (order.req_id, order.kind):
            return None
        if result == wire.RUNNING:
            order.running(now_ns)
            return None
        if result == wire.STALE_BOOT and kind == wire.REBOOT:
            result = wire.OK  # its first answer was lost, and it has rebooted since
        return self._end(order, wire.RESULTS[min(result, len(wire.RESULTS) - 1)])

    def on_value(self, req_id: int, i: int, value: float) -> Order | None:
        """Take a parameter; the order that it ends, if it ends one."""
        order = self.current
        if order is None or req_id != order.req_id or i >= len(parameters.NAMES):
            return None
        order.values[parameters.NAMES[i]] = float(f"{value:.6g}")  # float32 makes 0.1 into 0.10000000149
        if order.kind == wire.PARAM_LIST and len(order.values) < self.parameters:
            return None
        return self._end(order, wire.RESULTS[wire.OK])

    def _begin(self, order: Order) -> None:
        self._req_id = (self._req_id + 1) & 0xFFFF
        order.req_id = self._req_id
        self.current = order

    def _end(self, order: Order, result: str) -> Order:
        self.current = None
        order.end(result)
        return order


# --- fields of the wire's frames (hw.firmware.wire) and the host's messages ---

TTL_MS = 500  # of a set-point; the board holds position after it

LEVELS: tuple[Level, ...] = ("info", "warning", "error")  # in the order of wire.INFO ...


class Greeting(NamedTuple):
    """What the board says of itself."""

    build: str
    uid: str  # of the chip, hexadecimal
    boot_id: int
    reset_cause: int  # wire.POWER_ON ...
    parameters_crc: int  # parameters.crc of the values in force
    capabilities: int  # bits wire.CAN_...


def set_point_fields(asked: SetPoint, now_ns: int, version: int = wire.PROTOCOL) -> tuple[int, ...]:
    """Fields of a SETPOINT to a board of that version; what is beyond the wire's range is clipped."""
    i16 = wire.fixed
    return (
        i16(asked.depth_m, 1e4),
        i16(asked.roll_deg, 100),
        i16(asked.pitch_deg, 100),
        i16(asked.force_n[0], 1e3),
        i16(asked.force_n[1], 1e3),
        i16(asked.yaw_moment_nm, 1e4),
        *(i16(us, 1, 0, 65535) for us in asked.servos_us),
        i16(asked.light, 1000, 0, 1000),
        wire.VALID_ALL,
        TTL_MS,
        now_ns // (100_000_000 if version >= 3 else 1_000_000) & 0xFFFFFFFF,
    )


class TelemetryFrame(NamedTuple):
    telemetry: Telemetry
    greeted: bool  # the board knows this host; not so after a restart
    set_point_seq: int  # number of the frame that brought the set-point in force


def telemetry_frame(fields: Sequence[int], now_ns: int, rate_cdeg_s: int = wire.NO_RATE) -> TelemetryFrame:
    """A TELEM that arrived at now_ns, without its last field, which is rate_cdeg_s; or a TELEM_1."""
    t_us, state, ladder, flags, *rest = fields
    zeta, (roll, pitch, depth), pulses, servos = rest[0:4], rest[4:7], rest[10:18], rest[18:22]
    _light, battery_mv, saturated, bad, set_point_seq, dirty, loop_us = rest[22:]
    telemetry = Telemetry(
        t_ns=now_ns,
        board_us=t_us,
        depth_m=depth * 1e-4,
        roll_deg=roll * 1e-2,
        pitch_deg=pitch * 1e-2,
        sensor_depth_m=tuple(0.1 * z / wire.PA_PER_M for z in zeta),
        pulses_us=tuple(pulses),  # type: ignore[arg-type]
        servos_us=tuple(servos),  # type: ignore[arg-type]
        battery_v=battery_mv * 1e-3,
        armed=state == wire.ARMED,
        ladder=ladder,
        flags=flags,
        loop_us=loop_us,
        rate_rad_s=UNSET if rate_cdeg_s == wire.NO_RATE else math.radians(rate_cdeg_s * 1e-2),
        saturated=saturated or UNSET,
        sensors_bad=bad or UNSET,
        parameters_dirty=bool(dirty) or UNSET,
    )
    return TelemetryFrame(telemetry, bool(flags & wire.FLAG_HELLO), set_point_seq)


def log_line(level: int, text: bytes) -> StatusText:
    """The line of a LOG."""
    return StatusText(LEVELS[min(level, 2)], f"board: {text.decode(errors='replace')}")


def why(arg: int) -> str:
    """What an EVENT gives as its reason."""
    return wire.REASONS[arg] if 0 <= arg < len(wire.REASONS) else f"reason {arg}"


def event_line(code: int, before: int, after: int, severity: int, arg: int) -> StatusText:
    """The line of an EVENT, but for a refusal to arm."""
    ladder = f"failsafe level {before} -> {after}: {why(arg)}" if after else f"failsafe over, it was level {before}"
    text = {
        wire.EV_BOOT: "booted",
        wire.EV_ARMED: "armed",
        wire.EV_DISARMED: f"disarmed: {why(arg)}",
        wire.EV_LADDER: ladder,
    }.get(code, f"event {code}")
    return StatusText(LEVELS[min(severity, 2)], f"board: {text}")


# --- conversation ---

HELLO_EVERY_NS = 500_000_000
NO_IMU = "no IMU: sensors that drift in pairs and a robot put in upside down may go unnoticed"

# Telemetry kept for a caller that is late: 5 s at 50 Hz. Lines of text: more is a babbling board.
KEEP_TELEMETRY, KEEP_LINES = 256, 64


class Counters(NamedTuple):
    rx_ok: int = 0  # frames
    rx_bad: int = 0  # broken frames
    lost: int = 0  # frames missing in the board's numbering
    reconnects: int = 0  # times the port was opened again
    dropped: int = 0  # telemetry that the caller did not fetch in time
    latency_ns: int | None = None  # newest: from handing over a set-point to telemetry that shows it


LOSS_OVER = 10  # STATUS frames, each second one: over so long losses are counted
LOSSY, SOUND = 0.02, 0.01  # shares of frames: a fault, and none any more; control stands 15 % each way
FEWEST = 50  # frames, of which a share says something
GAP_NS = 1_000_000_000  # of silence, after which it may be another board that speaks: it is greeted anew


class FrameCounts(NamedTuple):
    """Frames up to a STATUS."""

    ours: int  # of the board, as its numbers count them
    lost: int  # of those
    board: int  # of this host, as the board counts them
    broken: int  # of those


class HostProtocol:
    """State of one conversation. It outlives the port: a board that comes back with a new boot id is not armed again,
    and another one at this port, as where two robots' cables change places, is told nothing.

    `now_ns` counts on any one clock.
    """

    def __init__(self, host_boot: int) -> None:
        self._arming = Arming()
        self._flags = self._failsafe = 0  # the board's flags and its level of the failsafe, by what it said last
        self._why: tuple[str, ...] = ()  # that level is not 0, one reason after the other
        self._stop: Literal["none", "latched", "rebooting"] = "none"  # an emergency stop of this host's
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
        self._imu_boot: int | None = None  # the newest that has an IMU, or was said to have none
        self._status: dict[str, float] = {}  # for the telemetry that comes next
        self._last_text = ""
        self._begin()

    def _begin(self) -> None:
        self._framer = wire.Framer(self._on_frame)
        self._hello = False
        self._stranger = ""  # chip of another board than greeted before
        self._greets_ns: int | None = None  # since when it is not known who is there
        self._lossy = False
        self._frame_counts: deque[FrameCounts] = deque(maxlen=LOSS_OVER)
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
        rx_ok, rx_bad = self._counts["rx_ok"] + self._framer.rx_ok, self._counts["rx_bad"] + self._framer.rx_bad
        total = self._counts | {"rx_ok": rx_ok, "rx_bad": rx_bad}
        return Counters(
            **total | {"reconnects": max(0, total["reconnects"])},
            latency_ns=self._latency_ns,
        )

    @property
    def faults(self) -> dict[str, str]:
        """What is wrong at the board, by its newest telemetry, and on the line to it: kind -> words."""
        found = {kind: words for flag, (kind, words) in FLAGGED.items() if self._flags & flag}
        if self._why and self._failsafe:
            found["failsafe cause"] = ", then ".join(self._why)
        if line := self._line_fault():
            found["tether"] = line
        return found

    def _line_fault(self) -> str:
        if self._stranger and self.greeting is not None:
            return (
                f"another control module answers at this port, chip {self._stranger}, not {self.greeting.uid}: it is "
                "told nothing; plug in this robot's, or start this agent again"
            )
        if not self._lossy:
            return ""
        from_board, to_board = self._lost_shares()
        return f"of its frames {from_board:.0%} are lost, of those to it {to_board:.0%}; look at cable and plugs"

    def _lost_shares(self) -> tuple[float, float]:
        """Of the board's frames, and of those to it."""
        first, last = self._frame_counts[0], self._frame_counts[-1]
        return (
            (last.lost - first.lost) / max(last.ours - first.ours, FEWEST),
            (last.broken - first.broken) / max(last.board - first.board, FEWEST),
        )

    def set_point(self, asked: SetPoint, now_ns: int) -> bytes:
        """The frame of a set-point, what is beyond the wire's range clipped; none before the board has said which it
        is: it would be steered for the time that it holds one."""
        if not self._hello:
            return b""
        self._sent_ns[self._writer.seq] = now_ns
        return self._frame(
            wire.SETPOINT, *set_point_fields(asked, now_ns, self._version if self._agreed else wire.OLDEST)
        )

    def arm(self) -> None:
        """Ask for arming as soon as the board can; a refusal that waiting cannot cure ends it.

        A board that this host stopped is rebooted first: the person who arms it knows of the stop. One that had latched
        before, for another reason or host, is not.
        """
        self._arming.want()

    def stop(self, kind: int, *fields: float) -> None:
        """DISARM, ESTOP, or MODE to surface, ahead of any other command."""
        self._arming.wanted = False
        if kind == wire.ESTOP and self._failsafe != failsafe.LATCHED:
            self._stop = "latched"
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
        return self._orders.current is None

    def due(self, now_ns: int) -> bytes:
        """The frames that it is time to send, perhaps none."""
        out = b""
        greeted = self._hello and self._agreed
        if not greeted and (self._hello_due_ns is None or now_ns >= self._hello_due_ns):
            # a zero first, so that noise before it does not swallow the frame
            out += b"\0" + self._frame(wire.HELLO, self._version, wire.schema_crc(self._version), self._host_boot)
            self._hello_due_ns = now_ns + HELLO_EVERY_NS
        if not self._hello and self._greets_ns is None:
            self._greets_ns = now_ns
        unknown = self._greets_ns is not None and self.greeting is not None and now_ns - self._greets_ns < GAP_NS
        if self._stranger or unknown:
            return out  # a stop would be obeyed by whichever board this is
        current = self._orders.current
        idle = self._hello and self._orders.idle
        if idle and self._arming.due(now_ns):
            if self._stop == "none":
                self._orders.ask(Order(wire.ARM))
            else:
                self._stop = "rebooting"
                self._orders.ask(Order(wire.REBOOT, (wire.REBOOT_MAGIC,)))
                self._arming.later(now_ns)
        order = self._orders.due(now_ns, ready=self._hello)
        if order is not None:
            out += self._frame(order.kind, order.req_id, self._boot_id or 0, *order.fields)
        elif current is not None and self._orders.current is None and current.kind == wire.ARM:
            self._arming.later(now_ns)
        return out

    def _frame(self, kind: int, *fields: float) -> bytes:
        return bytes(self._writer.frame(kind, *fields))

    def receive(self, chunk: bytes, now_ns: int) -> None:
        """Take bytes that arrived at now_ns."""
        if self._hello and now_ns - self._now_ns > GAP_NS:
            self._hello = self._agreed = False
            self._version, self._hello_due_ns = wire.OLDEST, None
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
            self._on_status(*wire.unpack(kind, payload))
        elif kind == wire.EVENT:
            self._on_event(*wire.unpack(kind, payload))
        elif kind == wire.LOG:
            self._say(log_line(*wire.unpack(kind, payload)))

    def _on_hello_ack(
        self, protocol: int, schema: int, build: bytes, uid: bytes, boot_id: int, cause: int, _state: int, *rest: int
    ) -> None:
        crc, count, capabilities = rest
        known_protocol = wire.OLDEST <= protocol <= wire.PROTOCOL and schema == wire.schema_crc(protocol)
        if not known_protocol or count != wire.PARAMETER_COUNTS[protocol]:
            self.say("error", "the board speaks another protocol; flash the firmware of this release")
            return
        newest = 3 if capabilities & wire.CAN_VERSION_3 else 2 if capabilities & wire.CAN_VERSION_2 else wire.OLDEST
        self._agreed = protocol == newest
        if not self._agreed and self._version != newest:
            self._version, self._hello_due_ns = newest, None  # it knows more: greet again, now
        self._orders.parameters = count
        if self._hello and boot_id == self._boot_id:
            return  # a greeting that was said already
        known = self.greeting
        self._stranger = uid.hex() if known is not None and known.uid != uid.hex() else ""
        if self._stranger:
            self._hello = self._agreed = False
            self.say("error", self._line_fault())
            return
        self._greets_ns = None
        self.greeting = Greeting(build.decode(errors="replace"), uid.hex(), boot_id, cause, crc, capabilities)
        if boot_id != self._boot_id and self._boot_id is not None:
            if self._stop != "rebooting":
                self._say(self._arming.give_up("the board has restarted; arm again"))
            self._stop = "none"
        self._boot_id = boot_id
        self._hello = True
        self.say("info", f"board {self.greeting.build}, boot {boot_id:08x}")
        if known is not None and known.boot_id != boot_id:
            self._events.clear()  # numbered anew
            self._frame_counts.clear()
            self._why, self._lossy = (), False
            again, self._set = self._set, {}
            for i, value in again.items():
                self.ask(wire.PARAM_SET, i, parameters.TABLE[i][4], 0, value)

    def _on_telemetry(self, frame: TelemetryFrame) -> None:
        telemetry, greeted, set_point_seq = frame
        if not greeted:  # it has restarted meanwhile
            self.hung_up()
            return
        self._say(self._arming.seen(telemetry.armed))
        self._flags, self._failsafe = telemetry.flags, telemetry.ladder
        if not telemetry.ladder:
            self._why = ()
        if telemetry.rate_rad_s is not UNSET:
            self._imu_boot = self._boot_id
        sent_ns = self._sent_ns.pop(set_point_seq, None)
        if sent_ns is not None:
            self._latency_ns = self._now_ns - sent_ns
        if len(self.telemetry) == KEEP_TELEMETRY:
            self.telemetry.popleft()
            self._counts["dropped"] += 1
        self.telemetry.append(replace(telemetry, **self._status) if self._status else telemetry)
        self._status = {}

    def _on_status(
        self, _t_us: int, _mv: int, current_10ma: int, temperature_cc: int, _loop_us: int, *rest: int
    ) -> None:
        rx_ok, rx_bad, heap_free_16, _late, _cause, _leak = rest
        counts = self.counters
        self._frame_counts.append(FrameCounts(counts.rx_ok + counts.lost, counts.lost, rx_ok + rx_bad, rx_bad))
        if len(self._frame_counts) == LOSS_OVER:
            self._lossy = max(self._lost_shares()) >= (SOUND if self._lossy else LOSSY)
        self._status = {"current_a": current_10ma * 1e-2, "heap_free_b": heap_free_16 * 16}
        if temperature_cc:  # 0: no sensor has told one
            self._status["temperature_c"] = temperature_cc * 1e-2

    def _on_ack(self, req_id: int, kind: int, result: int, _boot_id: int) -> None:
        if self._orders.on_ack(req_id, kind, result, self._now_ns) is None:
            return
        if result == wire.STALE_BOOT:
            self._hello = self._agreed = False
        if kind == wire.ARM:
            self._arming.answered(result == wire.OK, self._now_ns)
            if result == wire.OK and self._imu_boot != self._boot_id:
                self._imu_boot = self._boot_id
                self.say("warning", NO_IMU)
        elif kind == wire.TARE and result == wire.OK:
            self.say("info", "tared")
        elif kind == wire.TARE:
            self.say("error", "not tared: lay it down in air, still, motors off, and order again")
        elif kind in (wire.DISARM, wire.ESTOP):
            self._arming.armed = False  # by the host's own order: nothing to report
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
            return
        self._say(event_line(code, before, after, severity, arg))
        if code == wire.EV_LADDER or (code == wire.EV_DISARMED and after == failsafe.LATCHED):
            earlier = self._why if before else ()  # what surfaces for a leak stops for having surfaced
            self._why = earlier if why(arg) in earlier[-1:] else (*earlier, why(arg))

    def _say(self, line: StatusText | None) -> None:
        if line is not None:
            self.say(*line)

    def say(self, level: Level, text: str) -> None:
        """Add a line, unless it is the one said last."""
        if text != self._last_text:
            self.lines.append(StatusText(level, text))
        self._last_text = text
