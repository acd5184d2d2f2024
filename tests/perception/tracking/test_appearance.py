"""How like a lost thing a place has to be to be taken for it: like enough to be held, and more so in company."""

import cv2
import numpy as np
import pytest

from agent.perception.tracking import follow
from agent.perception.tracking.appearance import Box, Likeness, Place, agreement, gains_of, learn
from agent.perception.tracking.follow import FOLLOWED, Follower, load_box_tracker
from tests.perception.tracking.swimming import overlap

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
    faded = Likeness(follow.STRONG_SHAPE - 0.01, follow.STRICT.hold_colour - 0.02)
    seen["held"], seen["places"] = faded, [Place(HERE, faded)]
    assert [state(follower) for _ in range(3)] == ["lost"] * 3


def test_a_strong_shape_is_held_while_its_colours_fade(seen):
    """A plain dark fish on grey water has hardly any colour of its own; without all of it, it is another thing."""
    follower = follow.Follower(Standing())
    follower.start(IMAGE, HERE)
    seen["held"] = Likeness(follow.STRONG_SHAPE, follow.LEAST_COLOUR)
    assert [state(follower) for _ in range(3 * follow.STRICT.patience)] == ["followed"] * 3 * follow.STRICT.patience
    gone = Likeness(follow.STRONG_SHAPE, follow.LEAST_COLOUR - 0.02)
    seen["held"], seen["places"] = gone, [Place(HERE, gone)]
    assert state(follower) == "lost"


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


# --- loss ---
# A thing that leaves slowly, is hidden, or has look-alikes: lost is said, and no other thing is taken for it.

WIDTH, HEIGHT, RADIUS = 240, 180, 14
RED, YELLOW = (40, 40, 190), (40, 170, 190)  # blue green red
GRACE = 15  # frames


@pytest.fixture(scope="module")
def water():
    coarse = np.random.default_rng(0).integers(0, 60, (12, 16, 3)) + np.array([120, 100, 20])
    return cv2.resize(coarse.astype(np.uint8), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


def picture(water, *balls, seed=0):
    """balls: (u, v, colour); noise as of a camera."""
    image = water.copy()
    for u, v, colour in balls:
        cv2.circle(image, (round(16 * u), round(16 * v)), 16 * RADIUS, colour, -1, cv2.LINE_AA, shift=4)
        cv2.circle(image, (round(16 * u - 60), round(16 * v - 80)), 60, (230, 230, 230), -1, cv2.LINE_AA, shift=4)
    noise = np.random.default_rng(seed).normal(0, 3, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def around(u, v):
    return Box(u - RADIUS + 0.5, v - RADIUS + 0.5, 2 * RADIUS, 2 * RADIUS)


def states(frames, box):
    follower = Follower(load_box_tracker(None))
    follower.start(frames[0], box)
    return [follower.look(frame) for frame in frames[1:]]


def path(still, out, away, back):
    """How far to the right a thing has gone, 0 to 1: it leaves slowly, stays away and comes back."""
    return [0.0] * still + list(np.linspace(0, 1, out)) + [1.0] * away + list(np.linspace(1, 0, back)) + [0.0] * still


@pytest.mark.parametrize("other", [(60, 90, YELLOW), (60, 90, RED)], ids=["yellow stays", "a red one stays too"])
def test_what_leaves_slowly_is_lost_and_nothing_else_is_taken_for_it(water, other):
    ways = path(2, 20, 20, 8)
    places = [160 + 100 * way for way in ways]
    frames = [picture(water, other, (u, 60, RED), seed=k) for k, u in enumerate(places)]
    seen = states(frames, around(160, 60))
    gone = [k for k, u in enumerate(places) if u - RADIUS > WIDTH]
    assert all(seen[k - 1].lost for k in gone[GRACE:])
    assert not any(now.state in FOLLOWED and overlap(now.box, around(*other[:2])) > 0.1 for now in seen)
    assert all(not now.lost for k, now in enumerate(seen, start=1) if places[k] + RADIUS < WIDTH and k < gone[0])
    assert not seen[-1].lost and overlap(seen[-1].box, around(160, 60)) > 0.6
    assert [now.state for now in seen].count("found again") == 1


def test_what_is_hidden_is_lost(water):
    frames = [picture(water, (120, 90, RED), seed=k) for k in range(38)]
    for k, frame in enumerate(frames):
        left = max(105, 160 - 4 * k)
        frame[70:112, left : left + 45] = water[10:52, 20:65]
    seen = states(frames, around(120, 90))
    assert seen[0].state == "followed"
    assert all(now.lost for now in seen[15 + GRACE :])


def test_what_meets_a_look_alike_is_ambiguous_and_the_look_alike_is_not_taken_for_it(water):
    places = [min(96 + 3 * k, 150) for k in range(28)]
    frames = [picture(water, (u, 90, RED), (150, 90, RED), seed=k) for k, u in enumerate(places)]
    seen = states(frames, around(96, 90))
    assert all(now.state in FOLLOWED for now in seen[:10])
    assert all(now.state == "ambiguous" for now in seen[17:])


def test_what_passes_a_look_alike_is_followed_again_and_the_look_alike_is_not(water):
    places = [70 + 5 * k for k in range(30)]
    frames = [picture(water, (150, 90, RED), (u, 84, RED), seed=k) for k, u in enumerate(places)]
    seen = states(frames, around(70, 84))
    assert not seen[-1].lost and overlap(seen[-1].box, around(places[-1], 84)) > 0.6
    apart = [k for k, u in enumerate(places) if u > 150 + 2 * RADIUS + 5]
    assert all(overlap(seen[k - 1].box, around(150, 90)) < 0.2 for k in apart if not seen[k - 1].lost)


def test_two_places_that_are_equally_like_it_are_ambiguous_until_one_is_gone(water):
    follower = Follower(load_box_tracker(None))
    follower.expect(picture(water, (120, 90, RED)), around(120, 90))
    two = follower.look(picture(water, (60, 60, RED), (180, 120, RED), seed=1))
    assert two.state == "ambiguous" and two.lost and two.score == 0.0
    one = follower.look(picture(water, (60, 60, RED), seed=2))
    assert one.state == "followed" and overlap(one.box, around(60, 60)) > 0.6


def test_colours_tell_red_from_yellow_whatever_the_light():
    water = np.full((HEIGHT, WIDTH, 3), (130, 110, 30), np.uint8)
    image, other = picture(water, (120, 90, RED)), picture(water, (120, 90, YELLOW))
    colours = learn(image, around(120, 90))
    darker = (0.6 * image).astype(np.uint8)
    assert agreement(colours, image, around(120, 90), gains_of(image)) == pytest.approx(1.0, abs=0.02)
    assert agreement(colours, darker, around(120, 90), gains_of(darker)) > 0.8
    assert agreement(colours, other, around(120, 90), gains_of(other)) < 0.45
    assert agreement(colours, image, around(40, 40), gains_of(image)) < 0.3
