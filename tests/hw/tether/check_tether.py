# What telemetry and set-points leave in the heap of MicroPython: check_tether.py FIRMWARE_DIR; bytes of a hundred each.
# ruff: noqa: T201
import gc
import sys

sys.path.insert(0, sys.argv[1])
import failsafe
import frames
import tether


class Thing:
    def __init__(self, **values):
        for name in values:
            setattr(self, name, values[name])


class Law:
    def disturbance(self, i):
        return 123456


class Hal(Thing):
    def now_us(self):
        return 1000000

    def read_into(self, buf):
        buf[: len(asked)] = asked
        return len(asked)

    def write(self, frame):
        pass


def taken(act):
    """Bytes that a hundred calls leave, after one that may take what it keeps."""
    act()
    gc.collect()
    before = gc.mem_alloc()
    for _ in range(100):
        act()
    return gc.mem_alloc() - before


hal = Hal(late=0, servos_us=[1500] * 4, light_permille=0, battery_mv=15000, us_low=16960, us_high=15)
control = Thing(
    plane=Thing(
        bad=0,
        disagree=False,
        tare_mPa=[101325000] * 4,
        zeta_100nm=[3000000, 3000001, -5, 2999999],
        roll_100nrad=-12345,
        pitch_100nrad=54321,
        depth_100nm=3000000,
    ),
    law=Law(),
    set_point=Thing(age_us=0, seq=0, depth_100nm=0, tilt_100nrad=[0, 0], force_uN=[0, 0], yaw_uNm=0),
    ladder=failsafe.Ladder(),
    mode=0,
    leak=False,
    battery_mv=15000,
    battery_low=False,
    killed=False,
    state=1,
    saturated=0,
    pulses_us=[1500] * 8,
)
line = tether.Tether(hal, control, (bytes(12), 1, 1))
asked = bytes(frames.Writer().frame(0x10, 3000, 100, -100, 900, -900, 50, 1500, 1500, 1500, 1500, 100, 31, 500, 7))
gc.disable()
print(taken(line.say_telemetry), taken(line.listen))
assert control.set_point.depth_100nm == 3000000 and line.faults == 0
