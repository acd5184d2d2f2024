# Stands for MicroPython's own module where there is none: on a computer a function stays what it is, a buffer its own
# pointer, and a whole number has no bounds. Nothing of this goes to the board.
uint = int


def native(function):
    """Machine code on the board, an ordinary function here."""
    return function


def viper(function):
    """The same, with machine words for whole numbers."""
    return function


def const(value):
    """A number that the board's compiler writes in wherever its name stands."""
    return value


def ptr8(buffer):
    """The bytes of a buffer."""
    return buffer


def ptr16(buffer):
    """A buffer as words of 16 bits, which have no sign."""
    return memoryview(buffer).cast("B").cast("H")


def ptr32(buffer):
    """A buffer as words of 32 bits, with a sign as on the board."""
    return memoryview(buffer).cast("B").cast("i")
