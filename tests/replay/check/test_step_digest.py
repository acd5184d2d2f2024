"""The digest of every step of every test: the same however tests run, and another one where a constant is."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.golden.step_digest import main
from tests.places import ROOT

TEST = """
import pytest
from agent.robot import targets
from tests.robot.ordering import Ordering

@pytest.fixture(scope="module")
def robot():
    robot = Ordering()
    robot.run(1.0)
    return robot

@pytest.mark.parametrize("seconds", [1.0, 2.0])
def test_runs(seconds):
    Ordering().run(seconds)

def test_is_shared(robot):
    robot.run(0.5)

def test_steps_nothing():
    targets.STATE_NS = {state_ns}
"""
NODES = ["fixture robot", "test_is_shared", "test_runs[1.0]", "test_runs[2.0]"]


def digests(folder: Path, name: str, state_ns: int = 200_000_000, workers: int = 0) -> Path:
    """Of two files of tests: the second one's robots show their states after the first one has set how often."""
    tests = [folder / f"test_{k}_{name}.py" for k in (1, 2)]
    tests[0].write_text(TEST.format(state_ns=state_ns))
    tests[1].write_text(TEST.format(state_ns=state_ns).replace("test_runs", "test_dives"))
    found = folder / f"{name}.json"
    command = [sys.executable, "-m", "pytest", "-p", "tests.golden.step_digest", "--step-digest", str(found)]
    command += ["-p", "no:cacheprovider", "-n", str(workers), "-c", str(ROOT / "pyproject.toml")]
    command += ["--rootdir", str(folder), *map(str, tests)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return found


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return digests(tmp_path_factory.mktemp("alone"), "alone")


def test_they_are_the_same_with_workers_and_without(
    alone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    side_by_side = digests(tmp_path, "workers", workers=2)
    found = json.loads(alone.read_text())
    first = {name.partition("test_1_alone.py")[2].strip(" :"): each for name, each in found.items() if "_1_" in name}
    assert sorted(first) == NODES, "steps of a module's fixture have an entry of their own"
    assert [first[name][1] for name in NODES] == [20, 10, 20, 40]
    assert main(str(alone), str(side_by_side)) == 0, "in files of other names"
    assert capsys.readouterr().out == "8 of 8 digests are in both, of 180 steps\n"


def test_another_constant_is_another_digest(alone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    after = digests(tmp_path, "after", state_ns=250_000_000)
    assert main(str(alone), str(after)) == 1
    said = capsys.readouterr().out
    assert f"only in {after}: test_2_after.py::test_dives[1.0]" in said
    assert "test_1_after.py::test_runs[1.0]" not in said
