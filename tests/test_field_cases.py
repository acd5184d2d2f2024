"""Inputs like those of public reports, each with what is right. The inputs are not in this tree."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import ConfigError
from agent.process.command import Failed
from hw.camera.camera import CameraError
from tests.places import DATA

CASES = DATA / "field_cases"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="the field cases (shared/data/field_cases) are not here")

CAMERA = ["calibrate", "camera", "SOURCE", "--board", "9x6x20", "--out", "r1.toml"]
POSED = ["reconstruct", "--transforms", "SOURCE", "--out", "out"]
# Below CASES; what is typed, SOURCE for the input; exit codes that are right, and what is said.
TABLE = [
    ("01-*/fronto_many_dist", CAMERA, 2, "do not determine the focal length"),
    ("01-*/fronto_same_dist", CAMERA, 2, "do not determine the focal length"),
    ("03-*/pictures", ["tags", "SOURCE"], 0, r"4 pictures; ids, and in how many: 1 \(4\), .*8 \(4\)"),
    ("04-*/cropped_h/transforms.json", POSED, 2, "is no copy of 320x240"),
    ("04-*/empty_frames/transforms.json", POSED, 2, "key 'frames'"),
    ("04-*/fl_zero/transforms.json", POSED, 2, "key 'fl_x'"),
    ("04-*/int_path/transforms.json", POSED, 2, "file_path"),
    ("05-*/cut.avi", ["tags", "SOURCE"], 1, "ends after 24 of 60 frames"),
    ("05-*/interlaced.mp4", ["tags", "SOURCE"], 1, "frames are the same picture"),
    ("06-*/stack", ["depth-map", "SOURCE", "--out", "d.png"], 2, r"p09\.jpg: .*cut off"),
    ("07-*/frozen", ["depth-map", "SOURCE", "--out", "d.png"], 2, r"p08\.png to p12\.png are the same picture as p07"),
    ("07-*/shifted", ["depth-map", "SOURCE", "--out", "d.png"], 0, r"moved by 1\d\d px during the sweep"),
    ("08-*/german.csv", ["calibrate", "focus", "SOURCE", "--out", "r1.toml"], 0, "Good from 0.22 to 1.20 m"),
    ("08-*/semicolon.csv", ["calibrate", "focus", "SOURCE", "--out", "r1.toml"], 0, "Good from 0.22 to 1.20 m"),
    ("08-*/bom.toml", ["check", "SOURCE"], 0, "fleet 'tank3' of r1, r2"),
    ("09-*/metres.csv", ["calibrate", "focus", "SOURCE", "--out", "r1.toml"], 2, "is u_mm in metres"),
    ("09-*/inches.csv", ["calibrate", "focus", "SOURCE", "--out", "r1.toml"], 2, "is u_mm in inches"),
    ("09-*/mm_units.toml", ["check", "SOURCE"], 0, "tank.size_m: 1500; 0.1 to 60 are usual: write metres"),
    ("10-*/*pad*.mcap", ["replay", "info", "SOURCE"], 0, "whole, but not written by Aucamp"),
    ("10-*/*lz4.mcap", ["replay", "info", "SOURCE"], 0, "whole, but not written by Aucamp"),
    ("11-*/folder", ["tags", "SOURCE"], 1, "is AVIF.*is HEIC.*is JPEG 2000.*is GIF"),
    ("12-*/exif3_all", CAMERA, 0, r"8 of 8 pictures have an EXIF orientation.*centre \((309|310)\.\d, (249|250)\.\d\)"),
    ("14-*/lfs.mcap", ["replay", "info", "SOURCE"], 2, "a Git LFS pointer"),
    ("14-*/html.mcap", ["replay", "info", "SOURCE"], 2, "a page of HTML"),
]


@pytest.mark.parametrize(("where", "typed", "code", "says"), TABLE, ids=[row[0] for row in TABLE])
def test_a_field_case_gives_what_its_readme_calls_right(
    where: str, typed: list[str], code: int, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (source,) = CASES.glob(where)
    if source.suffix == ".csv":  # a figure goes beside the table
        source = Path(shutil.copy(source, tmp_path))
    done = CliRunner().invoke(app, [str(source) if word == "SOURCE" else word for word in typed])
    said, ended = done.output, done.exit_code
    if isinstance(done.exception, ConfigError | CameraError | Failed):  # `main` makes lines of them
        said, ended = f"{said}\n{done.exception}", 1 if isinstance(done.exception, Failed) else 2
    assert ended == code, said
    assert re.search(says, " ".join(said.split())), said
