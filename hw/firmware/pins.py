# The pins that move things: what they shall show, and what they do. Wiring: hw/README.md, wiring.py.
import sys
from micropython import const

_OUTPUTS_ON = const(0x8000)  # MOE, in a timer's break register: the chip clears it, and it stays clear


def forget(*names):
    """Give back the memory of modules that are needed once, or seldom."""
    for name in names:
        del sys.modules[name]


class Pins:
    """Thrusters, servos, lamp."""

    def __init__(self):
        import stm
        import wiring

        self.pulses_us = [1500] * 8
        self.servos_us = [1500] * 4
        self.light_permille = 0
        # what they do show
        self._pulses_us = [1500] * 8
        self._servos_us = [1500] * 4
        self._light = -1
        self._loop_1, self._loop_8 = wiring.connect_kill_switch()
        self._registers, self._breaks = stm.mem16, (stm.TIM1 + stm.TIM_BDTR, stm.TIM8 + stm.TIM_BDTR)
        self._aux = wiring.start_servos()
        self._timers = self._thrusters = None  # until begin_pulses
        forget("wiring")
        self.write_pins()

    def begin_pulses(self, frame_us):
        """A pulse for each thruster every frame_us.

        Where pulses run already, only the frame changes, at its end: a timer that the kill switch has stopped stays so.
        """
        self._frame_us = frame_us
        if self._timers:
            for timer in self._timers:
                timer.period(frame_us - 1)
        else:
            self._start()

    def _start(self):
        import wiring

        self._timers, self._thrusters = wiring.start_thrusters(self._frame_us)
        self._pulses_us = [1500] * 8
        forget("wiring")

    def killed(self):
        """Whether the kill switch's loop is open, or was, be it for a moment: the thrusters have no pulses since."""
        if self._loop_1() or self._loop_8():
            return True
        registers, breaks = self._registers, self._breaks
        return not registers[breaks[0]] & registers[breaks[1]] & _OUTPUTS_ON

    def revive(self):
        """Neutral pulses again after a kill, where its loop is closed. For a robot at rest."""
        if self._timers and self.killed() and not (self._loop_1() or self._loop_8()):
            self._start()

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
