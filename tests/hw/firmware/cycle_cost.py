# What a control cycle costs on whichever interpreter runs this: cycle_cost.py FIRMWARE_DIR LAW CYCLES us|bytes|kept
#
# The whole of main.Firmware.step, armed, set-points at 20 Hz and telemetry at 50 Hz, over hardware that costs nothing.
# Prints the median time of a cycle in us, the mean memory that one takes in bytes, or the bytes that the last
# holds more than the hundredth after a collection (MicroPython alone can say).
# ruff: noqa: T201 - this is a program
import gc
import sys
import time

sys.path.insert(0, sys.argv[1])
import main
import wire

if hasattr(time, "ticks_us"):
    now_us, since_us = time.ticks_us, time.ticks_diff
else:

    def now_us():
        return time.perf_counter_ns() // 1000

    def since_us(after, before):
        return after - before


class Hal:
    """A board of which nothing takes time."""

    capabilities, late = 0, 0

    def __init__(self, law):
        self.pressure_pa = [104262.0] * 4
        self.answered, self.battery_mv, self.current_10ma, self.leak = 15, 15000, 100, 0
        self.servos_us, self.light_permille, self.armed = [1500] * 4, 0, 0
        self.writer = wire.Writer()
        self.us, self.temperature_cC = 0, 2000
        self.law = law
        self.inbox = b""

    def begin_pulses(self, frame_us):
        pass

    def now_us(self):
        return self.us

    def read_into(self, buf):
        n = len(self.inbox)
        buf[:n] = self.inbox
        self.inbox = b""
        return n

    def write(self, frame):
        pass

    def end_cycle(self):
        pass

    def collect(self):
        return 0

    def heap_free(self):
        return 0

    def boot_info(self):
        return bytes(12), 1, 1

    def load_flash(self):
        return {"law": self.law, "tare_pa": [101325.0] * 4}


def set_point(hal):
    return bytes(hal.writer.frame(wire.SETPOINT, 3000, 0, 0, 0, 0, 0, 1500, 1500, 1500, 1500, 0, 31, 500, 7))


def run(law, cycles, read, difference):
    """The difference of what `read` says before and after each cycle, sorted."""
    hal = Hal(law)
    firmware = main.Firmware(hal)
    firmware.boot()
    hello = bytes(hal.writer.frame(wire.HELLO, wire.PROTOCOL, wire.schema_crc(), 1))
    again = set_point(hal)
    arm = bytes(hal.writer.frame(wire.ARM, 1, 1))
    costs = [0] * cycles
    for i in range(-400, cycles):
        hal.us += 10000
        for k in range(4):
            hal.pressure_pa[k] = 104262.0 + (i * 7 + k * 3) % 11  # about 1 mm of noise
        if i == -390:
            hal.inbox = hello
        elif i == -50:
            hal.inbox = arm
        elif i % 5 == 0:
            hal.inbox = again
        if i % 50 == 0:
            gc.collect()
        before = read()
        firmware.step()
        if i >= 0:
            costs[i] = difference(read(), before)
    assert hal.armed, "this measures the wrong thing"
    return costs


gc.disable()
_, _, law, cycles, what = sys.argv
if what == "us":
    print(sorted(run(law, int(cycles), now_us, since_us))[int(cycles) // 2])
elif what == "bytes":
    print(sum(run(law, int(cycles), gc.mem_alloc, lambda after, before: after - before)) / int(cycles))
else:

    def held():
        gc.collect()
        return gc.mem_alloc()

    levels = run(law, int(cycles), held, lambda after, before: after)
    print(levels[-1] - levels[100])
