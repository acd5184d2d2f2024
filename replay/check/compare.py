"""Where two outputs of one step differ: the bytes say whether, the fields say where and by how much.

A field is named by its path, `state.posterior_m[2]`. Counting and ignoring go by the path without indices.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgpack

from agent.core.config import Struct, convert, read_toml
from agent.core.messages import SCHEMA
from agent.core.step_io import OLDER, Outputs


class Absent:
    """What stands for a field that one side does not have."""

    def __repr__(self) -> str:
        return "absent"


ABSENT = Absent()


class Difference(NamedTuple):
    field: str
    recorded: Any
    replayed: Any

    @property
    def plain(self) -> str:
        """The field without indices: all elements of a list are one field."""
        return re.sub(r"\[\d+\]", "", self.field)

    @property
    def size(self) -> tuple[float, float]:
        """Absolute and relative difference; infinite where it is not one of numbers."""
        pair = (self.recorded, self.replayed)
        if not all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in pair):
            return math.inf, math.inf
        absolute = abs(self.replayed - self.recorded)
        largest = max(abs(self.replayed), abs(self.recorded))
        return absolute, absolute / largest if largest else 0.0

    def __str__(self) -> str:
        ulps = distance_ulps(self.recorded, self.replayed)
        apart = "" if ulps is None else f", {ulps} ULP apart"
        return f"{self.field}: recorded {exact(self.recorded)}, replayed {exact(self.replayed)}{apart}"


class Ignored(Struct, frozen=True, kw_only=True):
    """A field, with all below it, that may differ."""

    field: str
    reason: str
    since: str  # date

    def covers(self, difference: Difference) -> bool:
        return f"{difference.plain}.".startswith(f"{self.field}.")


class IgnoreFile(Struct, frozen=True, kw_only=True):
    ignore: tuple[Ignored, ...] = ()


def load_ignored(path: Path) -> tuple[Ignored, ...]:
    """The rows [[ignore]] of a TOML file. Raises ConfigError with one line."""
    return convert(read_toml(path), IgnoreFile, path).ignore


def differences(recorded: bytes, replayed: bytes) -> list[Difference]:
    """Every leaf that differs, in the order of the message; numbers by their bits, so -0.0 is not 0.0."""
    if recorded == replayed:
        return []
    try:
        before = msgpack.unpackb(recorded)
        older = isinstance(before, dict) and not OLDER.keys().isdisjoint(before)
        fields = opened(Outputs.upgraded(before) if older else before)
    except (ValueError, TypeError, KeyError, AttributeError, msgpack.UnpackException, RecursionError):
        return [Difference("outputs", f"{len(recorded)} bytes that are no message", "a message")]
    found = list(_walk(fields, opened(msgpack.unpackb(replayed)), ""))
    return found if found or older else [Difference("outputs", "these bytes", "other bytes of the same fields")]


def opened(outputs: Any) -> Any:
    """Outputs of a step with the payloads of what neighbours are told decoded where they stand."""
    if not isinstance(outputs, dict) or "outgoing" not in outputs:
        return outputs
    return outputs | {
        "outgoing": [said | {"payload": msgpack.unpackb(said["payload"])} for said in outputs["outgoing"]]
    }


def _walk(recorded: Any, replayed: Any, path: str) -> Iterator[Difference]:
    if isinstance(recorded, dict) and isinstance(replayed, dict):
        for name in [*recorded, *(name for name in replayed if name not in recorded)]:
            below = f"{path}.{name}" if path else str(name)
            yield from _walk(recorded.get(name, ABSENT), replayed.get(name, ABSENT), below)
        if list(recorded) != list(replayed) and set(recorded) == set(replayed):
            yield Difference(path, list(recorded), list(replayed))  # the same keys in another order
    elif isinstance(recorded, list) and isinstance(replayed, list):
        for k in range(max(len(recorded), len(replayed))):
            yield from _walk(_at(recorded, k), _at(replayed, k), f"{path}[{k}]")
    elif msgpack.packb(_leaf(recorded)) != msgpack.packb(_leaf(replayed)):
        yield Difference(path, recorded, replayed)


def _at(values: Sequence[Any], k: int) -> Any:
    return values[k] if k < len(values) else ABSENT


def _leaf(value: Any) -> Any:
    return {"absent": True} if value is ABSENT else value


def written(value: Any) -> str:
    """repr, or in a recording that something has damaged: that it nests deeper than Python writes."""
    try:
        return repr(value)
    except RecursionError:
        return f"a {type(value).__name__} in itself, beyond what can be shown"


def exact(value: Any) -> str:
    """repr, and for a float all of its bits."""
    if isinstance(value, float):
        return f"{value!r} ({value.hex()})"
    text = written(value)
    return text if len(text) <= 200 else f"{text[:200]}…"


def distance_ulps(a: Any, b: Any) -> int | None:
    """How many floats lie between two floats; None for anything else."""
    if not (isinstance(a, float) and isinstance(b, float)):
        return None
    return abs(_ordinal(a) - _ordinal(b))


def _ordinal(x: float) -> int:
    """Floats numbered in their order: neighbours differ by one."""
    bits: int = struct.unpack("<q", struct.pack("<d", x))[0]
    return bits if bits >= 0 else -(bits & 0x7FFF_FFFF_FFFF_FFFF)


# --- older schemas ---
# Recordings of an older schema: in what today's outputs must differ from theirs, however alike the robots behave.

NUMBERED = ("says.schema", "state.schema", "log.schema")  # fields that say the schema itself
# What each schema added to the one before. 2: `common`; proposals, which end a gossip; the signature that ends an
# entry; time and signature, which end a sample; of a state, `signed`, `sway_m`, `battery_v` and `ladder`; another entry
# is no such. 3: `missed` and `echo`; the lever that ends an entry, the bound that ends a sample, step and `against`,
# which end a proposal; of a state, `verdict`, `causes`, `moved_m`, `stretch` and `parts_m2`.
NEW = {
    2: r"says\[\d+\]\.(common|gossip\[4\]|gossip\[1\]\[\d+\]\[6\]|gossip\[2\]\[\d+\]\[[67]\])"
    r"|state\.(signed|battery_v|ladder|explain\.sway_m)",
    3: r"says\[\d+\]\.(missed|echo|gossip\[1\]\[\d+\]\[7\]|gossip\[2\]\[\d+\]\[8\]|gossip\[4\]\[\d+\]\[[56]\])"
    r"|state\.(verdict|causes|explain\.(moved_m|stretch|parts_m2))",
}
OTHERS = {3: r"state\.(prior|posterior)_sigma_m|says\[\d+\]\.cov_m2\[\d\]"}  # values: sigmas have the budget in them
IN_WORDS = {
    1: "the schema itself, signatures, times of exposure, proposals, `common`, `signed`, `sway_m`, battery, ladder, "
    "echoes, misses, levers, steps, verdicts, and sigmas",
    2: "the schema itself, echoes, misses, levers, steps, verdicts, and sigmas",
}
YOUNGER = ("state.battery_v", "state.ladder")  # said by robots only since some recordings of today's schema were made


def must_differ(schema: int, difference: Difference) -> bool:
    """Whether a difference from a recording of this schema says nothing but that the schema is an older one."""
    if schema == SCHEMA:
        return False
    if difference.plain in NUMBERED:
        return bool(difference.recorded == schema and difference.replayed == SCHEMA)
    new = NEW if difference.recorded is ABSENT else OTHERS
    return any(later > schema and re.fullmatch(fields, difference.field) for later, fields in new.items())


def note(schema: int) -> str | None:
    """What a reader of the verdict has to know; None for a recording of today's schema."""
    if schema == SCHEMA:
        return None
    return f"recorded with schema {schema}: compared but for {IN_WORDS.get(schema, 'what later ones added')}"


def only_younger(fields: Collection[str], first: Difference) -> bool:
    """Whether a recording differs in nothing but fields that it may be too old to have."""
    return first.recorded is ABSENT and set(fields) <= set(YOUNGER)
