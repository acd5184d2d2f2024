"""`aucamp track`: a line for each picture, pictures with the box, and mistakes in one line."""

import json
import sys

import cv2
import numpy as np
import pytest

from agent.__main__ import main
from agent.core.config import ConfigError
from agent.perception.tracking import follow
from agent.perception.tracking.appearance import Box, Likeness
from agent.perception.tracking.follow import LIMITS, Followed, Follower, load_box_tracker, model_files
from agent.tools.track import HEADER, Asked, Truth, annotated, check_rows, parse_box, read_truth, run, score, writer
from tests.perception.tracking.swimming import clip, overlap
from tests.places import DATA

NANO = DATA / "models" / "nanotrack_v2"


@pytest.fixture
def folder(tmp_path):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    boxes = []
    for k, (image, box) in enumerate(clip(6)):
        cv2.imwrite(str(pictures / f"{k:03}.png"), image)
        boxes.append(box)
    return pictures, boxes


def text(box):
    return ",".join(map(str, box))


def test_a_folder(folder, tmp_path):
    pictures, boxes = folder
    lines = []
    assert run(str(pictures), Asked(text(boxes[0]), out=tmp_path / "out"), lines.append)
    assert lines[0] == HEADER and len(lines) == 7
    for line, box in zip(lines[1:], boxes, strict=True):
        name, t_s, x, y, w, h, score, state = line.split(",")
        assert t_s == "" and state == "followed" and float(score) > 0.5
        assert overlap(tuple(map(float, (x, y, w, h))), box) > 0.6, name
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [f"{k:06}.png" for k in range(6)]


def test_pictures_whose_names_fall_together_are_all_written(tmp_path):
    out = tmp_path / "out"
    names = ["000007.png", "07.png", "7.jpg", "a.jpg", "a.png", "a.png.png"]
    with writer(out) as show:
        for k, name in enumerate(names):
            show(np.full((4, 4, 3), k, np.uint8), name)
    kept = {path.name: int(cv2.imread(str(path))[0, 0, 0]) for path in out.iterdir()}
    assert kept == {
        "000007.png": 0, "07.png.png": 1, "7.jpg.png": 2, "a.png": 3, "a.png.png": 4, "a.png.png.png": 5,
    }  # fmt: skip


def filmed(path, frames, rate_hz):
    """The clip's pictures as a film."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate_hz, (480, 360))
    for image, _ in frames:
        writer.write(image)
    writer.release()
    return path


def test_a_video_in_and_out(tmp_path):
    frames = list(clip(4))
    film = filmed(tmp_path / "film.avi", frames, 12.5)
    lines = []
    assert run(str(film), Asked(text(frames[0][1]), out=tmp_path / "out.avi"), lines.append)
    assert [line.split(",")[0] for line in lines[1:]] == ["0", "1", "2", "3"]
    out = cv2.VideoCapture(str(tmp_path / "out.avi"))
    assert (out.get(cv2.CAP_PROP_FRAME_COUNT), out.get(cv2.CAP_PROP_FPS)) == (4, 12.5)


@pytest.mark.parametrize("name", ["out.mp4", "out.avi"])
def test_a_film_of_odd_pictures_loses_neither_column_nor_row(tmp_path, name):
    image = np.zeros((43, 61, 3), np.uint8)
    image[32:, :], image[:, 48:] = 200, 200
    with writer(tmp_path / name) as show:
        show(image, "0")
    _, seen = cv2.VideoCapture(str(tmp_path / name)).read()
    assert seen.shape == (44, 62, 3)
    assert np.abs(seen[:43, :61].astype(int) - image).max() < 60 and seen[43].min() > 150 and seen[:, 61].min() > 150


@pytest.mark.parametrize("box", ["1,2,3", "a,b,c,d", "1,2,nan,4", ""])
def test_a_box_is_four_numbers(box):
    with pytest.raises(ConfigError, match="four numbers"):
        parse_box(box)


MISTAKES = [
    (["nowhere", "--box", "1,1,50,50"], "no such file or folder"),
    (["twin:r1", "--box", "1,1,50,50"], "--frames"),
    (["empty", "--box", "1,1,50,50"], "no pictures"),
    (["pictures", "--box", "1,1,9999,50"], "480x360"),
    (
        ["pictures", "--box", "1,1,50,50", "--out", "pictures"],
        "not empty, and nothing is overwritten; give --out a new",
    ),
    (["pictures", "--box", "1,1,50,50", "--out", "mine.avi"], "mine.avi: is there already, and nothing is overwritten"),
    (["pictures", "--box", "1,1,50,50", "--out", "mine.txt"], "give --out a folder, or a video that ends in .mp4 or"),
    (["pictures", "--box", "0,0,0,0", "--out", "new"], "draw it inside the 480x360 picture"),
    (["pictures", "--box", "-5,0,50,50", "--out", "new"], "draw it inside the 480x360 picture"),
    (["pictures", "--box", "1,1,50,50", "--nanotrack", "x.onnx", "y.onnx"], "x.onnx: no such file"),
    (["pictures", "--box", "1,1,50,50", "--nanotrack", "x.onnx"], "requires 2 arguments"),
]


@pytest.mark.parametrize(("arguments", "expected"), MISTAKES)
def test_mistakes(arguments, expected, folder, tmp_path, monkeypatch, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "mine.avi").write_text("mine")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["aucamp", "track", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    (line,) = said.err.strip().splitlines()
    assert ended.value.code == 2 and line.startswith("aucamp: ") and expected in line and said.out == ""
    assert not (tmp_path / "new").exists() and (tmp_path / "mine.avi").read_text() == "mine"


@pytest.mark.parametrize("models", [
    pytest.param(None, id="filter"),
    pytest.param(model_files(NANO), id="nano", marks=pytest.mark.skipif(not NANO.is_dir(), reason="no NanoTrack here")),
])  # fmt: skip
@pytest.mark.parametrize("box", ["0,0,480,360", "4,4,472,352", "0,0,480,40", "0,0,8,8"])
def test_a_box_may_be_as_large_as_the_picture_or_at_its_border(folder, models, box):
    lines = []
    assert run(str(folder[0]), Asked(box, models, 3), lines.append) in (True, False)
    drawn = ",".join(f"{float(side):.1f}" for side in box.split(","))
    assert len(lines) == 4 and lines[1] == f"000.png,,{drawn},1.00,followed"


# --- track truth ---
# `aucamp track --truth`: what is counted, what is written, and mistakes in one line.

HERE, BESIDE = Box(10, 10, 20, 20), Box(16, 10, 20, 20)
KEYS = {"frames", "on_target", "mean_iou", "absent", "absent_said_lost", "present_said_lost"}


def test_what_is_counted():
    """At 4 pictures a second the first two after it went are in grace."""
    truth = [
        Truth(0, HERE), Truth(1, HERE), Truth(2, HERE), Truth(3, HERE, counted=False),
        *(Truth(k, None) for k in range(4, 10)), Truth(10, HERE),
    ]  # fmt: skip
    states = [
        "followed",
        "found again",
        "ambiguous",
        "lost",
        "followed",
        "lost",
        "followed",
        "lost",
        "lost",
        "ambiguous",
    ]
    said = [Followed(BESIDE if k == 1 else HERE, 0.5, state) for k, state in enumerate([*states, "lost"])]
    found = score(truth, dict(enumerate(said)), rate_hz=4.0)
    assert (found.frames, found.absent, found.in_grace, found.in_grace_said_lost) == (4 + 3, 3, 3, 1)
    assert (found.absent_said_lost, found.present_said_lost, found.on_target) == (3, 2, 2)
    assert found.mean_iou_followed == pytest.approx((1.0 + 14 / 26) / 2)
    assert found.mean_iou == pytest.approx((1.0 + 14 / 26) / 4)


def test_a_thing_that_is_called_followed_while_it_is_away_counts_against_it():
    truth = [Truth(0, HERE), *(Truth(k, None) for k in range(1, 8))]
    found = score(truth, dict.fromkeys(range(8), Followed(HERE, 0.9, "followed")), rate_hz=4.0)
    assert (found.absent, found.absent_said_lost) == (4, 0)


def write(path, rows, header="frame,x,y,w,h,visible,count,seen"):
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_figures_of_a_folder(tmp_path, capsys):
    rows = []
    for k, (image, box) in enumerate(clip(5, range(3, 5))):
        cv2.imwrite(str(tmp_path / f"{k:03}.png"), image)
        rows.append(f"{k},{','.join(map(str, box))},1,1,whole" if box else f"{k},,,,,0,1,none")
    truth = write(tmp_path / "truth.csv", rows)
    assert run(str(tmp_path), Asked(truth=truth, out=tmp_path / "out", rate_hz=2.0), lambda line: None)
    found = json.loads((tmp_path / "out" / "result.json").read_text())
    assert set(found) >= KEYS and found["frames"] == 3 and found["on_target"] == 3 and found["mean_iou"] > 0.7
    assert found["absent"] == 0 and found["in_grace"] == 2
    told = capsys.readouterr().err
    assert "--strict" in told and "--keep" in told and "written to" in told


def test_frames_that_cannot_be_read_keep_their_numbers_and_are_not_scored(tmp_path, capsys):
    """It is at another place in each frame: against the rows of others it would miss."""
    source, rows = tmp_path / "source", []
    source.mkdir()
    for k, (image, box) in enumerate(clip(7)):
        cv2.imwrite(str(source / f"{k}.png"), image)
        rows.append(f"{k},{','.join(map(str, box))},1")
    truth = write(tmp_path / "truth.csv", rows, "frame,x,y,w,h,visible")
    figures = []
    for bad in ((), (0, 3)):
        for k in bad:
            (source / f"{k}.png").write_bytes(b"")
        out = tmp_path / f"out{len(bad)}"
        assert run(str(source), Asked(truth=truth, out=out), lambda line: None) is not bool(bad)
        figures.append(json.loads((out / "result.json").read_text()))
    assert [(each["frames"], each["on_target"]) for each in figures] == [(7, 7), (5, 5)]
    assert figures[1]["mean_iou"] == pytest.approx(figures[0]["mean_iou"], abs=0.1)
    assert "--truth: 2 of 7 marked frames could not be read and are not scored" in capsys.readouterr().err
    write(truth, rows[3:], "frame,x,y,w,h,visible")
    with pytest.raises(ConfigError, match="not marked in frame 1, the first that can be read"):
        run(str(source), Asked(truth=truth), lambda line: None)


def test_a_film_is_as_long_as_it_announces_before_it_is_walked(tmp_path):
    film = filmed(tmp_path / "film.avi", list(clip(4)), 30.0)
    truth = write(tmp_path / "truth.csv", ["0,10,10,20,20,1", "4,10,10,20,20,1"], "frame,x,y,w,h,visible")
    lines = []
    with pytest.raises(ConfigError, match="frame 4 is marked, but the source has 4 pictures"):
        run(str(film), Asked(truth=truth, out=tmp_path / "out"), lines.append)
    assert not lines and not (tmp_path / "out").exists()


def test_what_keeps_does_not_let_go_of_what_fades(monkeypatch):
    """Half of the colours that it showed lately, and of a middling shape: certain for the one, not for the other."""
    frames = list(clip(4))
    monkeypatch.setattr(follow, "likeness", lambda *about: Likeness(0.62, 0.55))
    states = {}
    for name, limits in LIMITS.items():
        follower = Follower(load_box_tracker(None), limits)
        follower.start(frames[0][0], Box(*frames[0][1]))
        states[name] = {follower.look(frames[0][0]).state for _ in range(3 * limits.patience)}
    assert states["keep"] == {"followed"} < states["strict"]


def test_where_it_may_be_is_drawn_while_it_is_lost():
    """A ring that grows; no box, which would say that it is there."""
    image, box = np.zeros((200, 200, 3), np.uint8), Box(80, 80, 40, 40)
    rings = [annotated(image, Followed(box, 0.0, "lost", reach_px)) for reach_px in (35.0, 60.0)]
    for ring, reach_px in zip(rings, (35, 60), strict=True):
        assert ring[95:105, 100 + reach_px].any() and not ring[80, 80:120].any()


TRACK_TRUTH_MISTAKES = {
    "no column": (["0,1,1,9,9"], "frame,x,y,w,h", "no column visible"),
    "no number": (["0,1,1,9,nine,1"], "frame,x,y,w,h,visible", "line 2: .*have to be numbers"),
    "no box": (["0,,,,,1"], "frame,x,y,w,h,visible", "line 2: .*have to be numbers"),
    "infinite": (["0,1,1,9,inf,1"], "frame,x,y,w,h,visible", "line 2: .*have to be numbers"),
    "twice": (["0,1,1,9,9,1", "0,1,1,9,9,1"], "frame,x,y,w,h,visible", "two rows"),
    "empty": ([], "frame,x,y,w,h,visible", "no rows"),
}


@pytest.mark.parametrize("mistake", TRACK_TRUTH_MISTAKES)
def test_a_table_that_is_none(mistake, tmp_path):
    rows, header, expected = TRACK_TRUTH_MISTAKES[mistake]
    with pytest.raises(ConfigError, match=expected) as caught:
        read_truth(write(tmp_path / "truth.csv", rows, header))
    assert "\n" not in str(caught.value)


def test_a_table_of_another_source(tmp_path):
    with pytest.raises(ConfigError, match="frame 9 is marked, but the source has 5 pictures"):
        check_rows([Truth(0, HERE), Truth(9, HERE)], 5)
    cv2.imwrite(str(tmp_path / "0.png"), next(clip(1))[0])
    late = write(tmp_path / "truth.csv", ["1,10,10,20,20,1"], "frame,x,y,w,h,visible")
    with pytest.raises(ConfigError, match="not marked in frame 0"):
        run(str(tmp_path), Asked(truth=late), lambda line: None)
    with pytest.raises(ConfigError, match="say what to follow"):
        run(str(tmp_path), Asked(), lambda line: None)


def test_a_film_that_was_cut_off_ends_with_exit_1(tmp_path, capsys):
    film, frames = tmp_path / "film.avi", list(clip(6))
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"MJPG"), 30, (480, 360))
    for image, _ in frames:
        writer.write(image)
    writer.release()
    data = film.read_bytes()
    film.write_bytes(data[: len(data) * 3 // 4])
    lines = []
    assert not run(str(film), Asked(text(frames[0][1])), lines.append)
    assert f"ends after {len(lines) - 1} of 6 frames" in capsys.readouterr().err
