"""The detection claim on a folder of pictures counts honestly, and says in one line what a truth.csv lacks."""

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.experiments.claim import Share
from agent.experiments.detection_pictures import Settings, look, marked_pictures, run, summary
from hw.camera.files import read_picture
from tests.perception.painted import grain
from tests.places import DATA

HEAD = "file,colour,u_px,v_px,radius_px,tol_px,look\n"
BGR = {"red": (50, 50, 170), "yellow": (50, 180, 180)}


def picture(path, **balls):
    """A grey wall with discs of 14 px radius, at (u, v)."""
    image = np.repeat((128 + 8 * grain((240, 320), 3))[..., None], 3, axis=-1).astype(np.uint8)
    for colour, centre in balls.items():
        cv2.circle(image, centre, 14, BGR[colour], -1, cv2.LINE_AA)
    cv2.imwrite(str(path), cv2.GaussianBlur(image, (0, 0), 0.8))


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    """A ball as marked, one that is none, one marked elsewhere, and a picture that nobody marked."""
    folder = tmp_path_factory.mktemp("pool")
    picture(folder / "a.png", red=(100, 120), yellow=(220, 80))
    picture(folder / "b.png", red=(100, 120))
    (folder / "truth.csv").write_text(HEAD + "a.png,red,100,120,14.5,,clear\na.png,yellow,150,200,14,0.5,faint\n")
    return folder


def seen(folder):
    """Rows and figures of a folder."""
    rows = run(0, "all", Settings(folder=str(folder)))
    return rows, summary({"all": rows})


def test_found_missed_and_false(pool):
    rows, figures = seen(pool)
    assert [row["file"] for row in rows] == ["a.png", "b.png"]
    assert figures["red_found"] == Share(1, 1) and figures["red_radius_percent"].values[0] < 5.0
    assert figures["yellow_found"] == Share(0, 1) and "yellow_radius_percent" not in figures
    assert not any(key.startswith("green") or "small" in key for key in figures)
    # The yellow one that was marked elsewhere, and the red one of b, once: as orange it looks the same.
    assert sorted((row["file"], false[0]) for row in rows for false in row["false"]) == [
        ("a.png", "yellow"),
        ("b.png", "red"),
    ]
    assert figures["false"] == 2.0 and figures["within_3_sigma"] == Share(1, 1)


def test_a_folder_without_truth_holds_no_ball(tmp_path):
    picture(tmp_path / "a.png")
    assert marked_pictures(tmp_path) == [(tmp_path / "a.png", [])]
    assert seen(tmp_path)[1] == {"false": 0.0}


def test_no_folder_is_one_line():
    with pytest.raises(ConfigError, match="--set folder=DIR"):
        run(0, "all", Settings())


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("file,colour,u_px,v_px\n", "no column `radius_px`"),
        (HEAD + "c.png,red,1,2,3,,\n", "line 2: no picture 'c.png' beside it"),
        (HEAD + "a.png,blue,1,2,3,,\n", "colour 'blue' is not known; write red, orange, yellow, green"),
        (HEAD + "a.png,red,one,2,3,,\n", "u_px: 'one' is no number"),
        (HEAD + "a.png,red,1,nan,3,,\n", "v_px: 'nan' is no number"),
        (HEAD + "a.png,red,1,2,0,,\n", "radius_px is 0; a ball has a radius above 0"),
        (HEAD + "a.png,red,1,2,3,-1,\n", "tol_px is -1; write 0 or more"),
        (HEAD + "a.png,red,1\n", "v_px: '' is no number"),
    ],
)
def test_a_bad_truth_is_one_line(tmp_path, text, complaint):
    (tmp_path / "a.png").touch()
    (tmp_path / "truth.csv").write_text(text)
    with pytest.raises(ConfigError) as error:
        marked_pictures(tmp_path)
    assert complaint in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(("row", "shows"), [("a.png,red,328,120,10", True), ("a.png,red,2000,120,14", False)])
def test_a_ball_is_marked_in_its_picture_or_at_its_border(tmp_path, row, shows):
    picture(tmp_path / "a.png")
    (tmp_path / "truth.csv").write_text(f"{HEAD}{row},,\n")
    if shows:
        assert len(marked_pictures(tmp_path)[0][1]) == 1
    else:
        with pytest.raises(ConfigError, match=r"line 2: nothing of the ball is in a.png, of 320x240 pixels; correct"):
            marked_pictures(tmp_path)


@pytest.mark.skipif(
    not (DATA / "real_water").is_dir(), reason="the real pictures (shared/data/real_water) are not here"
)
@pytest.mark.parametrize(
    ("folder", "name", "colour"),
    [
        ("balls", "usc_b_0003.jpg", "yellow"),
        ("balls", "usc_b_0008.jpg", "orange"),
        ("balls", "csula_front141.jpg", "red"),
        ("balls", "csula_front141.jpg", "green"),
        ("balls", "csula_front131.jpg", "yellow"),
        ("balls_composite", "comp_018.jpg", "red"),
        ("balls_composite", "comp_054.jpg", "green"),
    ],
)
def test_real_balls(tmp_path, folder, name, colour):
    source = DATA / "real_water" / folder
    rows = [line for line in (source / "truth.csv").read_text().splitlines() if line.startswith(("file", name))]
    (tmp_path / "truth.csv").write_text("\n".join(rows))
    (tmp_path / name).symlink_to(source / name)
    (row,), _ = seen(tmp_path)
    (ball,) = (ball for ball in row["balls"] if ball["colour"] == colour)
    assert ball["found"] and ball["radius_percent"] < 6.0


@pytest.mark.skipif(
    not (DATA / "real_water").is_dir(), reason="the real pictures (shared/data/real_water) are not here"
)
def test_a_vignetted_view_is_no_ball(tmp_path):
    for name in ("csula_front035.jpg", "csula_front019.jpg"):
        (tmp_path / name).symlink_to(DATA / "real_water" / "no_balls" / name)
    assert seen(tmp_path)[1]["false"] == 0.0


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the shared data are not here: set AUCAMP_DATA (looked in {DATA})")
def test_a_yellow_ball_beside_a_red_one_is_not_red() -> None:
    """It has a hue between both, and more green light than red. The frame cuts a green one off."""
    image = read_picture(DATA / "real_water" / "failing" / "balls" / "frame-043.png")
    found = {(colour, round(ball.centre_px[0], -1)) for colour, ball in look(image, []).false}
    assert found == {("red", 490), ("yellow", 340), ("green", 640)}


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the shared data are not here: set AUCAMP_DATA (looked in {DATA})")
def test_a_green_ball_under_a_camera_that_balances_white() -> None:
    """It has as much red as the water beside it."""
    image = read_picture(DATA / "real_water" / "failing" / "balls" / "frame-000.png")
    found = {(colour, round(ball.centre_px[0], -1)) for colour, ball in look(image, []).false}
    assert found == {("red", 200), ("yellow", 50), ("green", 340)}
