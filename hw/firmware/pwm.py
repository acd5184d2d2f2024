# Pulses in microseconds from the timers of an STM32F407: which timer and pin drives what, and the arithmetic.
# timer, channel of the first pin, pins; checked against the alternate functions of the chip
THRUSTERS = ((1, 1, "PE9 PE11 PE13 PE14"), (8, 1, "PC6 PC7 PC8 PC9"))
SERVOS = ((4, 1, "PD12 PD13 PD14 PD15"),)
LAMP = (3, 3, "PB0")
KILL = ((1, "PE15"), (8, "PA6"))  # break inputs: low stops the timer's outputs without any software
FUNCTION = b"\0\1\0\2\2\0\0\0\3"  # by timer: number of the alternate function that connects a pin with it


def prescaler(source_hz):
    """What to divide a timer's clock by, less one, for a count each microsecond. ValueError if it cannot be."""
    if source_hz % 1000000 or not 1000000 <= source_hz <= 65536000000:
        raise ValueError("timer clock %d Hz" % source_hz)
    return source_hz // 1000000 - 1
