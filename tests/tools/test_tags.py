"""`aucamp tags`: a line for each tag, pictures with them drawn in, and mistakes in one line."""

import sys

import cv2
import msgspec
import numpy as np
import pytest
import tomli_w

from agent.__main__ import main
from agent.tools.tags import HEADER, Asked, run
from tests.known_lens import CAMERA, PLAIN
from tests.perception.printed import modules, photograph

SIDE_PX = 64  # of the black square


def paper(*numbers, blur_px=1.0):
    """Tags side by side on a grey wall, the first corner of each at (32 + 144 k, 32) from its edge on."""
    tags = [np.pad(0.03 + 0.67 * np.kron(modules(n), np.ones((8, 8))), 32, constant_values=0.3) for n in numbers]
    return photograph(np.hstack(tags), blur_px)


@pytest.fixture
def folder(tmp_path):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name, image in (("a", paper(0, 3)), ("b", paper(3, blur_px=4.0)), ("c", np.full((100, 120, 3), 90, np.uint8))):
        cv2.imwrite(str(pictures / f"{name}.png"), image)
    return pictures


def fleet_file(tmp_path, *ids):
    """One robot in a tank, and tags on its wall."""
    robot = {
        "listen": "tcp/127.0.0.1:17401",
        "serial": "twin:r1",
        "camera": "twin:r1",
        "pose": {"x_m": 0.5, "y_m": 0.5, "yaw_deg": 0.0},
        "calibration": "r1.toml",
        "neighbours": [],
    }
    tags = [{"id": k, "face": "y0", "position_m": [0.2 + 0.2 * n, 0.0, 0.2]} for n, k in enumerate(ids)]
    content = {"fleet": "one", "target": {"ball": {"radius_m": 0.07}}, "robot": {"r1": robot}}
    if ids:
        content["landmarks"] = {"size_m": 0.08, "tag": tags}
    path = tmp_path / "fleet.toml"
    path.write_text(tomli_w.dumps(content))
    return path


def test_a_folder(folder, tmp_path, capsys):
    lines = []
    assert run(str(folder), Asked(out=tmp_path / "out"), lines.append)
    assert lines[0] == HEADER
    rows = [line.split(",") for line in lines[1:]]
    assert [(row[0], row[1], row[2], row[5]) for row in rows] == [
        ("a.png", "", "0", "sharp"),
        ("a.png", "", "3", "sharp"),
        ("b.png", "", "3", "blurred"),
    ]
    for left_px, row in zip((0, 144, 0), rows, strict=True):
        x, y = 39.5 + left_px, 39.5  # behind a margin of one module, from a pixel's middle to its border
        expected = np.array([x, y, x + SIDE_PX, y, x + SIDE_PX, y + SIDE_PX, x, y + SIDE_PX])
        assert np.abs(np.array(row[6:], float) - expected).max() < 0.1
        assert float(row[3]) == pytest.approx(SIDE_PX, abs=0.1)
    assert float(rows[2][4]) == pytest.approx(4.0, abs=0.5)
    assert capsys.readouterr().err.splitlines()[-2:] == [
        "3 pictures; ids, and in how many: 0 (1), 3 (2)",
        "no tag in 1: c.png",
    ]
    drawn = cv2.imread(str(tmp_path / "out" / "a.png"))
    assert drawn[39, 39].tolist() == [60, 220, 60]  # the first corner has a green dot


def test_what_the_fleet_file_does_not_know(folder, tmp_path, capsys):
    assert not run(str(folder), Asked(fleet=fleet_file(tmp_path, 0, 5), out=tmp_path / "out"), lambda line: None)
    said = capsys.readouterr().err
    assert "fleet.toml: 3; add where they hang, or take them away" in said and "not seen: 5" in said
    assert cv2.imread(str(tmp_path / "out" / "b.png"))[39, 39].tolist() == [60, 60, 230]  # red
    assert run(str(folder / "b.png"), Asked(fleet=fleet_file(tmp_path, 3)), lambda line: None)


def test_two_of_one_id_are_said(tmp_path, capsys):
    picture, lines = tmp_path / "twins.png", []
    cv2.imwrite(str(picture), paper(1, 1))
    assert not run(str(picture), Asked(), lines.append)
    assert [line.split(",")[2:6:3] for line in lines[1:]] == [["1", "double"]] * 2
    assert "more than once in a picture, where none of them counts: 1" in capsys.readouterr().err


def test_a_film_without_tags_is_an_answer_too(tmp_path):
    film = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"MJPG"), 30, (120, 96))
    for _ in range(3):
        writer.write(np.full((96, 120, 3), 90, np.uint8))
    writer.release()
    lines = []
    assert not run(str(film), Asked(), lines.append)
    assert lines == [HEADER]


MISTAKES = [
    (["nowhere"], "no such file or folder"),
    (["twin:r1"], "--frames"),
    (["pictures", "--calibration", "none.toml"], "none.toml"),
    (["pictures", "--calibration", "r1.toml"], "calibrated for 640x480 pixels, and these pictures have 288x144"),
    (["pictures", "--fleet", "fleet.toml"], "has no table [landmarks]; add it, or leave --fleet out"),
    (["pictures", "--out", "pictures"], "not empty, and nothing is overwritten"),
]


@pytest.mark.parametrize(("arguments", "expected"), MISTAKES)
def test_mistakes(arguments, expected, folder, tmp_path, monkeypatch, capsys):
    fleet_file(tmp_path)
    camera, focus = (msgspec.to_builtins(part) for part in (CAMERA, PLAIN))
    del focus["sag_sigma"], focus["field"], camera["covariance"]  # TOML has no word for what nobody measured
    calibration = {"robot": "r1", "made": "2026-01-01", "source": "a test", "focus": focus, "camera": camera}
    (tmp_path / "r1.toml").write_text(tomli_w.dumps(calibration))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["aucamp", "tags", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    (line,) = said.err.strip().splitlines()
    assert ended.value.code == 2 and line.startswith("aucamp: ") and expected in line and said.out == ""


def test_what_cannot_be_read_is_named_and_ends_with_exit_1(folder, capsys):
    (folder / "d.jpg").write_bytes(b"")
    (folder / "e.heic").write_bytes(b"\0\0\0\x18ftypheic")
    lines = []
    assert not run(str(folder), Asked(), lines.append)
    assert {line.split(",")[2] for line in lines[1:]} == {"0", "3"}
    said = capsys.readouterr().err
    assert "d.jpg: not an image that OpenCV can read (it is empty)" in said
    assert "e.heic: is HEIC, which is not read; convert it to PNG or JPEG" in said
