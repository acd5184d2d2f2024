"""Who is not heard is said once, and again when it changes."""

import pytest

import replay.recorder
from agent.core.config import Fleet, Pose, Robot, Target
from replay.recorder import RollCall


def fleet(robots: int = 3) -> Fleet:
    pose = Pose(x_m=0.0, y_m=0.0, yaw_deg=0.0)
    return Fleet(
        fleet="test",
        target={"ball": Target(radius_m=0.07)},
        robot={
            f"r{k}": Robot(listen=f"tcp/10.0.0.{k}:17401", serial="s", camera="c", pose=pose, calibration="x")
            for k in range(1, robots + 1)
        },
    )


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay.recorder, "SILENCE_S", 0.0)


def told(*heard: str, robots: int = 3, end: bool = False) -> list[str]:
    """What a person is told where these come one after the other."""
    said: list[str] = []
    roll = RollCall(fleet(robots), said.append)
    for count in range(len(heard) + 1):
        for _ in range(3):
            roll.look(heard[:count])
    if end:
        roll.end()
    return said


def test_nobody_is_heard() -> None:
    (line,) = told()
    assert line.startswith(
        "nobody of fleet 'test' is heard yet: r1 at tcp/10.0.0.1:17401, r2 at tcp/10.0.0.2:17401, r3"
    )
    assert line.endswith("start the agents, or give the fleet file that they were started with")


def test_one_comes_after_the_other() -> None:
    assert told("r2", "stranger", "r1", "r3", end=True)[1:] == [
        "r2 is heard now; still not heard: r1 at tcp/10.0.0.1:17401, r3 at tcp/10.0.0.3:17401",
        "stranger is of this fleet, and its file lacks it; give the fleet file that the agents were started with",
        "r1 is heard now; still not heard: r3 at tcp/10.0.0.3:17401",
        "r3 is heard now; that is all",
    ]


def test_one_is_missing_to_the_end() -> None:
    said: list[str] = []
    roll = RollCall(fleet(), said.append)
    for _ in range(3):
        roll.look({"r1", "r2"})
    roll.end()
    assert said == [
        "not heard yet: r3 at tcp/10.0.0.3:17401; start it with aucamp agent, or correct its address in the fleet file",
        "never heard: r3 at tcp/10.0.0.3:17401",
    ]


def test_all_are_heard_and_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    roll = RollCall(fleet(), said.append)
    roll.look({"r1", "r2", "r3"})
    roll.end()
    monkeypatch.setattr(replay.recorder, "SILENCE_S", 3600.0)
    early = RollCall(fleet(), said.append)
    early.look(())
    early.end()
    assert said == []


def test_many_are_counted() -> None:
    (line,) = told(robots=64)
    assert "r5 at tcp/10.0.0.5:17401, 59 more; start" in line and "r6" not in line


def test_whom_the_file_lacks_is_said_once_however_many_there_are() -> None:
    said: list[str] = []
    roll = RollCall(fleet(1), said.append)
    for count in range(9):
        roll.look({"r1"}, {f"r{k}" for k in range(2, 2 + count)})
    assert [line.partition(" ")[0] for line in said] == ["r2", "r3", "r4", "r5", "r6"]
