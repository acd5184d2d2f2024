"""`aucamp depth-map`: its map and its files, of a stack with known depths; what it refuses."""

import csv
import json
import math
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from agent.__main__ import main
from agent.core.config import ConfigError, dump
from agent.core.ranging.focus import h
from agent.perception.depth_peaks import BoxRange, GridPeaks, Reason, box_clarity, box_range
from agent.perception.depth_sweep import DepthMap, measure, sweep
from agent.perception.tracking.appearance import Box
from agent.process.command import Failed
from agent.tools.depth_map import (
    GREY,
    LIGHT,
    Squares,
    coloured,
    depth_map,
    ranges_in_words,
    run,
    scale_of,
    spread,
    ticks,
    two_depths,
)
from hw.camera.camera import CameraError
from hw.camera.files import open_stack
from tests.places import DATA
from tests.tools.planes import CALIBRATION, FOCUS, Breathing, quiet


def read_rows(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_two_planes_of_a_stack(planes, tmp_path):
    seen = []
    result = depth_map(str(planes), tmp_path / "map.png", 40, tmp_path, None, lambda *now: seen.append(now))
    blocks = result.blocks
    assert blocks.lens_position.shape == (4, 6) and blocks.range_m is None
    assert blocks.accepted[:2, [0, 1, 4, 5]].all() and not blocks.accepted[3].any()  # plain grey has no distance
    assert set(blocks.reason[2, [0, 1, 4, 5]]) <= {Reason.ACCEPTED, Reason.NO_TEXTURE}  # a quarter of it is plain
    assert (blocks.reason[:3, 2:4] == Reason.TWO_DEPTHS).all()  # each sees the other's plane at its border
    said = result.lens_position_on_parts()[:10]
    assert np.isfinite(said[:, [8, 9, 10, 13, 14, 15]]).all() and np.isnan(said[:, 11:13]).all()
    assert np.nanmax(np.abs(said[:, :12] - 0.21)) < 0.2 * 0.05  # a fifth of a step
    assert np.nanmax(np.abs(said[:, 12:] - 0.388)) < 0.2 * 0.05
    assert seen == [(n, 13) for n in range(1, 14)]


def test_files(planes, tmp_path):
    result = depth_map(f"stack:{planes}", tmp_path / "map.png", 40, tmp_path, None, quiet)
    rows = read_rows(tmp_path / "map.csv")
    assert list(rows[0]) == ["row", "col", "x_px", "y_px", "focus", "sigma", "quality", "accepted", "size_px", "reason"]
    blocks, parts = ([row for row in rows if row["size_px"] == size] for size in ("40", "10"))
    assert len(blocks) == 24 and len(parts) + 24 == len(rows)
    assert {row["reason"] for row in blocks} == {"", "two depths", "no texture"}
    assert {(row["row"], row["col"]) for row in parts} == {(r, c) for r in "012" for c in "23"} | {("2", "1")}
    told = np.zeros((160, 240), int)
    for row in rows:
        assert (row["accepted"] == "1") == (row["reason"] == "")
        if row["accepted"] == "1":
            x, y, half = (float(row[name]) for name in ("x_px", "y_px", "size_px"))
            told[round(y + 0.5 - half / 2) :, round(x + 0.5 - half / 2) :][: int(half), : int(half)] += 1
    assert told.max() == 1 and (told == 1).sum() == 100 * np.isfinite(result.lens_position_on_parts()).sum()
    last = blocks[11]
    assert (last["row"], last["col"], last["x_px"], last["y_px"], last["accepted"]) == ("1", "5", "219.5", "59.5", "1")
    assert float(last["focus"]) == pytest.approx(result.blocks.lens_position[1, 5], rel=1e-5)
    picture = cv2.imread(str(tmp_path / "map.png"))
    assert picture.shape[1] > 2 * 240 and picture.std() > 20


def test_ranges_in_the_files(planes, tmp_path):
    focus = replace(FOCUS, b_m=0.1, rho0=0.0)
    depth_map(str(planes), tmp_path / "map.png", 40, tmp_path, focus, quiet)
    rows = read_rows(tmp_path / "map.csv")
    assert float(rows[0]["range_m"]) == pytest.approx(0.05 + 0.1 / 0.21, rel=0.05)
    assert rows[-1]["range_m"] == ""


def test_the_verb_says_what_it_found(planes, tmp_path):
    (tmp_path / "r1.toml").write_text(dump(CALIBRATION))
    said = run(str(planes), tmp_path / "map.png", 40, tmp_path / "r1.toml")
    assert said.startswith("11 of 24 blocks have a clear peak, 7 more in parts, ") and "map.csv" in said


def test_a_calibration_at_another_resolution_is_refused(planes, tmp_path):
    camera = replace(CALIBRATION.camera, width_px=480, height_px=320)
    (tmp_path / "r1.toml").write_text(dump(replace(CALIBRATION, camera=camera)))
    with pytest.raises(ConfigError, match=r"has pictures of 240x160 pixels, and the camera was calibrated at 480x320"):
        run(str(planes), tmp_path / "map.png", 40, tmp_path / "r1.toml")


def test_what_is_odd_about_a_sweep_is_said(planes, tmp_path):
    for n in range(13):
        path = planes / f"{n:02}.png"
        cv2.imwrite(str(path), (cv2.imread(str(path)) * (0.8 + 0.015 * n)).astype(np.uint8))
    (planes / "positions.csv").write_text(
        "file,focus_position\n" + "".join(f"{n:02}.png,{n + n // 12}\n" for n in range(13))
    )
    said = run(str(planes), tmp_path / "map.png", 40, None).splitlines()
    assert "brightness changed 1.23 times in the sweep, which was undone; set exposure and gain by hand" in said
    assert not any("doubtful" in line for line in said)
    far = "".join(f"{n:02}.png,{n + 2 * (n // 12)}\n" for n in range(13))
    (planes / "positions.csv").write_text(f"file,focus_position\n{far}")
    said = run(str(planes), tmp_path / "again.png", 40, None)
    assert "doubtful: steps between lens positions differ 3.0 times; peaks lean to the closer ones" in said


def test_a_lens_that_looks_down_is_corrected_by_its_sag(planes, tmp_path):
    far = {}
    for name, tilt_deg, sag in (("level", 0.0, 0.5), ("down", -30.0, 0.5), ("stiff", -30.0, 0.0)):
        focus = replace(CALIBRATION.focus, sag=sag, sag_sigma=0.1)
        (tmp_path / f"{name}.toml").write_text(dump(replace(CALIBRATION, focus=focus)))
        run(str(planes), tmp_path / f"{name}.png", 40, tmp_path / f"{name}.toml", tilt_deg=tilt_deg)
        with (tmp_path / f"{name}.csv").open() as file:
            far[name] = [(float(row["focus"]), float(row["range_m"])) for row in csv.DictReader(file) if row["range_m"]]
    assert far["stiff"] == far["level"]
    focus = CALIBRATION.focus
    for (lens_position, there), (_, level) in zip(far["down"], far["level"], strict=True):
        assert there == pytest.approx(h(focus, lens_position + 0.25), rel=1e-3)  # it sank away from the sensor by 0.25
        assert there != level


def test_a_place_that_cannot_be_written_is_one_line(planes, tmp_path):
    with pytest.raises(OSError, match=r"'/proc/map\.csv'"):  # which `aucamp` says in one line
        depth_map(str(planes), Path("/proc/map.png"), 40, tmp_path, None, quiet)


@pytest.mark.parametrize("there", ["map.png", "map.csv", "map.json"])
def test_nothing_is_overwritten(planes, tmp_path, there):
    (tmp_path / there).write_text("mine")
    with pytest.raises(ConfigError, match=f"{there}: is there already, and nothing is overwritten"):
        depth_map(str(planes), tmp_path / "map.png", 40, tmp_path, None, quiet, box=Box(140, 20, 80, 60))
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == [there]


def test_ranges_need_the_table_of_the_focus_alone(planes, tmp_path):
    known = dump(CALIBRATION)
    (tmp_path / "focus.toml").write_text(known[: known.index("[camera]")])
    assert run(str(planes), tmp_path / "map.png", 40, tmp_path / "focus.toml").startswith("11 of 24")
    assert read_rows(tmp_path / "map.csv")[0]["range_m"]
    (tmp_path / "camera.toml").write_text(known[: known.index("[focus]")] + known[known.index("[camera]") :])
    with pytest.raises(ConfigError, match=r"camera\.toml: has no table \[focus\].*`aucamp calibrate focus`"):
        run(str(planes), tmp_path / "other.png", 40, tmp_path / "camera.toml")


def test_a_scene_without_texture_gives_a_map_without_distances(tmp_path):
    rows = ["file,focus_position"]
    for index in range(6):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((64, 64), 90, np.uint8))
        rows.append(f"{index}.png,{index}")
    (tmp_path / "positions.csv").write_text("\n".join(rows))
    result = depth_map(str(tmp_path), tmp_path / "map.png", 16, tmp_path, None, quiet)
    assert not result.blocks.accepted.any()
    assert (tmp_path / "map.png").stat().st_size > 0
    with pytest.raises(Failed, match=r"no block has a clear peak: .*; the map, which is empty, is in .*again\.png"):
        run(str(tmp_path), tmp_path / "again.png", 16, None)


@pytest.mark.parametrize(("block", "out"), [(4, "m.png"), (500, "m.png"), (40, "m.jpg"), (40, "none/m.png")])
def test_wrong_arguments_are_one_line_and_write_nothing(planes, tmp_path, block, out):
    with pytest.raises(ConfigError) as caught:
        depth_map(str(planes), tmp_path / out, block, tmp_path, None, quiet)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / out).exists()


def test_sources_that_cannot_be_swept(planes, tmp_path):
    with pytest.raises(ConfigError, match="nowhere: no such folder; give a folder of photographs"):
        depth_map(str(tmp_path / "nowhere"), tmp_path / "m.png", 40, tmp_path, None, quiet)
    with pytest.raises(CameraError, match="no such kind of camera"):
        depth_map("rtsp://pool", tmp_path / "m.png", 40, tmp_path, None, quiet)
    (planes / "positions.csv").write_text("file,focus_position\n" + "".join(f"{n:02}.png,{n}\n" for n in range(4)))
    with pytest.raises(CameraError, match="4 lens positions; a depth map needs at least 5"):
        depth_map(str(planes), tmp_path / "m.png", 40, tmp_path, None, quiet)
    video = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 64))
    writer.write(np.zeros((64, 64, 3), np.uint8))
    writer.release()
    with pytest.raises(CameraError, match="cannot be set"):
        depth_map(f"video:{video}", tmp_path / "m.png", 40, tmp_path, None, quiet)


# --- depth box ---
# The range of one thing in a box: one clear peak or a reason, in a picture that grows as well.

REFUSALS = {"20,115,80,40": "no texture", "70,10,100,80": "no single peak"}


def test_the_thing_in_a_box_has_one_range(planes, tmp_path):
    focus = replace(FOCUS, b_m=0.1, rho0=0.0, covariance=(1e-6, 0.0, 0.0, 0.0, 0.0, 0.0), noise=0.002)
    (tmp_path / "r1.toml").write_text(dump(replace(CALIBRATION, focus=focus)))
    said = run(str(planes), tmp_path / "map.png", 40, tmp_path / "r1.toml", box="140,20,80,60")
    found = json.loads((tmp_path / "map.json").read_text())
    assert found["box_px"] == [140, 20, 80, 60]
    assert found["position"] == pytest.approx(0.388, abs=0.1 * 0.05) and 0.0 < found["sigma"] < 0.01
    assert found["quality"] > 0.95
    assert found["range_m"] == pytest.approx(0.05 + 0.1 / found["position"])
    slope = 0.1 / found["position"] ** 2  # dh/drho
    assert found["range_sigma_m"] == pytest.approx(math.hypot(slope * max(found["sigma"], 0.002), 1e-3))
    assert said.splitlines()[-1].startswith(f"in the box: {found['range_m']:.4f} m +- ")
    assert "map.json" in said.splitlines()[0]


def squares(*at: float) -> Squares:
    """Nine of each depth, in a sweep whose peaks are 4 steps wide to either side."""
    there = np.sort(np.repeat(at, 9) + np.tile(np.linspace(-0.1, 0.1, 9), len(at)))
    return Squares(there, np.full(len(there), 0.06), np.full(len(there), 4.0))


def test_one_peak_between_two_depths_is_refused_and_a_slope_is_not():
    assert two_depths(squares(5.0, 8.0), 1.0).reason.startswith("it holds two depths, sharp at 5 and at 8; draw it")
    slope = squares(*np.arange(5.0, 8.1, 0.5))
    assert two_depths(slope, 1.0) is None and spread(slope) == pytest.approx(1.0, rel=0.01)
    assert two_depths(squares(5.0), 1.0) is None and spread(squares(5.0)) < 0.06
    odd = squares(5.0)._replace(at=np.append(squares(5.0).at[:-1], 9.0))
    assert two_depths(odd, 1.0) is None, "one square may be wrong"


def test_a_box_keeps_its_piece_of_a_picture_that_grows():
    lens, lens_positions = Breathing(), np.linspace(1.0, 1022.0, 30).round()
    images = []
    for lens_position in lens_positions:
        lens.lens_position = lens_position
        images.append(lens.read().image)
    boxes = [Box(x, x, side, side) for x in (10.0, 190.0) for side in (60.0, 100.0)]
    spread = []
    for size in (0.95 + 0.05 * lens_positions / 1023, np.ones(30)):
        found = [box_range(lens_positions, box_clarity(images, size, box), box, None) for box in boxes]
        assert all(isinstance(one, BoxRange) and one.range_m is None for one in found)
        spread.append(np.ptp([one.lens_position for one in found]))
    assert spread[0] < 0.5 * spread[1]


@pytest.mark.parametrize("box", REFUSALS)
def test_a_thing_without_one_clear_peak_is_refused_in_a_line(planes, tmp_path, box, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["aucamp", "depth-map", str(planes), "--block", "40", "--box", box])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err.strip().splitlines()
    assert ended.value.code == 1 and said[-1].startswith(f"aucamp: box {box}: ") and REFUSALS[box] in said[-1]
    assert (tmp_path / "depth.png").exists() and not (tmp_path / "depth.json").exists()


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        ("200,10,80,40", "240x160"),
        ("10,10,0,40", "at least 8 pixels"),
        ("1,2,3", "four numbers"),
        ("a", "four numbers"),
    ],
)
def test_a_box_that_cannot_be(planes, tmp_path, box, expected):
    with pytest.raises(ConfigError, match=expected) as caught:
        run(str(planes), tmp_path / "map.png", 40, None, box=box)
    assert "\n" not in str(caught.value) and not (tmp_path / "map.png").exists()


# --- depth picture ---
# The map as a picture: every square in its place and colour, hatched where nothing is known.


def test_squares_are_drawn_at_their_size():
    values = np.array([[1.0, 2.0], [np.nan, 3.0]])
    drawn = coloured(values, 12.5, (30, 30), (1.0, 3.0))
    assert drawn.shape == (30, 30, 3) and drawn.dtype == np.uint8
    for row, col in ((0, 0), (0, 1), (1, 1)):
        square = drawn[int(12.5 * row + 1) : int(12.5 * row + 12), int(12.5 * col + 1) : int(12.5 * col + 12)]
        assert len(np.unique(square.reshape(-1, 3), axis=0)) == 1
    nothing = np.concatenate([drawn[13:25, :12].reshape(-1, 3), drawn[26:].reshape(-1, 3)])
    assert {tuple(pixel) for pixel in nothing.tolist()} == {LIGHT, GREY}


def test_a_scale_without_values_or_with_one():
    assert scale_of(np.full((2, 2), np.nan)) is None
    low, high = scale_of(np.array([[0.4, np.nan]]))
    assert low == 0.4 < high
    assert coloured(np.full((2, 2), np.nan), 5.0, (10, 10), None).shape == (10, 10, 3)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1024.0), (-0.066, 0.85), (208.0, 717.0), (0.4, 0.4004)])
def test_ticks_are_round_and_within(low, high):
    found = list(ticks(low, high, 500 / (high - low)))
    assert 3 <= len(found) <= 13
    assert all(low - 1e-9 <= value <= high + 1e-9 and 0 <= at <= 500 for value, at in found)
    steps = np.diff([value for value, _ in found])
    assert np.allclose(steps, steps[0])


# --- depth ranges ---
# What is said of a calibration that does not suit, or suits in part, the lens of a sweep.

OWN = replace(FOCUS, u_inf_m=0.05, b_m=0.1, rho0=0.0, width=0.1, lowest=0, highest=1)  # of the lens of PEAKS
PEAKS = np.array([[0.21, 0.21, 0.388, 0.388, 0.388]])


def said_with(**changed):
    """Of a view with these peaks and a block without one, by a lens that differs from its own in so much."""
    focus, shape = replace(OWN, **changed), (1, 6)
    peaks = np.append(PEAKS, [[0.3]], axis=1)
    accepted = np.arange(6).reshape(shape) < 5
    range_m = np.array([[math.nan if (m := h(focus, rho)) is None else m for rho in peaks[0]]])
    range_m[~accepted] = math.nan
    reason = np.where(accepted, Reason.ACCEPTED, Reason.NO_TEXTURE).astype(np.uint8)
    blocks = GridPeaks(peaks, np.ones(shape), np.full(shape, 0.1), np.ones(shape), reason, range_m)
    found = DepthMap(10, blocks, None, np.zeros((10, 60, 3), np.uint8), 0.0)
    return ranges_in_words(found, focus, Path("r1.toml"), Path("depth.png"))


def test_a_calibration_that_suits_is_not_worth_a_word():
    assert said_with() == []


@pytest.mark.parametrize(("lens", "or_far"), [
    ({"rho0": 180.0, "b_m": 130.0, "lowest": 200, "highest": 700}, False),
    ({"rho0": 0.4, "lowest": 1, "highest": 2}, True),
])  # fmt: skip
def test_a_calibration_that_gives_no_range_is_of_another_camera(lens, or_far):
    with pytest.raises(Failed) as caught:
        said_with(**lens)
    said = str(caught.value)
    assert said.startswith("r1.toml: gives a range to none of the 5 clear peaks, so it is a calibration of another")
    assert "the peaks lie at lens positions 0.21 to 0.388" in said
    assert f"it was made at lens positions {lens['lowest']} to {lens['highest']} (" in said
    assert ("or all of the view is farther than 10 m" in said) == or_far


def test_what_has_no_range_or_one_that_was_not_calibrated_is_counted():
    none, extrapolated = said_with(rho0=0.3, lowest=1, highest=2)
    assert none == "2 of them have no range: 2 are sharp where the lens is set to infinity or beyond"
    assert extrapolated.startswith(
        "3 ranges are extrapolated: they are not at lens positions 1 to 2 (0.11 m to 0.19 m)"
    )


def test_peaks_far_wider_or_narrower_than_those_of_the_calibration_are_doubtful():
    for width in (0.01, 10.0):
        (line,) = said_with(width=width)
        assert line.startswith("doubtful: peaks are ") and "r1.toml, which may be a calibration of another" in line


# --- reference stacks ---
# Depth from focus on the reference stacks, where they are present: against the truth of the simulated one.

STACKS = DATA / "focal_stacks"


@pytest.mark.skipif(not STACKS.is_dir(), reason=f"reference stacks are not here: set AUCAMP_DATA (looked in {STACKS})")
class TestReferenceStacks:
    @pytest.mark.parametrize("block", [12, 13])
    def test_simulated_against_truth(self, block):
        """Half a step over the whole object. The truth lies 0.3 steps from every method's peaks; it is counted."""
        stack = STACKS / "bracket_simulated"
        taken = sweep(open_stack(stack), block, quiet)
        result, parabola = measure(taken, block, None), measure(taken, block, None, "parabola")
        with np.load(stack / "truth.npz") as truth:
            depth, mask = truth["depth"], truth["mask"]
        rows, cols = result.blocks.lens_position.shape
        tiles = (slice(rows * block), slice(cols * block))
        inside = mask[tiles].reshape(rows, block, cols, block).all(axis=(1, 3))
        true = depth[tiles].reshape(rows, block, cols, block).mean(axis=(1, 3))
        counted = inside & result.blocks.accepted
        assert counted.sum() >= 0.7 * inside.sum()
        error, baseline = ((r.blocks.lens_position - true)[counted] / 0.02 for r in (result, parabola))  # steps
        assert np.sqrt(np.mean(error**2)) <= 0.5
        assert np.median(np.abs(error)) <= 0.36
        assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean(baseline**2))
        off = np.abs(error - np.median(error)) * 0.02 / result.blocks.sigma[counted]
        assert 0.8 < np.mean(off < 2.0) < 0.99  # of peaks hardly wider than a step, whose residuals tell nothing
        beside = ~cv2.dilate(mask.astype(np.uint8), np.ones((101, 101)))[tiles].astype(bool)  # 50 px from the object
        nothing = beside.reshape(rows, block, cols, block).all(axis=(1, 3))
        assert nothing.sum() > 200 and not result.blocks.accepted[nothing].any()

    def test_real_bracket(self, tmp_path):
        result = depth_map(str(STACKS / "bracket_real"), tmp_path / "real.png", 32, tmp_path, None, quiet)
        assert np.isfinite(result.lens_position_on_parts()).mean() > 0.8  # textured metal all over; the rest are edges
        assert (result.blocks.reason == Reason.TWO_DEPTHS).mean() > 0.1
        disc, recess = result.blocks.lens_position[4:8, 4:12], result.blocks.lens_position[17:19, 8:24]
        for plane in (disc, recess):
            assert np.median(np.abs(plane - np.median(plane))) < 0.03  # flat; a third of a step
        assert np.median(disc) - np.median(recess) > 0.7
        # Smooth: across the metal, a block differs from the median of its 3 x 3 by less than the focus step of 0.1.
        lens_position = np.where(result.blocks.accepted, result.blocks.lens_position, np.nan)
        rows, cols = lens_position.shape
        around = np.stack([lens_position[r : rows - 2 + r, c : cols - 2 + c] for r in range(3) for c in range(3)])
        rough = np.abs(lens_position[1:-1, 1:-1] - np.median(around, axis=0))  # NaN beside what has none
        assert np.nanmedian(rough) < 0.02 and np.nanmean(rough > 0.1) < 0.05

    def test_a_stack_without_positions(self, tmp_path):
        with pytest.raises(CameraError, match=r"positions\.csv is missing"):
            depth_map(str(STACKS / "phone_balls"), tmp_path / "m.png", 50, tmp_path, None, quiet)
