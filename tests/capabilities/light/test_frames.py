"""The rule for whole frames: what it expects of lamps, and that it finds the best set of its own score."""

import itertools
import math

import pytest
from msgspec.structs import replace

from agent.capabilities.light.allocate import FrameScene, Lamp, Spot, allocate_frame, glares, lit, log_js, shown
from agent.capabilities.light.model import pair
from agent.core.config import Lighting, WaterOptics

HARBOUR = Lighting(water=WaterOptics(absorption_per_m=(0.55, 0.37, 0.45), scattering_per_m=(1.82, 1.82, 1.82)))
UP = (0.0, 0.0, 1.0)
EYE = (1.0, 1.0, 0.3)
SPOTS = tuple(Spot((1.0 + x, 1.0 + y, 0.0), UP, 24.0) for x in (0.4, 0.6, 0.8, 1.0) for y in (-0.2, 0.0, 0.2))
MIDDLE = (1.7, 1.0, 0.0)
AXIS = tuple((m - e) / math.dist(MIDDLE, EYE) for m, e in zip(MIDDLE, EYE, strict=True))
SCENE = FrameScene(EYE, AXIS, MIDDLE, SPOTS, 25)
OWN_M, ASIDE_M, FACING_M = (1.0, 1.12, 0.3), (1.5, 1.6, 0.3), (2.3, 1.0, 0.3)
LAMPS = {"r1": Lamp(OWN_M), "r2": Lamp(ASIDE_M), "r3": Lamp((1.6, 0.3, 0.3)), "r4": Lamp(FACING_M)}


def test_a_lamp_from_aside_shows_blocks_that_the_own_one_veils() -> None:
    choice = allocate_frame("r1", SCENE, LAMPS, HARBOUR)
    assert choice.blocks > 1.1 * choice.own_blocks
    assert choice.lamps != ("r1",) and "r4" not in choice.lamps  # which shines into the camera


def test_it_finds_the_best_set_of_its_own_score_but_for_two_percent() -> None:
    choice = allocate_frame("r1", SCENE, LAMPS, HARBOUR)
    lits = {name: lit(SCENE, lamp.place_m, HARBOUR) for name, lamp in LAMPS.items() if name != "r4"}
    sets = [some for size in (1, 2, 3) for some in itertools.combinations(sorted(lits), size)]
    assert choice.blocks >= 0.98 * max(shown(SCENE, [lits[name] for name in some]) for some in sets)


def test_borrowed_light_has_to_bring_its_gain() -> None:
    assert allocate_frame("r1", SCENE, LAMPS, replace(HARBOUR, gain=1e9)).lamps == ("r1",)


def test_lamps_that_are_not_free_are_not_asked() -> None:
    busy = {name: lamp._replace(free=name == "r1") for name, lamp in LAMPS.items()}
    assert allocate_frame("r1", SCENE, busy, HARBOUR).lamps == ("r1",)


def test_what_is_known_does_not_count() -> None:
    known = SCENE._replace(spots=tuple(spot._replace(blocks=0.0) for spot in SPOTS))
    choice = allocate_frame("r1", known, LAMPS, HARBOUR)
    assert choice.blocks == 0.0 and choice.lamps == ("r1",)


def test_a_near_spot_is_paid_for_by_the_far_ones() -> None:
    bright = Spot((1.15, 1.0, 0.25), (-1.0, 0.0, 0.0), 0.0)
    lamp = [lit(SCENE, OWN_M, HARBOUR)]
    crowded = SCENE._replace(spots=(bright, *SPOTS))
    with_it = log_js(crowded, [lit(crowded, OWN_M, HARBOUR)])[1:]
    assert all(less < more for less, more in zip(with_it, log_js(SCENE, lamp), strict=True))


def test_light_on_a_spot_and_veil_are_those_of_a_target_in_the_middle_of_the_picture() -> None:
    """Against model.pair, at a small ball in the place of the middle spot that faces the camera as the spot does."""
    back = tuple(-a for a in AXIS)
    one = SCENE._replace(spots=(Spot(MIDDLE, back, 1.0),))
    for lamp_m in (OWN_M, ASIDE_M):
        here, ball = lit(one, lamp_m, HARBOUR), pair(EYE, MIDDLE, 1e-4, lamp_m, HARBOUR)
        assert here.direct[0] == pytest.approx(ball.direct[0], rel=2e-3)
        assert here.veil[0] == pytest.approx(ball.veil, rel=0.02)


def test_lamps_behind_the_view_glare_and_those_before_it_do_not() -> None:
    assert glares(SCENE, FACING_M) and not glares(SCENE, OWN_M) and not glares(SCENE, ASIDE_M)
