"""The law under MicroPython: the pulses of CPython on a recorded dive of each law, and no more memory than is good."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hw.firmware import law, pressure, thrust, wire
from tests.hw.desk import MICROPYTHON
from tests.hw.firmware.nominal_plant import AIR_PA, Plant

FIRMWARE = Path(wire.__file__).parent
COST = Path(__file__).with_name("cycle_cost.py")
CHECK = Path(__file__).with_name("check_law.py")
STEPS = 1000
LAWS = {"pi": law.Pi, "pid": law.Pid, "observer": law.Observer}


def dive(name: str) -> list[tuple[str | None, list[float], int, float, float]]:
    """10 s under this law: noise, a step of depth and one of roll, a push beyond what the thrusters can, a dead sensor
    and a spike. Steered by the bare law, as the plant has to answer to something while it is recorded."""
    plant, steers = Plant(8, 0.22), LAWS[name]()
    plane = pressure.Plane(wire.PA_PER_M, 0.13, 0.13)
    plane.tare_pa = [AIR_PA] * 4
    realised, want, forces = [0.0] * 3, [0.0] * 3, [0.0] * 8
    rows = []
    for i in range(STEPS):
        depth_m, roll_rad = (0.22 if i < 100 else 0.41), (0.1 if 250 < i < 350 else 0.0)
        plant.push[0] = 60.0 if 450 < i < 565 else 0.0
        answered = 0b1011 if 600 < i < 900 else 0b1111
        pa = [p - tare + AIR_PA for p, tare in zip(plant.pressure_pa(), plant.tare_pa, strict=True)]
        pa[1] += 3000.0 * (i == 400)
        rows.append((None if i else name, pa, answered, depth_m, roll_rad))
        plane.step(pa, answered, 10_000)
        y = [plane.depth_m, plane.roll_rad, plane.pitch_rad]
        if i == 0:
            steers.reset(y)
        steers.step(y, [depth_m, roll_rad, 0.0], realised, want)
        thrust.central(want, 0.0, 10.0, 2.0, forces, realised)
        plant.step([thrust.pulse_us(f, 1500, 10.0) for f in forces])
    return rows


def test_pulses_differ_by_a_microsecond_at_most(tmp_path):
    if MICROPYTHON is None:
        pytest.skip("the MicroPython Unix port is not installed")
    recording = tmp_path / "dives.jsonl"
    recording.write_text("".join(json.dumps(row) + "\n" for name in LAWS for row in dive(name)))
    runs = [
        subprocess.Popen([interpreter, CHECK, FIRMWARE, recording], stdout=subprocess.PIPE, text=True)
        for interpreter in (sys.executable, MICROPYTHON)
    ]
    ours, theirs = (
        np.array([line.split() for line in run.communicate(timeout=30)[0].splitlines()], int) for run in runs
    )
    assert ours.shape == theirs.shape == (len(LAWS) * STEPS, 8)
    assert np.abs(ours - theirs).max() <= 1
    for k in range(len(LAWS)):  # and the dives are worth comparing
        pulses = ours[k * STEPS : (k + 1) * STEPS, :4]
        assert pulses.min() == 1100 or pulses.max() == 1900, "the push saturates"
        assert np.ptp(pulses, axis=0).min() > 100
        assert np.unique(pulses, axis=0).shape[0] > 300


@pytest.mark.parametrize("law", LAWS)
def test_a_cycle_takes_little_memory_and_keeps_none(law):
    """13 kB here are 6 kB on the board, of 108 kB that are free, collected every cycle."""
    if MICROPYTHON is None:
        pytest.skip("the MicroPython Unix port is not installed")

    def cost(what: str) -> float:
        command = [MICROPYTHON, "-X", "heapsize=4M", COST, FIRMWARE, law, "500", what]
        ran = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
        return float(ran.stdout)

    assert 1000 < cost("bytes") < 13_000
    assert cost("kept") == 0
