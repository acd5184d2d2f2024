"""Views from a black box: one whole sweep of a moored robot, where the kernel says that the target is."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from agent.core.codec import decode
from agent.core.config import ConfigError
from agent.core.ranging.camera_model import CameraFit, at_lens_position
from agent.core.step_io import Outputs, Sighting, SweepOutcome
from agent.reconstruction.refine_poses import DEPTH_M, LEVEL_RAD, Sigmas, covariance_of
from agent.reconstruction.sources import Cut, _corner_px, aligned, recorded_views
from agent.reconstruction.views import rotation_of, see, surface_points
from replay.check.reexecute import open_box
from replay.files.log import read
from replay.viewers.viewer_channels import SweepFrame, whole_sweeps
from tests.places import ROOT

SEEN = ROOT / "tests" / "golden" / "seen"


def test_a_recorded_sweep_puts_the_target_where_the_kernel_did() -> None:
    (view,) = recorded_views([SEEN], lambda done, total: None).views
    box = open_box(SEEN / "r1.mcap")
    outputs = [decode(step.outputs, Outputs, 2**22) for step in box.steps() if step.outputs]
    target = next(o.outcome.x_m for o in outputs if isinstance(o.outcome, SweepOutcome) and o.outcome.x_m)
    pixels, _ = see(view, np.array(target))
    col, row = np.rint(pixels).astype(int)
    there = surface_points(view)[row - 2 : row + 3, col - 2 : col + 3].reshape(-1, 3)
    radius = np.linalg.norm(np.nanmedian(there, axis=0) - target)
    sigma_m = float(view.sigma_m[row, col])  # 0.85 m away in a small picture: 27 mm
    assert sigma_m < 0.03
    assert radius == pytest.approx(box.fleet.target["ball"].radius_m, abs=2 * sigma_m)  # its skin
    assert (view.robot, view.incarnation) == ("r1", str(box.incarnation))
    assert 0.0 < np.sqrt(view.pose_covariance[3, 3]) < 0.02


def test_what_is_no_black_box_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no recording"):
        recorded_views([tmp_path], lambda done, total: None)


def test_dives_of_two_tanks_are_no_scene() -> None:
    with pytest.raises(ConfigError, match=r"swim/r1\.mcap: is of another tank than .*seen/r1\.mcap"):
        recorded_views([SEEN, SEEN.parent / "swim"], lambda done, total: None)


def test_frames_without_a_target_are_laid_on_each_other_by_what_they_show() -> None:
    box = open_box(SEEN / "r1.mcap")
    ((frames, tilt_rad),) = list(whole_sweeps(read(box.path), box.fleet.camera.sweep_steps))
    assert abs(tilt_rad) < 1.0
    blind = [
        SweepFrame(f.image, f.roi, type(f.sighting)(**{**_fields(f.sighting), "radius_px": None, "centre_px": None}))
        for f in frames
    ]
    sizes = {f.roi[2:] for f in frames}
    by_target, by_picture = aligned(frames), aligned(blind)
    assert by_target is not None
    if len(sizes) == 1:
        assert by_picture is not None
        assert np.abs(np.array(by_picture.corners_px) - by_target.corners_px).max() < 40
    else:  # parts of different sizes cannot be registered: said, not guessed
        assert by_picture is None


def test_the_axis_goes_away_from_a_target_that_frames_are_laid_on_as_they_grow() -> None:
    camera = CameraFit(width_px=640, height_px=480, f_px=1100.0, cx_px=320.0, cy_px=240.0, breathing=3e-5, lens=300.0)
    cut = Cut([], [(100, 80), (102, 81), (104, 82)], (60.0, 50.0))
    positions = np.array([200.0, 400.0, 900.0])
    x, y = _corner_px(cut, 1, camera, positions)
    grown = at_lens_position(camera, 900.0).f_px / at_lens_position(camera, 400.0).f_px
    assert (320.0 - x - 60.0, 240.0 - y - 50.0) == pytest.approx((grown * (320 - 102 - 60), grown * (240 - 81 - 50)))
    assert _corner_px(cut._replace(grown_about_px=None), 1, camera, positions) == (102, 81)


def test_a_view_of_a_robot_that_drifts_is_of_where_it_was_when_its_frames_were_clear() -> None:
    rng = np.random.default_rng(5)
    noise = np.kron(rng.normal(0, 1, (50, 63)), np.ones((8, 8)))
    wide = np.asarray(cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX), np.uint8)
    blurs_px, shifts_px = (4.0, 2.0, 0.5, 2.0, 4.0), ((0, 0), (2, 1), (4, 3), (7, 4), (9, 6))
    frames = [
        SweepFrame(
            cv2.cvtColor(cv2.GaussianBlur(wide, (0, 0), blur_px)[y : y + 300, x : x + 400], cv2.COLOR_GRAY2BGR),
            (120, 90, 400, 300),
            Sighting(t_ns=0, frame=0, focus=0, target="ball", found=False),
        )
        for blur_px, (x, y) in zip(blurs_px, shifts_px, strict=True)
    ]
    cut = aligned(frames)
    assert cut is not None and cut.clearest == 2
    there = np.array(cut.corners_px[2]) - (120, 90)
    assert np.abs(there - (9 - 4, 6 - 3)).max() <= 1  # what all show begins where the last one's picture does
    assert all(image.shape == cut.images[0].shape for image in cut.images)


def _fields(sighting: object) -> dict[str, object]:
    return {name: getattr(sighting, name) for name in sighting.__struct_fields__}  # type: ignore[attr-defined]


def test_the_prior_of_a_pose_is_what_its_parts_add_up_to() -> None:
    rng, sigmas = np.random.default_rng(1), Sigmas(3e-3, math.radians(0.5), math.radians(0.1))
    rotation, arm = rotation_of(np.array([0.4, -1.0, 0.6])), np.array([0.12, 0.03, -0.05])
    count = 20_000
    yaw, level = rng.normal(0, sigmas.yaw_rad, count), rng.normal(0, LEVEL_RAD, (count, 2))
    turn = np.column_stack([level, yaw])
    gimbal = rng.normal(0, sigmas.gimbal_rad, (count, 2))
    w = (turn + gimbal[:, :1] * [0, 0, 1] + gimbal[:, 1:] * rotation[:, 0]) @ rotation
    shift = np.cross(turn, arm) + rng.normal(0, 1, (count, 3)) * [sigmas.place_m, sigmas.place_m, DEPTH_M]
    drawn = np.cov(np.column_stack([w, shift @ rotation]).T)
    told = covariance_of(rotation, arm, sigmas)
    scale = np.sqrt(np.outer(np.diag(told), np.diag(told)))
    assert np.abs((drawn - told) / scale).max() < 0.05
