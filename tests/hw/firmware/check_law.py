# Pulses of recorded dives, on whichever interpreter runs this: check_law.py FIRMWARE_DIR RECORDING
#
# RECORDING: one JSON row a cycle: [law, four pressures mPa, sensors that answered, depth and roll in 1e-7 m and rad];
# None for the law of the row before. Prints the eight pulses of each cycle.
# ruff: noqa: PTH123, T201 - MicroPython has no pathlib
import json
import sys

sys.path.insert(0, sys.argv[1])
import main  # noqa: F401 - sees to it that there is a micropython
import motor_control
import parameters

AIR_mPa, CYCLE_US = 101325000, 10000

module = None
with open(sys.argv[2]) as file:
    for line in file:
        law, pressure_mPa, answered, depth_100nm, roll_100nrad = json.loads(line)
        if law:
            module = motor_control.Control()
            module.configure(parameters.from_flash({"law": law, "net_weight_N": 0.5, "zero_3_us": 1507, "nudge_s": 0}))
            module.plane.tare_mPa = [AIR_mPa] * 4
            for _ in range(10):
                module.sense(pressure_mPa, answered, 15000, 0, CYCLE_US)
            module.arm()
        module.set_point.age_us = 0
        module.set_point.ttl_us = 500000
        module.set_point.depth_100nm = depth_100nm
        module.set_point.tilt_100nrad[0] = roll_100nrad
        module.sense(pressure_mPa, answered, 14600, 0, CYCLE_US)
        module.act(CYCLE_US)
        print(*module.pulses_us)
