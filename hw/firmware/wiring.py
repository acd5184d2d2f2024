# Pins and timers as they are connected at boot. Done once, and its memory given back (pins.py).
import pwm
import pyb


def connect_kill_switch():
    """A break input that has no pin yet reads low, and low, once break is armed, keeps the outputs off for good."""
    for timer, pin in pwm.KILL:
        pyb.Pin(pin, mode=pyb.Pin.ALT, pull=pyb.Pin.PULL_UP, alt=pwm.FUNCTION[timer])


def start(rows, frame_us, brk):
    """PWM outputs that stand at neutral: their timers, and of each output the function that sets its pulse.

    Where no timer drives them, before it starts or after a kill, they are held low: an ESC hears no pulse. For that the
    pin is no argument of channel(), which would take the pull away.
    """
    timers, shows = [], []
    for number, channel, pins in rows:
        for pin in pins.split():
            pyb.Pin(pin, mode=pyb.Pin.ALT, pull=pyb.Pin.PULL_DOWN, alt=pwm.FUNCTION[number])
        timer = pyb.Timer(number)
        timers.append(timer)
        scale = pwm.prescaler(timer.source_freq())
        timer.init(prescaler=scale, period=frame_us - 1, brk=brk)  # type: ignore[call-overload] # brk is missing
        for _ in pins.split():
            shows.append(timer.channel(channel, timer.PWM, pulse_width=1500).pulse_width)
            channel += 1
    return timers, shows


def start_servos():
    """Four servos and the lamp, 50 pulses a second: any of them takes that."""
    return start(pwm.SERVOS + (pwm.LAMP,), 20000, pyb.Timer.BRK_OFF)[1]


def start_thrusters(frame_us):
    """The eight of them, with the timers that the kill switch stops."""
    return start(pwm.THRUSTERS, frame_us, pyb.Timer.BRK_LOW)
