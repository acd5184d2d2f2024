"""The wish that a board be armed: asked again while waiting can cure a refusal, given up for good when it cannot."""

from __future__ import annotations

from hw.firmware import wire
from hw.stm32.fields import StatusText

AGAIN_NS = 500_000_000  # after a refusal that time alone can cure

# Refusals that go away while the robot just waits; each other one needs somebody to do something.
CURABLE = frozenset(
    {
        "no handshake",
        "sensors not all good",
        "sensors disagree",
        "set-point old",
        "ESC neutral for less than 3 s",
        "control cycle too slow",
    }
)


LATCHED = "fault latched"
REBOOT = "look at the robot, then `aucamp board reboot`"


class Arming:
    """What we want, what the board is, and when to ask. Methods that return a line want it to be said."""

    def __init__(self) -> None:
        self.wanted = False
        self.armed = False  # what the board said last
        self._ordered = False  # `want` was called and the board has not agreed yet
        self._due_ns = 0
        self._refusal = ""

    def want(self) -> None:
        """Ask as soon as the board can. One that is armed and surfaces is called back to work by the same order."""
        self.wanted = self._ordered = True
        self.begin()

    def begin(self) -> None:
        """Ask at once: a new wish, or a new port."""
        self._due_ns = 0
        self._refusal = ""

    def due(self, now_ns: int) -> bool:
        """Whether it is time to send the order."""
        return self.wanted and (self._ordered or not self.armed) and now_ns >= self._due_ns

    def later(self, now_ns: int) -> None:
        """The order got no answer."""
        self._due_ns = now_ns + AGAIN_NS

    def answered(self, ok: bool, now_ns: int) -> None:
        self.armed = ok
        self._ordered = self._ordered and not ok
        self.later(now_ns)

    def seen(self, armed: bool) -> StatusText | None:
        """What telemetry shows. A board that disarms by itself is not armed again."""
        line = self.give_up("the board has disarmed") if self.armed and not armed else None
        self.armed = armed
        return line

    def refused(self, mask: int) -> StatusText | None:
        """Why, as the bits of wire.ARM_CHECKS; the same reason is told once."""
        why = [check for i, check in enumerate(wire.ARM_CHECKS) if mask >> i & 1]
        text, before = ", ".join(why), self._refusal
        self._refusal = text
        if not CURABLE.issuperset(why):
            remedy = REBOOT if LATCHED in why else "put it right"
            return self.give_up(f"arming refused: {text}; {remedy}, then arm again")
        return StatusText("info", f"arming waits: {text}") if text != before else None

    def give_up(self, text: str) -> StatusText | None:
        """The board is not armed, and from here on nobody wants it to be until somebody says so again."""
        line = StatusText("error", text) if self.wanted else None
        self.wanted = self.armed = False
        return line
