"""A camera is pulled out and comes back as another node: the vision worker goes on by itself."""

from agent.clock.clock import SystemClock
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import SweepPlan
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import Vision
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from hw.camera import v4l2_node as v4l2
from tests.hw.camera.fake_v4l2 import FakeComputer
from tests.sightings import collect
from tests.waiting import until

CAMERA = CameraFit(width_px=96, height_px=64, f_px=150.0, cx_px=47.5, cy_px=31.5)


def test_a_sweep_after_the_replug_is_carried_out_on_the_new_node():
    computer = FakeComputer()
    fleet = load_fleet(shipped_fleet())
    vision = Vision(computer.open, fleet, CAMERA, load_detectors(fleet, CAMERA), SystemClock())
    vision.start()
    try:
        vision.plan(SweepPlan(sweep=1, focus=(0, 5, 10)))
        collect(vision, lambda seen: any(s.sweep == 1 for s in seen), 30.0)
        computer.pull()
        until(lambda: vision.errors)
        computer.plug("/dev/video12")
        until(lambda: vision.fault is None)
        vision.plan(SweepPlan(sweep=2, focus=(0, 5, 10, 15, 20)))
        seen = collect(vision, lambda seen: any(s.sweep == 2 and s.index == 4 for s in seen), 30.0)
        assert [s.focus for s in seen if s.sweep == 2] == [5, 10, 15, 20]
        assert computer.camera.path == "/dev/video12" and computer.camera.value(v4l2.FOCUS_AUTO) == 0
    finally:
        vision.close()
