# What is connected where, and how pins and timers are connected at boot: pulses in microseconds from the timers of an
# STM32F407. Done once, and its memory given back (pins.py). docs/draw_wiring.py draws the table for people.

# timer, channel of the first pin, pins; checked against the alternate functions of the chip
THRUSTERS = ((1, 1, "PE9 PE11 PE13 PE14"), (8, 1, "PC6 PC7 PC8 PC9"))
SERVOS = ((4, 1, "PD12 PD13 PD14 PD15"),)
LAMP = (3, 3, "PB0")
# Break inputs: while one is high, its timer's outputs are off without any software. One loop of wire from both to
# ground, closed while the robot may run: a switch that opens it, a magnet that is pulled and a wire that breaks are the
# same, for the pull-up then has the pin. The filter in front of each, in ohm and nF, lets no spike of a motor pass;
# the chip's own inputs have none.
KILL = ((1, "PE15"), (8, "PA6"))
KILL_FILTER = (1000, 100)
FUNCTION = b"\0\1\0\2\2\0\0\0\3"  # by timer: number of the alternate function that connects a pin with it


def prescaler(source_hz):
    """What to divide a timer's clock by, less one, for a count each microsecond. ValueError if it cannot be."""
    if source_hz % 1000000 or not 1000000 <= source_hz <= 65536000000:
        raise ValueError("timer clock %d Hz" % source_hz)
    return source_hz // 1000000 - 1


def connect_kill_switch():
    """The levels of the loop, as functions: 1 is open. Pulled up before break is armed."""
    import pyb

    pins = [pyb.Pin(pin, mode=pyb.Pin.ALT, pull=pyb.Pin.PULL_UP, alt=FUNCTION[timer]) for timer, pin in KILL]
    return [pin.value for pin in pins]


def connect_inputs():
    """Functions that read battery, current and leak probe; the bus of the gyro, and the function that selects it."""
    import machine
    import pyb

    probe = pyb.Pin("PC4", mode=pyb.Pin.IN, pull=pyb.Pin.PULL_UP).value
    spi = machine.SPI(2, baudrate=1000000, polarity=0, phase=0)
    pyb.Pin("PB14", mode=pyb.Pin.ALT, pull=pyb.Pin.PULL_UP, alt=5)  # so that silence reads as 255
    select = pyb.Pin("PE7", mode=pyb.Pin.OUT, value=1).value
    return pyb.ADC(pyb.Pin("PC1")).read, pyb.ADC(pyb.Pin("PC2")).read, probe, spi, select


def start(rows, frame_us, brk):
    """PWM outputs that stand at neutral: their timers, and of each output the function that sets its pulse.

    Where no timer drives them, before it starts or after a kill, they are held low: an ESC hears no pulse. For that the
    pin is no argument of channel(), which would take the pull away.
    """
    import pyb

    timers, shows = [], []
    for number, channel, pins in rows:
        for pin in pins.split():
            pyb.Pin(pin, mode=pyb.Pin.ALT, pull=pyb.Pin.PULL_DOWN, alt=FUNCTION[number])
        timer = pyb.Timer(number)
        timers.append(timer)
        scale = prescaler(timer.source_freq())
        timer.init(prescaler=scale, period=frame_us - 1, brk=brk)  # type: ignore[call-overload] # brk is missing
        for _ in pins.split():
            shows.append(timer.channel(channel, timer.PWM, pulse_width=1500).pulse_width)
            channel += 1
    return timers, shows


def start_servos():
    """Four servos and the lamp, 50 pulses a second: any of them takes that."""
    import pyb

    return start(SERVOS + (LAMP,), 20000, pyb.Timer.BRK_OFF)[1]


def start_thrusters(frame_us):
    """The eight of them, with the timers that the kill switch stops."""
    import pyb

    return start(THRUSTERS, frame_us, pyb.Timer.BRK_HIGH)
