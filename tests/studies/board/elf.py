"""Functions and objects of a program, from its ELF file of 64 bits."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import NamedTuple

from tests.studies.board.tools import UNIX_PORT, BoardError

SYMBOL_TABLE, OBJECT, FUNCTION = 2, 1, 2
PRICED = {"mp_execute_bytecode": 0x2017, "gc_alloc": 0x361}  # sizes in the build that prices.json was found with


class Symbol(NamedTuple):
    """One function or object."""

    offset: int
    size: int
    kind: int
    name: str


def symbols(path: Path) -> list[Symbol]:
    """Sorted by offset. Raises BoardError where the names are gone; says so where the build is another."""
    data = path.read_bytes()
    if data[:5] != b"\x7fELF\x02":
        raise BoardError(f"{path} is no program of 64 bits")
    (at,) = struct.unpack_from("<Q", data, 0x28)
    size, n = struct.unpack_from("<HH", data, 0x3A)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, at + i * size) for i in range(n)]
    found: dict[int, Symbol] = {}
    for section in sections:
        if section[1] != SYMBOL_TABLE:
            continue
        names = sections[section[6]]
        for at in range(section[4], section[4] + section[5], 24):
            name, info, _, _, value, length = struct.unpack_from("<IBBHQQ", data, at)
            if info & 15 in (OBJECT, FUNCTION) and length and value:
                start = names[4] + name
                text = data[start : data.index(b"\0", start)].decode(errors="replace")
                found[value] = Symbol(value, length, info & 15, text)
    sizes = {symbol.name: symbol.size for symbol in found.values()}
    if "fun_bc_call" not in sizes:
        raise BoardError(f"{path} is stripped of its functions' names: pip install {UNIX_PORT}")
    if any(sizes.get(name) != length for name, length in PRICED.items()):
        sys.stderr.write("another build of MicroPython than the prices were found with: expect larger errors\n")
    return sorted(found.values())
