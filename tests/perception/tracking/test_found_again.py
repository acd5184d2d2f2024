"""How like a lost thing a place has to be to be taken for it: like enough to be held, and more so in company."""

import numpy as np
import pytest

from agent.perception.tracking import follow
from agent.perception.tracking.appearance import Box, Likeness, Place

IMAGE, HERE, ELSEWHERE = np.full((120, 160, 3), 90, np.uint8), Box(40, 40, 30, 30), Box(110, 10, 30, 30)


class Standing:
    """A tracker of a thing that stays where it is."""

    def start(self, image, box):
        pass

    def follow(self, image):
        return HERE

    def learn(self, image, box):
        pass


@pytest.fixture
def seen(monkeypatch):
    """What a follower finds: how like it is where it is held, and places of the whole picture."""
    found = {"held": Likeness(0.95, 1.0), "places": [Place(HERE, Likeness(0.95, 1.0))]}
    monkeypatch.setattr(follow, "likeness", lambda appearance, image, box: found["held"])
    monkeypatch.setattr(follow, "search", lambda *about: found["places"])
    monkeypatch.setattr(follow, "fitted", lambda appearance, image, place: place)
    monkeypatch.setattr(follow, "beside", lambda *about: [])
    monkeypatch.setattr(follow, "coloured", lambda *about: [])
    return found


def state(follower):
    return follower.look(IMAGE).state


def test_what_would_not_be_held_is_not_found(seen):
    """Its colours fade until they are too few; the same few, beside what it showed lately, would else be enough."""
    follower = follow.Follower(Standing())
    follower.start(IMAGE, HERE)
    for colour in np.linspace(1.0, 0.46, 60):
        seen["held"] = Likeness(0.95, float(colour))
        assert state(follower) == "followed"
    faded = Likeness(0.95, follow.HOLD_COLOUR - 0.02)
    seen["held"], seen["places"] = faded, [Place(HERE, faded)]
    assert [state(follower) for _ in range(3)] == ["lost"] * 3


@pytest.mark.parametrize(("company", "like", "then"), [
    (False, 0.75, "found again"), (True, 0.75, "lost"), (True, 0.9, "found again"),
])  # fmt: skip
def test_in_company_it_takes_more_to_be_found(seen, company, like, then):
    rival = [Place(ELSEWHERE, Likeness(0.6, 0.6))] if company else []
    seen["places"] = [Place(HERE, Likeness(0.95, 1.0)), *rival]
    follower = follow.Follower(Standing())
    follower.start(IMAGE, HERE)
    seen["held"] = Likeness(0.2, 1.0)
    seen["places"] = rival
    assert state(follower) == "lost"
    seen["places"] = [Place(HERE, Likeness(like, like)), *rival]
    assert state(follower) == then
