"""Depth maps of a recorded sweep: frames lie on each other by their target, and a whole sweep is told from others."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.ranging.focus import lens_position
from agent.core.step_io import Sighting
from agent.perception.depth_sweep import BLOCK_PX, growth, sweep_depth
from replay.files.channels import VISION, entry_on
from replay.files.frames import frame_entries
from replay.files.log import LogWriter, read
from replay.report.report import report
from replay.viewers.viewer_channels import SweepFrame, sweep_points, whole_sweeps
from tests.perception.painted import PX_PER_POSITION, ball_light, defocus, expose
from tests.replay.small_box import CALIBRATION, flat, write_box

FOCUS = CALIBRATION.focus
STEPS = 30
RANGE_M = 0.5
CENTRE_M = (0.0, 0.0, 0.55)
LEFT, TOP = 100, 60  # of the part of the frame that is read


def frames() -> list[SweepFrame]:
    """A sweep across RANGE_M over which the robot drifts: everything in the picture is equally far."""
    light, sharp = ball_light(CENTRE_M), lens_position(FOCUS, RANGE_M)
    sweep = []
    for k, rho in enumerate(np.linspace(FOCUS.lowest, FOCUS.highest, STEPS).round().astype(int)):
        drift_x, drift_y = k // 3, -(k // 4)
        image = expose(defocus(light, abs(rho - sharp) * PX_PER_POSITION), seed=k)
        image = np.roll(image, (drift_y, drift_x), axis=(0, 1))[TOP:420, LEFT:540]
        centre_px = (319.5 + drift_x, 239.5 + drift_y)
        sighting = Sighting(
            t_ns=k, frame=k, sweep=1, index=k + 1, focus=int(rho), target="ball", found=True, centre_px=centre_px,
            radius_px=149.0,
        )  # fmt: skip
        sweep.append(SweepFrame(image, (LEFT, TOP, 440, 360), sighting))
    return sweep


@pytest.fixture(scope="module")
def sweep() -> list[SweepFrame]:
    return frames()


def test_every_block_of_an_equally_far_picture_is_as_far(sweep: list[SweepFrame]) -> None:
    found = sweep_depth(sweep, CALIBRATION)
    assert found is not None
    known = np.isfinite(found.range_m)
    assert known.mean() > 0.8
    assert np.median(found.range_m[known]) == pytest.approx(RANGE_M, rel=0.01)
    assert np.quantile(np.abs(found.range_m[known] / RANGE_M - 1), 0.9) < 0.03
    places_m, colours = sweep_points(found, CALIBRATION.camera)
    assert places_m.shape == colours.shape == (known.sum(), 3)
    # Where the target is in the map, the cloud is red; and it is about the optical axis.
    middle = np.abs(places_m[:, :2]).max(axis=1) < 0.02
    assert colours[middle, 0].mean() > 2 * colours[middle, 2].mean()
    assert np.abs(places_m[:, :2].mean(axis=0)).max() < 0.01


def test_without_the_target_to_lie_on_the_drift_costs_blocks(sweep: list[SweepFrame]) -> None:
    fixed = [frame._replace(sighting=replace(frame.sighting, centre_px=(319.5, 239.5))) for frame in sweep]
    errors = []
    for frames_ in (sweep, fixed):
        found = sweep_depth(frames_, CALIBRATION)
        assert found is not None
        known = found.range_m[np.isfinite(found.range_m)]
        errors.append(np.abs(known / RANGE_M - 1).mean())
    assert errors[0] < errors[1]


def test_too_little_to_see_is_no_map(sweep: list[SweepFrame]) -> None:
    assert sweep_depth(sweep[:4], CALIBRATION) is None
    assert sweep_depth([frame._replace(sighting=hidden(frame.sighting)) for frame in sweep], CALIBRATION) is None
    edge = [frame._replace(image=frame.image[:, 200:], roi=(300, TOP, 240, 360)) for frame in sweep]
    assert 2 * BLOCK_PX > 319 - 300  # of the target's centre from the edge
    assert sweep_depth(edge, CALIBRATION) is None


def hidden(sighting: Sighting) -> Sighting:
    return replace(sighting, found=False, centre_px=None, radius_px=None)


def test_growth_is_a_line_through_the_radii() -> None:
    lens_positions = np.array([100.0, 200.0, 300.0])
    assert growth(lens_positions, [100.0, 101.0, 102.0]) == pytest.approx(0.02)
    assert growth(lens_positions, [0.0, 0.0, 0.0]) == 0.0


def write_sweep(log: LogWriter, sweep: list[SweepFrame], lost: int | None = None) -> None:
    for n, frame in enumerate(sweep):
        if n != lost:
            for entry in frame_entries("r1", n, n, frame.image, frame.roi, frame.sighting, False):
                log.put(entry)
        log.put(entry_on(VISION, n, n, n, encode(frame.sighting)))


@pytest.mark.parametrize(("lost", "sweeps"), [(None, 1), (7, 0)])
def test_a_whole_sweep_comes_back_from_a_recording(
    tmp_path: Path, sweep: list[SweepFrame], lost: int | None, sweeps: int
) -> None:
    with LogWriter(tmp_path / "r1.mcap", {}) as log:
        write_sweep(log, sweep, lost)
    found = list(whole_sweeps(read(tmp_path / "r1.mcap"), STEPS))
    assert len(found) == sweeps
    for frames_ in found:
        assert [frame.sighting for frame in frames_] == [frame.sighting for frame in sweep]
        assert sweep_depth(frames_, CALIBRATION) is not None


def test_the_report_shows_the_map_of_each_robot(tmp_path: Path) -> None:
    path = write_box(tmp_path)
    shown = report(path, depth=flat).read_text()
    assert '<section id="depth">' in shown
    assert "r1, 0 s: 3 of 4 blocks" in shown
    assert '<section id="depth">' not in report(path).read_text()
