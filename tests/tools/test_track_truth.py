"""`aucamp track --truth`: what is counted, what is written, and mistakes in one line."""

import json

import cv2
import pytest

from agent.core.config import ConfigError
from agent.perception.tracking.appearance import Box
from agent.perception.tracking.follow import Followed
from agent.tools.track import Asked, Truth, check_rows, read_truth, run, score
from tests.perception.tracking.swimming import clip

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
    found = score(truth, said, rate_hz=4.0)
    assert (found.frames, found.absent, found.in_grace, found.in_grace_said_lost) == (4 + 3, 3, 3, 1)
    assert (found.absent_said_lost, found.present_said_lost, found.on_target) == (3, 2, 2)
    assert found.mean_iou_followed == pytest.approx((1.0 + 14 / 26) / 2)
    assert found.mean_iou == pytest.approx((1.0 + 14 / 26) / 4)


def test_a_thing_that_is_called_followed_while_it_is_away_counts_against_it():
    truth = [Truth(0, HERE), *(Truth(k, None) for k in range(1, 8))]
    found = score(truth, [Followed(HERE, 0.9, "followed")] * 8, rate_hz=4.0)
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
    assert run(str(tmp_path), Asked(truth=truth, result=tmp_path / "result.json", rate_hz=2.0), lambda line: None)
    found = json.loads((tmp_path / "result.json").read_text())
    assert set(found) >= KEYS and found["frames"] == 3 and found["on_target"] == 3 and found["mean_iou"] > 0.7
    assert found["absent"] == 0 and found["in_grace"] == 2
    assert "written to" in capsys.readouterr().err


MISTAKES = {
    "no column": (["0,1,1,9,9"], "frame,x,y,w,h", "no column visible"),
    "no number": (["0,1,1,9,nine,1"], "frame,x,y,w,h,visible", "line 2: .*have to be numbers"),
    "no box": (["0,,,,,1"], "frame,x,y,w,h,visible", "line 2: .*have to be numbers"),
    "infinite": (["0,1,1,9,inf,1"], "frame,x,y,w,h,visible", "line 2: .*have to be numbers"),
    "twice": (["0,1,1,9,9,1", "0,1,1,9,9,1"], "frame,x,y,w,h,visible", "two rows"),
    "empty": ([], "frame,x,y,w,h,visible", "no rows"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_table_that_is_none(mistake, tmp_path):
    rows, header, expected = MISTAKES[mistake]
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
