"""From counted instructions to nanoseconds of an STM32F407 at 168 MHz: prices.json, found as README.md says."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping

from tests.studies.board.counts import Count
from tests.studies.board.tools import HERE

_PRICES = json.loads((HERE / "prices.json").read_text())
_INSTRUCTION, _CALL, _PRETENDED = _PRICES["instruction"], _PRICES["call"], _PRICES["pretended"]
_GROUP = _PRICES["group"]
NOT_COUNTED = {"gc_alloc", "gc_info", "gc_collect", "(full)"}  # what they take depends on the heap, not on this one
ATTRIBUTES = {
    "mp_obj_instance_attr",
    "mp_obj_class_lookup",
    "mp_load_method_maybe",
    "mp_convert_member_lookup",
    "mp_load_method",
    "mp_load_attr",
    "type_attr",
    "module_attr",
}
UART_BYTE_NS = 10000  # of the tether, at 1 Mbaud
LOOK_NS = float(_CALL["gc_info"])  # gc.mem_free: it looks at every block of the heap
HEAP_WORK = {"(scan)": "looking for room", "(single)": "taking memory", "(multiple)": "taking memory"}

# Garbage collection: where the prices were found, and for each byte more in use, and of garbage
OVERFLOW = 1.94  # a collection whose stack of 64 overflows walks the heap again
GC_MS, GC_MS_A_BYTE, GC_MS_A_BYTE_OF_GARBAGE = 2.755, 3.52e-5, 3.3e-6
# The firmware that the prices were found with: bytes that it took on the board, took here, and of its .mpy files
USED, USED_ON_UNIX, COMPILED = 54080, 87680, 28776
FREE_AT_START = 102352
MISSED = 4200  # that the firmware of gyros took more, on the real port, than its figures here say


def group(name: str) -> str | None:
    """What a function of the interpreter is priced as that has no price of its own; None: nothing."""
    if name == "mp_execute_bytecode":
        return "vm"
    if name == "mp_map_lookup":
        return "map"
    if name in ("(native)", "(libm)", "(libc)"):
        return name[1:-1]
    if name.startswith("m_malloc") or name in ("gc_free", "m_free") or "mutex" in name or "gc_" in name:
        return None
    if "float" in name:
        return "float"
    return "attr" if name in ATTRIBUTES else "other"


def instruction_ns(name: str) -> float:
    """Of one instruction in this function of the interpreter."""
    if name in NOT_COUNTED:
        return 0.0
    if name in _INSTRUCTION:
        return float(_INSTRUCTION[name])
    kind = group(name)
    return 1.0 if kind is None else float(_GROUP[kind])


def nanoseconds(count: Count, pretended: Mapping[str, float]) -> float:
    """Of what was counted, and of calls of the pretended hardware, by name."""
    total = sum(instruction_ns(name) * n for name, n in count.instructions.items())
    total += sum(_CALL.get(name, 0.0) * n for name, n in count.called.items())
    return float(total + sum(_PRETENDED.get(name, _GROUP["fake"]) * n for name, n in pretended.items()))


def by_group(count: Count) -> dict[str, float]:
    """Nanoseconds by what the interpreter did."""
    out: dict[str, float] = defaultdict(float)
    for name, n in count.instructions.items():
        out[HEAP_WORK.get(name) or group(name) or "taking memory"] += instruction_ns(name) * n
    for name, n in count.called.items():
        out[group(name) or "taking memory"] += _CALL.get(name, 0.0) * n
    return out


def gc_ms(used: float, garbage: float, overflows: bool) -> float:
    """Of one collection; used: bytes of the firmware on the board."""
    ms = GC_MS + GC_MS_A_BYTE * (used - USED) + GC_MS_A_BYTE_OF_GARBAGE * garbage
    return OVERFLOW * ms if overflows else ms


def used_on_board(on_unix: int, compiled: int, bytecode: int) -> float:
    """Bytes of the board's heap that the firmware takes after boot. compiled: size of its .mpy files for the board;
    bytecode: the same with nothing in its native functions. What is no code is of half the size on the board."""
    return USED + (compiled - COMPILED) + 0.5 * ((on_unix - USED_ON_UNIX) - (bytecode - COMPILED))
