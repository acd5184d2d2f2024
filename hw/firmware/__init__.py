"""Firmware: the same files run on the board under MicroPython and on the host."""

from hw.firmware import emitters_unix

emitters_unix.take_place()  # the files ask for MicroPython's own module
