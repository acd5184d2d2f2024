"""What cameras look through is empty: a wrong block in the open water goes, what is really there stays."""

import random

import numpy as np
from msgspec.structs import replace

from agent.capabilities.survey.coverage_map import (
    EVERY,
    FREE,
    CoverageMap,
    along,
    block_slopes,
    crossed,
    is_free,
    is_inner,
    passed,
    place_m,
    rotation,
)
from agent.core.capability_messages import UNIT_M, Frame, measured
from tests.capabilities.survey.frames import GRID, LENS, SCENE, drawn_frames

FRAMES = drawn_frames(30)


def map_of(frames) -> CoverageMap:
    known = CoverageMap(GRID)
    for one in frames:
        known.add(one)
    return known


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
    known, clean, gone, stayed = map_of(FRAMES), map_of(FRAMES).solid(), 0, 0
    rng = np.random.default_rng(1)
    for n, one in enumerate(FRAMES):
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
    known, (nx, ny, _), kept = map_of(FRAMES), GRID.shape, list[bool]()
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
    one = FRAMES[0]
    sigmas = bytes([130] * len(one.sigmas))  # 12 mm
    for z_m in (0.2, 0.3, 0.4):
        known = map_of([replace(one, depths=round(z_m / UNIT_M).to_bytes(2, "little") * len(sigmas), sigmas=sigmas)])
        ends = [n for n in known.hits if is_inner(n, GRID)]
        assert len(ends) > 8 and sum(is_free(n, known.hits, known.passes) for n in ends) <= 0.1 * len(ends)
        assert sum(known.passes.values()) > len(sigmas)
        assert all(count % (EVERY * EVERY) == 0 and is_inner(n, GRID) for n, count in known.passes.items())


def test_any_order_gives_the_same_counts_and_what_is_taken_back_is_gone():
    first = map_of(FRAMES[:8])
    shuffled = [*FRAMES[:8], *FRAMES[2:4]]
    random.Random(4).shuffle(shuffled)
    again = map_of(shuffled)
    assert (again.hits, again.passes) == (first.hits, first.passes)
    assert again.as_bytes() == first.as_bytes()
    other = replace(FRAMES[9], origin=FRAMES[0].origin, number=FRAMES[0].number)
    a, b = map_of([*FRAMES[:8], other]), map_of([other, *FRAMES[:8]])
    assert (a.hits, a.passes, a.solid()) == (b.hits, b.passes, b.solid())
    assert map_of([FRAMES[0], other]).passes in (passed(FRAMES[0], GRID), passed(other, GRID))
