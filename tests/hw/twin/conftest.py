"""Dives whose boards run a firmware of a few lines."""

import textwrap

import pytest

from hw.twin.board import Board
from hw.twin.dive import Dive
from tests.hw.twin.stand_ins import FIRMWARE, fleet


@pytest.fixture
def firmware(tmp_path):
    path = tmp_path / "stand_in.py"
    path.write_text(textwrap.dedent(FIRMWARE))
    return path


@pytest.fixture
def plunge(tmp_path, firmware):
    """Make dives whose boards are closed at the end."""
    boards = []

    def make(names=("r1", "r2"), seed=4, **flash):
        dive = Dive(fleet(names, seed, turn_deg=30.0), names, start_ns=0)
        dive.boards = [
            Board(name, tmp_path, tare, firmware, settings=flash)
            for name, tare in zip(names, dive.tare_pa, strict=True)
        ]
        for board in dive.boards:
            board.start()
        boards.extend(dive.boards)
        return dive

    yield make
    for board in boards:
        board.close()
