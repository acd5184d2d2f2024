"""Ranges off the axis, through a flat port, on stacks of a renderer that nobody here wrote: Mitsuba, true depths."""

import functools
import json
import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.ranging.camera_model import CameraFit, FocusFit, at_lens_position
from agent.core.ranging.focus import port_share, share_at
from agent.experiments import still_camera
from agent.experiments.depth import wall_places
from agent.experiments.still_camera import BLOCK_PX, WATER_INDEX, StillCamera, breathing, facing_wall, lens_positions
from agent.perception.depth_sweep import DepthSweep, clarity_of, measure, outward, sweep
from agent.tools.focus_calibration import fit_field
from hw.camera.files import open_stack
from tests.known_lens import FOCUS
from tests.places import DATA
from tests.tools.planes import quiet

STACKS = DATA / "rendered_stacks"
BLOCK, SIZE = 32, (640, 480)
FLAT = 0.03  # of its depth that a square may span: more is an edge, or a slope of which no peak is the middle


@functools.cache
def off_axis(name: str, block: int = BLOCK) -> np.ndarray:
    """(3, squares): errors of all squares of one depth, m, their depths, and how large an error their sigma says."""
    folder = STACKS / name
    made = json.loads((folder / "scene.json").read_text())
    index, port_m, focal_m = made["n_water"], made["port_m"], made["focal_length_m"]
    focus = replace(
        FOCUS, u_inf_m=port_m + index * (focal_m - port_m), b_m=index * focal_m**2 / (made["step_um"] * 1e-6), rho0=0.0
    )
    camera = CameraFit(
        width_px=SIZE[0],
        height_px=SIZE[1],
        f_px=index * SIZE[0] / 2 / math.tan(math.radians(made["fov_x_deg"] / 2)),
        cx_px=(SIZE[0] - 1) / 2,
        cy_px=(SIZE[1] - 1) / 2,
        bend=(index**2 - 1) / 2,
        ahead_m=-(index - 1) * port_m,
    )
    truth_m = cv2.imread(str(folder / "depth_tenth_mm.png"), cv2.IMREAD_UNCHANGED) * 1e-4
    found = measure(sweep(open_stack(folder), block, quiet), block, focus, camera=camera)
    rows = []
    for squares, told, side in (
        (found.blocks, found.blocks.accepted, block),
        (found.parts, found.used_parts(), block // found.along),
    ):
        for row, col in np.argwhere(told):
            depths_m = truth_m[row * side : (row + 1) * side, col * side : (col + 1) * side]
            middle_m = float(np.median(depths_m))
            if depths_m.min() > 0.0 and np.ptp(depths_m) < FLAT * middle_m:
                per_position_m = focus.b_m / squares.lens_position[row, col] ** 2
                rows.append((squares.range_m[row, col] - middle_m, middle_m, per_position_m * squares.sigma[row, col]))
    return np.array(rows).T


@pytest.mark.skipif(
    not STACKS.is_dir(), reason=f"the rendered stacks are not here: set AUCAMP_DATA (looked in {STACKS})"
)
@pytest.mark.parametrize(("name", "times"), [("tap_a", 1.0), ("veil_a", 2.0)])
def test_another_program_s_pictures_are_ranged_right_all_over_the_frame(name: str, times: float) -> None:
    """To 21 degrees in air. Without the port's share the median is -38 mm, and a tenth is 77 mm off or more."""
    errors_m, depths_m, _ = off_axis(name)
    off = np.abs(errors_m) / depths_m
    assert len(off) > 250
    assert abs(np.median(errors_m)) < 2e-3 * times
    assert np.median(off[depths_m < 1.0]) < 0.003 * times
    assert np.quantile(off, 0.9) < 0.01 * times


@pytest.mark.skipif(not STACKS.is_dir(), reason="the rendered stacks are not here: set AUCAMP_DATA")
@pytest.mark.parametrize("name", ["tap_a", "veil_a"])
@pytest.mark.parametrize("block", [BLOCK, 20])
def test_errors_are_as_large_as_their_sigma_says(name: str, block: int) -> None:
    """Near and far alike: a port that is off by 10 mm, as the veiled stack's is, is no part of sigma."""
    errors_m, depths_m, sigma_m = off_axis(name, block)
    z = errors_m / sigma_m
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.3
    for some in (depths_m < 1.0, depths_m > 1.0):
        assert some.sum() > 30 and 0.6 < np.sqrt(np.mean(z[some] ** 2)) < 1.7


@pytest.mark.skipif(not STACKS.is_dir(), reason="the rendered stacks are not here: set AUCAMP_DATA")
@pytest.mark.parametrize("name", ["tap_a", "veil_a"])
def test_a_picture_that_does_not_grow_does_not_grow(name: str) -> None:
    assert sweep(open_stack(STACKS / name), BLOCK, quiet).growth == 0.0


def test_a_port_shows_what_lies_aside_nearer_and_a_dome_does_not() -> None:
    flat = CameraFit(width_px=640, height_px=480, f_px=1111.0, cx_px=319.5, cy_px=239.5, bend=0.39)
    assert port_share(flat, (319.5, 239.5)) == 1.0
    read = {10.0: 986.84, 20.0: 946.00, 30.0: 873.49}  # mm, by traced rays: 1 m ahead of the lens, 20 mm to the port
    for air_deg, read_mm in read.items():
        sine = math.sin(math.radians(air_deg)) / 1.333
        assert share_at(flat, math.sqrt(1.0 - sine * sine)) == pytest.approx((read_mm - 20.0) / 980.0, abs=2e-4)
    assert port_share(replace(flat, bend=0.0), (0.0, 0.0)) == 1.0
    sine = math.sin(math.radians(20.0)) / 1.333
    for q, apparent_mm in ((1.0, 695.64), (0.0, 734.78)):  # where rays that fan out from the axis meet, and the others
        share = share_at(flat, math.sqrt(1.0 - sine * sine), q)
        assert share == pytest.approx(1.333 * (apparent_mm - 20.0) / 980.0, abs=2e-4)


def test_which_way_texture_runs_is_seen_from_the_axis() -> None:
    """Upright stripes point away from the axis to its right, and around it above; grain points all ways."""
    camera = CameraFit(width_px=640, height_px=480, f_px=1111.0, cx_px=319.5, cy_px=239.5, bend=0.39)
    edges = np.array([0, 160, 320, 480]), np.array([0, 210, 430, 640])
    stripes = np.tile(np.where(np.arange(640) // 4 % 2, 200, 60).astype(np.uint8), (480, 1))
    grain = np.random.default_rng(0).integers(0, 255, (480, 640)).astype(np.uint8)

    def seen(picture: np.ndarray, corner_px: tuple[int, int] = (0, 0)) -> np.ndarray:
        taken = DepthSweep(np.arange(5.0), np.zeros((5, 3, 3)), picture, 0.0, 0, corner_px=corner_px)
        return outward(taken, camera, *edges)

    across = seen(stripes)
    assert (across[1, [0, 2]] > 0.9).all() and (across[[0, 2], 1] < 0.15).all()
    assert seen(grain) == pytest.approx(0.5, abs=0.02)
    assert (seen(np.full((480, 640), 90, np.uint8)) == 0.5).all()
    assert seen(stripes, (430, 0))[1, 0] == pytest.approx(across[1, 2], abs=0.03)


def test_a_sensor_that_leans_and_a_curved_field_are_measured_and_taken_out() -> None:
    """On the twin: 0.2 degrees and 6 um at the corner. A wall at 0.8 m, seen all over the picture."""
    camera = StillCamera("imx519_640", 3, sensor_tilt_deg=0.2, field_um=6.0)
    camera.prepare()
    lens, seen, rho, growth = camera.lens, camera.seen(), np.array(lens_positions(camera), float), breathing(camera)
    axis = replace(  # the thin lens itself, as good a calibration as there is
        FOCUS,
        u_inf_m=lens.port_gap_m + WATER_INDEX * (lens.focal_m - lens.port_gap_m),
        b_m=WATER_INDEX * lens.focal_m**2 / lens.per_position_m,
        rho0=(lens.focal_m - lens.at_rest_m) / lens.per_position_m,
    )
    field = fit_field(axis, wall_places(camera, growth))
    at_f_m = seen.f_px * lens.pixel_m
    lean = [-at_f_m / lens.per_position_m * slope for slope in lens.lean]
    assert (field.right, field.down) == pytest.approx(lean, abs=4.0)
    assert field.curved == pytest.approx(lens.curved_per_m * at_f_m**2 / lens.per_position_m, abs=20.0)
    camera.view = facing_wall(0.8)
    taken = clarity_of(still_camera.sweep(camera), rho, BLOCK_PX, growth)

    def ranges_m(fit: FocusFit, by: CameraFit = seen) -> np.ndarray:
        found = measure(taken, BLOCK_PX, fit, camera=by).blocks
        assert found.range_m is not None
        return found.range_m[found.accepted]

    def worst_m(range_m: np.ndarray) -> float:
        return float(np.quantile(np.abs(range_m - np.median(range_m)), 0.9))

    ranged_m = ranges_m(replace(axis, field=field))
    assert worst_m(ranges_m(axis)) > 0.08
    assert worst_m(ranged_m) < 0.014  # as of a flat lens: 12 mm
    # Blocks are squares in the largest picture, wherever the lens was when the camera was calibrated.
    largest = at_lens_position(seen, float(rho[taken.reference]))
    assert largest.f_px > 1.02 * seen.f_px
    assert ranges_m(replace(axis, field=field), largest) == pytest.approx(ranged_m, abs=1e-9)
