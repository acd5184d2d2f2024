"""A vision worker on cameras that do as they are told."""

import threading

import pytest

from agent.clock.clock import SystemClock
from agent.perception import vision
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import Vision
from hw.camera.camera import CameraError
from tests.perception.painted import CAMERA, ball_frame
from tests.perception.scripted_camera import CENTRE_M, fleet_of_one


@pytest.fixture(scope="module")
def images():
    """Frames of the ball by blur diameter, drawn once."""
    drawn = {}

    def at(blur_px):
        key = round(2 * blur_px) / 2
        if key not in drawn:
            drawn[key] = ball_frame(CENTRE_M, key)
        return drawn[key]

    return at


@pytest.fixture
def worker(monkeypatch):
    """Start a worker on a list of cameras (or errors) to open one after the other; closed at the end."""
    monkeypatch.setattr(vision, "IDLE_PERIOD_S", 0.01)
    monkeypatch.setattr(vision, "HOMING_S", 0.01)
    monkeypatch.setattr(vision, "RETRY_S", (0.01, 0.02))
    started = []

    def start(*cameras, settle_s=0.03, on_frame=None, clock=None, find=None, landmarks=None):
        waiting = list(cameras)

        def open_camera():
            camera = waiting.pop(0) if waiting else CameraError("no camera there; plug it in")
            if isinstance(camera, Exception):
                raise camera
            return camera

        fleet = fleet_of_one(settle_s)
        detectors = load_detectors(fleet, CAMERA)
        if find is not None:
            detectors["ball"].find = find
        clock = clock or SystemClock()
        out = Vision(open_camera, fleet, CAMERA, detectors, clock, on_frame=on_frame, landmarks=landmarks)
        started.append(out)
        out.start()
        return out

    yield start
    for out in started:
        out.close()
    assert not [t for t in threading.enumerate() if t.name == "vision"]
