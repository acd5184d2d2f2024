"""Faults that were found once, as small files: `make test` replays every one of them."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec

from tests.fuzz.kernel.episode import Plan
from tests.fuzz.kernel.invariants import Broken
from tests.places import ROOT

FOLDER = ROOT / "tests" / "fuzz" / "cases"
Told = list[tuple[int, str, bytes]]


def write(plan: Plan, told: Told, fault: Broken, seed: str) -> Path:
    """Keep lies that broke something. The same plan and lies give the same file."""
    facts = {
        "part": "kernel",
        "fault": fault.name,
        "was": fault.detail,
        "seed": seed,
        "plan": msgspec.to_builtins(plan),
        "told": [[step, src, payload.hex()] for step, src, payload in told],
    }
    return _store(f"{plan.scene.named()}-{fault.name}", facts)


def write_bytes(decoder: str, payload: bytes, fault: Broken, seed: str) -> Path:
    """Keep bytes that broke a decoder."""
    facts = {"part": decoder, "fault": fault.name, "was": fault.detail, "seed": seed, "bytes": payload.hex()}
    return _store(f"{decoder}-{fault.name}", facts)


def read(path: Path) -> dict[str, Any]:
    """The facts of a case; `plan` and `told`, or `bytes`, are as they were written."""
    facts: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    if "plan" in facts:
        facts["plan"] = msgspec.convert(facts["plan"], Plan)
        facts["told"] = [(step, src, bytes.fromhex(payload)) for step, src, payload in facts["told"]]
    else:
        facts["bytes"] = bytes.fromhex(facts["bytes"])
    return facts


def _store(about: str, facts: dict[str, Any]) -> Path:
    FOLDER.mkdir(exist_ok=True)
    words = "".join(letter if letter.isalnum() else "-" for letter in about.lower())
    text = json.dumps(facts, indent=1) + "\n"
    path = FOLDER / f"{words}-{sha256(text.encode()).hexdigest()[:6]}.json"
    path.write_text(text, encoding="utf-8")
    return path
