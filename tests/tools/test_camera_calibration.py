"""Intrinsics come back from photographs painted with known ones."""

import io
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from agent.core.config import ConfigError, read_toml
from agent.tools.camera_calibration import calibrate_camera

F, CX, CY = 820.0, 330.0, 232.0
QUIET = Console(quiet=True)


def photograph(path: Path, tilt: float, turn: float, distance_mm: float) -> None:
    """A board of 10 x 7 squares of 25 mm, painted through a pinhole four times as fine and averaged down."""
    squares = np.kron(np.indices((7, 10)).sum(axis=0) % 2, np.ones((40, 40))) * 170 + 40
    sheet = np.pad(squares, 40, constant_values=210).astype(np.uint8)
    rotation = cv2.Rodrigues(np.array([tilt, turn, 0.1]))[0]
    mm = np.array([[25 / 40, 0, -25 * 5 - 25], [0, 25 / 40, -25 * 3.5 - 25], [0, 0, 1]])  # sheet pixel -> mm on board
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], [0.0, 0.0, distance_mm]])
    K = np.array([[4 * F, 0, 4 * CX + 1.5], [0, 4 * F, 4 * CY + 1.5], [0, 0, 1]])
    fine = cv2.warpPerspective(sheet, K @ plane @ mm, (2560, 1920), borderValue=120)
    cv2.imwrite(str(path), cv2.resize(fine, (640, 480), interpolation=cv2.INTER_AREA))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    poses = [(t, u, d) for t in (-0.4, 0.0, 0.4) for u in (-0.4, 0.3) for d in (420.0, 550.0)]
    for k, pose in enumerate(poses):
        photograph(folder / f"{k:02}.png", *pose)
    return folder


def test_known_intrinsics_come_back(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "r1.toml"
    out.write_text('robot = "r1"\n[camera]\npan_zero_deg = 0.5\nf_px = 1.0\n[focus]\nrho0 = 3.0\n')
    fit = calibrate_camera(folder, 9, 6, 25.0, out, QUIET)
    assert fit.f_px == pytest.approx(F, rel=0.003)
    assert (fit.cx_px, fit.cy_px) == pytest.approx((CX, CY), abs=3.0)
    assert fit.residual_px < 0.3
    content = read_toml(out)
    assert content["camera"]["f_px"] == fit.f_px
    assert content["camera"]["pan_zero_deg"] == 0.5
    assert content["camera"]["bend"] == fit.k1 and content["camera"]["breathing"] == 0.0
    assert content["focus"] == {"rho0": 3.0}


def test_what_cannot_be_used_is_one_line(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such folder"):
        calibrate_camera(tmp_path / "none", 9, 6, 25.0, None, QUIET)
    with pytest.raises(ConfigError, match="whole in 0 of 12"):
        calibrate_camera(folder, 13, 6, 25.0, None, QUIET)
    with pytest.raises(ConfigError, match="no pictures in this folder; it needs a PNG"):
        calibrate_camera(tmp_path, 9, 6, 25.0, None, QUIET)
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(ConfigError, match=r"a\.png: not an image that OpenCV can read"):
        calibrate_camera(tmp_path, 9, 6, 25.0, None, QUIET)


def test_photographs_that_cannot_be_read_are_left_out_by_name(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    (tmp_path / "00.png").write_bytes(b"")
    (tmp_path / "z.heic").write_bytes(b"\0\0\0\x18ftypheic")
    console = Console(record=True, width=200, file=io.StringIO())
    assert calibrate_camera(tmp_path, 9, 6, 25.0, None, console).views == 11
    said = console.export_text()
    assert "left out: " in said and "00.png: not an image that OpenCV can read (it is empty)" in said
    assert "z.heic: is HEIC" in said
