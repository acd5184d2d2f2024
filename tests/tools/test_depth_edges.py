"""Blocks astride an edge in depth: refused, and split into the parts that hold one depth."""

import json

import cv2
import numpy as np
import pytest
from scipy.special import j1

from agent.perception.depth_peaks import (
    COMMON,
    FEWEST_FOURS,
    GridPeaks,
    Reason,
    as_sure,
    cuts,
    enclosed,
    grid_peaks,
    middle,
    off_plane,
    scatter,
    shown,
    with_edges,
    with_two_peaks,
)
from agent.perception.depth_sweep import clarity_of, measure, sweep
from hw.camera.files import open_stack
from tests.bench.pictures.scenes import FRAMES, render
from tests.bench.pictures.score import score
from tests.places import DATA
from tests.tools.planes import quiet

BLOCK = 40
SMOOTH = DATA / "real_water" / "stacks" / "cou_6"
STACKS = DATA / "rendered_stacks"


@pytest.fixture(scope="module")
def edge():
    """A slanted edge four peak widths deep, texture on both sides: its sweep, scores without parts and with them."""
    stack = render("pink", "leaves", "slanted", 10.0, 7, 1.0)
    taken = clarity_of(stack.images, np.arange(float(FRAMES)), BLOCK, 0.0, split=True)
    maps = [measure(sweep, BLOCK, None) for sweep in (taken._replace(finer=None), taken)]
    return taken, *(score(found, stack.truth, FRAMES - 1.0) for found in maps)


def test_blocks_with_two_depths_give_way_to_their_parts(edge):
    taken, before, after = edge
    found = measure(taken, BLOCK, None)
    assert before.across == after.across >= 6
    assert before.across_whole >= 0.4 * before.across  # nothing in a block's own curve tells it
    assert after.across_whole == 0
    assert after.across_told > 0.2 * after.across and after.across_wrong <= 0.1 * after.across_told
    assert (found.blocks.reason == Reason.TWO_DEPTHS).sum() >= after.across - 1


def test_blocks_without_an_edge_keep_their_depth(edge):
    _, before, after = edge
    assert after.plain_told > 0.8 * before.plain_told  # most of the rest lie beside the edge, which their parts see
    assert after.plain_wrong == 0


def test_other_ways_to_take_the_peak_keep_the_same_squares(edge):
    matched, parabola = (measure(edge[0], BLOCK, None, method) for method in ("matched", "parabola"))
    assert np.array_equal(parabola.used_parts(), matched.used_parts()) and matched.used_parts().any()
    assert not np.array_equal(parabola.parts.lens_position, matched.parts.lens_position, equal_nan=True)


def squares(depth):
    """Clear peaks at these lens positions, two wide, known to a tenth."""
    ones = np.ones(depth.shape)
    return GridPeaks(depth, 0.1 * ones, 2.0 * ones, ones, np.zeros(depth.shape, np.uint8))


@pytest.mark.parametrize(
    ("depth", "two"),
    [
        (lambda x, y: 0.0 * x + 12.0, False),
        (lambda x, y: 0.02 * x - 0.01 * y + 12.0, False),
        (lambda x, y: np.where(x < 31, 12.0, 16.0), True),
        (lambda x, y: np.where(x + y < 55, 12.0, 14.5), True),
    ],
)
def test_a_step_is_told_from_a_slope(depth, two):
    """One block of 40 px, its parts and cells with the mean depth of what they cover."""
    y, x = np.mgrid[:40, :40].astype(float)
    pixels = depth(x, y)
    block, parts, cells = (squares(pixels.reshape(n, 40 // n, n, 40 // n).mean(axis=(1, 3))) for n in (1, 4, 8))
    curves = 1.0 / (1.0 + ((np.arange(25.0)[:, None, None] - parts.lens_position) / 2.0) ** 2)
    blocks, parts = with_edges(block, parts, cells, curves, 1.0)
    assert blocks.reason[0, 0] == (Reason.TWO_DEPTHS if two else Reason.ACCEPTED)
    wrong = [np.ptp(pixels[10 * r : 10 * r + 10, 10 * c : 10 * c + 10]) > 1 for r, c in np.argwhere(parts.accepted)]
    assert not any(wrong) and parts.accepted.any()


def test_two_peaks_are_told_from_noise():
    """Of curves that are not those of one depth, and of one that is."""
    x, rng = np.arange(30.0), np.random.default_rng(0)
    one, other = (1.0 / (1.0 + ((x - at) / 2.0) ** 2) for at in (10.0, 19.0))
    curves = np.stack([one + 0.6 * other, one + 0.15 * rng.standard_normal(30), one], axis=1)[:, None]
    quality = [[np.corrcoef(curve, one)[0, 1] for curve in curves[:, 0].T]]
    parts = squares(np.full((1, 3), 10.0))._replace(
        quality=np.array(quality), reason=np.array([[Reason.POOR_FIT, Reason.POOR_FIT, Reason.ACCEPTED]], np.uint8)
    )
    assert with_two_peaks(curves, parts).tolist() == [[True, False, False]]


def test_a_plain_part_is_filled_in_between_others_and_never_beyond_them():
    depth = np.full((7, 8), 12.0)
    depth[2:4, 2] = np.nan  # a plain spot
    depth[6, 2] = np.nan  # one that the picture's border cuts
    depth[:, 5:] = np.nan  # a plain rim
    expected = np.ones((7, 8), bool)
    expected[:, 4:] = False  # what shows the depth at the rim shows it itself
    found = enclosed(depth, np.full((7, 8), 12.0), np.full((7, 8), 0.5))
    assert np.array_equal(found, expected)


@pytest.mark.parametrize(("there", "said"), [(12.0, True), (12.8, True), (16.0, False), (None, False)])
def test_a_part_too_weak_for_a_peak_speaks_for_its_block_if_it_has_its_peak(there, said):
    """One block; one half of it has weak curves, sharp at `there`, or what a blurred neighbour spills over it."""
    x = np.arange(30.0)
    curves = np.tile(1000.0 / (1 + ((x - 12.0) / 2) ** 2)[:, None, None], (1, 4, 4))
    spilt = 1 - 1 / (1 + ((x - 12.0) / 4) ** 2)
    weakly = 100 * (spilt if there is None else 1 / (1 + ((x - there) / 2) ** 2))
    curves[:, :, :2] = weakly[:, None, None]
    blocks, parts = squares(np.full((1, 1), 12.0)), squares(np.full((4, 4), 12.0))
    weak = np.zeros((4, 4), bool)
    weak[:, :2] = True
    parts = parts.refused(weak, Reason.NO_TEXTURE)
    assert shown(x, curves, blocks, parts, 1.0)[0, 0] == said


def test_a_plane_through_what_is_known():
    rng = np.random.default_rng(0)
    row, col = np.mgrid[:4, :4]
    plane = (3.0 + 0.5 * row - 0.2 * col).reshape(1, 1, 16)
    plane[0, 0, [2, 9, 11]] = np.nan
    off, _ = off_plane(plane)
    assert np.abs(off).max() < 1e-5
    values = rng.normal(size=(5, 7, 16))
    values[rng.random(values.shape) < 0.4] = np.nan
    values[0, 0] = np.nan
    for found, row in zip(middle(values).ravel(), values.reshape(-1, 16), strict=True):
        known = row[np.isfinite(row)]
        assert found == np.median(known) if known.size else np.isnan(found)


def test_blocks_are_cut_into_cells_of_five_pixels_and_more():
    assert [cuts(block) for block in (8, 12, 19, 20, 32, 40, 50, 100)] == [1, 1, 1, 4, 4, 8, 8, 16]


@pytest.mark.skipif(not SMOOTH.is_dir(), reason=f"the smooth stack is not here: set AUCAMP_DATA (looked in {SMOOTH})")
@pytest.mark.parametrize(("block", "least"), [(BLOCK, 0.97), (32, 0.85)])
def test_a_smooth_surface_is_split_but_not_refused(block, least):
    """As steep as a peak's width in a part: blocks hold many depths, and nearly all of them are told."""
    found = measure(sweep(open_stack(SMOOTH), block, quiet), block, None)
    with np.load(SMOOTH / "truth.npz") as truth:
        depth, mask = truth["depth"], truth["mask"]
    side, said = block // found.along, found.lens_position_on_parts()
    rows, cols = said.shape
    cut = [field[: rows * side, : cols * side].reshape(rows, side, cols, side) for field in (depth, mask)]
    inside = cut[1].all(axis=(1, 3))
    error = (said - cut[0].mean(axis=(1, 3)))[inside & np.isfinite(said) & found.used_parts()]
    assert np.isfinite(said[inside]).mean() > least
    assert np.median(np.abs(error)) < 0.1 and np.quantile(np.abs(error), 0.95) < 0.5  # steps


@pytest.mark.skipif(
    not STACKS.is_dir(), reason=f"the rendered stacks are not here: set AUCAMP_DATA (looked in {STACKS})"
)
@pytest.mark.parametrize("block", [20, 32])
def test_across_the_edges_of_another_program_s_pictures_no_block_is_told_as_one(block):
    """Mitsuba's: a ball and stones before a wall. Each side has 15 % of the block, and they are 1.5 steps apart."""
    across = told = 0
    for name in ("tap_a", "veil_a"):
        found = measure(sweep(open_stack(STACKS / name), block, quiet), block, None)
        depth = cv2.imread(str(STACKS / name / "depth_tenth_mm.png"), cv2.IMREAD_UNCHANGED) * 1e-4
        for row, col in np.ndindex(found.blocks.accepted.shape):
            own = depth[row * block : (row + 1) * block, col * block : (col + 1) * block]
            far = (own > (own.min() + own.max()) / 2).mean()
            if own.min() > 0.0 and min(far, 1 - far) >= 0.15 and apart(name, own) > 1.5 and jumps(own):
                across += 1
                told += bool(found.blocks.accepted[row, col])
    assert across > 30 and told <= 0.05 * across


def apart(name, depth_m):
    """Steps between the lens positions of the near and of the far side."""
    made = json.loads((STACKS / name / "scene.json").read_text())
    index, port_m, focal_m = made["n_water"], made["port_m"], made["focal_length_m"]
    steps = index * focal_m**2 / (made["step_um"] * 1e-6) / (depth_m - port_m - index * (focal_m - port_m))
    return np.ptp(np.quantile(steps, [0.1, 0.9]))


def jumps(depth_m):
    return (np.hypot(*np.gradient(depth_m)) > 0.02 * np.median(depth_m)).any()


# --- how sure a peak is ---


@pytest.mark.parametrize("times", [0.4, 3.0])
def test_neighbours_tell_how_sure_peaks_are(times):
    """Noise `times` as large as residuals say, which differs from square to square, on a plane and on a bowl. A tenth
    of the squares is wrong."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:24, :32].astype(float)
    sigma = rng.uniform(0.05, 0.2, x.shape)
    for surface in (0.3 * x - 0.2 * y, 0.05 * (x - 15.0) ** 2 + 0.05 * (y - 9.0) ** 2):
        found = squares(surface + times * sigma * rng.normal(size=x.shape))._replace(sigma=sigma)
        assert scatter(found) == pytest.approx(times, rel=0.12)
        wrong = np.where(rng.random(x.shape) < 0.02, 5.0, 0.0)
        assert times < scatter(found._replace(lens_position=found.lens_position + wrong)) < 1.6 * times
        surer = as_sure(found, scatter(found), 256.0).sigma
        assert surer == pytest.approx(sigma * np.hypot(scatter(found), COMMON))


def test_where_there_are_few_neighbours_the_twin_tells_how_sure_peaks_are():
    """By half of a peak's half width, over the square's side; residuals come on top."""
    rows = int(np.sqrt(FEWEST_FOURS))
    assert scatter(squares(np.zeros((rows, rows)))) is None
    lone = squares(np.random.default_rng(1).normal(size=(20, 20)))
    checked = lone.refused(np.indices((20, 20)).sum(axis=0) % 2 == 0, Reason.NO_TEXTURE)
    assert scatter(lone) is not None and scatter(checked) is None
    assert as_sure(lone, None, 16.0**2).sigma == pytest.approx(np.hypot(0.1, 0.5 * 2.0 / 16.0))


def blurred(radius_px):
    """Clarity of white texture, seen by whole pixels, under discs of these radii; 1 where it is sharp."""
    f = np.linspace(0.002, 0.5, 400)
    energy = (np.sinc(f) * np.sin(2.0 * np.pi * f)) ** 2 * f
    a = np.maximum(2.0 * np.pi * np.abs(radius_px)[..., None] * f, 1e-6)
    return np.sum(energy * (2.0 * j1(a) / a) ** 2, axis=-1) / energy.sum()


@pytest.mark.parametrize(("steps", "frames"), [(2.0, 30), (3.0, 16), (3.0, 30), (5.0, 25)])
def test_a_curve_that_blur_alone_makes_is_off_by_a_part_of_what_its_residuals_say(steps, frames):
    """steps: of the sweep, in a peak's half width. Neighbours at one depth share this error."""
    radii = np.linspace(0.0, 5.0, 500)
    half_px = np.interp(-0.5, -blurred(radii), radii)
    x, peaks = np.arange(float(frames)), np.random.default_rng(0).uniform(2.0, frames - 3.0, 100)
    curves = blurred((x[:, None] - peaks) * half_px / steps)
    found = grid_peaks(x, 1000.0 * (curves[:, None] + 0.03), 0.96)
    off = ((found.lens_position - peaks) / found.sigma)[found.accepted]
    assert len(off) > 50
    assert 0.4 * COMMON < np.sqrt(np.mean(off**2)) < 1.6 * COMMON
