# The control module: 100 Hz from pressure to pulses, and the conversation with the host.
#   main.py SERIAL_FD BUS_FD FLASH_PATH        on a computer, under CPython or MicroPython
#   without arguments                          on the board
import sys

if sys.implementation.name != "micropython":
    import emitters_unix

    emitters_unix.take_place()

from micropython import const

import motor_control
import orders
import tether

# Of wire.py, whose numbers these are
_DISARMED = const(0)
_EV_BOOT = const(1)
_EV_LADDER = const(4)
_INFO = const(0)
_WARNING = const(1)
_BY_WATCHDOG = const(3)
_TO_PROMPT = const(2)  # of orders.py

# Indices of wire.REASONS, and of failsafe.py
_PARAMETERS = const(11)
_WATCHDOG = const(12)
_HOLD_AFTER_US = const(500000)

# What is not done in each cycle has cycles of its own, so that no two dear things meet: telemetry in even ones (50 Hz),
# in odd ones the rest. Cycle after cycle, what a cycle takes must stay below 10 ms.
_TELEMETRY_EVERY = const(2)
_STATUS_EVERY = const(100)
_STATUS_AT = const(1)
_COLLECT_EVERY = const(50)  # what a cycle leaves is less than 200 bytes
_COLLECT_AT = const(25)
_FEEL_EVERY = const(10)  # where up is, if somebody knows
_FEEL_AT = const(7)
_LOOK_EVERY = const(100)  # how much memory is free: looking takes 2 ms
_LOOK_AT = const(53)


class Firmware:
    """One boot of the control module."""

    def __init__(self, hal):
        self.hal = hal
        self.control = motor_control.Control()
        hal.pulses_us = self.control.pulses_us  # one list: what control decides is what the pins show
        self.tether = tether.Tether(hal, self.control, hal.boot_info())
        self.cycle = 0

    def boot(self):
        """Read flash and announce ourselves. What is wrong there does not stop the loop: it stops arming."""
        import flash
        import parameters

        hal, module, line = self.hal, self.control, self.tether
        try:
            values = flash.values(hal)
        except ValueError as error:
            values = parameters.from_flash({})
            line.complain(str(error))
            module.ladder.latch(_PARAMETERS)
        line.orders.saved = values
        module.configure(list(values))
        try:
            module.plane.tare_mPa, line.orders.tared = flash.tared(hal)
        except ValueError as error:
            line.complain(str(error))
        if line.reset_cause == _BY_WATCHDOG:
            line.complain("reset by watchdog: reboot by order, then arm")
            module.ladder.latch(_WATCHDOG)
        line.begin_pulses()
        line.event(_EV_BOOT, 0, module.ladder.level, _INFO, line.reset_cause)
        orders.put_away()
        hal.collect()

    def run(self):
        """Cycle until the hardware goes (0), or an order to reboot comes (Orders.reboot).

        Where the hardware itself fails, or somebody interrupts, the motors stop before it is told.
        """
        try:
            while self.hal.wait_tick():
                self.step()
                if self.tether.orders.reboot:
                    return self.tether.orders.reboot
            return 0
        except BaseException as error:
            self.control.disarm()
            self.hal.armed = _DISARMED
            self.hal.write_pins()
            self.tether.last_words("stopped: " + repr(error))
            raise

    def step(self):
        """One cycle; writing to the tether comes last, because on a UART it blocks.

        What breaks off is left out, counted and told, and the rest of the cycle goes on: a robot at depth is lost
        without its control law. Whether it may go on without that, the ladder says.
        """
        hal, module, line = self.hal, self.control, self.tether
        dt_us = hal.dt_us
        self.cycle += 1
        unsensed = None
        try:
            module.killed = hal.killed()
            if self.cycle % _FEEL_EVERY == _FEEL_AT:
                gravity_mg = hal.gravity_mg()
                if gravity_mg:
                    module.plane.feel(*gravity_mg)
            module.sense(hal.pressure_mPa, hal.answered, hal.battery_mv, hal.leak, dt_us)
        except Exception as error:
            unsensed = error
        try:
            line.listen()
            line.orders.step(hal.pressure_mPa)
        except Exception as error:
            line.fault("tether", error)
        before = module.ladder.level
        try:
            if unsensed:
                raise unsensed
            moved = module.act(dt_us)
        except Exception as error:
            line.fault("control", error)
            moved = module.fail(dt_us)
        if moved:
            line.event(_EV_LADDER, before, module.ladder.level, _WARNING, module.ladder.reason)
        hal.armed = module.state
        hal.end_cycle()
        try:
            self._take_turns()
        except Exception as error:
            line.fault("telemetry", error)
        line.took(hal.cycle_us())

    def _take_turns(self):
        """What it is time to tell the host, or to clean up."""
        line, cycle = self.tether, self.cycle
        if cycle % _TELEMETRY_EVERY == 0:
            line.say_telemetry()
        elif cycle % _STATUS_EVERY == _STATUS_AT:
            line.say_status()
        elif cycle % _COLLECT_EVERY == _COLLECT_AT:
            if self.control.set_point.age_us > _HOLD_AFTER_US:
                self.hal.light_permille = 0  # armed or not: nobody asks for light any more
            self.hal.collect()
        elif cycle % _LOOK_EVERY == _LOOK_AT:
            line.heap_free_16 = self.hal.heap_free() >> 4
        else:
            line.say_one()


def serve(hal):
    """Boot, and boot again by order, until the hardware goes."""
    while True:
        firmware = Firmware(hal)
        firmware.boot()
        reboot = firmware.run()
        if not reboot:
            return
        hal.reboot(reboot == _TO_PROMPT)


if __name__ == "__main__":
    if sys.platform == "pyboard":
        import hal_stm32

        serve(hal_stm32.Hal())
    elif len(sys.argv) == 4:
        import hal_unix

        try:
            serve(hal_unix.Hal(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]))
        except KeyboardInterrupt:
            pass
    else:
        sys.stderr.write("usage: main.py SERIAL_FD BUS_FD FLASH_PATH\n")
        sys.exit(2)
