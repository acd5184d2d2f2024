# The control module: 100 Hz from pressure to pulses, and the conversation with the host.
#   main.py SERIAL_FD BUS_FD FLASH_PATH        on a computer, under CPython or MicroPython
import sys

import control
import failsafe
import law
import pressure
import tether
import wire

TELEMETRY_EVERY, STATUS_EVERY = 2, 100  # cycles: 50 Hz, 1 Hz


class Firmware:
    """One boot of the control module."""

    def __init__(self, hal):
        self.hal = hal
        self.flash = {}
        self.control = control.Control()
        hal.pulses_us = self.control.pulses_us  # one list: what control decides is what the pins show
        self.tether = tether.Tether(hal, self.control, hal.boot_info())
        self.tare = None  # collects, while one runs
        self.last_us = None
        self.cycle = 0

    def boot(self):
        """Read flash and announce ourselves. What is wrong there does not stop the loop: it stops arming."""
        module = self.control
        try:
            self.flash = self.hal.load_flash()
            module.law = law.choose(self.flash.get("law", "observer"))
        except ValueError as error:
            self.tether.log(wire.ERROR, str(error))
            module.ladder.latch(failsafe.PARAMETERS)
        tare_pa = self.flash.get("tare_pa")
        if pressure.believable(tare_pa):
            module.plane.tare_pa = tare_pa
        elif tare_pa is not None:
            self.tether.log(wire.ERROR, "tare_pa in flash is no tare: tare again")
        self.tether.event(wire.EV_BOOT, 0, module.ladder.level, wire.INFO, self.tether.reset_cause)

    def run(self):
        """Until the hardware goes. Whatever goes wrong in a cycle, the motors stop before it is told."""
        try:
            while self.hal.wait_tick():
                self.step()
        except BaseException as error:
            self.control.disarm()
            self.hal.armed = wire.DISARMED
            self.hal.write_pins()
            self.tether.last_words("stopped: " + repr(error))
            raise

    def step(self):
        """One cycle; writing to the tether comes last, because on a UART it blocks."""
        hal, module, line = self.hal, self.control, self.tether
        now_us = hal.now_us()
        dt_us = 10000 if self.last_us is None else (now_us - self.last_us) & 0xFFFFFFFF
        self.last_us = now_us
        self.cycle += 1
        module.sense(hal.pressure_pa, hal.answered, hal.battery_mv, hal.leak, dt_us)
        line.listen()
        if line.tare_request:
            self.step_tare()
        before = module.ladder.level
        if module.act(dt_us):
            line.event(wire.EV_LADDER, before, module.ladder.level, wire.WARNING, module.ladder.reason)
        hal.armed = module.state
        hal.feed()
        if self.cycle % TELEMETRY_EVERY == 0:
            line.say_telemetry(now_us)
            line.say_one()
        if self.cycle % STATUS_EVERY == 0:
            line.say_status(now_us)
        line.loop_us = (hal.now_us() - now_us) & 0xFFFFFFFF
        line.loop_max_us = max(line.loop_max_us, line.loop_us)
        line.gc_max_us = max(line.gc_max_us, hal.collect())

    def step_tare(self):
        """Two seconds of readings, then the answer that the host waits for."""
        req_id, depth_m = self.tether.tare_request
        if self.tare is None:
            self.tare = pressure.Tare()
        if not self.tare.step(self.hal.pressure_pa):
            return
        medians = self.tare.result()
        if medians:
            self.flash["tare_pa"] = self.control.plane.tare_pa = [p - depth_m * wire.PA_PER_M for p in medians]
            self.hal.save_flash(self.flash)
        self.tare = self.tether.tare_request = None
        self.tether.answer(req_id, wire.TARE, wire.OK if medians else wire.REFUSED)


def main(serial_fd, bus_fd, flash_path):
    import hal_unix

    firmware = Firmware(hal_unix.Hal(int(serial_fd), int(bus_fd), flash_path))
    firmware.boot()
    try:
        firmware.run()
    except KeyboardInterrupt:
        pass


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.stderr.write("usage: main.py SERIAL_FD BUS_FD FLASH_PATH\n")
        sys.exit(2)
    main(*sys.argv[1:])
