"""Golden cases of robots that swim in the dark and light for each other: after a fish, in search, and in a survey."""

from __future__ import annotations

from pathlib import Path

from msgspec import UNSET
from msgspec.structs import replace

from agent.core.capability_messages import Claim, Keyframe
from agent.core.messages import Message
from tests.capabilities.light.dark_fish import DarkFish
from tests.capabilities.light.dark_survey import DarkSurvey
from tests.golden.swim import record
from tests.replay.step_box import Said

FISH_M_S = 0.15
NOWHERE = 10**6, 10**6, 0  # 0.1 mm


def fish(out: Path) -> None:
    """Three robots find a fish by their lamps and go with it."""
    seconds = 20.0
    world = DarkFish(126, FISH_M_S, seconds)
    world.follows_points = False
    record(world, out, seconds)


def dark_survey(out: Path) -> None:
    """Three robots survey by lent light; an order to r1's lamp spoils its view, and some words are forged."""
    world = DarkSurvey(9)
    world.follows_points, world.forged = False, forged
    record(world, out, 20.0, [Said(17.5, "lamp", {"light": 0.5}), Said(18.5, "resume")])


def forged(letter: Message) -> Message:
    """Claims from outside the tank, keyframes from there or without depths."""
    if isinstance(letter, Claim) and letter.src == "r2" and letter.view is not UNSET and letter.seq % 4 == 0:
        return replace(letter, view=replace(letter.view, place=NOWHERE))
    if isinstance(letter, Keyframe) and letter.seq < 3:
        wrong = {"depths": b""} if letter.seq % 2 else {"place": NOWHERE}
        return replace(letter, frame=replace(letter.frame, **wrong))
    return letter
