"""Depth, roll and pitch by telemetry: at which time, and how well they are known as the sensors drift."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.attitude import LATE_NS, AttitudeLog, zeros
from agent.core.config import CAREFUL, Pose
from agent.core.step_io import SetPoint
from agent.experiments.ball_measurements import hosts_of
from agent.experiments.navigation import basin
from hw.twin.dive import Dive
from hw.twin.physics.body import SENSOR_M
from hw.twin.physics.sensors import CORNERS, PA_PER_M, PressureSensors
from hw.twin.scene import Scene

S = 1_000_000_000
START_NS = 10**18


def told(t_ns, board_us, depth_m=0.3):
    return replace(basin.at_rest(t_ns, True, depth_m), board_us=board_us)


def test_how_long_a_module_is_on_goes_by_its_own_clock() -> None:
    log = AttitudeLog()
    assert log.on_s(START_NS) == 0.0
    log.add(told(START_NS, 300_000_000))  # the agent comes five minutes later
    assert log.on_s(START_NS + 2 * S) == pytest.approx(302.0)
    for later_s, board_us in ((4100, 105_032_704), (4200, 5_000_000)):  # the clock wraps; the board starts again
        log.add(told(START_NS + later_s * S, board_us))
        assert log.on_s(START_NS + later_s * S) == pytest.approx(300.0 + later_s)


def test_telemetry_tells_of_a_moment_ago() -> None:
    log = AttitudeLog()
    for k in range(3):
        log.add(told(START_NS + k * LATE_NS, 0, 0.3 + 0.1 * k))
    depths = [log.at(START_NS + k * LATE_NS).depth_m for k in (-1, 0, 1, 2)]
    assert depths == pytest.approx([0.3, 0.4, 0.5, 0.5])
    assert log.now(START_NS + 2 * LATE_NS).depth_m == pytest.approx(0.5)


def test_attitude_is_known_as_well_as_the_twins_sensors_allow() -> None:
    """Depth and pitch of 1500 robots at rest on the surface, each by its own four sensors, after tare."""
    names = [f"r{k}" for k in range(1500)]
    sensors, still = PressureSensors(5, names), np.full((len(names), 4), 0.3 * PA_PER_M)
    tare_pa = sensors.tare_pa()
    for on_s in (0.0, 60.0, 600.0, 3000.0):
        readings = [sensors.sample(still, on_s) for _ in range(11)][1:]  # one late, and a tenth of a second of them
        off_m = (np.mean(readings, axis=0) - tare_pa) / PA_PER_M - 0.3
        said = zeros(CAREFUL, on_s)
        pitch_rad = off_m @ CORNERS[:, 0] / (4.0 * SENSOR_M)
        assert np.std(off_m.mean(axis=1)) < 1.06 * said.height_m
        assert np.std(pitch_rad) < 1.06 * said.tilt_rad
        if on_s >= 60.0:  # no more doubt than there is reason for
            assert np.std(off_m.mean(axis=1)) > 0.5 * said.height_m
            assert np.std(pitch_rad) > 0.8 * said.tilt_rad


def test_telemetry_of_the_firmware_is_as_late_as_is_said() -> None:
    """A robot under its own firmware is pushed: its pitch of that long ago fits best."""
    fleet = basin.fleet({"r1": basin.robot("r1", Pose(x_m=1.5, y_m=1.0, yaw_deg=0.0))}, seed=3)
    said, true = [], []
    dive = Dive(fleet, ["r1"], START_NS, scene=Scene(name="basin", moored=False))
    with hosts_of(dive) as hosts:
        bodies = basin.TwinBodies(dive, hosts)
        for step in range(300):
            if step in (200, 225, 250, 275):
                dive.push("r1", (0.0, 0.0, 3.0 if step % 50 else -3.0), (0.2, 0.15, 0.0), 0.3)
            heard = bodies.step({"r1": SetPoint(depth_m=0.3)})["r1"]
            if step > 200:
                said += [(one.t_ns - START_NS, one.pitch_deg) for one in heard]
                true.append((bodies.now_ns - START_NS, -math.degrees(math.asin(bodies.pose("r1").rotation[2, 0]))))
    (t, pitch), (at, truth) = np.array(said).T, np.array(true).T
    assert np.ptp(truth) > 5.0
    late_ms = range(60)
    misses = [np.std(np.interp(at + 1e6 * ms, t, pitch) - truth) for ms in late_ms]
    assert abs(late_ms[int(np.argmin(misses))] - 1e-6 * LATE_NS) <= 4.0
