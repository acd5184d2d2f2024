# What memory a control cycle costs, under MicroPython:
#   cycle_cost.py FIRMWARE_DIR LAW CYCLES plain|kept
#
# The whole of main.Firmware.step, armed, set-points at 20 Hz and telemetry at 50 Hz, over hardware that costs nothing.
# Prints the most memory in bytes that a cycle takes which neither hears nor says anything, or the bytes that the last
# holds more than the hundredth after a collection.
# ruff: noqa: T201 - this is a program
import gc
import sys

sys.path.insert(0, sys.argv[1])
import failsafe
import main
import wire


class Hal:
    """A board of which nothing takes time."""

    capabilities, late = 0, 0

    def __init__(self, law):
        self.pressure_mPa, self.dt_us, self.ticks = [104262000] * 4, 10000, 1
        self.answered, self.battery_mv, self.current_10ma, self.leak = 15, 15000, 100, 0
        self.servos_us, self.light_permille, self.armed = [1500] * 4, 0, 0
        self.writer = wire.Writer()
        self.us, self.temperature_cC = 0, 2000
        self.law = law
        self.inbox = b""
        self.quiet = False  # nothing was heard, said or cleaned up in this cycle

    def begin_pulses(self, frame_us):
        pass

    def killed(self):
        return False

    def gravity_mg(self):
        return 1000, 0

    @property
    def us_low(self):
        return self.us & 0xFFFF

    @property
    def us_high(self):
        return self.us >> 16

    def now_us(self):
        return self.us

    def yaw_rate_cdeg_s(self):
        return 150

    def read_into(self, buf):
        n = len(self.inbox)
        if n:
            self.quiet = False
        buf[:n] = self.inbox
        self.inbox = b""
        return n

    def write(self, frame):
        self.quiet = False

    def cycle_us(self):
        return 5000

    def end_cycle(self):
        pass

    def collect(self):
        self.quiet = False

    def heap_free(self):
        self.quiet = False
        return 0

    def boot_info(self):
        return bytes(12), 1, 1

    def load_flash(self):
        return {"law": self.law, "tare_pa": [101325.0] * 4, "wiring": failsafe.WIRING}


def set_point(hal):
    return bytes(hal.writer.frame(wire.SETPOINT, 3000, 0, 0, 0, 0, 0, 1500, 1500, 1500, 1500, 0, 31, 500, 7))


def run(law, cycles, read, difference, plain=False):
    """The difference of what `read` says before and after each cycle; if `plain`, 0 for those that hear or say."""
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
            hal.pressure_mPa[k] = 104262000 + 1000 * ((i * 7 + k * 3) % 11)  # about 1 mm of noise
        if i == -390:
            hal.inbox = hello
        elif i == -50:
            hal.inbox = arm
        elif i % 5 == 0:
            hal.inbox = again
        if i % 50 == 0:
            gc.collect()
        hal.quiet = True
        before = read()
        firmware.step()
        after = read()
        if i >= 0:
            costs[i] = difference(after, before) if hal.quiet or not plain else 0
    assert hal.armed, "this measures the wrong thing"
    return costs


gc.disable()
_, _, law, cycles, what = sys.argv
if what == "plain":
    print(max(run(law, int(cycles), gc.mem_alloc, lambda after, before: after - before, True)))
else:

    def held():
        gc.collect()
        return gc.mem_alloc()

    levels = run(law, int(cycles), held, lambda after, before: after)
    print(levels[-1] - levels[100])
