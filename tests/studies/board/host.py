"""The host's side of the tether, in the words of the measured firmware's own wire.py."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

from hw.firmware import emitters_unix

# What a set-point asks for: everything at once, so that no part of the firmware has an easy time.
BUSY = {
    "depth_100um": 3000,
    "roll_cdeg": 500,
    "pitch_cdeg": 300,
    "fx_mN": 900,
    "fy_mN": 700,
    "mz_100uNm": 1000,
    "servo_us": 1500,
    "light_permille": 100,
    "valid": 31,
    "ttl_ms": 500,
    "host_time": 0xF1234567,
    "host_ms": 0xF1234567,
}
NEUTRAL = BUSY | {"roll_cdeg": 0, "pitch_cdeg": 0, "fx_mN": 0, "fy_mN": 0, "mz_100uNm": 0, "light_permille": 0}

Fields = dict[str, Any]


class Host:
    """Frames to the board, and what is in those that come back."""

    def __init__(self, folder: Path) -> None:
        """folder: the firmware's, whose wire.py is imported as the board's modules import theirs."""
        self._wire: Any = _import_wire(folder)
        self._writer = self._wire.Writer()
        self._names = {row[1]: _names(row[3]) for row in self._wire.TABLE}
        self._kinds = {row[0]: row[1] for row in self._wire.TABLE}

    def hello(self) -> bytes:
        wire = self._wire
        return self._frame("HELLO", {"protocol": wire.PROTOCOL, "schema_crc": wire.schema_crc(), "host_boot": 1})

    def set_point(self, fields: Fields) -> bytes:
        return self._frame("SETPOINT", fields)

    def arm(self, boot_id: int) -> bytes:
        return self._frame("ARM", {"req_id": 1, "boot_id": boot_id})

    def _frame(self, name: str, fields: Fields) -> bytes:
        values = [fields.get(field, 0) for field in self._names[name]]
        return bytes(self._writer.frame(getattr(self._wire, name), *values))

    def read(self, data: bytes) -> list[tuple[str, Fields]]:
        """The whole frames in what the board has sent: message name and fields by name."""
        found: list[tuple[str, Fields]] = []

        def on_frame(kind: int, _seq: int, payload: memoryview) -> None:
            name = self._kinds[kind]
            names = self._names[name] + ["text"] if name == "LOG" else self._names[name]
            found.append((name, dict(zip(_distinct(names), self._wire.unpack(kind, payload), strict=True))))

        self._wire.Framer(on_frame).feed(data, len(data))
        return found

    def complaints(self, sent: bytes) -> list[str]:
        """What the board has said against arming, and its lines of text."""
        lines = []
        for name, fields in self.read(sent):
            if name == "LOG":
                text = bytes(fields["text"]).decode(errors="replace")
                lines += [] if "Done" in text else [text]  # that is how a run of ours ends
            elif name == "EVENT" and fields["code"] == self._wire.EV_ARM_REFUSED:
                lines += [text for i, text in enumerate(self._wire.ARM_CHECKS) if fields["arg"] >> i & 1]
        return list(dict.fromkeys(lines))


def _import_wire(folder: Path) -> Any:
    """This folder's, whatever others of these names have been imported; and none of them stays."""
    ours = {path.stem for path in folder.glob("*.py")} & sys.modules.keys()
    others = {name: sys.modules.pop(name) for name in ours}
    before = set(sys.modules)
    emitters_unix.take_place()
    sys.path.insert(0, str(folder))
    try:
        return importlib.import_module("wire")
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:
            del sys.modules[name]
        sys.modules.update(others)


def _names(text: str) -> list[str]:
    """Field names; `servo_us_x4` stands for four."""
    names = []
    for token in text.split():
        stem, _, count = token.rpartition("_x")
        names += [stem] * int(count) if stem and count.isdigit() else [token]
    return names


def _distinct(names: list[str]) -> list[str]:
    return [f"{name}_{names[:i].count(name) + 1}" if names.count(name) > 1 else name for i, name in enumerate(names)]
