# The pins that move things: thrusters, servos, lamp, and the two inputs that stop the thrusters. Wiring: hw/README.md.
import pyb

import pwm


class Pins:
    """What the pins shall show, and the timers that show it."""

    def __init__(self):
        self.pulses_us = [1500] * 8
        self.servos_us = [1500] * 4
        self.light_permille = 0
        # what they do show
        self._pulses_us = [1500] * 8
        self._servos_us = [1500] * 4
        self._light = 0
        # A break input that has no pin yet reads low, and low, once break is armed, keeps the outputs off for good.
        for timer, pin in pwm.KILL:
            pyb.Pin(pin, mode=pyb.Pin.ALT, pull=pyb.Pin.PULL_UP, alt=pwm.FUNCTION[timer])
        self._timers = []  # of the thrusters
        self._thrusters = self._outputs((), 0)  # none yet: begin_pulses
        self._servos = self._outputs(pwm.SERVOS, 20000)  # 50 pulses a second: any servo takes that
        (self._lamp,) = self._outputs((pwm.LAMP,), 20000)
        self._lamp(pwm.lamp_us(0))

    def _outputs(self, rows, frame_us):
        """PWM outputs that stand at neutral: of each the function that sets its pulse.

        Where no timer drives them, before it starts or after a kill, they are held low: an ESC hears no pulse. For
        that the pin is no argument of channel(), which would take the pull away.
        """
        shows = []
        for number, channel, pins in rows:
            for pin in pins.split():
                pyb.Pin(pin, mode=pyb.Pin.ALT, pull=pyb.Pin.PULL_DOWN, alt=pwm.FUNCTION[number])
            timer = pyb.Timer(number)
            brk = timer.BRK_OFF
            if rows is pwm.THRUSTERS:
                brk = timer.BRK_LOW
                self._timers.append(timer)
            scale = pwm.prescaler(timer.source_freq())
            timer.init(prescaler=scale, period=frame_us - 1, brk=brk)  # type: ignore[call-overload] # brk is missing
            for _ in pins.split():
                shows.append(timer.channel(channel, timer.PWM, pulse_width=1500).pulse_width)
                channel += 1
        return shows

    def begin_pulses(self, frame_us):
        """A pulse for each thruster every frame_us.

        Where pulses run already, only the frame changes, at its end: a timer that the kill switch has stopped stays so.
        """
        if self._timers:
            for timer in self._timers:
                timer.period(frame_us - 1)
        else:
            self._thrusters = self._outputs(pwm.THRUSTERS, frame_us)

    def write_pins(self):
        """Show what has changed."""
        new, shown = self.pulses_us, self._pulses_us
        if new != shown:
            i = 0
            for show in self._thrusters:
                us = shown[i] = new[i]
                show(us)
                i += 1
        new, shown = self.servos_us, self._servos_us
        if new != shown:
            for i in range(4):
                us = shown[i] = new[i]
                self._servos[i](us)
        if self.light_permille != self._light:
            self._light = self.light_permille
            self._lamp(pwm.lamp_us(self._light))
        return True
