# COBS and the framer on whichever interpreter runs this: check_cobs.py FIRMWARE_DIR LINES
#
# A line has plain bytes and what another implementation stuffs them to, or chunks and the frames that are in them.
# ruff: noqa: I001, PTH123, T201 - main comes first; MicroPython has no pathlib
import json
import sys

sys.path.insert(0, sys.argv[1])
import binascii

import main  # noqa: F401 - sees to it that there is a micropython
import frames
import wire  # noqa: F401 - adds what only computers hear

unhex = binascii.unhexlify


def check_cobs(plain, stuffed):
    out = bytearray(len(plain) + 8)
    n = frames.stuff(plain, len(plain), out)
    assert bytes(out[:n]) == stuffed, (plain, out)
    assert out[n:] == bytes(len(out) - n), "written beyond its end"
    back = bytearray(stuffed) + b"\x55" * 8
    assert frames.unstuff(back, len(stuffed)) == len(plain), stuffed
    assert back[: len(plain)] == plain and back[len(stuffed) :] == b"\x55" * 8


def check_framer(chunks, expected, bad):
    got = []
    framer = frames.Framer(lambda kind, seq, payload: got.append([kind, seq, bytes(payload)]))
    for chunk in chunks:
        framer.feed(chunk + b"\x55" * 8, len(chunk))
    assert got == expected, (chunks, got)
    assert (framer.rx_ok, framer.rx_bad) == (len(expected), bad), (framer.rx_ok, framer.rx_bad, bad)


count = 0
with open(sys.argv[2]) as file:
    for line in file:
        row = json.loads(line)
        if "plain" in row:
            check_cobs(unhex(row["plain"]), unhex(row["stuffed"]))
        else:
            expected = [[kind, seq, unhex(payload)] for kind, seq, payload in row["frames"]]
            check_framer([unhex(chunk) for chunk in row["chunks"]], expected, row["bad"])
        count += 1
print(count)
