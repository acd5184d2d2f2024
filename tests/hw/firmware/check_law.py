# Pulses of recorded dives, on whichever interpreter runs this: check_law.py FIRMWARE_DIR RECORDING
#
# RECORDING: one JSON row a cycle: [law, four pressures Pa, sensors that answered, depth m, roll rad]; None for the law
# of the row before. Prints the eight pulses of each cycle.
# ruff: noqa: PTH123, T201 - MicroPython has no pathlib
import json
import sys

sys.path.insert(0, sys.argv[1])
import motor_control
import parameters
import wire

AIR_PA, CYCLE_US = 101325.0, 10000

module = None
with open(sys.argv[2]) as file:
    for line in file:
        law, pressure_pa, answered, depth_m, roll_rad = json.loads(line)
        if law:
            module = motor_control.Control()
            module.configure(parameters.from_flash({"law": law, "net_weight_N": 0.5, "zero_3_us": 1507}))
            module.plane.tare_pa = [AIR_PA] * 4
            for _ in range(10):
                module.sense(pressure_pa, answered, 15000, 0, CYCLE_US)
            module.arm()
            assert module.state == wire.ARMED
        module.set_point.age_us = 0
        module.set_point.ttl_us = 500000
        module.set_point.depth_m = depth_m
        module.set_point.tilt_rad[0] = roll_rad
        module.sense(pressure_pa, answered, 14600, 0, CYCLE_US)
        module.act(CYCLE_US)
        print(*module.pulses_us)
