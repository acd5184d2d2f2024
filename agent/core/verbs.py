"""THE table of verbs: what can be ordered, and with which arguments. docs/orders.md says what each does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from agent.core.codec import Refusal, prepare
from agent.core.config import Follow, Goto, Name, Orbit, Search, Struct, Survey, Trial, Turn
from agent.core.messages import MAX_WORDS, Arg

Setting = Literal["sweeps", "send_hz", "preview_hz", "speed_m_s"]
Box = Annotated[float, Meta(ge=0, le=16384)]  # pixels


class Stop(Struct, frozen=True, kw_only=True):
    """Motors off, at once."""


class Disarm(Struct, frozen=True, kw_only=True):
    """Motors off, at once: another word for stop."""


class Surface(Struct, frozen=True, kw_only=True):
    """Go up level and switch the motors off there."""


class Arm(Struct, frozen=True, kw_only=True):
    """Motors on, as soon as the control module agrees; one that surfaces is called back."""


class Tare(Struct, frozen=True, kw_only=True):
    """What the pressure sensors read now is air: for a robot that lies still, out of the water, its motors off."""


class Resume(Struct, frozen=True, kw_only=True):
    """Do again all that the fleet file says. The motors stay as they are."""


class Clock(Struct, frozen=True, kw_only=True):
    """Say what time it is there."""


class HoldHere(Struct, frozen=True, kw_only=True):
    """Stay, at a depth; one that swims stays where it is now."""

    depth_m: float | None = None  # none: as deep as it is told to be


class LookAt(Struct, frozen=True, kw_only=True):
    """Turn the camera there and keep it there: degrees, pan positive to the left, tilt positive upwards."""

    pan_deg: float
    tilt_deg: float = 0.0


class Burn(Struct, frozen=True, kw_only=True):
    """Light the own lamp, or put it out, and turn it there: as the camera's gimbal counts."""

    light: Annotated[float, Meta(ge=0, le=1)]  # share of full power
    pan_deg: float = 0.0
    tilt_deg: float = 0.0


class DrawBox(Struct, frozen=True, kw_only=True):
    """A target of detector "box" is what is in this box of that frame: pixels of the frame."""

    frame: Annotated[int, Meta(ge=0, le=2**63 - 1)]  # number of the frame, as previews say
    x: Box
    y: Box
    width: Box
    height: Box
    target: Name | None = None  # none: the only one


class Set(Struct, frozen=True, kw_only=True):
    """Change a setting until the agent ends, or until `resume`."""

    name: Setting
    value: float


BEHAVIOURS = (Goto, Turn, Orbit, Trial, Follow, Search, Survey)
Args = (
    Stop
    | Disarm
    | Surface
    | Arm
    | Tare
    | Resume
    | Clock
    | HoldHere
    | LookAt
    | Burn
    | DrawBox
    | Set
    | Goto
    | Turn
    | Orbit
    | Trial
    | Follow
    | Search
    | Survey
)

VERBS: Mapping[str, type[Args]] = MappingProxyType(
    {
        "stop": Stop,
        "disarm": Disarm,
        "surface": Surface,
        "arm": Arm,
        "tare": Tare,
        "hold": HoldHere,
        "look": LookAt,
        "lamp": Burn,
        "goto": Goto,
        "turn": Turn,
        "orbit": Orbit,
        "follow": Follow,
        "search": Search,
        "survey": Survey,
        "trial": Trial,
        "target_box": DrawBox,
        "set": Set,
        "resume": Resume,
        "clock": Clock,
    }
)
CLOCK = "clock"  # answered at once, and of no age
URGENT = ("stop", "disarm", "surface")  # never refused for their age


def arguments(verb: str, args: Mapping[str, Arg], strict: bool = True) -> Args:
    """What was ordered, its types checked. strict: numbers are numbers; else texts that are some will do. Raises
    Refusal."""
    kind = VERBS.get(verb)
    if kind is None:
        raise Refusal("content", f"no verb {verb!r}; there are {', '.join(VERBS)}")
    for name, value in args.items():
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise Refusal("content", f"{verb}: {name[:40]}: a whole number of more than 64 bits; write a smaller one")
    try:
        found = msgspec.convert(dict(args), kind, strict=strict)
    except msgspec.ValidationError as error:
        what, _, where = str(error).partition(" - at `$.")
        about = where.rstrip("`") + ": " if where else ""
        raise Refusal("content", f"{verb}: {about}{_plain(what)}") from None
    for name in args:
        value = getattr(found, name)
        if isinstance(value, float) and not math.isfinite(value):
            raise Refusal("content", f"{verb}: {name}: {value} is no number; write one, such as 0.3")
    return found


def in_words(verb: str, what: Args) -> str:
    """An order as a person would type it."""
    given = {name: getattr(what, name) for name in what.__struct_fields__}
    shown = [f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}" for name, value in given.items()]
    told = [text for text, value in zip(shown, given.values(), strict=True) if value is not None]
    return " ".join((verb, *told))[:MAX_WORDS]


def within(name: str, value: float, lowest: float, highest: float) -> None:
    """Raises Refusal for a value that is not."""
    if not lowest <= value <= highest:
        raise Refusal("content", f"{name}: {value:g} is not within {lowest:g} to {highest:g}")


def _plain(what: str) -> str:
    """A mistake as msgspec names it, in words for a person."""
    for sign, words in (
        ("Object missing required field `", "required, and missing: "),
        ("Object contains unknown field `", "there is no such argument: "),
    ):
        if what.startswith(sign):
            return words + what[len(sign) :].rstrip("`")[:40]
    if what.startswith("Invalid enum value"):  # one verb has a choice
        return f"{what.rsplit(' ', 1)[-1][:40]} is no choice; there are {', '.join(get_args(Setting))}"
    return what[0].lower() + what[1:100]


def prepare_all() -> None:
    """Have msgspec look into every kind of message and order, before a second thread reads any (codec.prepare)."""
    prepare()
    for kind in VERBS.values():
        with suppress(msgspec.ValidationError):
            msgspec.convert(None, kind)
