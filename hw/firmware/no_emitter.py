# Stands for MicroPython's own module where there is none: on a computer a function stays what it is.


def native(function):
    """Machine code on the board, an ordinary function here."""
    return function


def viper(function):
    """The same, with machine words for whole numbers; here they have no bounds."""
    return function


def const(value):
    """A number that the board's compiler writes in wherever its name stands."""
    return value
