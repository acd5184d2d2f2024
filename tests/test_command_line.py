"""What users type wrong: one line on stderr, exit 2, no traceback; and that a crew's processes do not outlive it."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

import agent
from agent.__main__ import app, main
from agent.process.command import Failed, temporary_folder
from agent.process.launch import Child, Crew, crew, free_ports, wait_for
from tests.places import GOLDEN
from tests.waiting import until

TANK = str(Path(agent.__file__).parent / "fleets" / "tank.toml")
MISTAKES = [
    (["agent", "nowhere.toml", "--robot", "r1"], "no such file"),
    (["agent", TANK, "--robot", "r9"], "the file has r1, r2"),
    (["agent", TANK, "--robot", "r1"], "r1.toml: no such file; make it with: aucamp calibrate run"),
    (["demo", "--robots", "9"], "choose 1 to 5"),
    (["demo", "--robots", "0"], "choose 1 to 5"),
    (
        ["demo", "--protocol", "gossip"],
        "'gossip' is not one of 'paper', 'metropolis', 'evidence'; see aucamp demo --help",
    ),
    (["demo", "--robots", "few"], "'--robots': 'few' is not a valid int"),
    (["demo", "--loss", "1.5"], "'--loss': 1.5 is not in the range 0.0<=x<=0.99"),
    (["demo", "--out"], "Option '--out' requires an argument"),
    (["demo", "--robot", "3"], "No such option: --robot"),
    (["dive"], "No such command 'dive'; see aucamp --help"),
    (["agent", "--robot", "r1"], "Missing argument 'FLEET'"),
    (["experiment", "detections"], "'detections' is not one of 'demo', 'localization', 'liar', 'doubt'"),
    (["experiment", "peak-shift", "--only", "sea"], "--only sea: choose from air, tap, pool, coastal, turbid"),
    (["experiment", "depth", "--set", "colour=3"], "--set colour=3: write NAME=VALUE, NAME one of repeats, views"),
    (["experiment", "tag-fix", "--set", "places=many"], "experiment tag-fix: Expected `int`, got `str`"),
    (["explain", "priorities", "runs"], "explain priorities: takes no RUN; leave it out"),
    (["replay", "explain", str(GOLDEN / "two" / "r1.mcap"), "--at", "²"], "--at ²: write an iteration"),
    (["replay", "explain", str(GOLDEN / "two"), "--track", "--at", "5"], "--track: takes no --at"),
    (["experiment", "list", "--seeds", "3"], "experiment list: takes no --seeds; leave it out"),
    (["experiment", "depth", "runs"], "experiment depth: takes no DIR; leave it out"),
    (["experiment", "docs", "nowhere"], "there is no folder docs here; run it in a checkout of the repository"),
    (
        ["calibrate", "lens"],
        "'lens' is not one of 'cameras', 'board', 'run', 'focus', 'camera', 'gamma', 'body', 'landmarks'",
    ),
    (["calibrate", "run", TANK], "say which robot with --robot"),
    (["calibrate", "focus"], "calibrate focus: say what it is measured from, the SOURCE"),
    (["calibrate", "cameras", TANK], "calibrate cameras: takes no SOURCE; leave it out"),
    (["calibrate", "focus", "table.csv", "--robot", "r1"], "calibrate focus: takes no --robot"),
    (["calibrate", "camera", "pictures", "--board", "14x9"], "--board '14x9': write inner corners both ways"),
    (["calibrate", "landmarks", "film.mp4"], "say which fleet file lists the tags"),
    (["calibrate", "body", "r1.mcap", TANK], "calibrate body: takes no FLEET"),
    (["export", "--out", "x"], "Missing argument 'kind'. Choose from: csv, mp4, webp, jsonl, rosbag"),
    (["bridge", "ros2", TANK, "--origin", "47,8"], "bridge ros2: takes no --origin"),
    (["board", "stop", TANK, "--robot", "r1"], "'stop' is not one of 'info', 'tare', 'check'"),
    (["demo", "--out", "/proc"], "not empty"),
    (["demo", "--out", "/proc/new"], "/proc/new: cannot be written"),
    (["record", "nowhere.toml", "--out", "x.mcap"], "no such file"),
    (["depth-map", "nowhere"], "nowhere: no such folder; give a folder of photographs, or a camera"),
    (["depth-map", "stack:nowhere"], "nowhere"),
    (["calibrate", "focus", "nowhere.csv"], "nowhere.csv: no such file; give a CSV file"),
    (["enhance", TANK, "--variant", "fine"], "'fine' is not one of 'plain', 'folded', 'fast', 'classic', 'auto'"),
    (["enhance", TANK, "--variant", "fst"], "did you mean 'fast'?"),
    (["order", TANK, "stopp", "--as", "ann"], "did you mean 'stop'?"),
    (["order", TANK, "hold", "r1", "depth=0.3", "--as", "ann"], "'depth'; did you mean depth_m? it takes depth_m"),
    (["order", TANK, "hold", "r1", "depth_m=nan", "--as", "ann"], "depth_m: nan is no number; write one, such as 0.3"),
    (["order", TANK, "hold", "r1", "depth_m=0,3", "--as", "ann"], "depth_m: is no number; write one, such as 0.3"),
    (["order", TANK, "set", "r1", "name=x", "value=1", "--as", "ann"], "'x' is no choice; there are sweeps, send_hz"),
    (["order", TANK, "look", "r1", "pan_deg=1", "pan_deg=2", "--as", "ann"], "pan_deg is given 2 times; write it once"),
    (["enhance", "--evaluate", "a", "b", "--out", "c"], "enhance --evaluate: takes no --out; leave it out"),
    (
        ["calibrate", "board", "--out", "board.txt"],
        "board.txt: the board is a PDF; give --out a name that ends in .pdf",
    ),
    (["demo", "--fleet", "survey", "--robots", "1"], "judged by what robots tell each other of it"),
    (["track", "nowhere", "--box", "1,2,3,4"], "nowhere: no such file or folder"),
    (["keys", TANK], "Missing option '--out'"),
    (["keys", TANK, "--out", "keys", "--only", "r9"], "has no 'r9' to make keys for; it has r1, r2"),
    (["keys", TANK, "--out", ""], "aucamp: --out: is empty; write what is meant, or leave it out"),
    (["keys", TANK, "--out="], "aucamp: --out: is empty; write what is meant, or leave it out"),
    (["keys", "", "--out", "keys"], "aucamp: an argument: is empty; write what is meant, or leave it out"),
    (
        ["snapshot", TANK, "--robot", "r1", "--out", "p.png"],
        "--out p.png: a robot shows JPEGs; give it a name that ends",
    ),
    (["keys", TANK, "--out", "strange.toml"], "strange.toml: cannot be made (File exists); give --out another folder"),
    (["board", "reboot", "nowhere.toml", "--robot", "r1"], "no such file"),
    (["board", "reboot", TANK, "--robot", "r9"], "the file has r1, r2"),
    (["calibrate", "run", TANK, "--robot", "r9"], "the file has r1, r2"),
    (["replay", "report", "nowhere"], "nowhere: cannot be read"),
    (["twin", "nowhere.toml"], "no such file"),
    (["bridge", "mavlink", "nowhere.toml"], "no such file"),
    (["bridge", "mavlink", TANK, "--origin", "91,0"], "--origin '91,0': write latitude and longitude in degrees"),
    (["bridge", "mavlink", TANK, "--origin", "here"], "--origin 'here': write latitude and longitude in degrees"),
    (["agent", "strange.toml", "--robot", "r1"], "camera 'rtsp://pool': no such kind of camera"),
]


@pytest.mark.parametrize(
    ("arguments", "expected"), MISTAKES, ids=lambda v: " ".join(v)[:40] if isinstance(v, list) else ""
)
def test_a_mistake_is_one_line(
    arguments: list[str], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture
) -> None:
    (tmp_path / "strange.toml").write_text(
        Path(TANK).read_text().replace('camera = "twin:r1"', 'camera = "rtsp://pool"')
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["aucamp", *arguments])
    with signals_as_they_were(), pytest.raises(SystemExit) as end:
        main()
    said = capfd.readouterr()
    assert end.value.code == 2, said.err
    assert expected in said.err
    assert said.err.count("\n") == 1, said.err
    assert said.out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["strange.toml"], "nothing is left behind"


def test_a_mistake_is_one_line_of_a_process() -> None:
    command = [sys.executable, "-m", "agent", "agent", TANK, "--robot", "r9"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr.count("\n"), done.stdout) == (2, 1, "")


@contextmanager
def signals_as_they_were() -> Iterator[None]:
    """A command answers to signals in its own way, and the tests after it shall not."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(
    ("verb", "choices"),
    [
        ("demo", "paper|metropolis|evidence"),
        ("enhance", "plain|folded|fast|classic|auto"),
        ("experiment", "manoeuvres"),
        ("bridge", "mavlink|ros2|keelson"),
    ],
)
def test_help_lists_what_may_be_given(verb: str, choices: str) -> None:
    shown = CliRunner(env={"COLUMNS": "160"}).invoke(app, [verb, "--help"])
    assert choices in shown.output


def test_help_alone_where_a_verb_is_missing() -> None:
    for verb in ("replay", "experiment"):
        done = subprocess.run([sys.executable, "-m", "agent", verb], capture_output=True, text=True, timeout=60)
        assert done.returncode == 2 and done.stderr == "" and done.stdout.count(f"Usage: aucamp {verb}") == 1


def commands(command: Any, name: str = "aucamp") -> Iterator[tuple[str, Any]]:
    """A command and all below it, each with the words that call it."""
    yield name, command
    for word, sub in getattr(command, "commands", {}).items():
        yield from commands(sub, f"{name} {word}")


VERBS = {name: verb for name, verb in commands(get_command(app)) if not hasattr(verb, "commands")}


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_has_help_with_an_example(name: str) -> None:
    assert VERBS[name].help
    assert VERBS[name].epilog and VERBS[name].epilog.startswith(f"Example: {name} ")


def test_the_command_line_stays_small() -> None:
    """A new option takes the place of one that nobody needs. A verb of several kinds counts once, --help not at all."""
    options = [
        f"{name} {option.opts[0]}"
        for name, command in commands(get_command(app))
        for option in command.params
        if option.param_type_name == "option" and option.opts != ["--help"]
    ]
    assert len(VERBS) <= 35, VERBS.keys()
    assert len(options) <= 120, options


def test_a_crew_ends_with_its_block_and_names_who_failed(tmp_path: Path) -> None:
    with pytest.raises(Failed, match=r"bad .*no such file"), crew(tmp_path) as processes:
        processes.start("bad", "twin", "nowhere.toml")
        processes.start("other", "record", TANK, "--out", str(tmp_path / "x.mcap"))
        pid = processes._children[1].process.pid
        wait_for("never", lambda: False, processes, 20.0)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_that_nobody_reads_on_is_no_answer() -> None:
    """`replay check` ends by 1 where steps are not the same, and `replay info` by 2 where a file is none."""
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "agent", "replay", "info", str(GOLDEN / "seen" / "r1.mcap")]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, timeout=60)
    os.close(writer)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, b"")


def test_a_process_that_ignores_sigterm_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.process.launch.STOP_S", 0.3)
    program = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); time.sleep(60)"
    deaf = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert deaf.stdout.readline() == b"\n", "it is deaf from here on"
    processes = Crew(tmp_path)
    processes._children.append(Child("deaf", deaf, tmp_path / "log"))
    processes.stop_all()
    deaf.stdout.close()
    assert deaf.returncode == -signal.SIGKILL


def test_free_ports_are_free_and_below_the_ephemeral_range() -> None:
    import socket

    first = free_ports(1)[0]
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # an earlier test's connections may linger
        taken.bind(("127.0.0.1", first))
        taken.listen()
        ports = free_ports(3, first)
    assert first not in ports
    assert len(set(ports)) == 3
    assert max(ports) <= 32767


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.fixture
def heeds_ctrl_c() -> Iterator[None]:
    """A shell that runs tests in the background ignores SIGINT for them, and so for processes that they start."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for children in /proc, which is Linux")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_ends_a_command_and_the_processes_that_it_started(
    number: int, code: int, tmp_path: Path, heeds_ctrl_c: None
) -> None:
    command = [sys.executable, "-m", "agent", "calibrate", "run", TANK, "--robot", "r1", "--out", "r1.toml"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as calibration:
        deadline_s = time.monotonic() + 60.0
        while not (benches := children(calibration.pid)):
            assert time.monotonic() < deadline_s and calibration.poll() is None
            time.sleep(0.05)
        calibration.send_signal(number)
        assert calibration.wait(60) == code
        assert b"Traceback" not in calibration.stderr.read()
    # One that was only just being started was nobody's child yet: its parent watch ends it.
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in benches))
    assert not any(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for children in /proc, which is Linux")
def test_processes_end_with_a_command_that_is_killed() -> None:
    """The command cannot do anything about it any more; nor can one that has to be killed because it is slow to end."""
    command = [sys.executable, "-m", "agent", "calibrate", "run", TANK, "--robot", "r1", "--out", "r1.toml"]
    with temporary_folder() as folder:  # a short path: there are sockets in it
        with subprocess.Popen(command, cwd=folder, env={**os.environ, "TMPDIR": str(folder)}) as calibration:
            ready = until(lambda: list(folder.glob("*/ready")))
            (bench,) = children(calibration.pid)
            calibration.kill()
        until(lambda: not Path(f"/proc/{bench}").exists())
        assert not ready[0].exists(), "it ended in order, and took its files away"


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for children in /proc, which is Linux")
def test_one_that_hangs_when_its_parent_is_gone_ends_too(tmp_path: Path) -> None:
    child = "import signal, time, agent.process.launch as w; w.GRACE_S = 0.2\n"
    child += "signal.signal(15, lambda *_: print(15)); w.exit_with_parent()\n"
    child += "while True: time.sleep(60)"
    parent = (
        "import subprocess, sys, time, agent.process.launch as w; watch = w.watched_by_us()\n"
        f"subprocess.Popen([sys.executable, '-c', {child!r}], pass_fds=(watch.given,), env=watch.environment())\n"
        "time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", parent]) as started:
        (pid,) = until(lambda: children(started.pid))
        started.kill()
    until(lambda: not Path(f"/proc/{pid}").exists())


def test_who_does_not_end_well_is_told_with_its_last_words(tmp_path: Path) -> None:
    def ended() -> bool:
        try:
            processes.check()
        except Failed:
            return True
        return False

    with crew(tmp_path) as processes:
        processes.start("recorder", "replay", "info", str(tmp_path / "none.mcap"))
        until(ended)
        (line,) = processes.stop("recorder")
        assert line.startswith("recorder did not end well (exit 2): aucamp: ")
        assert "cannot be read" in line
        processes.start("good", "--help")
        until(ended)
        assert processes.stop("good") == []
