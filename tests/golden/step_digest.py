"""What every step of every test took in and gave, as digests: the proof that a move or a merge changed no behaviour.

    python -m pytest -p tests.golden.step_digest --step-digest before.json
    python -m pytest -p tests.golden.step_digest --step-digest after.json
    python -m tests.golden.step_digest before.json after.json

The file has [digest, number of steps] by test: SHA-256 over time, inputs and outputs of each Agent.step in the test's
process. Tests are closed loops, so that a difference grows. What a fixture of a module or of the session steps has an
entry of its own: otherwise it would count for the test that happens to come first. With pytest-xdist each worker sends
its part, and the controller writes the file.

The comparison looks for each (digest, steps) of one file in all of the other, whatever the test is called there: tests
move to other files, and are renamed, merged and parametrised; the names only say where to look. It exits with 1 if one
is missing. A test that uses the wall's clock or chance differs from run to run: take `before` twice, and see which.
Tests in which several share an agent have to stay in their order, and steps in other processes are not seen.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

OPTION = "step_digest"
Digests = dict[str, tuple[str, int]]  # hexadecimal, and number of steps, by test


class Taken:
    """Of one process."""

    def __init__(self) -> None:
        self.found: Digests = {}  # of workers, at their controller
        self._open: dict[str, tuple[Any, int]] = {}
        self._at: list[str] = []  # the test, and the fixtures within it that are being set up

    def step(self, *what: bytes) -> None:
        """Take note of one step."""
        if self._at:
            digest, steps = self._open.get(self._at[-1]) or (hashlib.sha256(), 0)
            for each in what:
                digest.update(each)
            self._open[self._at[-1]] = digest, steps + 1

    @property
    def all(self) -> Digests:
        return self.found | {name: (digest.hexdigest(), steps) for name, (digest, steps) in self._open.items()}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self._at.append(item.nodeid)
        try:
            return (yield)
        finally:
            self._at.pop()

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        param = f"[{request.param_index}]" if hasattr(request, "param") else ""
        self._at.append(f"{request.node.nodeid} fixture {fixturedef.argname}{param}")
        try:
            return (yield)
        finally:
            self._at.pop()

    def pytest_sessionstart(self) -> None:
        from agent.core.codec import encode  # not before tests/conftest.py has said how many threads numpy takes
        from agent.robot.step import Agent

        step = Agent.step

        def noted(agent: Agent, inputs: Any, now_ns: int) -> Any:
            outputs = step(agent, inputs, now_ns)
            self.step(str(now_ns).encode(), as_bytes(inputs), as_bytes(outputs))
            return outputs

        def as_bytes(message: Any) -> bytes:
            try:
                return encode(message)
            except (TypeError, ValueError):  # a test's own, or what no message can hold
                return repr(message).encode()

        Agent.step = noted

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        self.found |= {name: tuple(each) for name, each in getattr(node, "workeroutput", {}).get(OPTION, {}).items()}

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if (output := getattr(session.config, "workeroutput", None)) is not None:
            output[OPTION] = self.all

    def pytest_unconfigure(self, config: pytest.Config) -> None:
        if not hasattr(config, "workeroutput"):
            Path(config.getoption(OPTION)).write_text(json.dumps(self.all, indent=0, sort_keys=True) + "\n")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--step-digest", metavar="FILE", help="write a digest of the steps of each test there")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption(OPTION):
        config.pluginmanager.register(Taken(), "taken steps")


def missing(these: Digests, those: Digests) -> list[str]:
    """Tests whose digest none of the others has."""
    known = {tuple(each) for each in those.values()}
    return [name for name, each in sorted(these.items()) if tuple(each) not in known]


def main(before: str, after: str) -> int:
    these, those = (json.loads(Path(file).read_text()) for file in (before, after))
    lost, new = missing(these, those), missing(those, these)
    for file, names in ((before, lost), (after, new)):
        for name in names:
            print(f"only in {file}: {name}")
    same = [steps for name, (_, steps) in these.items() if name not in set(lost)]
    print(f"{len(same)} of {len(these)} digests are in both, of {sum(same)} steps")
    return 1 if lost or new else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
