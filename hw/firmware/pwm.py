# Pulses in microseconds from the timers of an STM32F407: which timer and pin drives what, and the arithmetic.
FRAME_US = 20000  # 50 pulses a second: any ESC and any servo takes that

# timer, channel, pin; checked against the alternate functions of the chip
THRUSTERS = (
    (1, 1, "PE9"),
    (1, 2, "PE11"),
    (1, 3, "PE13"),
    (1, 4, "PE14"),
    (8, 1, "PC6"),
    (8, 2, "PC7"),
    (8, 3, "PC8"),
    (8, 4, "PC9"),
)
SERVOS = ((4, 1, "PD12"), (4, 2, "PD13"), (4, 3, "PD14"), (4, 4, "PD15"))
LAMP = (3, 3, "PB0")
KILL = ((1, "PE15"), (8, "PA6"))  # break inputs: low stops the timer's outputs without any software

LAMP_OFF_US, LAMP_FULL_US = 1100, 1900  # Blue Robotics Lumen


def prescaler(source_hz):
    """What to divide a timer's clock by, less one, for a count each microsecond. ValueError if it cannot be."""
    if source_hz % 1000000 or not 1000000 <= source_hz <= 65536000000:
        raise ValueError("a timer clock of %d Hz makes no microseconds" % source_hz)
    return source_hz // 1000000 - 1


def lamp_us(permille):
    """Pulse for a lamp level in 1/1000."""
    return LAMP_OFF_US + (LAMP_FULL_US - LAMP_OFF_US) * permille // 1000
