"""A camera is pulled out and comes back as another node: the vision worker goes on by itself."""

import time

from fake_v4l2 import FakeComputer

from agent.config import load_fleet
from agent.launch import shipped_fleet
from agent.messages import SweepPlan
from agent.perception.seekers import seekers
from agent.perception.vision import Vision
from agent.ranging.calibration import CameraFit
from hw import v4l2_calls as v4l2
from tests.sightings import collect

CAMERA = CameraFit(width_px=96, height_px=64, f_px=150.0, cx_px=47.5, cy_px=31.5)


def test_a_sweep_after_the_replug_is_carried_out_on_the_new_node():
    computer = FakeComputer()
    fleet = load_fleet(shipped_fleet())
    vision = Vision(computer.open, fleet, CAMERA, seekers(fleet, CAMERA), epoch_offset_ns=0)
    vision.start()
    try:
        vision.plan(SweepPlan(sweep=1, focus=(0, 5, 10)))
        collect(vision, lambda seen: any(s.sweep == 1 for s in seen), 30.0)
        computer.pull()
        while vision.errors == 0:
            time.sleep(0.005)
        computer.plug("/dev/video12")
        while vision.fault is not None:
            time.sleep(0.005)
        vision.plan(SweepPlan(sweep=2, focus=(0, 5, 10, 15, 20)))
        seen = collect(vision, lambda seen: any(s.sweep == 2 and s.index == 4 for s in seen), 30.0)
        assert [s.focus for s in seen if s.sweep == 2] == [5, 10, 15, 20]
        assert computer.camera.path == "/dev/video12" and computer.camera.value(v4l2.FOCUS_AUTO) == 0
    finally:
        vision.close()
