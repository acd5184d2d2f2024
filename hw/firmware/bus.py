# The records on the simulated hardware bus: what stands for I2C, ADC and timer pins between twin and firmware.
# MicroPython and CPython both import this file: no annotations that need typing, no module but struct.
import struct

TICK_US = 10000  # between two ticks of the hardware
NO_RATE = -32768  # of wire.py: no gyro is there
NO_GRAVITY = (-32768, 0)  # nor an accelerometer

# twin -> firmware, where a cycle begins: board clock us; for how many of these us its tick has waited for the cycle
# before; what everything takes, in percent of the table of times; absolute pressure of sensors 1-4 in mPa; battery mV,
# current in 10 mA, leak probe 0/1, bit mask of sensors that answered; yaw rate as wire.TELEM tells it; loop of the
# kill switch, 1: open; of the accelerometer, in thousandths of gravity: upwards, where -32768 is none, and level
TICK = "<QHH4IHHBBhBhH"
TICK_SIZE = struct.calcsize(TICK)

# firmware -> twin, the answer to each: the same clock; thruster pulses T1-T8 us, servo pulses us (camera pan, camera
# tilt, lamp pan, lamp tilt), lamp level in 1/1000, armed 0/1; the thrusters' pulse frame us; how many us after the
# cycle's beginning these pins were written, and after how many it was over
ACT = "<Q8H4HHBHII"
ACT_SIZE = struct.calcsize(ACT)

# The environment variable with the table: whole ns that the board takes for what hal_unix counts, in this order
TIMES = "AUCAMP_CYCLE_TIMES"


def tick(
    clock_us,
    pressure_pa,
    battery_mv,
    current_10ma,
    leak,
    answered,
    waited_us=0,
    percent=100,
    yaw_rate=NO_RATE,
    open_loop=False,
    gravity_mg=NO_GRAVITY,
):
    """A record for the firmware; pressures are floats, yaw_rate is in hundredths of a degree a second."""
    motion = yaw_rate, open_loop, gravity_mg[0], gravity_mg[1]
    mpa = [min(max(int(1000.0 * p + 0.5), 0), 0xFFFFFFFF) for p in pressure_pa]
    return struct.pack(TICK, clock_us, waited_us, percent, *mpa, battery_mv, current_10ma, leak, answered, *motion)
