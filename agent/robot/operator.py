"""Operators' orders: which console may order what, and when. Each is judged, carried out at most once, and answered.

No two clocks are compared: an order says which State of the robot was looked at, by the robot's own stamp. One that
goes by a State of three seconds ago or of an earlier start is refused. A stop, in whatever words, is never refused for
its age, and no arm that was on its way undoes it. While the control module is silent an arm is refused, and a stop goes
out but is not called done.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agent.core.capability import CameraAct, Overrides, Proposal, Situation
from agent.core.codec import Refusal, decode, printable
from agent.core.config import Fleet, Follow, Goto, Hold, Orbit, Search, Survey, Trial, Turn
from agent.core.messages import MAX_ORDER, MAX_WORDS, NAME, Answer, Order
from agent.core.status import Logbook
from agent.core.step_io import Motors, Ordered, Outputs, TargetBox, Telemetry
from agent.core.step_transaction import SURFACE_M, Revertible
from agent.core.verbs import (
    CLOCK,
    URGENT,
    Args,
    Arm,
    Burn,
    Clock,
    Disarm,
    DrawBox,
    HoldHere,
    LookAt,
    Resume,
    Set,
    Stop,
    Surface,
    Tare,
    arguments,
    in_words,
    within,
)
from agent.robot.arbiter import CAPABILITIES, Equipment
from agent.robot.fleet_reader import wrong_way

# --- what is ordered of the devices ---


class AtOnce(NamedTuple):
    """For the devices, with the outputs of this step."""

    motors: Motors | UnsetType = UNSET
    box: TargetBox | UnsetType = UNSET
    preview_hz: float | UnsetType = UNSET


RANK: tuple[Motors, ...] = ("tare", "arm", "surface", "off")  # of two in one step the later here goes


def prevailing(before: Motors | UnsetType, ordered: Motors) -> Motors:
    """Of what was ordered of the motors in one step."""
    return ordered if before is UNSET else max(before, ordered, key=RANK.index)


# --- carrying orders out ---

MOST_SEND_HZ, LEAST_SEND_HZ, MOST_PREVIEW_HZ = 20.0, 0.2, 5.0
MIN_SIDE_PX = 8.0  # of a box that can be followed


class Commands(Revertible):
    """Commands that are in force, and what carrying one out means; which console may give it, and when, is judged
    before (Operator)."""

    def __init__(self, fleet: Fleet, name: str, equipment: Equipment) -> None:
        self._fleet, self._robot, self._equipment = fleet, fleet.robot[name], equipment
        self.overrides, self.at_once = Overrides(), AtOnce()

    def carry_out(self, what: Args) -> None:
        """Raises Refusal for what this robot cannot do, and then does nothing."""
        match what:
            case Stop() | Disarm() | Surface():
                self.halt("surface" if isinstance(what, Surface) else "stop")
            case Arm():
                self._motors("arm")
            case Tare():
                self._motors("tare")
            case Clock():
                pass
            case HoldHere():
                self._hold(what)
            case LookAt():
                body = self._fleet.body
                within("pan_deg", what.pan_deg, *body.pan_limit_deg)
                within("tilt_deg", what.tilt_deg, *body.tilt_limit_deg)
                self.overrides = self.overrides._replace(look_deg=(what.pan_deg, what.tilt_deg))
            case DrawBox():
                self._draw(what)
            case Set():
                self._set(what)
            case Resume():
                self.overrides = Overrides()
                self.at_once = self.at_once._replace(preview_hz=self._fleet.link.preview_hz)
                self._equipment.carry_out(what)
            case Burn():
                self._by_owner(what)
            case _:
                self._behave(what)

    def halt(self, verb: str) -> None:
        """Stop, disarm or surface; nothing can be wrong with it."""
        self._motors("surface" if verb == "surface" else "off")

    def take_at_once(self) -> AtOnce:
        """What is ordered of the devices in this step, once."""
        at_once, self.at_once = self.at_once, AtOnce()
        return at_once

    def _motors(self, ordered: Motors) -> None:
        self.at_once = self.at_once._replace(motors=prevailing(self.at_once.motors, ordered))

    def _by_owner(self, what: Args) -> None:
        """The capability that it is for carries it out. Raises Refusal where this robot lacks it."""
        if not self._equipment.carry_out(what):
            raise Refusal("content", lacking(what))

    def _hold(self, what: HoldHere) -> None:
        if what.depth_m is not None:
            within("depth_m", what.depth_m, SURFACE_M, self._fleet.tank.surface_m)
            self.overrides = self.overrides._replace(depth_m=what.depth_m)
        self._equipment.carry_out(what)
        if self._equipment.source.moves:
            self.overrides = self.overrides._replace(behaviour=Hold())

    def _draw(self, what: DrawBox) -> None:
        boxed = [name for name, target in self._fleet.target.items() if target.detector == "box"]
        if not boxed:
            raise Refusal("content", 'no target of the fleet file has detector = "box"; others are found by colour')
        target = what.target or boxed[0]
        if target not in boxed or (what.target is None and len(boxed) > 1):
            raise Refusal("content", f"target: write one of {', '.join(boxed)}")
        size = self._fleet.camera.width_px, self._fleet.camera.height_px
        if min(what.width, what.height) < MIN_SIDE_PX:
            raise Refusal("content", f"a box of less than {MIN_SIDE_PX:g} pixels cannot be followed; draw a larger one")
        if what.x + what.width > size[0] or what.y + what.height > size[1]:
            raise Refusal("content", f"the box is not within the frame, {size[0]} x {size[1]} pixels")
        box = TargetBox(target=target, frame=what.frame, box=(what.x, what.y, what.width, what.height))
        self.at_once = self.at_once._replace(box=box)

    def _set(self, what: Set) -> None:
        match what.name:
            case "sweeps":
                if what.value not in (0.0, 1.0):
                    raise Refusal("content", "value: 1 is on, 0 is off")
                self.overrides = self.overrides._replace(sweeps=bool(what.value))
            case "send_hz":  # heard less often, neighbours would leave it out
                within("value", what.value, max(LEAST_SEND_HZ, 1.0 / self._fleet.estimation.validity_s), MOST_SEND_HZ)
                self.overrides = self.overrides._replace(send_hz=what.value)
            case "preview_hz":
                within("value", what.value, 0.0, MOST_PREVIEW_HZ)
                self.at_once = self.at_once._replace(preview_hz=what.value)
            case _:
                self._by_owner(what)

    def _behave(self, what: Goto | Turn | Orbit | Trial | Follow | Search | Survey) -> None:
        """A behaviour, as a fleet file has it."""
        if isinstance(what, Survey) and not isinstance(self._robot.behaviour, Survey):
            raise Refusal(
                "content", "its behaviour in the fleet file is no survey, so that it has not chosen any views"
            )
        swims = any(isinstance(what, one.commands) for one in self._equipment.by_name.values())
        if swims and (wrong := wrong_way(self._fleet, what)) is not None:
            raise Refusal("content", wrong)
        self._by_owner(what)
        self.overrides = self.overrides._replace(behaviour=what)


def lacking(what: Args) -> str:
    """Why a robot that lacks a capability cannot carry out its commands."""
    return (
        next((kind.lacks for kind in CAPABILITIES if isinstance(what, kind.commands)), "")
        or "this robot cannot do that"
    )


# --- control module ---

WEATHER_M = 0.25  # of water: the pressure of air differs by less from day to day
UNTOLD = "its control module is silent and motors may turn; use the kill switch. It is told as soon as it is heard"

# --- memory of answers ---

ORDERS = 64  # of each session of a console
SESSIONS = 4  # of each console; the one that was silent for longest is forgotten
ALL_SESSIONS = 16  # a fleet file names fewer consoles; where any may order, likewise


class Answered(NamedTuple):
    order: Order
    answer: Answer


class Known(Revertible):
    """What one session of a console has ordered."""

    def __init__(self) -> None:
        self.answered: dict[int, Answered] = {}  # by the order's id; the oldest stands first
        self.forgotten_ns = -1  # stamp of the newest State that one went by which was carried out and is forgotten

    def keep(self, order: Order, answer: Answer) -> None:
        self.answered[order.id] = Answered(order, answer)
        while len(self.answered) > ORDERS:
            gone, its_answer = self.answered.pop(next(iter(self.answered)))
            if its_answer.ok and gone.seen is not None:
                self.forgotten_ns = max(self.forgotten_ns, gone.seen[1])


class Memory(Revertible):
    """How orders were answered, so that one that comes again is answered again and carried out once.

    Since the robot's start; what came before that is refused by its State's incarnation. An id says which order it is
    and no more: how old it is, the State says that was looked at.
    """

    def __init__(self) -> None:
        self._sessions: dict[tuple[str, int], Known] = {}  # by console and session; who ordered last stands last

    def again(self, console: str, order: Order) -> Answer | str:
        """The answer that the same order was given; else why it cannot be told from one that was; empty: it is new.

        A stop is never taken for another order, nor for one that is forgotten.
        """
        known = self._sessions.get((console, order.session))
        if known is None:
            return ""
        if (before := known.answered.get(order.id)) is not None:
            same = (before.order.verb, before.order.args) == (order.verb, order.args)
            if same:
                return before.answer
            return "" if order.verb in URGENT else f"another order had this id, {order.id}; order again"
        if order.verb not in URGENT and order.seen is not None and order.seen[1] <= known.forgotten_ns:
            return "it came after many later ones of the same console; order again"
        return ""

    def keep(self, console: str, order: Order, answer: Answer) -> None:
        known = self._sessions.pop((console, order.session), None) or Known()
        known.keep(order, answer)
        self._sessions[console, order.session] = known
        own = [one for one in self._sessions if one[0] == console]
        for silent in own[:-SESSIONS] or list(self._sessions)[:-ALL_SESSIONS]:
            del self._sessions[silent]


# --- rights ---
# The consoles that the fleet file names may order, where links prove which one asks; on one computer alone any may.

LOOPBACK = re.compile(r"127(\.\d{1,3}){3}|localhost|\[::1\]")


def why_closed(fleet: Fleet, console: str) -> str:
    """Why a console of that name may not order; empty: it may. The same at the console and at the robots."""
    if NAME.fullmatch(console) is None:
        return "the name of a console is a small letter and up to 15 small letters, digits or _"
    consoles = fleet.access.consoles
    if console not in consoles and (fleet.secured or consoles):
        named = ", ".join(consoles) or "nobody"
        return f"'{console}' is no console of this fleet; [access] consoles names {named}"
    if not fleet.secured and not all(_on_loopback(robot.listen) for robot in fleet.robot.values()):
        return 'anybody could order over links without keys; secure the fleet: aucamp keys, and listen = "tls/.."'
    return ""


def _on_loopback(listen: str) -> bool:
    return LOOPBACK.fullmatch(listen.partition("/")[2].rpartition(":")[0]) is not None


# --- judging and answering orders ---

PARTS = {**dict.fromkeys(("stop", "disarm", "surface", "arm"), "motors"), "look": "camera", "lamp": "lamp"}
PARTS |= {"target_box": "box"}
STALE_NS = 3_000_000_000
BROKE = "the step that it came with broke, and it was left out; order again"


class Operator(Revertible):
    """Judges the orders to one robot, has them carried out and answers them."""

    def __init__(self, fleet: Fleet, name: str, incarnation: int, equipment: Equipment, log: Logbook) -> None:
        self._fleet, self._name, self._incarnation, self._log = fleet, name, incarnation, log
        self._commands, self._memory = Commands(fleet, name, equipment), Memory()
        self._halted_ns = -1  # when a stop or a surfacing was ordered last
        self._module: Telemetry | None = None  # the newest of its control module; None: it is silent
        self._holds: dict[str, str] = {}  # what each of a robot's parts is ordered to do, and by which console
        self._now: dict[tuple[str, bytes], Answer] = {}  # of this step

    @property
    def overrides(self) -> Overrides:
        return self._commands.overrides

    def propose(self, situation: Situation) -> Iterable[Proposal[CameraAct]]:
        """The camera, where a look is ordered."""
        look_deg = self.overrides.look_deg
        if look_deg is not None and situation.camera.goal_us is not None:
            yield Proposal("camera", "operator", lambda at: CameraAct(look_deg))

    @property
    def ordered(self) -> tuple[str, ...] | UnsetType:
        """What people have ordered that holds, for telemetry."""
        return tuple(self._holds.values()) or UNSET

    def take(self, orders: tuple[Ordered, ...] | UnsetType, module: Telemetry | None, now_ns: int) -> None:
        """Judge and carry out what arrived since the last step. module: the newest that it said; None: it is silent."""
        self._module = module
        for ordered in orders or ():
            self._now[ordered.console, ordered.payload] = self._answer(ordered, now_ns)

    def complete(self, outputs: Outputs, orders: tuple[Ordered, ...] | UnsetType, now_ns: int) -> Outputs:
        """The outputs of a step with an answer to each order, and what they want of the devices.

        Outside of the transaction: an order that broke the step, or came with one that came to nothing, is answered
        here; and if it was a stop, it is one still.
        """
        if orders is UNSET:
            return outputs
        answers = tuple(
            self._now.get((ordered.console, ordered.payload)) or self._left_out(ordered, now_ns) for ordered in orders
        )
        self._now = {}
        at_once = self._commands.take_at_once()
        motors = outputs.motors if at_once.motors is UNSET else prevailing(outputs.motors, at_once.motors)
        return replace(outputs, answers=answers, motors=motors, box=at_once.box, preview_hz=at_once.preview_hz)

    def _answer(self, ordered: Ordered, now_ns: int) -> Answer:
        console, order, said = ordered.console, None, ""
        try:
            if why := why_closed(self._fleet, console):
                raise Refusal("content", why)
            order = decode(ordered.payload, Order, MAX_ORDER)
            what = arguments(order.verb, order.args)
            said = in_words(order.verb, what)
            again = self._memory.again(console, order)
            if isinstance(again, Answer):
                return again
            if why := again or self._too_old(order, now_ns) or self._unable(what):
                raise Refusal("content", why)
            self._commands.carry_out(what)
        except Refusal as refusal:
            text = printable(str(refusal))  # some are a stranger's
            about = f"refuses what {console[:16]} orders{f', {said}' if said else ''}: {text}"
            self._log.note_seldom("warning", f"order {console} {order.verb if order and said else ''}", about, now_ns)
            answer = self._said(ordered, order, said, text, now_ns)
            if order is not None and said and not self._memory.again(console, order):
                self._memory.keep(console, order, answer)
            return answer
        self._note(order.verb, what, f"{console}: {said}")
        if order.verb in URGENT:
            self._halted_ns = now_ns
        self._log.note("warning" if order.verb in URGENT else "info", f"{console} orders: {said}", now_ns)
        untold = UNTOLD if order.verb in URGENT and self._module is None else None
        answer = self._said(ordered, order, said, untold, now_ns)
        self._memory.keep(console, order, answer)
        return answer

    def _note(self, verb: str, what: Args, text: str) -> None:
        """Of what concerns the same part the newest holds."""
        if isinstance(what, Resume):
            self._holds = {part: held for part, held in self._holds.items() if part == "motors"}
        elif verb not in (CLOCK, "tare"):
            self._holds[what.name if isinstance(what, Set) else PARTS.get(verb, "body")] = text[:MAX_WORDS]

    def _too_old(self, order: Order, now_ns: int) -> str:
        """Why it comes too late; empty: it does not."""
        if order.verb in URGENT or order.verb == CLOCK:
            return ""
        if order.seen is None:
            return "it does not say which State of the robot was looked at"
        incarnation, seen_ns = order.seen
        if incarnation != self._incarnation:
            return "the robot has started again since; look at what it does, and order again"
        if not 0 <= now_ns - seen_ns <= STALE_NS:
            return f"it goes by a State of {(now_ns - seen_ns) * 1e-9:.1f} s ago; look at the newest, and order again"
        if order.verb == "arm" and seen_ns <= self._halted_ns:
            return "somebody has ordered a stop or a surfacing since; look whether that is over, and order again"
        return ""

    def _unable(self, what: Args) -> str:
        """Why the control module cannot do it now; empty: it can. When it could, later, who orders may be elsewhere."""
        if not isinstance(what, Arm | Tare):
            return ""
        if self._module is None:
            return "its control module is silent; look at its cable, and order again"
        if isinstance(what, Tare) and abs(self._module.depth_m) > WEATHER_M:
            depth = f"its sensors read {self._module.depth_m:+.2f} m by the zero that they have"
            return f"{depth}; take it out of the water, or if it is in air: aucamp board tare --depth 0"
        return ""

    def _left_out(self, ordered: Ordered, now_ns: int) -> Answer:
        """The answer to an order whose step broke."""
        try:
            order = decode(ordered.payload, Order, MAX_ORDER)
            what: Args = arguments(order.verb, order.args)
        except Exception:  # noqa: BLE001 - whatever broke the step
            return self._said(ordered, None, "", BROKE, now_ns)
        why: str | None = BROKE
        if order.verb in URGENT:
            try:
                return self._answer(ordered, now_ns)
            except Exception:  # noqa: BLE001 - the motors go off whatever is broken
                if not why_closed(self._fleet, ordered.console):
                    self._commands.halt(order.verb)
                    self._halted_ns, why = now_ns, None
        return self._said(ordered, order, in_words(order.verb, what), why, now_ns)

    def _said(self, ordered: Ordered, order: Order | None, said: str, why: str | None, now_ns: int) -> Answer:
        """why: it is refused; None: it is done."""
        return Answer(
            robot=self._name,
            console=ordered.console[:16],
            id=0 if order is None else order.id,
            order=said,
            ok=why is None,
            why=(why or "")[:MAX_WORDS],
            arrived_ns=ordered.arrived_ns,
            sent_ns=now_ns,
        )
