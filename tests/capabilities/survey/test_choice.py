"""Where to look next: better than anywhere, the same on every machine, and elsewhere than where others look."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.survey import candidates
from agent.capabilities.survey.candidates import (
    TILTS_DEG,
    Ahead,
    Candidate,
    Where,
    ahead,
    better,
    drawn,
    gain,
    with_claims,
)
from agent.capabilities.survey.coverage_map import CoverageMap, dose, place_m, rotation
from agent.capabilities.survey.survey import APART_M, CLAIMS_EACH_STEP, EACH_STEP, Surveyor
from agent.core.capability_messages import Blocks, Frame, quantised
from agent.core.config import Body, Navigation, Pose
from agent.core.ranging.camera_model import Calibration
from agent.experiments.reconstruction.coverage import (
    PLACES,
    SIZE_M,
    SURFACE_M,
    SURVEY_CAMERA,
    draw_scene,
    fleet_of,
    look,
    sigma_m,
)
from tests.capabilities.survey.frames import GRID, LENS, ROWS, SIGMA
from tests.known_lens import PLAIN

ROOM = ((0.3, 0.3), (1.2, 0.9))


def where(k: int = 0, room=None) -> Where:
    x, y, yaw = PLACES[k]
    return Where(Pose(x_m=x, y_m=y, yaw_deg=yaw), 0.25, SURFACE_M, Body(), LENS, ROWS, SIGMA, room)


def seen(scene, candidate: Candidate, number: int, rng) -> Frame:
    """What the sweep of a candidate would measure there."""
    view = candidate.view
    found = look(scene, np.array(place_m(view.place)), np.array(rotation(view.turn)), SURVEY_CAMERA, LENS.block)
    sigma = sigma_m(np.minimum(found.z_m, 5.0))
    noise = rng.normal(size=sigma.size)
    z = [float(d + s * e) if d < 1.6 else None for d, s, e in zip(found.z_m, sigma, noise, strict=True)]
    packed = quantised(Blocks(LENS.cols, tuple(z), tuple(map(float, sigma))))
    return Frame("r1", 1, number, view.place, view.turn, LENS, *packed)


def by_map(known: CoverageMap, claims=(), k: int = 0) -> Ahead:
    return ahead(where(k), GRID, known.cells, known.solid(), claims)


def chosen(known: CoverageMap, robot: str, number: int, k: int, count: int = 12):
    by, best = by_map(known, (), k), None
    for n in range(count):
        best = better(best, drawn(where(k), robot, number, n), by)
    return best


def test_greedy_is_better_than_random_in_ten_worlds():
    won = 0
    for seed in range(10):
        scene, rng = draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), 50 + seed), np.random.default_rng(seed)
        gains = []
        for greedy in (True, False):
            known = CoverageMap(GRID)
            for number in range(1, 5):
                k = number % len(PLACES)
                best = chosen(known, "r1", number, k) if greedy else None
                candidate = drawn(where(k), "r1", number, 0) if best is None else best.candidate
                known.add(seen(scene, candidate, number, rng))
            gains.append(gain(known.cells, GRID, {}))
        won += gains[0] > gains[1]
        assert gains[0] > 0.9 * gains[1]
    assert won >= 9


def test_the_draw_is_of_name_and_number_and_within_the_gimbals_reach():
    for k in range(60):
        one = drawn(where(room=ROOM), "r1", 7, k)
        assert one == drawn(where(room=ROOM), "r1", 7, k)
        station = one.station
        assert TILTS_DEG[0] <= station.tilt_deg <= TILTS_DEG[1] and abs(station.pan_deg) <= 50.0 + 1e-9
        if k % 3:
            assert all(low <= at <= high for low, at, high in zip(ROOM[0], station.place_m, ROOM[1], strict=True))
        else:
            assert station.place_m == PLACES[0][:2]
        moored = drawn(where(), "r1", 7, k).station
        assert moored.place_m == PLACES[0][:2] and -90.0 <= moored.pan_deg <= 90.0
    assert drawn(where(), "r1", 7, 0) != drawn(where(), "r2", 7, 0) != drawn(where(), "r2", 8, 0)


def test_of_equals_the_first_is_taken_and_what_gains_nothing_never():
    known = CoverageMap(GRID)
    by, one = by_map(known), drawn(where(), "r1", 1, 3)
    first = better(None, one, by)
    assert first is not None and better(first, replace_seconds(one), by) is first
    full = ahead(where(), GRID, dict.fromkeys(range(math.prod(GRID.shape)), GRID.goal), frozenset(), ())
    assert better(None, one, full) is None


def replace_seconds(one: Candidate) -> Candidate:
    return one._replace(seconds=one.seconds)


def test_what_another_claims_is_no_gain_any_more():
    known = CoverageMap(GRID)
    one = drawn(where(), "r1", 1, 3)
    alone, claimed = (better(None, one, by_map(known, views)) for views in ((), (one.view,) * 3))
    assert alone is not None and (claimed is None or claimed.gain < 0.2 * alone.gain)
    views = [drawn(where(k), "r2", 1, 5 + k).view for k in range(3)]
    assert by_map(known, views) == ahead(where(), GRID, known.cells, known.solid(), views[::-1])


@pytest.fixture
def surveyor() -> Surveyor:
    fleet = replace(fleet_of(), navigation=Navigation())
    return Surveyor(fleet, "r1", Calibration(robot="r1", made="", source="", focus=PLAIN, camera=SURVEY_CAMERA), 1)


def choose(surveyor: Surveyor, claims=(), others=()) -> None:
    for k in range(40):
        surveyor.choose(Pose(x_m=0.5, y_m=0.5, yaw_deg=0.0), claims, others, k)


def test_many_claims_are_taken_in_over_some_steps_and_all_count(surveyor, monkeypatch):
    """Each costs a hundred rays through the map."""
    claims = tuple(drawn(where(k % 5), "r2", k, 5).view for k in range(2 * CLAIMS_EACH_STEP + 1))
    views, sound, known = [], candidates.expected, surveyor.known
    monkeypatch.setattr(candidates, "expected", lambda view, *by: (views.append(view), sound(view, *by))[1])
    for k in range(3):
        views.clear()
        surveyor.choose(Pose(x_m=0.5, y_m=0.5, yaw_deg=0.0), claims, (), k)
        assert len(views) <= CLAIMS_EACH_STEP + EACH_STEP
    assert surveyor._ahead.cells == with_claims(known.cells, known.solid(), claims, known.grid)


def test_a_robot_that_swims_goes_nowhere_near_another(surveyor):
    other = (0.9, 0.6)
    choose(surveyor, others=(other,))
    assert surveyor.phase == "go" and math.dist(surveyor.station.place_m, other) >= APART_M
    assert surveyor.view is not None


def test_it_gives_up_what_it_cannot_reach_and_what_never_comes_to_rest(surveyor):
    choose(surveyor)
    before = surveyor.station
    far = Pose(x_m=before.place_m[0] + 0.5, y_m=before.place_m[1], yaw_deg=0.0)
    surveyor.go(far, True, 10 * 10**9)
    assert surveyor.phase == "go"
    surveyor.go(far, True, 40 * 10**9)
    assert surveyor.phase == "choose" and surveyor.view is None
    for k in range(40):
        surveyor.choose(Pose(x_m=0.5, y_m=0.5, yaw_deg=0.0), (), (), 41 * 10**9 + k)
    assert surveyor.phase == "go" and surveyor.station != before
    there = surveyor.station
    pose = Pose(x_m=there.place_m[0], y_m=there.place_m[1], yaw_deg=math.degrees(there.yaw) + 3.0)
    surveyor.go(pose, True, 42 * 10**9)
    assert surveyor.phase == "look"
    assert surveyor.gimbal_deg(pose)[0] == pytest.approx(there.pan_deg - 3.0)
    assert surveyor.sweep(False, 43 * 10**9) is None
    plan = surveyor.sweep(True, 44 * 10**9)
    assert plan is not None and plan.block_px == LENS.block and surveyor.phase == "sweep"
    assert not surveyor.missed(45 * 10**9) and surveyor.missed(80 * 10**9) and surveyor.phase == "choose"


def test_doses_of_what_it_saw_are_in_its_map(surveyor):
    one = seen(
        draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), 50), drawn(where(), "r1", 1, 3), 1, np.random.default_rng(1)
    )
    surveyor.known.add(one)
    assert surveyor.known.cells == dict(dose(one, surveyor.known.grid))
