"""Firmware: the same files run on the board under MicroPython and on the host."""
