"""The law under MicroPython: the pulses of CPython on a recorded dive of each law, and no more memory than is good."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hw.firmware import wire
from tests.hw.desk import MICROPYTHON
from tests.hw.firmware.float_law import recorded

FIRMWARE = Path(wire.__file__).parent
COST = Path(__file__).with_name("cycle_cost.py")
CHECK = Path(__file__).with_name("check_law.py")
LAWS = ("observer", "pid", "pi")


def test_pulses_are_the_same_on_both_interpreters(tmp_path):
    """To the last bit in whole numbers; the laws in floats may differ by a microsecond."""
    if MICROPYTHON is None:
        pytest.skip("the MicroPython Unix port is not installed")
    recording = tmp_path / "dives.jsonl"
    rows = [(None if i else law, *cycle[:-1]) for law in LAWS for i, cycle in enumerate(recorded(law))]
    recording.write_text("".join(json.dumps(row) + "\n" for row in rows))
    runs = [
        subprocess.Popen([interpreter, CHECK, FIRMWARE, recording], stdout=subprocess.PIPE, text=True)
        for interpreter in (sys.executable, MICROPYTHON)
    ]
    ours, theirs = (
        np.array([line.split() for line in run.communicate(timeout=30)[0].splitlines()], int) for run in runs
    )
    assert ours.shape == theirs.shape == (len(rows), 8)
    assert np.array_equal(ours[:1000], theirs[:1000])
    assert np.abs(ours - theirs).max() <= 1


def cost(law: str, what: str) -> float:
    if MICROPYTHON is None:
        pytest.skip("the MicroPython Unix port is not installed")
    command = [MICROPYTHON, "-X", "heapsize=4M", COST, FIRMWARE, law, "500", what]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    return float(ran.stdout)


def test_a_plain_cycle_takes_next_to_no_memory():
    """256 bytes here are at most 256 on the board, whose blocks are of 16 where these are of 32."""
    assert cost("observer", "plain") <= 256


@pytest.mark.parametrize("law", LAWS)
def test_no_cycle_keeps_memory(law):
    assert cost(law, "kept") == 0
