# Takes the place of MicroPython's own module under another Python: a function stays what it is, a buffer is its own
# pointer, and a whole number has no bounds.
import builtins
import sys


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


def take_place():
    """From now on this is what `import micropython` finds; pointers are words of the language in viper functions."""
    sys.modules.setdefault("micropython", sys.modules[__name__])
    builtins.ptr8, builtins.ptr16, builtins.ptr32 = ptr8, ptr16, ptr32
