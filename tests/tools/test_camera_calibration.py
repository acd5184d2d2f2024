"""Intrinsics come back from photographs painted with known ones."""

import io
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from agent.cli.pictures import as_board
from agent.core.config import ConfigError, read_toml
from agent.tools.camera_calibration import (
    board_figure,
    board_picture,
    calibrate_camera,
    of_corners,
    print_board,
    unit_sigma,
)

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
    off = np.abs(np.array([fit.f_px - F, fit.cx_px - CX, fit.cy_px - CY]))
    assert (off < 3.0 * np.array(fit.sigma_px)).all() and off[0] < 0.001 * F
    assert fit.residual_px < 0.15 and fit.fuller_px is None
    assert 0.2 < fit.sigma_px[0] < 2.0 and max(fit.sigma_px[1:]) < 1.0
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


RNG = np.random.default_rng(3)
BAD_VIEWS = {
    "parallel, from far and near": ([(0.0, 0.0, d) for d in np.linspace(400, 600, 7)], "focal length at all"),
    "all tilted alike": ([(0.43, 0.0, d) for d in np.linspace(380, 620, 7)], "focal length at all"),
    "nearly parallel": (
        [(*RNG.normal(0.0, 0.03, 2), d) for d in np.linspace(380, 620, 7)],
        r"focal length (at all|to \d+\.\d %), and 0\.5 % is needed; tilt the board by 20 degrees and more",
    ),
    "a burst of one pose": (
        [(0.3 + RNG.normal(0.0, 0.002), 0.2, 450.0 + RNG.normal(0.0, 0.5)) for _ in range(8)],
        "whole in 8 of 8 photographs, of which 1 differ; 6 are needed",
    ),
}


@pytest.mark.parametrize(("poses", "why"), BAD_VIEWS.values(), ids=BAD_VIEWS)
def test_views_that_do_not_determine_a_camera_are_refused(tmp_path: Path, poses: list, why: str) -> None:
    for k, pose in enumerate(poses):
        photograph(tmp_path / f"{k:02}.png", *pose)
    out = tmp_path / "r1.toml"
    with pytest.raises(ConfigError, match=why):
        calibrate_camera(tmp_path, 9, 6, 25.0, out, QUIET)
    assert not out.exists()


def test_what_is_said_of_its_errors_is_what_they_are(folder: Path) -> None:
    """Against the scatter of fits to corners with noise."""
    board = np.zeros((54, 3), np.float32)
    board[:, :2] = 25.0 * np.mgrid[0:9, 0:6].T.reshape(-1, 2)
    K, straight = np.array([[F, 0, CX], [0, F, CY], [0, 0, 1]]), np.zeros(5)
    turns = [np.array([[t], [u], [0.1]]) for t in (-0.4, 0.0, 0.4) for u in (-0.4, 0.3)]
    places = [np.array([[-100.0], [-60.0], [450.0 + 20 * k]]) for k in range(6)]
    corners = [cv2.projectPoints(board, t, p, K, straight)[0] for t, p in zip(turns, places, strict=True)]
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO
    flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    found = []
    for _ in range(60):
        noisy = [(c + RNG.normal(0.0, 0.2, c.shape)).astype(np.float32) for c in corners]
        _, matrix, *_ = cv2.calibrateCamera([board] * 6, noisy, (640, 480), K.copy(), straight.copy(), flags=flags)
        found.append((matrix[0, 0], matrix[0, 2], matrix[1, 2]))
    said = 0.2 * unit_sigma(board, K, straight, turns, places)[:3]
    assert np.std(found, axis=0) == pytest.approx(said, rel=0.35)


def corners_of(f_px: tuple[float, float], bends: tuple[float, ...]) -> tuple[np.ndarray, list]:
    """A board, and where a lens of k1, k2, p1 and p2 sees it in 14 views, corners 0.1 px off."""
    board = np.zeros((54, 3), np.float32)
    board[:, :2] = 25.0 * np.mgrid[0:9, 0:6].T.reshape(-1, 2)
    K, dice, views = np.array([[f_px[0], 0, CX], [0, f_px[1], CY], [0, 0, 1]]), np.random.default_rng(7), []
    while len(views) < 14:
        turn, z = np.radians(dice.uniform(-35, 35, 3)), dice.uniform(300.0, 800.0)
        place = z * np.array([dice.uniform(-0.4, 0.4), dice.uniform(-0.3, 0.3), 1.0])
        place -= cv2.Rodrigues(turn)[0] @ board.mean(axis=0)
        px = cv2.projectPoints(board, turn, place, K, np.array(bends))[0]
        if (px > 5).all() and (px < (635, 475)).all():
            views.append((px + dice.normal(0.0, 0.1, px.shape)).astype(np.float32))
    return board, views


@pytest.mark.parametrize(
    ("bends", "fuller"),
    [((0.25, 0.0, 0.0, 0.0), False), ((-0.35, 0.15, 0.0, 0.0), True), ((-0.1, 0.0, 0.004, -0.003), True)],
)
def test_a_lens_that_one_term_does_not_describe_is_as_sure_as_it_says(bends: tuple[float, ...], fuller: bool) -> None:
    fit = of_corners(Path("photographs"), *corners_of((500.0, 500.0), bends), (640, 480))
    off = np.abs(np.array([fit.f_px - 500.0, fit.cx_px - CX, fit.cy_px - CY]))
    assert (off < 2.5 * np.array(fit.sigma_px)).all() and max(fit.sigma_px) < 1.6
    assert (fit.fuller_px is not None) == fuller


def test_pictures_that_are_stretched_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"stretched: f is 500\.\d px across and 50[678]\.\d px down"):
        of_corners(Path("photographs"), *corners_of((500.0, 507.0), (-0.1, 0.0, 0.0, 0.0)), (640, 480))


def test_a_square_in_another_unit_is_a_warning(capsys: pytest.CaptureFixture) -> None:
    assert as_board("9x6x25") == (9, 6, 25.0)
    assert capsys.readouterr().err == ""
    assert as_board("9x6x2.5") == (9, 6, 2.5)
    assert "squares of 2.5 mm are rarely printed; the last number is in millimetres" in capsys.readouterr().err


def test_the_board_to_print_is_true_to_size_and_found(tmp_path) -> None:
    paper, drawn = board_figure(14, 9, 20.0)
    width_in, height_in = drawn.get_size_inches()
    assert (paper, width_in * 25.4, height_in * 25.4) == ("A3", pytest.approx(420), pytest.approx(297))
    drawn.savefig(tmp_path / "board.png", dpi=8 * 25.4)  # eight pixels a millimetre, so that grains begin at pixels
    sheet = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    far = cv2.resize(sheet, None, fx=3 / 16, fy=3 / 16, interpolation=cv2.INTER_AREA)  # a square is 30 pixels wide
    high, wide = far.shape
    dice = np.random.default_rng(1)
    seen = 90 + 3 * dice.normal(0.0, 5.0, (2 * high, 2 * wide))
    seen[high // 2 : high // 2 + high, wide // 2 : wide // 2 + wide] = 20 + 0.7 * far
    seen = np.clip(cv2.GaussianBlur(seen, (0, 0), 0.7), 0, 255).astype(np.uint8)
    found, corners = cv2.findChessboardCornersSB(seen, (14, 9), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    assert found
    steps = np.diff(corners.reshape(9, 14, 2), axis=1)
    assert np.hypot(*steps.reshape(-1, 2).T) == pytest.approx(30.0, abs=0.3)


def test_the_squares_of_the_board_have_grain_of_their_own_and_stay_apart() -> None:
    picture = board_picture(14, 9, 20.0)
    assert picture.shape == (400, 600)
    dark, bright = picture[6:34, 6:34], picture[6:34, 46:74]
    assert dark.std() > 0.08 and bright.std() > 0.08
    assert dark.mean() < 0.35 and bright.mean() > 0.65


def test_a_pdf_has_the_size_of_its_paper_and_nothing_is_overwritten(tmp_path) -> None:
    out = tmp_path / "board.pdf"
    print_board(9, 6, 20.0, out, QUIET)
    box = re.search(rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+) *\]", out.read_bytes())
    assert [float(side) / 72 * 25.4 for side in box.groups()] == pytest.approx([297, 210], abs=0.01)
    with pytest.raises(ConfigError, match="is there already"):
        print_board(14, 9, 20.0, out, QUIET)
    with pytest.raises(ConfigError, match="larger than A0"):
        print_board(60, 40, 30.0, tmp_path / "large.pdf", QUIET)
