# Runs on the board before the firmware, and no update over the tether replaces it: it says which of two sets of files
# runs. Their folders are a and b; `aucamp board update` fills the one that rests. A set on trial runs once and for two
# minutes at most, whatever it does: the boot after that is of the set that is known to work.
# Over USB the board is a serial port alone: as a drive it would let a computer write into the file system meanwhile.
import machine
import os
import pyb
import stm
import sys
from micropython import const

# Names of files that say by being there what is to be done: each is made and removed in one step.
_SECOND = const("second")  # b is the set that runs
_TRIAL = const("trial")  # the other one is to be tried

# In backup registers of the clock, which a reset leaves alone: in the last one, that the host asked for a prompt; in
# the one before it, which set was chosen last.
_AT_PROMPT = const(0x0A12)
_TRIAL_S = const(120)  # the host needs 20 to see how it goes
_PROMPT_S = const(600)  # a board that was left at its prompt goes back to its firmware
_HANGS_MS = const(8000)  # the watchdog of a trial, until the firmware sets its own
_BAUD = const(1000000)


def reset_after(seconds):
    """Whatever runs then: counted in the interrupt of a timer that nothing else has."""
    left = [seconds]

    def count(_timer):
        left[0] -= 1
        if left[0] <= 0:
            machine.reset()

    pyb.Timer(14, freq=1).callback(count)


def wants_prompt():
    """The host's order, which is forgotten with that, or PB1 bridged to ground."""
    if stm.mem32[stm.RTC + stm.RTC_BKP19R] == _AT_PROMPT:
        stm.mem32[stm.RTC + stm.RTC_BKP19R] = 0
        if "usb" not in os.listdir():
            pyb.repl_uart(pyb.UART(2, _BAUD, read_buf_len=1024))
        reset_after(_PROMPT_S)
        return True
    return not pyb.Pin("PB1", mode=pyb.Pin.IN, pull=pyb.Pin.PULL_UP).value()


def choose():
    """The folder of the set that runs in this boot."""
    names = os.listdir()
    second = _SECOND in names
    if _TRIAL in names:
        os.remove(_TRIAL)
        os.sync()
        reset_after(_TRIAL_S)
        machine.WDT(timeout=_HANGS_MS)
        second = not second
    chosen = "b" if second else "a"
    stm.mem32[stm.RTC + stm.RTC_BKP18R] = ord(chosen)
    return chosen


def start():
    """Say what follows this file."""
    pyb.usb_mode("VCP")
    if wants_prompt():
        pyb.main("no file, a prompt")
        return
    folder = choose()
    sys.path.insert(0, folder)
    pyb.main(folder + "/main.py")


start()
for _name in ("reset_after", "wants_prompt", "choose", "start"):  # main.py has them beside its own, and memory is short
    del globals()[_name]
