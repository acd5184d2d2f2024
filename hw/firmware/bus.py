# The records on the simulated hardware bus: what stands for I2C, ADC and timer pins between twin and firmware.
# MicroPython and CPython both import this file: no annotations that need typing, no module but struct.
import struct

# twin -> firmware, one each control tick (100 Hz): board clock us, absolute pressure of sensors 1-4 in Pa,
# battery mV, current in 10 mA, leak probe 0/1, bit mask of sensors that answered
TICK = "<Q4fHHBB"
TICK_SIZE = struct.calcsize(TICK)

# firmware -> twin, the answer to each tick: the tick's clock, thruster pulses T1-T8 us, servo pulses us
# (camera pan, camera tilt, lamp pan, lamp tilt), lamp level in 1/1000, armed 0/1
ACT = "<Q8H4HHB"
ACT_SIZE = struct.calcsize(ACT)
