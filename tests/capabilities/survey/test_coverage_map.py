"""The map is the same to the bit whatever the order, however often a keyframe comes, and whoever lies."""

import random
import subprocess
import sys

import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.survey.candidates import beam, cast, expected, gain
from agent.capabilities.survey.coverage_map import (
    EVERY,
    FREE,
    STARTS,
    SUMS,
    CoverageMap,
    Grid,
    along,
    block_slopes,
    crossed,
    dose,
    grid_of,
    information,
    is_free,
    is_inner,
    passed,
    place_m,
    quaternion,
    rotation,
)
from agent.core.capability_messages import SIGMAS_M, UNIT_M, Frame, Keyframe, View, measured, place_of, sigma_byte
from agent.core.codec import encode
from agent.core.topics import KEYFRAME
from agent.experiments.reconstruction.coverage import SURVEY_CAMERA, gimbal_eye, look
from tests.capabilities.survey.frames import FLEET, GRID, LENS, ROWS, SCENE, SIGMA, drawn_frames, frame

FRAMES = drawn_frames(12)


def map_of(frames) -> CoverageMap:
    known = CoverageMap(GRID)
    for one in frames:
        known.add(one)
    known.let_go()
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
        assert known.as_bytes() == newest.as_bytes() and len(known.all_keys()) == STARTS


def held_of(silent: int) -> tuple[CoverageMap, list[Frame]]:
    """A map with so many keyframes that one robot said itself."""
    frames = [replace(FRAMES[k % len(FRAMES)], origin="r3", incarnation=1, number=k + 1) for k in range(silent)]
    return map_of(frames), frames


def test_what_others_say_of_an_origin_pushes_nothing_of_it_out():
    known, frames = held_of(8)
    keys, share = known.all_keys(), known.share()
    for k in range(8):
        known.add(replace(FRAMES[k], origin="r3", incarnation=100 + k, number=1), vouched=False)
    for one in frames:
        known.add(replace(one, depths=bytes(len(one.depths))), vouched=False)  # smaller bytes under its own numbers
    known.let_go()
    assert set(keys) < set(known.all_keys()) and len(known.all_keys()) == len(keys) + STARTS - 1
    assert known.share() >= share
    assert [known.held["r3", 1][k + 1].frame for k in range(8)] == frames


def test_the_word_of_the_origin_goes_before_what_others_say_of_it():
    known, frames = held_of(4)
    invented = [replace(FRAMES[k], origin="r3", incarnation=100 + k, number=1) for k in range(STARTS - 1)]
    for one in invented:
        known.add(one, vouched=False)
    again = replace(FRAMES[9], origin="r3", incarnation=50, number=1)
    assert known.add(again)
    known.let_go()
    assert known.as_bytes() == map_of([*frames, again, *invented[1:]]).as_bytes()
    true = replace(FRAMES[8], origin="r3", incarnation=102, number=1)
    assert known.add(true) and known.held["r3", 102][1] == (true, True, b"")


def test_a_start_that_gives_way_leaves_by_so_many_keyframes_a_step():
    known, _ = held_of(2 * SUMS + 1)
    for k in range(STARTS):
        known.add(replace(FRAMES[k], origin="r3", incarnation=2 + k, number=1))
    newest = map_of([replace(FRAMES[k], origin="r3", incarnation=2 + k, number=1) for k in range(STARTS)])
    assert known.all_keys() == newest.all_keys() and known.sums == STARTS
    for _ in range(3):
        assert known.as_bytes() != newest.as_bytes()
        known.let_go(SUMS)
    assert known.as_bytes() == newest.as_bytes() and not known.leaving


def test_another_hash_seed_gives_the_same_digest():
    code = "from tests.capabilities.survey.test_coverage_map import *; print(map_of(FRAMES[:4]).digest())"
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
    said = replace(said, frame=replace(full, incarnation=2**60))
    assert len(encode(said)) <= 1600 and len(encode(replace(said, signature=bytes(64)))) <= KEYFRAME.limit
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


# --- free space ---
# What cameras look through is empty: a wrong block in the open water goes, what is really there stays.

FREE_SPACE_FRAMES = drawn_frames(30)


def test_cells_on_the_way_are_those_that_small_steps_meet():
    rng = np.random.default_rng(3)
    for _ in range(30):
        at = tuple(rng.uniform(0.01, np.array(GRID.size_m) - 0.01))
        way = tuple(rng.normal(size=3) / rng.uniform(0.3, 1.0))
        depth_m = float(rng.uniform(0.02, 1.5))
        out = min(((size if w > 0 else 0.0) - p) / w for p, w, size in zip(at, way, GRID.size_m, strict=True))
        fine = np.array(at) + np.linspace(0.0, min(depth_m, out) - 1e-9, 3_000)[:, None] * np.array(way)
        met = [GRID.number(*map(float, place)) for place in fine]
        stepped = [n for k, n in enumerate(met) if k == 0 or n != met[k - 1]]
        found = crossed(at, way, depth_m, GRID)
        assert len(set(found)) == len(found)
        assert set(stepped) <= set(found)  # a corner that a ray cuts may be thinner than a step
        assert len(found) - len(stepped) <= 2
    assert crossed((-0.1, 0.5, 0.2), (1.0, 0.0, 0.0), 1.0, GRID) == []


def spoilt(one: Frame, block: int, z_m: float) -> tuple[Frame, int]:
    """The same with one block that is wrong, and sure of itself; and the cell that it puts something into."""
    depths, sigmas = bytearray(one.depths), bytearray(one.sigmas)
    depths[2 * block : 2 * block + 2] = round(z_m / UNIT_M).to_bytes(2, "little")
    sigmas[block] = 60  # 2.2 mm
    x, y = block_slopes(LENS, len(sigmas))[block]
    way = along(rotation(one.turn), (x, y))
    cell = GRID.number(*(a + z_m * w for a, w in zip(place_m(one.place), way, strict=True)))
    assert cell is not None
    return replace(one, depths=bytes(depths), sigmas=bytes(sigmas)), cell


def test_a_wrong_block_in_the_open_water_goes_as_others_look_through():
    known, clean, gone, stayed = map_of(FREE_SPACE_FRAMES), map_of(FREE_SPACE_FRAMES).solid(), 0, 0
    rng = np.random.default_rng(1)
    for n, one in enumerate(FREE_SPACE_FRAMES):
        deep = [k for k, z_m, _ in measured(one) if z_m > 0.45]
        wrong, cell = spoilt(replace(one, number=100 + n), int(rng.choice(deep)), 0.25) if deep else (one, 0)
        if not is_inner(cell, GRID) or known.hits.get(cell, 0):
            continue
        if 4 * map_of([wrong]).cells.get(cell, 0) < GRID.goal:  # by what was measured there is nothing
            continue
        looked = known.passes.get(cell, 0) - passed(one, GRID).get(cell, 0)
        known.add(wrong)
        assert looked <= 2 * FREE or not known.occupied(cell)
        gone, stayed = gone + (cell not in known.solid()), stayed + (cell in known.solid())
    assert gone >= 8 and stayed <= 0.2 * gone
    assert len(clean - known.solid()) <= 0.05 * len(clean)


def test_what_is_there_stays():
    """Cells whose middle is within a body."""
    known, (nx, ny, _), kept = map_of(FREE_SPACE_FRAMES), GRID.shape, list[bool]()
    for number, total in known.cells.items():
        middle = (np.array([number % nx, number // nx % ny, number // (nx * ny)]) + 0.5) * GRID.cell_m
        if is_inner(number, GRID) and 4 * total >= GRID.goal and any(inside(body, middle) for body in SCENE.bodies):
            kept.append(number in known.solid())
    assert len(kept) > 20
    assert sum(kept) >= 0.85 * len(kept)


def inside(body, place) -> bool:
    p = (body.turn @ (place - body.centre_m)) / body.half_m
    return bool((p @ p if body.round else np.abs(p).max()) < 1.0)


def test_a_plane_that_is_seen_square_is_not_looked_through():
    one = FREE_SPACE_FRAMES[0]
    sigmas = bytes([130] * len(one.sigmas))  # 12 mm
    for z_m in (0.2, 0.3, 0.4):
        known = map_of([replace(one, depths=round(z_m / UNIT_M).to_bytes(2, "little") * len(sigmas), sigmas=sigmas)])
        ends = [n for n in known.hits if is_inner(n, GRID)]
        assert len(ends) > 8 and sum(is_free(n, known.hits, known.passes) for n in ends) <= 0.1 * len(ends)
        assert sum(known.passes.values()) > len(sigmas)
        assert all(count % (EVERY * EVERY) == 0 and is_inner(n, GRID) for n, count in known.passes.items())


def test_any_order_gives_the_same_counts_and_what_is_taken_back_is_gone():
    first = map_of(FREE_SPACE_FRAMES[:8])
    shuffled = [*FREE_SPACE_FRAMES[:8], *FREE_SPACE_FRAMES[2:4]]
    random.Random(4).shuffle(shuffled)
    again = map_of(shuffled)
    assert (again.hits, again.passes) == (first.hits, first.passes)
    assert again.as_bytes() == first.as_bytes()
    other = replace(FREE_SPACE_FRAMES[9], origin=FREE_SPACE_FRAMES[0].origin, number=FREE_SPACE_FRAMES[0].number)
    a, b = map_of([*FREE_SPACE_FRAMES[:8], other]), map_of([other, *FREE_SPACE_FRAMES[:8]])
    assert (a.hits, a.passes, a.solid()) == (b.hits, b.passes, b.solid())
    assert map_of([FREE_SPACE_FRAMES[0], other]).passes in (passed(FREE_SPACE_FRAMES[0], GRID), passed(other, GRID))


@pytest.mark.parametrize(
    ("side_m", "cell_mm", "cells"),
    [(1.8, 60.0, 30), (1.12, 40.0, 28), (2.7, 30.0, 90), (2.41, 40.0, 60), (2.42, 40.0, 61)],
)
def test_no_layer_of_cells_is_beyond_a_wall(side_m: float, cell_mm: float, cells: int) -> None:
    """1.8 m of 60 mm are thirty cells, though 1.8 / 0.06 is more in floats; and 1 cm of water is no layer."""
    fleet = replace(
        FLEET,
        tank=replace(FLEET.tank, size_m=(2.0, side_m, 0.6)),
        coverage=replace(FLEET.coverage, cell_mm=cell_mm, faces=("y1",)),
    )
    grid = grid_of(fleet)
    assert grid.shape[1] == cells
    assert grid.number(1.0, side_m - 1e-6, 0.3) in grid.wanted
