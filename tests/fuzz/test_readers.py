"""Every reader of bytes from outside is fuzzed by somebody, and by whom it says: decoders are run and watched."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from random import Random
from types import FrameType

import pytest

from tests.fuzz import parts
from tests.fuzz.decoders import decoders
from tests.fuzz.decoding import mute
from tests.fuzz.readers import FUZZED, SAFE, readers, readers_in, safe

DECODERS = {each.name: each for each in decoders()}
LACKING = {"mavlink": "pymavlink", "pth": "torch", "pth.pickle": "torch", "safetensors": "torch"}
HANDED = {  # a handler as it is handed over -> where what arrives is read
    "agent.ground.page.server:site.answer": "agent.ground.page.server:answer",
    "agent.ground.page.server:site.socket": "agent.ground.page.server:_take",
    "agent.process.transport:self._box.asked": "agent.process.links:asked",
    "agent.process.transport:self._token": "agent.process.links:token",
    "replay.recorder:partial(arrivals.message, topic)": "replay.recorder:message",
}


def test_every_reader_is_fuzzed_or_has_a_reason() -> None:
    fuzzed = {reader for some in FUZZED.values() for reader in some}
    found = readers()
    assert {reader for reader in found if reader not in fuzzed and safe(reader) is None} == set(), "fuzz these"
    assert fuzzed <= found, "there are no such readers"
    assert {name for name in SAFE if any(reader.startswith(name) for reader in found)} == set(SAFE), (
        "nobody reads there"
    )


def test_the_list_names_every_decoder_and_what_it_reads() -> None:
    lines = list(parts.told())
    assert {line.partition(":")[0] for line in lines} == {*DECODERS, *parts.ELSEWHERE}
    assert "transforms: agent.reconstruction.sources:read_transforms" in lines


def test_who_is_said_to_fuzz_is_there() -> None:
    lacking = {name for name, package in LACKING.items() if find_spec(package) is None}
    assert set(FUZZED) <= {*DECODERS, *parts.ELSEWHERE, *lacking}


@pytest.mark.parametrize("name", sorted(set(FUZZED) & set(DECODERS)))
def test_a_decoder_enters_the_readers_that_it_is_said_to_fuzz(name: str) -> None:
    decoder, rng = DECODERS[name], Random(name)
    with entered() as seen, mute():
        for _ in range(200):
            decoder.take(decoder.sound(rng))
            if wanted(name) <= seen:
                break
    assert wanted(name) <= seen


def wanted(name: str) -> set[tuple[str, str]]:
    """Module and name of each function."""
    there = (HANDED.get(reader, reader).split(":") for reader in FUZZED[name] if "mavlink" not in reader)  # a socket
    return {(module, what.rpartition(".")[2]) for module, what in there}


@contextmanager
def entered() -> Iterator[set[tuple[str, str]]]:
    """Which functions are called meanwhile in this thread."""
    seen: set[tuple[str, str]] = set()

    def watch(frame: FrameType, event: str, arg: object) -> None:
        seen.add((frame.f_globals.get("__name__", ""), frame.f_code.co_name))

    before = sys.getprofile()
    sys.setprofile(watch)
    try:
        yield seen
    finally:
        sys.setprofile(before)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("import json\ndef f(text):\n    return json.loads(text)", {"f"}),
        ("from json import loads as read\nclass A:\n    def f(self, t):\n        read(t)", {"A.f"}),
        ("import numpy as np\nx = np.load('a')", {""}),
        ("def f(session):\n    session.subscribe('k', self._heard)", {"self._heard"}),
        ("def f(self):\n    self._session.answer('k', self._asked)", {"self._asked"}),
        ("HEAD = Struct('<I')\ndef f(data):\n    return HEAD.unpack(data)", {"f"}),
        ("from agent.core.config import read_toml\ndef f(path):\n    read_toml(path)", {"f"}),
        ("def f(box):\n    return box.answer(3)", set()),
    ],
)
def test_a_new_reader_is_noticed(text: str, found: set[str]) -> None:
    assert readers_in(text, "new") == {f"new:{name}" for name in found}
