"""`aucamp depth-map`: its map and its files, of a stack with known depths; what it refuses."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import ConfigError, dump
from agent.core.ranging.focus import h
from agent.perception.depth_peaks import Reason
from agent.perception.tracking.appearance import Box
from agent.process.command import Failed
from agent.tools.depth_map import depth_map, run
from hw.camera.camera import CameraError
from tests.tools.planes import CALIBRATION, FOCUS, quiet


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
    with pytest.raises(ConfigError, match=r"map\.png: cannot be written"):
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
    with pytest.raises(ConfigError, match=r"camera\.toml: has no table \[focus\]; add it by `aucamp calibrate focus`"):
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
