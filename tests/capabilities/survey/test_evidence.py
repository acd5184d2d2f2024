"""The map is the same to the bit whatever the order, however often a keyframe comes, and whoever lies."""

import random
import subprocess
import sys

import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.survey.candidates import beam, cast, expected, gain
from agent.capabilities.survey.coverage_map import (
    STARTS,
    CoverageMap,
    Grid,
    along,
    block_slopes,
    dose,
    information,
    quaternion,
    rotation,
)
from agent.core.capability_messages import SIGMAS_M, UNIT_M, Keyframe, View, measured, place_of, sigma_byte
from agent.core.codec import encode
from agent.experiments.reconstruction.coverage import SURVEY_CAMERA, gimbal_eye, look
from tests.capabilities.survey.frames import FLEET, GRID, LENS, ROWS, SCENE, SIGMA, drawn_frames, frame

FRAMES = drawn_frames(12)


def map_of(frames) -> CoverageMap:
    known = CoverageMap(GRID)
    for one in frames:
        known.add(one)
    return known


def test_any_order_and_doubles_give_the_same_bytes():
    first = map_of(FRAMES)
    for seed in range(5):
        shuffled = FRAMES + FRAMES[:4]
        random.Random(seed).shuffle(shuffled)
        again = map_of(shuffled)
        assert again.as_bytes() == first.as_bytes() and again.digest() == first.digest()
    assert map_of(FRAMES[:-1]).digest() != first.digest()
    assert first.share() > 0.05


def test_two_different_keyframes_under_one_key_end_alike_and_leave_nothing_of_the_other():
    honest, other = FRAMES[0], replace(frame(servos=(1700.0, 1250.0)), number=FRAMES[0].number)
    a, b = map_of([*FRAMES, other]), map_of([other, *FRAMES])
    assert a.as_bytes() == b.as_bytes()
    assert a.as_bytes() in (map_of(FRAMES).as_bytes(), map_of([other, *FRAMES[1:]]).as_bytes())
    assert map_of(FRAMES).as_bytes() != map_of([other, *FRAMES[1:]]).as_bytes()
    assert honest != other


def test_of_many_starts_the_newest_count_whatever_came_first():
    frames = [replace(FRAMES[k], origin="r1", number=1, incarnation=k + 1) for k in range(STARTS + 3)]
    newest = map_of(frames[-STARTS:])
    for seed in range(3):
        random.Random(seed).shuffle(frames)
        known = map_of(frames)
        assert known.as_bytes() == newest.as_bytes() and len(known.held) == STARTS


def test_another_hash_seed_gives_the_same_digest():
    code = "from tests.capabilities.survey.test_evidence import *; print(map_of(FRAMES[:4]).digest())"
    told = {
        subprocess.run(
            [sys.executable, "-c", code], env={"PYTHONHASHSEED": seed}, capture_output=True, text=True, check=True
        ).stdout
        for seed in ("1", "77")
    }
    assert told == {map_of(FRAMES[:4]).digest() + "\n"}


def test_a_keyframe_fits_on_the_wire_and_quantising_costs_little():
    full = replace(FRAMES[0], depths=b"\xff\x0f" * 475, sigmas=b"\x50" * 475)
    said = Keyframe(fleet="survey", src="r1", dst="r2", incarnation=2**60, seq=999, sent_ns=2**60, frame=full)
    assert len(encode(replace(said, frame=replace(full, incarnation=2**60)))) <= 1600
    for sigma_m in np.geomspace(0.001, 0.1, 200):
        assert abs(SIGMAS_M[sigma_byte(float(sigma_m))] / sigma_m - 1.0) < 0.0126  # half a step of 2.5 %
    assert (
        UNIT_M / np.sqrt(12.0) < 0.02 * 0.002
    )  # what rounding a depth adds is under 2 % of the best sigma, in squares nothing


def test_pose_and_rays_survive_as_integers():
    eye = gimbal_eye(FLEET, "r2", (1320.0, 1210.0))
    turn = rotation(quaternion(eye.rotation))
    assert np.abs(np.array(turn) - eye.rotation).max() < 1e-8
    seen = look(SCENE, np.array(eye.position_m), np.array(eye.rotation), SURVEY_CAMERA, LENS.block)
    slopes, ahead_m = block_slopes(LENS, len(seen.z_m)), LENS.ahead * UNIT_M
    start = np.array(place_of(eye.position_m)) * UNIT_M
    for k in np.flatnonzero(np.isfinite(seen.z_m))[::29]:
        x, y = slopes[k]
        z = seen.z_m[k]
        there = start + np.array(rotation(quaternion(eye.rotation))) @ [x * (z - ahead_m), y * (z - ahead_m), z]
        assert np.abs(there - seen.points_m[k]).max() < 4e-4


def test_a_plane_seen_square_adds_what_it_should():
    """Straight down from the middle of the tank, all blocks at one depth: cos is that of the ray, cells are counted."""
    z = 0.25
    turn = quaternion(((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)))
    lens = replace(LENS, bend=0, ahead=0)
    count = lens.cols * ROWS
    depths, sigmas = round(z / UNIT_M).to_bytes(2, "little") * count, bytes([sigma_byte(0.004)]) * count
    seen = replace(FRAMES[0], place=(7500, 6000, 2500), turn=turn, lens=lens, depths=depths, sigmas=sigmas)
    added = dict(dose(seen, GRID))
    sigma_mm = SIGMAS_M[sigma_byte(0.004)] * 1000.0
    whole = 0
    for x, y in block_slopes(lens, count):
        whole += information(1.0 / float(np.sqrt(1.0 + x * x + y * y)), sigma_mm)
    assert sum(added.values()) == pytest.approx(whole, rel=1e-6)
    assert all(number < GRID.shape[0] * GRID.shape[1] for number in added)


def test_rays_of_a_guess_meet_what_brute_force_meets():
    """Small steps along each ray, against the walk from cell to cell."""
    rng = np.random.default_rng(4)
    known = map_of(FRAMES)
    stops = known.solid()
    assert stops
    for _ in range(150):
        at = tuple(float(v) for v in rng.uniform(0.05, np.array(GRID.size_m) - 0.05))
        way = tuple(float(v) for v in rng.normal(size=3))
        hit = cast(at, way, GRID, stops)
        steps = np.arange(1e-4, 1.5, 2e-4)[:, None] * way + at
        inside = np.all((steps > 0.0) & (steps < GRID.size_m), axis=1)
        end = len(steps) if inside.all() else int(np.argmin(inside))
        cells = [GRID.number(*map(float, p)) for p in steps[:end]]
        first = next((k for k, n in enumerate(cells) if n in stops and n != cells[0]), None)
        if first is not None:
            assert hit is not None and hit[0] == cells[first] and abs(hit[1] - 1e-4 - 2e-4 * first) < 5e-4
        elif hit is not None:
            assert end < len(steps) and abs(hit[1] - 2e-4 * end) < 6e-4
        else:
            assert inside.all() or steps[end][2] >= GRID.size_m[2]


def test_gain_is_what_brute_force_says():
    known = map_of(FRAMES)
    eye = gimbal_eye(FLEET, "r4", (1450.0, 1280.0))
    view = View(place_of(eye.position_m), quaternion(eye.rotation), LENS, ROWS, SIGMA)
    adds = expected(view, beam(LENS, ROWS), GRID, known.solid())
    goal = GRID.goal
    floats = sum(
        min((known.cells.get(n, 0) + more) / goal, 1.0) - min(known.cells.get(n, 0) / goal, 1.0)
        for n, more in adds.items()
    )
    assert adds and gain(adds, GRID, known.cells) == int(1000 * floats + 1e-6)
    done = dict.fromkeys(adds, goal)
    assert gain(adds, GRID, done) == 0


def test_what_a_view_promises_is_about_what_it_brings():
    """The map's own forecast of an empty tank, against keyframes of the same view; within a third, over some views."""
    promised, brought = 0, 0
    empty: Grid = GRID
    for us in (900.0, 1200.0, 1500.0, 1800.0, 2100.0):
        one = frame(servos=(us, 1330.0))
        promised += gain(expected(View(one.place, one.turn, LENS, ROWS, SIGMA), beam(LENS, ROWS), empty, ()), empty, {})
        brought += gain(dict(dose(one, empty)), empty, {})
    assert 0.6 < brought / promised < 1.5


def test_every_measured_block_is_read_back():
    found = measured(FRAMES[0])
    assert found and all(0.05 < z < 2.0 and 0.001 < sigma < 0.05 for _, z, sigma in found)
    x, y, z = along(rotation(FRAMES[0].turn), (0.0, 0.0))
    assert abs(x * x + y * y + z * z - 1.0) < 1e-6
