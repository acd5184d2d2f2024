# Runs on the board before main.py. Over USB the board is a serial port alone: as a drive it would let a computer write
# into the file system while the firmware has it open.
import pyb


pyb.usb_mode("VCP")
