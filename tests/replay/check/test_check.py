"""Replay says identical only of what is, and of the rest where and why not."""

import json
import math
import os
import shutil
import struct
from pathlib import Path

import msgpack
import pytest

from agent.core.config import ConfigError
from replay.check.check import check, text, update_recordings
from replay.check.compare import Difference, differences, distance_ulps
from replay.check.reexecute import CPU_CLASS
from replay.files.log import Record, info, read
from replay.files.mcap_file import environment
from tests.places import GOLDEN
from tests.replay.rewritten import rewritten

R1 = GOLDEN / "three" / "r1.mcap"
X = ("state", "posterior_m", 0)


def up(x: float, ulps: int) -> float:
    """A positive float so many floats on."""
    (bits,) = struct.unpack("<q", struct.pack("<d", x))
    return struct.unpack("<d", struct.pack("<q", bits + ulps))[0]


def nudged(step: int, path: tuple = X, ulps: int = 1):
    """A change of one number in the outputs of one step."""

    def change(record: Record) -> bytes:
        if record.channel != "/raw/step_out" or record.sequence < step:
            return record.data
        outputs = msgpack.unpackb(record.data)
        part = outputs
        for key in path[:-1]:
            part = part[key]
            if part is None:
                return record.data
        part[path[-1]] = up(part[path[-1]], ulps)
        return msgpack.packb(outputs)

    return change


def here() -> dict[str, str]:
    """What makes a recording one of this machine's class: its floats are to be the same to the bit."""
    return {name: value for name, value in environment().items() if name in CPU_CLASS}


def only(step: int, change):
    return lambda record: change(record) if record.sequence == step else record.data


def stated(since: int) -> int:
    """The first step from `since` on in which the golden robot shows a posterior."""
    from replay.check.reexecute import open_box

    for step in open_box(R1).steps():
        state = msgpack.unpackb(step.outputs)["state"]
        if step.number >= since and state and state["posterior_m"]:
            return step.number
    raise AssertionError


def test_a_whole_run_in_one_go() -> None:
    checked = check([GOLDEN / "three"])
    assert checked.exit_code == 0
    shown = checked.as_json()
    assert shown["identical"] is True
    assert shown["steps"] == 3 * 320
    assert shown["first_divergence"] is None
    assert shown["speed_x_realtime"] > 0
    assert [each["robot"] for each in shown["recordings"]] == ["r1", "r2", "r3"]
    assert "identical: 960 steps" in text(checked)
    json.dumps(shown, allow_nan=False)


def test_robots_side_by_side_are_found_the_same_as_in_turn(tmp_path: Path, monkeypatch) -> None:
    step = stated(100)
    rewritten(R1, tmp_path / "r1.mcap", nudged(step), run=here())
    shutil.copy(GOLDEN / "three" / "r2.mcap", tmp_path)
    in_turn = check([tmp_path])
    monkeypatch.setattr("replay.check.check.WORTH_STEPS", 0)
    side_by_side = check([tmp_path])
    assert side_by_side.first.step == in_turn.first.step == step
    assert text(side_by_side).splitlines()[:-1] == text(in_turn).splitlines()[:-1]  # the last one tells how fast it was
    assert side_by_side.links == in_turn.links and side_by_side.exit_code == 1


def test_what_was_heard_was_said() -> None:
    (found,) = check([GOLDEN / "three"]).links.values()
    assert len(found) == 6
    # The last words of a run find nobody who still steps.
    assert all(link.unknown == 0 and 0 <= link.said - link.heard <= 1 for link in found)


def test_a_forged_message_is_seen_although_the_replay_is_identical(tmp_path: Path) -> None:
    shutil.copytree(GOLDEN / "three", tmp_path / "run")
    (tmp_path / "run" / "r1.mcap").unlink()

    def forge(record: Record) -> bytes:
        fields = msgpack.unpackb(record.data)
        if record.channel == "/raw/step_out":
            for estimate in fields["says"]:
                estimate["x_m"] = [0.1, 0.1, 0.1]
        return msgpack.packb(fields)

    rewritten(R1, tmp_path / "run" / "r1.mcap", lambda r: forge(r) if r.sequence == 200 else r.data)
    checked = check([tmp_path / "run"])
    (found,) = checked.links.values()
    assert {(link.src, link.dst): link.unknown for link in found if link.unknown} == {("r1", "r2"): 1, ("r1", "r3"): 1}
    assert "forged" in text(checked)


def test_the_first_divergence_has_its_step_field_bits_and_inputs(tmp_path: Path) -> None:
    step = stated(100)
    file = rewritten(R1, tmp_path / "r1.mcap", nudged(step, ulps=3), run=here())
    checked = check([file])
    assert checked.exit_code == 1
    first = checked.first
    assert (first.robot, first.step, first.difference.field) == ("r1", step, "state.posterior_m[0]")
    shown = text(checked)
    assert "3 ULP apart" in shown
    assert first.difference.recorded.hex() in shown
    assert "telemetry, 0.0 ms old" in shown
    count = checked.results[0].fields["state.posterior_m"]
    assert count.first == step
    assert 0 < count.absolute < 1e-15
    assert checked.as_json()["first_divergence"]["step"] == step


def test_one_ulp_in_one_step_is_enough(tmp_path: Path) -> None:
    step = stated(100)
    checked = check([rewritten(R1, tmp_path / "r1.mcap", only(step, nudged(step)), run=here())])
    assert checked.exit_code == 1
    assert checked.results[0].fields["state.posterior_m"].steps == 1


def test_another_class_of_cpu_gets_a_tolerance_and_says_so(tmp_path: Path) -> None:
    step = stated(100)
    other = {"cpu.features": "none"}
    checked = check([rewritten(R1, tmp_path / "near.mcap", nudged(step), run=other)])
    assert checked.results[0].verdict == "within tolerance"
    assert checked.exit_code == 0
    assert checked.as_json()["identical"] is False
    assert "another class of CPU: floats may differ by 1e-09" in text(checked)
    checked = check([rewritten(R1, tmp_path / "far.mcap", nudged(step, ulps=10**7), run=other)])
    assert checked.exit_code == 1  # 1e7 ULP of 0.76 are 1.1e-9


def test_versions_that_differ_are_named(tmp_path: Path) -> None:
    checked = check([rewritten(R1, tmp_path / "r1.mcap", run={"version.numpy": "1.0"})])
    assert checked.exit_code == 0
    assert f"version.numpy 1.0 -> {environment()['version.numpy']}" in text(checked)


def test_rows_of_the_ignore_list_cover_a_field_and_all_below_it(tmp_path: Path) -> None:
    step = stated(100)
    file = rewritten(R1, tmp_path / "r1.mcap", nudged(step))
    rows = tmp_path / "ignore.toml"
    rows.write_text(
        '[[ignore]]\nfield = "state.posterior_m"\nreason = "a test"\nsince = "2026-01-01"\n'
        '[[ignore]]\nfield = "state.post"\nreason = "covers nothing"\nsince = "2026-01-01"\n'
    )
    checked = check([file], rows)
    assert checked.exit_code == 0
    assert checked.results[0].ignored["state.posterior_m"] > 1
    assert checked.unused == ("state.post",)
    rows.write_text('[[ignore]]\nfield = "state"\n')
    with pytest.raises(ConfigError, match="reason"):
        check([file], rows)


def test_steps_that_were_dropped_end_the_check_where_they_are_missing(tmp_path: Path) -> None:
    def change(record: Record) -> bytes | None:
        return None if record.sequence in (150, 151) else record.data

    checked = check([rewritten(R1, tmp_path / "r1.mcap", change)])
    assert checked.exit_code == 0
    assert checked.results[0].steps == 150
    assert "steps are missing after step 149: 168 later ones cannot be checked" in text(checked)


def test_missing_outputs_are_counted_and_the_rest_is_checked(tmp_path: Path) -> None:
    def change(record: Record) -> bytes | None:
        return None if record.channel == "/raw/step_out" and record.sequence == 150 else record.data

    checked = check([rewritten(R1, tmp_path / "r1.mcap", change)])
    assert checked.exit_code == 0
    assert checked.results[0].steps == 319
    assert "the outputs of step 150 are not in the file" in text(checked)


def test_a_file_cut_anywhere_is_checked_up_to_the_cut(tmp_path: Path) -> None:
    whole = R1.read_bytes()
    for k, share in enumerate((0.6, 0.75, 0.97)):
        file = tmp_path / f"cut{k}" / "r1.mcap.active"
        file.parent.mkdir()
        file.write_bytes(whole[: round(share * len(whole))])
        checked = check([file.parent])
        assert checked.exit_code == 0
        assert checked.results[0].steps > 0
        assert "not finished by its writer" in text(checked)


def test_a_file_without_a_step_cannot_be_checked(tmp_path: Path) -> None:
    checked = check([rewritten(R1, tmp_path / "r1.mcap", lambda record: None)])
    assert checked.exit_code == 2
    assert "cannot be checked" in text(checked)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"run": {"schema": "99"}}, "message schema 99, ours is"),
        ({"run": {"kind": "fleet"}}, "recording of a fleet, which holds no inputs|is not the black box"),
        ({"run": {"part": "2"}}, "build on those before"),
        ({"without": ("incarnation",)}, "has no incarnation"),
        ({"without": ("calibration.toml",)}, r"has no calibration\.toml"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_one_line(tmp_path: Path, changes: dict, match: str) -> None:
    file = rewritten(R1, tmp_path / "r1.mcap", **changes)
    with pytest.raises(ConfigError, match=match) as caught:
        check([file])
    assert "\n" not in str(caught.value)


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has no recording"):
        check([tmp_path])


def test_a_kernel_that_raises_is_a_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from agent.robot.step import Agent

    monkeypatch.setattr(Agent, "step", lambda self, inputs, now_ns: 1 // 0)  # beyond its own net
    checked = check([R1])
    assert checked.exit_code == 1
    assert checked.first.step == 0
    assert "raised ZeroDivisionError" in text(checked)


def test_what_the_kernel_s_net_catches_is_a_difference_too(monkeypatch: pytest.MonkeyPatch) -> None:
    from agent.robot.targets import Targets

    monkeypatch.setattr(Targets, "measure", lambda self, now_ns: 1 // 0)
    checked = check([R1])
    assert checked.exit_code == 1
    assert checked.first.step == 0


def test_inputs_of_another_version_cannot_be_checked(tmp_path: Path) -> None:
    def change(record: Record) -> bytes:
        return msgpack.packb({"sonar": []}) if record.channel == "/raw/step_in" else record.data

    checked = check([rewritten(R1, tmp_path / "r1.mcap", change)])
    assert checked.exit_code == 2
    assert "sonar" in text(checked)


def test_fields_are_compared_by_their_bits_and_named_by_their_path() -> None:
    def found(a: object, b: object) -> list[tuple[str, object, object]]:
        return [tuple(d) for d in differences(msgpack.packb(a), msgpack.packb(b))]

    assert found({"a": [1, {"b": 2.0}]}, {"a": [1, {"b": 2.5}]}) == [("a[1].b", 2.0, 2.5)]
    assert found({"a": 0.0}, {"a": -0.0}) == [("a", 0.0, -0.0)]
    assert found({"a": 1}, {"a": 1.0}) == [("a", 1, 1.0)]
    assert found({"a": True}, {"a": 1}) == [("a", True, 1)]
    assert [d[0] for d in found({"a": [1, 2]}, {"a": [1]})] == ["a[1]"]
    assert str(found({"a": 1, "b": 2}, {"a": 1})[0][2]) == "absent"
    assert [d[0] for d in found({"a": 1, "b": 2}, {"b": 2, "a": 1})] == [""]
    assert Difference("says[0].x_m[2]", 1.0, 2.0).plain == "says.x_m"


def test_ulps_count_the_floats_between() -> None:
    assert distance_ulps(1.0, math.nextafter(1.0, 2.0)) == 1
    assert distance_ulps(-5e-324, 5e-324) == 2
    assert distance_ulps(0.0, -0.0) == 0
    assert distance_ulps(1, 2.0) is None


# --- update ---
# Accepting a change: deliberate, with a reason, and nothing but the outputs.

BLIND_GIT = "#!/bin/sh\nexit 128\n"  # no checkout


@pytest.fixture
def git(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A program called git that says what a test wants."""
    stub = tmp_path / "bin" / "git"
    stub.parent.mkdir()
    stub.write_text(BLIND_GIT)
    stub.chmod(0o755)
    monkeypatch.setenv("PATH", f"{stub.parent}:{os.environ['PATH']}")
    return stub


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return Path(shutil.copytree(GOLDEN / "three", tmp_path / "run"))


def test_outputs_are_replaced_and_inputs_kept(run: Path, git: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.core.ranging.sweep.TRACK_SPAN", 1.6)
    assert check([run]).exit_code == 1
    accepted = [text] if (text := info(run / "r1.mcap").run.get("accepted")) else []
    before = {record.sequence: record.data for record in read(run / "r1.mcap") if record.channel == "/raw/step_in"}
    updated = update_recordings([run], "wider sweeps find the flanks")
    assert [each.box.robot for each in updated] == ["r1", "r2", "r3"]
    assert check([run]).exit_code == 0
    after = {record.sequence: record.data for record in read(run / "r1.mcap") if record.channel == "/raw/step_in"}
    assert after == before
    about = info(run / "r1.mcap")
    assert about.complete
    accepted.append("wider sweeps find the flanks")
    assert about.run["accepted"] == "; ".join(accepted)
    assert about.run["incarnation"] == info(GOLDEN / "three" / "r1.mcap").run["incarnation"]
    assert [file.name for file in sorted(run.iterdir())] == ["r1.mcap", "r2.mcap", "r3.mcap"]
    assert "estimate_m: (" in str(updated[0])
    assert f"{updated[0].steps} steps changed" in str(updated[0])
    monkeypatch.undo()
    monkeypatch.setenv("PATH", f"{git.parent}:{os.environ['PATH']}")
    update_recordings([run], "back again")
    assert info(run / "r1.mcap").run["accepted"] == "; ".join([*accepted, "back again"])
    assert [r.data for r in read(run / "r1.mcap")] == [r.data for r in read(GOLDEN / "three" / "r1.mcap")]


def test_nothing_is_written_where_nothing_changed(run: Path, git: Path) -> None:
    before = (run / "r1.mcap").read_bytes()
    assert update_recordings([run], "no reason needed, but one given") == []
    assert (run / "r1.mcap").read_bytes() == before


def test_it_needs_a_reason(run: Path, git: Path) -> None:
    with pytest.raises(ConfigError, match="needs a reason"):
        update_recordings([run], " ")


def test_it_refuses_a_dirty_checkout(run: Path, git: Path) -> None:
    git.write_text("#!/bin/sh\necho ' M agent/robot/step.py'\n")
    with pytest.raises(ConfigError, match="uncommitted changes"):
        update_recordings([run], "a reason")


def test_it_refuses_what_is_not_whole(run: Path, git: Path) -> None:
    rewritten(GOLDEN / "three" / "r1.mcap", run / "x.mcap", lambda r: None if r.sequence == 9 else r.data)
    with pytest.raises(ConfigError, match="lacks steps"):
        update_recordings([run / "x.mcap"], "a reason")
    with pytest.raises(ConfigError, match="is torn"):
        update_recordings([GOLDEN / "torn"], "a reason")
