"""Sweeps of a survey in a recording: their frames have no number, and are known by where the lens stood."""

import pytest

from agent.core.step_io import Sighting
from replay.files.frames import Picture
from replay.whole_sweeps import rising


def frame(n: int, focus: int | None) -> tuple[Picture, Sighting]:
    picture = Picture(t_ns=n, frame=n, roi=(0, 0, 8, 8), focus=focus, format="png")
    return picture, Sighting(t_ns=n, frame=n, sweep=0, index=-1, focus=focus, target="ball", found=False)


def frames(*positions: int | None) -> list[tuple[Picture, Sighting]]:
    return [frame(n, focus) for n, focus in enumerate(positions)]


def test_the_newest_frames_are_the_sweeps() -> None:
    recent = frames(400, 208, 300, 420)
    assert rising(recent, 3) == recent[1:]


@pytest.mark.parametrize("recent", [frames(208, 300), frames(400, 300, 420), frames(208, None, 420), frames()])
def test_a_sweep_that_lost_a_frame_is_passed_over(recent: list[tuple[Picture, Sighting]]) -> None:
    assert rising(recent, 3) == []
