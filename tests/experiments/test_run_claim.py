"""Seeds on processes and on a cluster: the same bytes, also of a run that was killed again and again."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.experiments.run_claim import FINISHED, ROWS, read_finished, run_plan, work
from tests.experiments import dice
from tests.places import ROOT
from tests.waiting import until

distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

PURE = (ROWS, "result.json")
KILLS = 2


def content(folder: Path) -> list[bytes]:
    return [(folder / name).read_bytes() for name in PURE]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    folder = tmp_path_factory.mktemp("whole") / "run"
    dice.throw(folder)
    return content(folder)


def run_on(plan, folder: Path, **changes):
    return run_plan(plan, folder, changes.get("jobs", 1), changes.get("scheduler"), lambda *_: None, dice.CLAIM)


@pytest.mark.slow
def test_a_run_that_is_killed_and_goes_on_writes_the_same_bytes(tmp_path: Path, undisturbed: list[bytes]) -> None:
    folder, chance = tmp_path / "run", random.Random(3)
    command = [sys.executable, "-m", "tests.experiments.dice", str(folder), "0.15"]
    counts = []
    for _ in range(KILLS):
        one = subprocess.Popen(command, cwd=ROOT)
        kill_after(one, folder, (counts[-1] if counts else 0) + chance.randrange(6))
        counts.append(lines(folder))
    assert counts == sorted(counts) and 0 < counts[0] < counts[-1] < 80
    with (folder / FINISHED).open("a") as file:
        file.write('{"case": "one", "se')  # as a kill in the middle of a line leaves it
    assert subprocess.run(command, cwd=ROOT, check=False).returncode == 0
    rows, result = content(folder)
    assert rows == undisturbed[0]
    assert json.loads(result)["figures"] == json.loads(undisturbed[1])["figures"]
    until(lambda: not workers(folder))


def kill_after(one: subprocess.Popen, folder: Path, count: int) -> None:
    """At a random moment of the work: so many lines are there, or the next one is being written."""
    until(lambda: lines(folder) > count or one.poll() is not None, 60.0)
    one.send_signal(signal.SIGKILL)
    assert one.wait() == -signal.SIGKILL, "it came to its end before it was killed"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_at_once_and_keeps_what_has_finished(tmp_path: Path, number: signal.Signals) -> None:
    """Sent to all its processes, as a terminal does, and again before it has ended."""
    command = [sys.executable, "-m", "tests.experiments.dice", str(tmp_path), "1"]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True) as one:
        until(lambda: lines(tmp_path) >= 2, 60.0)
        send = os.killpg if number == signal.SIGINT else os.kill
        for _ in range(2):
            send(one.pid, number)
            time.sleep(0.05)
        said = one.communicate(timeout=10.0)[1]
    assert one.returncode == -number and "SpawnProcess" not in said and said.count("Traceback") <= 1
    assert 2 <= lines(tmp_path) == len(read_finished(tmp_path / FINISHED)) < 20
    until(lambda: not living(one.pid))
    assert run_on(dice.plan(seeds=1, seconds=1.0), tmp_path, jobs=2).kept == 2


def lines(folder: Path) -> int:
    path = folder / FINISHED
    return path.read_bytes().count(b"\n") if path.exists() else 0


def workers(folder: Path) -> list[str]:
    """Processes that still write or work for this folder."""
    return named("-f", str(folder))


def living(group: int) -> list[str]:
    """Of a group of processes those that have not ended, whether anybody has taken note of the others or not."""
    return named("-g", str(group), "-r", "D,R,S,T")


def named(*how: str) -> list[str]:
    return subprocess.run(["pgrep", *how], capture_output=True, text=True, check=False).stdout.split()


@pytest.mark.slow
def test_a_cluster_of_two_workers_and_processes_write_the_same_bytes(tmp_path: Path, undisturbed: list[bytes]) -> None:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as cluster:
        dice.throw(tmp_path / "run", scheduler=cluster.scheduler_address)
    assert content(tmp_path / "run") == undisturbed


def test_more_seeds_join_a_run_and_what_is_there_is_not_run_again(tmp_path: Path) -> None:
    assert run_on(dice.plan(seeds=3), tmp_path).kept == 0
    found = run_on(dice.plan(seeds=5), tmp_path)
    assert found.kept == 6 and sorted(found.rows["one"]) == [0, 1, 2, 3, 4]
    assert len(read_finished(tmp_path / FINISHED)) == 10


def test_seeds_of_a_folder_count_whichever_are_asked_for(tmp_path: Path) -> None:
    run_on(dice.plan(seeds=3), tmp_path)
    written = (tmp_path / ROWS).read_bytes()
    with pytest.raises(
        ConfigError, match=r"some between are missing; ask for all by --seed 0 --seeds 9, or give --out"
    ):
        run_on(dice.plan()._replace(seeds=range(7, 9)), tmp_path)
    assert (tmp_path / ROWS).read_bytes() == written
    found = run_on(dice.plan()._replace(seeds=range(3, 5)), tmp_path)
    assert (found.seeds, found.kept, sorted(found.rows["one"])) == (range(5), 6, [0, 1, 2, 3, 4])
    assert run_on(dice.plan(seeds=1), tmp_path).seeds == range(5)


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    run_on(dice.plan(seeds=1), tmp_path / "run")
    with pytest.raises(ConfigError, match="holds seeds of another state of the code; give --out a new folder"):
        run_on(dice.plan(seeds=1, code="y"), tmp_path / "run")
    with pytest.raises(ConfigError, match="holds seeds of another settings"):
        run_on(dice.plan(seeds=1, seconds=0.1), tmp_path / "run")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    with pytest.raises(ConfigError, match="not empty, and nothing is overwritten"):
        run_on(dice.plan(seeds=1), tmp_path / "full")
    (tmp_path / "run" / FINISHED).write_text('{"eyes": 3}\n')
    with pytest.raises(ConfigError, match="holds a line that no run wrote"):
        run_on(dice.plan(seeds=1), tmp_path / "run")


def test_two_runs_do_not_write_into_one_folder(tmp_path: Path) -> None:
    run_on(dice.plan(seeds=1), tmp_path)
    with (tmp_path / FINISHED).open("a") as file:
        from agent.experiments.run_claim import lock

        lock(file, tmp_path)
        with pytest.raises(ConfigError, match="another run writes there"):
            run_on(dice.plan(seeds=2), tmp_path)


def test_a_scheduler_that_is_not_there_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.experiments.run_claim.TIMED_OUT_S", 0.5)
    with pytest.raises(ConfigError, match=r"--scheduler tcp://127\.0\.0\.1:9: no scheduler answers there"):
        run_on(dice.plan(seeds=1), tmp_path, scheduler="tcp://127.0.0.1:9")


def test_a_claim_that_times_the_machine_runs_alone(tmp_path: Path) -> None:
    alone = dice.CLAIM._replace(alone=True)
    with pytest.raises(ConfigError, match="runs alone, for it times the machine"):
        run_plan(dice.plan(seeds=1), tmp_path, 2, None, lambda *_: None, alone)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.int64(3), np.zeros(2)])
def test_rows_that_are_no_plain_json_are_one_line(monkeypatch: pytest.MonkeyPatch, value: object) -> None:
    claim = dice.CLAIM._replace(run=lambda seed, case, settings: [{"eyes": value}])
    monkeypatch.setattr("agent.experiments.run_claim.load", lambda module: claim)
    with pytest.raises(ConfigError, match=r"^a\.module: one, seed 4: rows are plain JSON, and this is none: ") as error:
        work("a.module", {}, "one", 4)
    assert "\n" not in str(error.value)
