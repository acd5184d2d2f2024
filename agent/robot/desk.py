"""Who may order what, and when: every order is judged, carried out at most once, and answered.

Nobody's clock is compared with another's: an order says which State of the robot was looked at, by the robot's own
stamp. One that goes by a State of three seconds ago or of an earlier start is refused.
A stop, in whatever words, is never refused for its age, and no arm that was on its way undoes it.
"""

from __future__ import annotations

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agent.capabilities.light.lights import Lights
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.codec import Refusal, decode
from agent.core.config import Fleet, Survey
from agent.core.control.target_search import Seek
from agent.core.messages import MAX_ORDER, MAX_WORDS, Answer, Order
from agent.core.status import Logbook
from agent.core.step_io import Ordered, Outputs
from agent.core.step_transaction import Revertible
from agent.robot.doing import Doing
from agent.robot.memory import Memory
from agent.robot.rights import why_closed
from agent.robot.verbs import CLOCK, URGENT, Args, Resume, Set, arguments, in_words
from agent.robot.wishes import AtOnce, Wishes

PARTS = {**dict.fromkeys(("stop", "disarm", "surface", "arm"), "motors"), "look": "camera", "lamp": "lamp"}
PARTS |= {"target_box": "box"}
STALE_NS = 3_000_000_000
BROKE = "the step that it came with broke, and it was left out; order again"


class Desk(Revertible):
    """Of one robot, between steps."""

    def __init__(
        self, fleet: Fleet, name: str, incarnation: int, swimmer: Swimmer | None, lights: Lights, log: Logbook
    ) -> None:
        self._fleet, self._name, self._incarnation, self._log = fleet, name, incarnation, log
        self._doing, self._memory = Doing(fleet, name, swimmer, lights), Memory()
        self._halted_ns = -1  # when a stop or a surfacing was ordered last
        self._holds: dict[str, str] = {}  # what each of a robot's parts is ordered to do, and by whom
        self._now: dict[tuple[str, bytes], Answer] = {}  # of this step

    @property
    def wishes(self) -> Wishes:
        return self._doing.wishes

    @property
    def surveys(self) -> bool:
        """A survey may have camera and lens."""
        return self.wishes.sweeps and isinstance(self.wishes.behaviour, Survey | None)

    def looks(self, seek: Seek, now_ns: int) -> bool:
        """Turn the camera where somebody wants it; returns whether it is taken from the target. Not in a sweep."""
        if self.wishes.gaze_deg is None or seek.measuring or seek.pointing.goal_us is None:
            return False
        seek.look(*self.wishes.gaze_deg, now_ns)
        return True

    @property
    def ordered(self) -> tuple[str, ...] | UnsetType:
        """What people have ordered that holds, for whoever looks."""
        return tuple(self._holds.values()) or UNSET

    def take(self, orders: tuple[Ordered, ...] | UnsetType, now_ns: int) -> None:
        """Judge and carry out what arrived since the last step."""
        for ordered in orders or ():
            self._now[ordered.console, ordered.payload] = self._answer(ordered, now_ns)

    def complete(self, outputs: Outputs, orders: tuple[Ordered, ...] | UnsetType, now_ns: int) -> Outputs:
        """The outputs of a step with an answer to each order, and what they want of the devices.

        Outside of the net: an order that broke the step, or came with one that came to nothing, is answered here; and
        if it was a stop, it is one still.
        """
        if orders is UNSET:
            return outputs
        answers = tuple(
            self._now.get((ordered.console, ordered.payload)) or self._left_out(ordered, now_ns) for ordered in orders
        )
        self._now = {}
        at_once, self._doing.at_once = self._doing.at_once, AtOnce()
        return replace(outputs, answers=answers, motors=at_once.motors, box=at_once.box, preview_hz=at_once.preview_hz)

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
            if why := again or self._too_old(order, now_ns):
                raise Refusal("content", why)
            self._doing.carry_out(what)
        except Refusal as refusal:
            text = "".join(letter if letter.isprintable() else "?" for letter in str(refusal))  # some are a stranger's
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
        answer = self._said(ordered, order, said, None, now_ns)
        self._memory.keep(console, order, answer)
        return answer

    def _note(self, verb: str, what: Args, text: str) -> None:
        """Of what concerns the same part the newest holds."""
        if isinstance(what, Resume):
            self._holds = {part: held for part, held in self._holds.items() if part == "motors"}
        elif verb != CLOCK:
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
                    self._doing.halt(order.verb)
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
