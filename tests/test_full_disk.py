"""What a verb has no room for is an error in one line that names the file, and nothing broken stays there."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from agent.__main__ import main
from tests.full_disk import room
from tests.places import GOLDEN

SEEN = str(GOLDEN / "seen" / "r1.mcap")
VERBS = {
    "film.mp4": ["export", "mp4", SEEN, "--out", "film.mp4"],
    "lines.jsonl": ["export", "jsonl", SEEN, "--out", "lines.jsonl"],
    "tables/r1_telemetry.csv": ["export", "csv", SEEN, "--out", "tables"],
    "followed.mp4": ["track", "pictures", "--box", "10,10,40,40", "--out", "followed.mp4"],
    "followed.avi": ["track", "pictures", "--box", "10,10,40,40", "--out", "followed.avi"],
    "followed/000000.png": ["track", "pictures", "--box", "10,10,40,40", "--out", "followed"],
    "board.pdf": ["calibrate", "board", "--out", "board.pdf"],
    "enhanced/film.mp4": ["enhance", "film.avi", "--out", "enhanced", "--variant", "classic"],
}


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with pictures and a film of noise."""
    monkeypatch.chdir(tmp_path)
    Path("pictures").mkdir()
    rng = np.random.default_rng(1)
    film = cv2.VideoWriter("film.avi", cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (160, 120))
    for number in range(6):
        image = rng.integers(0, 255, (120, 160, 3), dtype=np.uint8)
        cv2.imwrite(f"pictures/{number}.png", image)
        film.write(image)
    film.release()
    return tmp_path


@pytest.mark.parametrize("name", VERBS)
def test_what_finds_no_room_is_no_success(
    name: str, there: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["aucamp", *VERBS[name]])
    with room(2000), pytest.raises(SystemExit) as left:
        main()
    said = capfd.readouterr()
    assert left.value.code == 2
    complaint = said.err.strip().splitlines()[-1]
    assert complaint == f"aucamp: {name}: File too large; choose a file or folder that can be used"
    assert "written to" not in said.out and "Traceback" not in said.err and "mcap" not in said.err
    assert not (there / name).exists()


@pytest.mark.parametrize("name", ["film.mp4", "followed.mp4", "followed.avi", "enhanced/film.mp4"])
def test_a_film_that_finds_room_plays(name: str, there: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["aucamp", *VERBS[name]])
    with pytest.raises(SystemExit):
        main()
    film = cv2.VideoCapture(str(there / name))
    count = int(film.get(cv2.CAP_PROP_FRAME_COUNT))
    assert count > 0 and sum(1 for _ in iter(film.grab, False)) == count
