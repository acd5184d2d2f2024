# Encode and decode every golden frame, on whichever interpreter runs this: check_vectors.py FIRMWARE_DIR VECTORS
# ruff: noqa: PTH123, T201, UP031 - MicroPython has no pathlib
import json
import sys

sys.path.insert(0, sys.argv[1])
import binascii

import main  # noqa: F401 - sees to it that there is a micropython
import wire


def fields_of(row):
    return [binascii.unhexlify(f["hex"]) if isinstance(f, dict) else f for f in row["fields"]]


def check(row):
    kind = {name: kind for kind, name, _, _ in wire.TABLE}[row["kind"]]
    fields = fields_of(row)
    writer = wire.Writer()
    writer.seq = row["seq"]
    frame = bytes(writer.log(*fields) if kind == wire.LOG else writer.frame(kind, *fields))
    assert frame == binascii.unhexlify(row["frame"]), (row, frame)
    got = []
    framer = wire.Framer(lambda k, seq, payload: got.append((k, seq, list(wire.unpack(k, payload)))))
    framer.feed(frame, len(frame))
    assert got == [(kind, row["seq"], fields)], (row, got)


count = 0
with open(sys.argv[2]) as file:
    for line in file:
        check(json.loads(line))
        count += 1
print(count, "%08x" % wire.schema_crc())
