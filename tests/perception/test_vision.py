"""The worker against a scripted camera: plans, order, regions, loss and return, closing."""

import time

import numpy as np
import pytest

from agent.core.ranging.focus import Peak, fit_peak
from agent.core.step_io import SweepPlan
from agent.perception import vision
from agent.perception.vision import QUEUE
from hw.camera.camera import CameraError
from tests.perception.painted import sharp_position
from tests.perception.scripted_camera import CENTRE_M, EMPTY, ScriptedCamera
from tests.sightings import collect


def test_between_plans_every_frame_is_a_sighting(worker, images):
    camera = ScriptedCamera(images=images)
    seen = collect(worker(camera), lambda s: len(s) >= 3)
    assert [s.frame for s in seen[:3]] == [1, 2, 3]
    offset_ns = seen[0].t_ns - 1_000_000  # from the stamps of a camera to the time of day
    assert [s.t_ns - offset_ns for s in seen[:3]] == [1_000_000, 2_000_000, 3_000_000]
    assert offset_ns == pytest.approx(time.time_ns() - time.monotonic_ns(), abs=1e9)
    assert all(s.found and s.sweep == 0 and s.index == -1 and s.focus is None for s in seen)
    assert not [call for call in camera.calls if call[0] == "focus"]


def test_a_frame_without_the_ball_is_a_sighting_too(worker):
    seen = collect(worker(ScriptedCamera(images=lambda _: EMPTY)), lambda s: len(s) >= 2)
    assert all(not s.found and s.centre_px is None and s.clarity is None for s in seen)


def test_a_plan_is_carried_out_in_order_and_gives_the_peak(worker, images):
    camera = ScriptedCamera(images=images)
    lens_positions = tuple(range(60, 600, 30))
    out = worker(camera)
    collect(out, lambda s: len(s) >= 1)
    out.plan(SweepPlan(sweep=7, focus=(0, *lens_positions)))
    seen = [s for s in collect(out, lambda s: any(x.index == len(lens_positions) for x in s)) if s.sweep == 7]
    assert [s.focus for s in seen] == list(lens_positions)
    assert [s.index for s in seen] == list(range(1, len(lens_positions) + 1))
    peak = fit_peak([s.focus for s in seen], [s.clarity for s in seen])
    assert isinstance(peak, Peak)
    assert peak.lens_position == pytest.approx(sharp_position(CENTRE_M[2] - 0.07), abs=6)
    assert len({s.area_px for s in seen}) == 1 or np.ptp([s.area_px for s in seen]) < 0.01 * seen[0].area_px
    reads = [call for call in camera.calls if call[0] == "read" and call[1] is not None]
    assert all(call[2] == 0.03 and call[1].width < 400 for call in reads) and len(reads) >= len(lens_positions)


def test_a_newer_plan_replaces_the_one_under_way(worker, images):
    out = worker(ScriptedCamera(images=images))
    out.plan(SweepPlan(sweep=1, focus=tuple(range(100, 600))))
    collect(out, lambda s: any(x.sweep == 1 for x in s))
    out.plan(SweepPlan(sweep=2, focus=(200, 210, 220)))
    seen = collect(out, lambda s: any(x.sweep == 2 and x.index == 2 for x in s))
    later = [s.sweep for s in seen]
    assert 1 not in later[later.index(2) :]
    with pytest.raises(ValueError, match="no lens position"):
        out.plan(SweepPlan(sweep=3, focus=()))


def test_a_lost_camera_is_opened_again(worker, images):
    first, second = ScriptedCamera(images=images), ScriptedCamera(images=images)
    out = worker(first, CameraError("still away"), second)
    collect(out, lambda s: len(s) >= 1)
    first.gone = True
    while not second.seq:
        time.sleep(0.002)
    seen = collect(out, lambda s: len(s) >= 1)
    assert seen and first.closed and out.errors == 2
    collect(out, lambda s: len(s) >= 1)
    assert out.fault is None


def test_no_camera_at_all_is_a_fault_with_its_reason(worker):
    out = worker()
    while out.errors < 3:
        time.sleep(0.002)
    assert "plug it in" in out.fault
    assert out.drain() == []


def test_a_camera_without_focus_refuses_plans_and_goes_on(worker, images):
    out = worker(ScriptedCamera(focusable=False, images=images))
    out.plan(SweepPlan(sweep=1, focus=(0, 100)))
    seen = collect(out, lambda s: len(s) >= 3)
    assert out.refused == 1 and all(s.sweep == 0 for s in seen)


def test_what_nobody_fetches_is_bounded_and_counted(worker):
    out = worker(ScriptedCamera(images=lambda _: EMPTY))
    vision.IDLE_PERIOD_S = 0.0  # as fast as it goes; the fixture puts it back
    while out.dropped < 5:
        time.sleep(0.005)
    seen = out.drain()
    assert len(seen) <= QUEUE and seen[0].frame > 1


def test_every_frame_is_offered_to_the_recording(worker, images):
    frames = []
    out = worker(
        ScriptedCamera(images=images), on_frame=lambda frame, sightings: frames.append((frame.seq, sightings[0].frame))
    )
    collect(out, lambda s: len(s) >= 3)
    assert frames[:3] == [(1, 1), (2, 2), (3, 3)]


def test_closing_does_not_wait_for_the_next_frame(worker, images, monkeypatch):
    monkeypatch.setattr(vision, "IDLE_PERIOD_S", 60.0)
    camera = ScriptedCamera(images=images)
    out = worker(camera)
    collect(out, lambda s: len(s) >= 1)
    out.close()
    assert camera.closed
