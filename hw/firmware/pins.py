# The pins that move things: what they shall show, and what they do. Wiring: hw/README.md, wiring.py.
import sys


def forget(*names):
    """Give back the memory of modules that are needed once, or seldom."""
    for name in names:
        del sys.modules[name]


class Pins:
    """Thrusters, servos, lamp."""

    def __init__(self):
        import wiring

        self.pulses_us = [1500] * 8
        self.servos_us = [1500] * 4
        self.light_permille = 0
        # what they do show
        self._pulses_us = [1500] * 8
        self._servos_us = [1500] * 4
        self._light = -1
        wiring.connect_kill_switch()
        self._aux = wiring.start_servos()
        self._timers = self._thrusters = None  # until begin_pulses
        forget("wiring", "pwm")
        self.write_pins()

    def begin_pulses(self, frame_us):
        """A pulse for each thruster every frame_us.

        Where pulses run already, only the frame changes, at its end: a timer that the kill switch has stopped stays so.
        """
        if self._timers:
            for timer in self._timers:
                timer.period(frame_us - 1)
        else:
            import wiring

            self._timers, self._thrusters = wiring.start_thrusters(frame_us)
            forget("wiring", "pwm")

    def write_pins(self):
        """Show what has changed."""
        new, shown = self.pulses_us, self._pulses_us
        if new != shown and self._thrusters:
            i = 0
            for show in self._thrusters:
                us = shown[i] = new[i]
                show(us)
                i += 1
        new, shown = self.servos_us, self._servos_us
        if new != shown:
            for i in range(4):
                us = shown[i] = new[i]
                self._aux[i](us)
        if self.light_permille != self._light:
            self._light = self.light_permille
            self._aux[4](1100 + 800 * self._light // 1000)  # us, Blue Robotics Lumen
        return True
