"""The firmware as it runs in the twin, under both interpreters, in lock-step virtual time."""

from __future__ import annotations

import importlib
import json
import os
from pathlib import Path

import numpy as np
import pytest

from hw.firmware import failsafe, wire
from tests.hw.firmware.nominal_plant import AIR_PA, PA_PER_M, Plant
from tests.waiting import until

FIRMWARE = Path(wire.__file__).parent
NEUTRAL = (1500,) * 8


@pytest.fixture
def desk(put_on_desk, interpreter):
    return put_on_desk(interpreter)


def test_speaks_50_times_a_second_and_keeps_still(desk):
    act = desk.tick(100)

    def told() -> bool:
        desk.listen()
        return bool(desk.heard(wire.STATUS))

    until(told)  # the last words of the hundredth cycle
    assert act[1:9] == NEUTRAL and act[-1] == wire.DISARMED
    telemetry = desk.heard(wire.TELEM_1)
    assert len(telemetry) == 50
    assert telemetry[-1][10] == pytest.approx(3000, abs=3)  # 0.1 mm
    assert telemetry[-1][4:8] == pytest.approx((round(0.3 * PA_PER_M * 10),) * 4, abs=1)
    assert len(desk.heard(wire.STATUS)) == 1
    assert desk.events(wire.EV_BOOT)


def test_gimbals_turn_although_disarmed(desk):
    desk.set_point(servos=(1300, 1620, 1400, 1510))
    assert desk.tick()[9:14] == (1300, 1620, 1400, 1510, 300)


def test_arming_names_all_that_is_wrong(desk):
    boot_id = desk.greet()
    desk.leak = 1
    assert desk.order(wire.ARM, boot_id) == wire.REFUSED
    mask = desk.until(lambda: desk.events(wire.EV_ARM_REFUSED))[0][5]
    why = {check for i, check in enumerate(wire.ARM_CHECKS) if mask >> i & 1}
    assert why == {"leak", "set-point old", "ESC neutral for less than 3 s"}


def test_armed_it_holds_depth_and_level_on_the_plant(desk):
    plant = Plant(seed=3, depth_m=0.30)
    plant.push[0] = -0.4  # 1 % light
    desk.pressure_pa = [AIR_PA + p - tare for p, tare in zip(plant.pressure_pa(), plant.tare_pa, strict=True)]
    desk.arm()
    off = []
    for cycle in range(400):
        if cycle % 5 == 0:
            desk.set_point()
        act = desk.tick()
        plant.step(act[1:9])
        desk.pressure_pa = [AIR_PA + p - tare for p, tare in zip(plant.pressure_pa(), plant.tare_pa, strict=True)]
        off.append(plant.position - (0.3, 0.0, 0.0))
    rms = np.sqrt(np.mean(np.square(off[200:]), axis=0))
    assert act[-1] == wire.ARMED
    assert rms[0] < 0.003 and np.degrees(rms[1:]).max() < 0.5


def test_silent_host_hold_surface_disarm(desk):
    desk.arm()
    desk.set_point()
    start_us = desk.now_us
    when: dict[int, float] = {}
    for _ in range(3600):
        desk.tick()
        for event in desk.events(wire.EV_LADDER):
            when.setdefault(event[3], (event[0] - start_us) * 1e-6)
    assert when[failsafe.HOLD] == pytest.approx(0.5, abs=0.04)
    assert when[failsafe.SURFACE] == pytest.approx(3.0, abs=0.04)
    assert when[failsafe.DISARM] == pytest.approx(33.0, abs=0.05)  # depth never changes on the desk
    assert desk.tick()[1:9] == NEUTRAL
    desk.set_point()
    assert desk.tick(50)[-1] == wire.DISARMED, "the host's return does not arm"


def test_estop_is_latched_and_disarm_needs_no_boot_id(desk):
    boot_id = desk.arm()
    assert desk.order(wire.DISARM, 12345) == wire.OK
    assert desk.tick()[-1] == wire.DISARMED
    desk.tick(310)
    desk.set_point()
    assert desk.order(wire.ARM, boot_id) == wire.OK
    assert desk.order(wire.ESTOP, 0) == wire.OK
    assert desk.tick()[1:9] == NEUTRAL
    desk.tick(310)
    desk.set_point()
    assert desk.order(wire.ARM, boot_id) == wire.REFUSED
    assert desk.heard(wire.TELEM)[-1][2] == failsafe.LATCHED


def test_commands_execute_once(desk):
    boot_id = desk.arm()
    desk.tick(20)
    desk.say(wire.ARM, desk.req_id, boot_id)  # the same request, as if its answer had been lost
    desk.forget()
    assert desk.until(lambda: desk.heard(wire.ACK))[0][:3] == (desk.req_id, wire.ARM, wire.OK)
    desk.tick(20)
    assert not desk.events(wire.EV_ARMED)
    assert desk.order(wire.ARM, boot_id ^ 1) == wire.STALE_BOOT


def test_other_schema_is_told_and_not_armed(desk):
    boot_id = desk.greet(schema=1)
    desk.tick(310)
    desk.set_point()
    assert desk.order(wire.ARM, boot_id) == wire.REFUSED
    mask = desk.until(lambda: desk.events(wire.EV_ARM_REFUSED))[0][5]
    assert mask == 1 << wire.ARM_CHECKS.index("no handshake")


def test_tare_in_air_is_kept_over_a_power_cut(put_on_desk, interpreter):
    desk = put_on_desk(interpreter, {})
    desk.pressure_pa = [AIR_PA + offset for offset in (0.0, 100.0, -50.0, 20.0)]
    boot_id = desk.greet()
    assert desk.order(wire.TARE, boot_id, 0) == wire.OK
    assert json.loads(desk.flash_path.read_text())["tare_pa"] == pytest.approx(desk.pressure_pa)
    assert desk.power_off() == 0
    desk.power_on()
    assert desk.greet() != boot_id
    desk.tick(10)
    assert desk.heard(wire.TELEM)[-1][4:8] == pytest.approx((0, 0, 0, 0), abs=1)


@pytest.mark.parametrize(
    ("flash", "complaint"), [({"law": "pip"}, b"law = pip; write pi pid observer"), ({"tare_pa": [1, 2]}, b"no tare")]
)
def test_bad_flash_is_told_and_not_armed(put_on_desk, interpreter, flash, complaint):
    desk = put_on_desk(interpreter, flash)
    boot_id = desk.greet()
    assert any(complaint in text for _, text in desk.until(lambda: desk.heard(wire.LOG)))
    desk.tick(310)
    desk.set_point()
    assert desk.order(wire.ARM, boot_id) == wire.REFUSED


def test_noise_on_the_tether_changes_nothing(desk):
    boot_id = desk.arm()
    os.write(desk.slave, bytes(range(256)) * 4)
    desk.say(wire.HELLO, wire.PROTOCOL, 0, 0)  # glued to the noise before it: lost
    desk.set_point()
    assert desk.tick()[-1] == wire.ARMED
    assert desk.order(wire.DISARM, boot_id) == wire.OK


def test_ends_with_its_hardware(desk):
    desk.arm()
    assert desk.power_off() == 0


def test_a_fault_stops_the_motors_before_it_is_told(monkeypatch):
    monkeypatch.syspath_prepend(str(FIRMWARE))
    main = importlib.import_module("main")
    told = []

    class Hal:
        pressure_mPa, answered, battery_mv, current_10ma, leak = [round(1000 * AIR_PA)] * 4, 15, 15000, 0, 0
        servos_us, light_permille, armed, pulses_us = [1500] * 4, 0, 0, []
        capabilities, temperature_cC, dt_us, late = 0, 2000, 10_000, 0

        def boot_info(self):
            return b"", 1, 1

        def killed(self):
            return False

        def wait_tick(self):
            return True

        def now_us(self):
            return 0

        def end_cycle(self):
            raise ZeroDivisionError("a fault")

        def write_pins(self):
            told.append((self.armed, tuple(self.pulses_us)))

        def write(self, frame):
            told.append(bytes(frame))

    firmware = main.Firmware(Hal())
    firmware.hal.armed = firmware.control.state = wire.ARMED
    firmware.control.pulses_us[2] = 1700
    with pytest.raises(ZeroDivisionError):
        firmware.run()
    assert told[0] == (wire.DISARMED, NEUTRAL)
    assert b"stopped: ZeroDivisionError" in told[1]
