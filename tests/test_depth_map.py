"""The depth map of a stack with known depths, of a camera, and of the reference stack where it is present."""

import csv
import json
import math
import os
import sys
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from agent.__main__ import main
from agent.config import ConfigError, dump
from agent.depth_box import BoxRange, box_clarity, box_range
from agent.depth_map import depth_map, run
from agent.depth_sweep import measure, sweep
from agent.perception.breathing import measure_growth
from agent.perception.likeness import Box
from agent.ranging.calibration import Calibration, CameraFit, FocusFit
from agent.ranging.focus import h
from hw.camera import CameraError, FocusRange, Frame, Roi
from hw.camera_files import open_stack

DATA = Path(os.environ.get("AUCAMP_DATA", Path(__file__).parents[1] / ".." / "shared" / "data")) / "focal_stacks"
FOCUS = FocusFit(
    u_inf_m=0.05, b_m=200.0, rho0=-300.0, covariance=(0, 0, 0, 0, 0, 0), noise=1.0, width=80.0,
    lowest=0, highest=1023, r2=1.0, rmse_m=0.0, held_out_rmse_m=0.0,
)  # fmt: skip
PINHOLE = CameraFit(width_px=240, height_px=160, f_px=800.0, cx_px=120.0, cy_px=80.0)
CALIBRATION = Calibration(robot="r1", made="2024-01-01", source="invented", focus=FOCUS, camera=PINHOLE)


def quiet(done, total):
    pass


def read_rows(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def blurred(texture, sharp_at, position, per_position):
    """The texture as a lens shows it whose blur grows with the distance from its sharp position."""
    return cv2.GaussianBlur(texture, (0, 0), 0.5 + per_position * abs(position - sharp_at))


def two_planes(position, left, right, per_position):
    """160x240: one plane at `left`, one at `right`, and from row 110 on plain grey."""
    texture = np.random.default_rng(3).integers(0, 256, (160, 240, 3)).astype(np.uint8)
    halves = ((texture[:, :120], left), (texture[:, 120:], right))
    image = np.hstack([blurred(half, sharp_at, position, per_position) for half, sharp_at in halves])
    image[110:] = 128
    return image


class Lens:
    """A camera with 1024 lens positions that reports one less than it was told, as a driver with a coarse step does."""

    size = (240, 160)

    def __init__(self):
        self.position = 700
        self.visited = []

    def focus_range(self):
        return FocusRange(0, 1023, 1)

    def set_focus(self, position):
        self.position = max(position - 1, 0)
        self.visited.append(self.position)
        return self.position

    def read(self, roi=None, settle_s=0.0, timeout_s=1.0):
        return Frame(0, 0, two_planes(self.position, 400.4, 640.7, 1 / 100), Roi(0, 0, *self.size))

    def close(self):
        pass


@pytest.fixture
def planes(tmp_path):
    """Thirteen photographs at 0.00, 0.05, … 0.60: the left plane sharp at 0.21, the right one at 0.388."""
    directory = tmp_path / "planes"
    directory.mkdir()
    rows = ["file,focus_position"]
    for index in range(13):
        cv2.imwrite(str(directory / f"{index:02}.png"), two_planes(0.05 * index, 0.21, 0.388, 10.0))
        rows.append(f"{index:02}.png,{0.05 * index:.2f}")
    (directory / "positions.csv").write_text("\n".join(rows))
    return directory


def test_two_planes_of_a_stack(planes, tmp_path):
    seen = []
    result = depth_map(str(planes), tmp_path / "map.png", 40, tmp_path, None, lambda *now: seen.append(now))
    assert result.position.shape == (4, 6) and result.range_m is None
    assert result.accepted[:3].all() and not result.accepted[3].any()  # plain grey has no distance
    assert np.abs(result.position[:3, :3] - 0.21).max() < 0.1 * 0.05  # a tenth of a step
    assert np.abs(result.position[:3, 3:] - 0.388).max() < 0.1 * 0.05
    assert seen == [(n, 13) for n in range(1, 14)]


def test_files(planes, tmp_path):
    result = depth_map(f"stack:{planes}", tmp_path / "map.png", 40, tmp_path, None, quiet)
    rows = read_rows(tmp_path / "map.csv")
    assert list(rows[0]) == ["row", "col", "x_px", "y_px", "focus", "sigma", "quality", "accepted"]
    assert len(rows) == 24
    last = rows[11]
    assert (last["row"], last["col"], last["x_px"], last["y_px"], last["accepted"]) == ("1", "5", "219.5", "59.5", "1")
    assert float(last["focus"]) == pytest.approx(result.position[1, 5], rel=1e-5)
    picture = cv2.imread(str(tmp_path / "map.png"))
    assert picture.shape[1] == 1200 and picture.std() > 20


def test_the_picture_is_sharp_everywhere(planes):
    sharp = sweep(open_stack(planes), 40, quiet).sharp
    for position in (0.20, 0.40):  # each photograph is sharp on one side only
        photograph = two_planes(position, 0.21, 0.388, 10.0)
        assert cv2.Laplacian(sharp, cv2.CV_64F).var() > 1.2 * cv2.Laplacian(photograph, cv2.CV_64F).var()


def test_a_camera_is_swept_upwards_and_its_own_report_counts(tmp_path):
    lens = Lens()
    taken = sweep(lens, 40, quiet)
    home, *visited = lens.visited
    assert home == 0 and visited == sorted(visited) and len(visited) == 30 and visited[-1] == 1022
    result = measure(taken, 40, CALIBRATION)
    step = 1023 / 29
    assert np.abs(result.position[:3, :3] - 400.4).max() < 0.1 * step
    assert np.abs(result.position[:3, 3:] - 640.7).max() < 0.1 * step
    assert result.range_m[:3, :3] == pytest.approx(0.05 + 200.0 / 700.4, rel=0.01)
    assert np.isnan(result.range_m[3]).all()


def test_ranges_in_the_files(planes, tmp_path):
    focus = msgspec.structs.replace(FOCUS, b_m=0.1, rho0=0.0)
    calibration = msgspec.structs.replace(CALIBRATION, focus=focus)
    depth_map(str(planes), tmp_path / "map.png", 40, tmp_path, calibration, quiet)
    rows = read_rows(tmp_path / "map.csv")
    assert float(rows[0]["range_m"]) == pytest.approx(0.05 + 0.1 / 0.21, rel=0.05)
    assert rows[-1]["range_m"] == ""


class Breathing(Lens):
    """Its picture grows by five percent about the middle, as that of a lens does that focuses nearer."""

    size = (300, 300)
    texture = cv2.GaussianBlur(np.random.default_rng(5).normal(128, 60, (1200, 1200)), (0, 0), 3.0)

    def read(self, roi=None, settle_s=0.0, timeout_s=1.0):
        k = 0.5 * (1 + 0.05 * self.position / 1023)
        warp = np.array([[k, 0, 149.5 - k * 599.5], [0, k, 149.5 - k * 599.5]])
        image = cv2.warpAffine(blurred(self.texture, 500.0, self.position, 1 / 200), warp, self.size)
        grey = np.clip(image, 0, 255).astype(np.uint8)
        return Frame(0, 0, np.repeat(grey[:, :, None], 3, axis=2), Roi(0, 0, *self.size))


def test_the_grid_grows_with_the_picture():
    grown = sweep(Breathing(), 50, quiet)
    assert grown.growth == pytest.approx(0.05, abs=0.004)
    assert sweep(Breathing(), 50, quiet, 0.0).growth == 0.0
    spread = [np.std(measure(sweep(Breathing(), 50, quiet, g), 50, None).position) for g in (0.05, 0.0)]
    assert spread[0] < 0.7 * spread[1]
    with pytest.raises(ConfigError, match=r"growth 0\.5"):
        sweep(Breathing(), 50, quiet, 0.5)


def test_a_scene_without_texture_has_no_growth():
    assert measure_growth([np.full((200, 200), 90, np.uint8)] * 8) is None


def test_the_verb_says_what_it_found(planes, tmp_path):
    (tmp_path / "r1.toml").write_text(dump(CALIBRATION))
    said = run(str(planes), tmp_path / "map.png", 40, tmp_path / "r1.toml")
    assert said.startswith("18 of 24 blocks") and "map.csv" in said


def test_the_thing_in_a_box_has_one_range(planes, tmp_path):
    focus = msgspec.structs.replace(FOCUS, b_m=0.1, rho0=0.0, covariance=(1e-6, 0.0, 0.0, 0.0, 0.0, 0.0), noise=0.002)
    (tmp_path / "r1.toml").write_text(dump(msgspec.structs.replace(CALIBRATION, focus=focus)))
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


def test_a_box_keeps_its_piece_of_a_picture_that_grows():
    lens, focus = Breathing(), np.linspace(1.0, 1022.0, 30).round()
    images = []
    for position in focus:
        lens.position = position
        images.append(lens.read().image)
    boxes = [Box(x, x, side, side) for x in (10.0, 190.0) for side in (60.0, 100.0)]
    spread = []
    for size in (0.95 + 0.05 * focus / 1023, np.ones(30)):
        found = [box_range(focus, box_clarity(images, size, box), box, None) for box in boxes]
        assert all(isinstance(one, BoxRange) and one.range_m is None for one in found)
        spread.append(np.ptp([one.position for one in found]))
    assert spread[0] < 0.5 * spread[1]


REFUSALS = {"20,115,80,40": "no texture", "70,10,100,80": "no single peak"}


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
    for (position, there), (_, level) in zip(far["down"], far["level"], strict=True):
        assert there == pytest.approx(h(focus, position + 0.25), rel=1e-3)  # it sank away from the sensor by 0.25
        assert there != level


def test_a_place_that_cannot_be_written_is_one_line(planes, tmp_path):
    (tmp_path / "map.csv").mkdir()
    with pytest.raises(ConfigError, match=r"map\.png: cannot be written"):
        depth_map(str(planes), tmp_path / "map.png", 40, tmp_path, None, quiet)


def test_a_scene_without_texture_gives_a_map_without_distances(tmp_path):
    rows = ["file,focus_position"]
    for index in range(6):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((64, 64), 90, np.uint8))
        rows.append(f"{index}.png,{index}")
    (tmp_path / "positions.csv").write_text("\n".join(rows))
    result = depth_map(str(tmp_path), tmp_path / "map.png", 16, tmp_path, None, quiet)
    assert not result.accepted.any()
    assert (tmp_path / "map.png").stat().st_size > 0


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
    with pytest.raises(CameraError, match="4 focus positions; a depth map needs at least 5"):
        depth_map(str(planes), tmp_path / "m.png", 40, tmp_path, None, quiet)
    video = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 64))
    writer.write(np.zeros((64, 64, 3), np.uint8))
    writer.release()
    with pytest.raises(CameraError, match="cannot be set"):
        depth_map(f"video:{video}", tmp_path / "m.png", 40, tmp_path, None, quiet)


@pytest.mark.skipif(not DATA.is_dir(), reason=f"reference stacks are not here: set AUCAMP_DATA (looked in {DATA})")
class TestReferenceStacks:
    @pytest.mark.parametrize("block", [12, 13])
    def test_simulated_against_truth(self, block):
        """Half a step over the whole object. The truth lies 0.3 steps from every method's peaks; it is counted."""
        stack = DATA / "bracket_simulated"
        taken = sweep(open_stack(stack), block, quiet)
        result, parabola = measure(taken, block, None), measure(taken, block, None, "parabola")
        with np.load(stack / "truth.npz") as truth:
            depth, mask = truth["depth"], truth["mask"]
        rows, cols = result.position.shape
        tiles = (slice(rows * block), slice(cols * block))
        inside = mask[tiles].reshape(rows, block, cols, block).all(axis=(1, 3))
        true = depth[tiles].reshape(rows, block, cols, block).mean(axis=(1, 3))
        counted = inside & result.accepted
        assert counted.sum() >= 0.7 * inside.sum()
        error, baseline = ((r.position - true)[counted] / 0.02 for r in (result, parabola))  # steps
        assert np.sqrt(np.mean(error**2)) <= 0.5
        assert np.median(np.abs(error)) <= 0.36
        assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean(baseline**2))
        beside = ~cv2.dilate(mask.astype(np.uint8), np.ones((101, 101)))[tiles].astype(bool)  # 50 px from the object
        nothing = beside.reshape(rows, block, cols, block).all(axis=(1, 3))
        assert nothing.sum() > 200 and not result.accepted[nothing].any()

    def test_real_bracket(self, tmp_path):
        result = depth_map(str(DATA / "bracket_real"), tmp_path / "real.png", 32, tmp_path, None, quiet)
        assert result.accepted.mean() > 0.95  # textured metal all over
        disc, recess = result.position[4:8, 4:12], result.position[17:19, 8:24]
        for plane in (disc, recess):
            assert np.median(np.abs(plane - np.median(plane))) < 0.03  # flat; a third of a step
        assert np.median(disc) - np.median(recess) > 0.7
        # Smooth: across the metal, a block differs from the median of its 3 x 3 by less than the focus step of 0.1.
        position = np.where(result.accepted, result.position, np.nan)
        rows, cols = position.shape
        around = np.stack([position[r : rows - 2 + r, c : cols - 2 + c] for r in range(3) for c in range(3)])
        rough = np.abs(position[1:-1, 1:-1] - np.nanmedian(around, axis=0))
        assert np.nanmedian(rough) < 0.02 and np.nanmean(rough > 0.1) < 0.05

    def test_a_stack_without_positions(self, tmp_path):
        with pytest.raises(CameraError, match=r"positions\.csv is missing"):
            depth_map(str(DATA / "phone_balls"), tmp_path / "m.png", 50, tmp_path, None, quiet)
