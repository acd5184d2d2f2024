"""The golden logs: a change of behaviour that does not update them fails here, and so does one that notices none.

`aucamp replay check tests/golden/CASE --update "reason"` accepts a change that was meant.
"""

import json
import shutil
import subprocess
import sys
from collections import Counter
from itertools import groupby
from pathlib import Path

import pytest

from agent.core.codec import decode
from agent.core.messages import Answer, Explain, LogLine, State
from agent.core.step_io import Outputs
from agent.core.verbs import VERBS
from agent.perception.vision import rerun_vision
from agent.robot.operator import BROKE
from replay.check.check import check, text
from replay.check.reexecute import open_box, open_boxes
from replay.check.vision_check import check_vision
from tests.golden import fleet_files, orders, picture_heads, swim
from tests.places import GOLDEN, ROOT

CASES = ("three", "three_evidence", "outage", "liar", "empty", "push", "signed", "lit", "two", "torn", "seen", "survey")
CASES += ("carried", "dark", "orders", "spoiled", "strange", "swim", "fish", "dark_survey")
TARGET_M = (0.76, 0.56, 0.07)  # of tests/network/scripted_agent.py


def states(file: Path) -> list[State]:
    outputs = (decode(step.outputs, Outputs, limit=10**6) for step in open_box(file).steps() if step.outputs)
    return [each.state for each in outputs if each.state is not None]


def explains(case: str) -> list[Explain]:
    return [state.explain for state in states(GOLDEN / case / "r1.mcap") if state.explain is not None]


def answers(case: str) -> list[Answer]:
    outputs = (decode(step.outputs, Outputs, limit=10**6) for step in open_box(GOLDEN / case / "r1.mcap").steps())
    return [answer for each in outputs for answer in each.answers or ()]


def log_lines(file: Path) -> list[LogLine]:
    outputs = (decode(step.outputs, Outputs, limit=10**6) for step in open_box(file).steps() if step.outputs)
    return [line for each in outputs for line in each.log]


@pytest.mark.slow
def test_todays_vision_sees_what_the_golden_frames_say() -> None:
    (found,) = check_vision([GOLDEN / "seen"], rerun_vision)
    assert found.passed, str(found)
    assert (found.frames, found.lost) == (28, 0)
    assert found.sweeps == found.quantities["place of each sweep, in its own sigma, rms"].compared == 2


@pytest.mark.slow
def test_todays_kernel_does_what_the_golden_logs_say() -> None:
    checked = check([GOLDEN / case for case in CASES], GOLDEN / "ignore.toml")
    assert checked.exit_code == 0, text(checked)
    assert checked.unused == (), "rows of ignore.toml that cover nothing"
    unsaid = {(run.name, link.src, link.dst) for run, found in checked.links.items() for link in found if link.unknown}
    forged = {("signed", "r2", "r1"), ("strange", "r2", "r1"), ("strange", "r3", "r1")}
    assert unsaid == forged, text(checked)  # what was put on the way


def test_they_are_small() -> None:
    files = [file for file in GOLDEN.rglob("*") if ".mcap" in file.name]
    assert sum(file.stat().st_size for file in files) < 3.5e6, "each of the kernel's folders takes some"


def test_heads_of_pictures_say_what_they_said() -> None:
    rows = [json.loads(line) for line in picture_heads.FILE.read_text().splitlines()]
    assert json.loads(json.dumps(picture_heads.read())) == rows
    assert {row["name"] for row in rows if row["several"]} == {
        "png animated",
        "webp animated and turned",
        "tiff of two pages",
    }
    assert {row["name"] for row in rows if row["cut_off"]} == {"jpg cut", "png cut"}
    assert {row["name"] for row in rows if row["orientation"] == 6} == {
        "jpg turned",
        "png turned",
        "webp animated and turned",
    }


def test_of_fleet_files_is_said_what_was_said() -> None:
    assert fleet_files.lines() == fleet_files.FILE.read_text().splitlines()


def test_each_shows_what_it_is_kept_for() -> None:
    for robot in ("r1", "r2", "r3"):
        for case in ("three", "three_evidence", "outage", "liar", "empty", "signed"):
            last = states(sorted((GOLDEN / case).glob(f"{robot}.*mcap"))[0])[-1]  # r3.2.mcap before r3.mcap
            assert last.posterior_m == pytest.approx(TARGET_M, abs=0.003), (case, robot)
    assert [box.path.name for box in open_boxes([GOLDEN / "outage"])] == ["r1.mcap", "r2.mcap", "r3.mcap", "r3.2.mcap"]
    assert {s.rule for s in states(GOLDEN / "outage" / "r2.mcap") if 10 <= s.t <= 12} == {"alone"}
    liar = states(GOLDEN / "liar" / "r1.mcap")[-1]
    assert liar.explain is not None
    assert liar.explain.doubted == {"r3": 0.0}
    told = states(GOLDEN / "signed" / "r1.mcap")[-1]
    assert told.signed and told.refused["bad signature"] > 0
    assert {s.rule for s in states(GOLDEN / "empty" / "r1.mcap") if 11 <= s.t <= 12} == {"hold"}
    knocked = [line.text for line in log_lines(GOLDEN / "push" / "r2.mcap")]
    assert any("tilted by" in text for text in knocked)
    assert states(GOLDEN / "push" / "r2.mcap")[-1].posterior_m == pytest.approx(TARGET_M, abs=0.003)
    assert not open_box(GOLDEN / "torn" / "r1.mcap").complete
    for robot in ("r1", "r2", "r3"):
        two = {state.target: state for state in states(GOLDEN / "two" / f"{robot}.mcap")}
        assert {target: state.knows for target, state in two.items()} == {"ball": "sees", "buoy": "sees"}


def test_the_new_ones_show_what_they_are_kept_for() -> None:
    does = [state.behaviour for state in states(GOLDEN / "swim" / "r1.mcap")]
    assert [one for one, _ in groupby(does)] == ["hold", "goto", "turn", "orbit", "trial", "hold"]
    known = [state.whereabouts is not None for state in states(GOLDEN / "swim" / "r1.mcap")]
    spans = [(one, len(list(found))) for one, found in groupby(known)]
    assert any(n > 10 for one, n in spans[2:] if not one) and known[-1], "it is lost, and finds itself again"
    fish = states(GOLDEN / "fish" / "r1.mcap")
    assert [one for one, _ in groupby(state.behaviour for state in fish)] == ["search", "follow"]
    assert "sees" in {state.knows for state in fish[-10:]}, "it goes with it"
    lines = {case: [line.text for line in log_lines(GOLDEN / case / "r1.mcap")] for case in CASES if case != "torn"}
    assert "view 1000002 was spoiled: its own lamp changed" in lines["dark_survey"]
    assert any(text.startswith("keyframe 1") for text in lines["dark_survey"])
    assert any(text.startswith("searches for 'ball' by the light of") for text in lines["dark"])
    assert "sweep rejected: spoiled: the lamp of r2 changed" in lines["spoiled"]
    assert {explain.epoch.moving for explain in explains("carried")} == {False, True}
    assert set(VERBS) <= {order.verb for order in (*orders.ORDERS, *swim.ORDERS)}
    strange = states(GOLDEN / "strange" / "r1.mcap")[-1]
    assert strange.mode == "degraded" and len(strange.refused) > 10
    left_out = [answer.why == BROKE for answer in answers("strange") if answer.order.startswith("hold")]
    assert True in left_out and False in left_out, "an order that came with what broke a step"


MUTATIONS = {  # one a folder
    "agent.robot.targets.STATE_NS": 250_000_000,
    "agent.core.ranging.sweep.TRACK_SPAN": 1.6,
    "agent.core.estimation.fuse.AGREE": 1e6,
    "agent.core.status.NO_FRAMES_NS": 10**7,
}


@pytest.mark.parametrize("constant", MUTATIONS)
def test_one_other_constant_is_noticed(constant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constant, MUTATIONS[constant])
    checked = check([GOLDEN / ("liar" if ".fuse." in constant else "three_evidence")])
    assert checked.exit_code == 1
    assert checked.first is not None


def test_a_changed_gain_in_a_copy_is_named_by_its_first_step_and_field(tmp_path: Path) -> None:

    for package in ("agent", "replay"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    source = tmp_path / "agent" / "core" / "estimation" / "protocols.py"
    line = "alpha = 1.0 / (self.t + 1)"
    assert source.read_text().count(line) == 2  # the paper's protocol, and Metropolis weights after it
    source.write_text(source.read_text().replace(line, "alpha = 1.1 / (self.t + 1)", 1))
    program = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from pathlib import Path; import replay.check.check as c\n"
        f"assert c.__file__.startswith({str(tmp_path)!r})\n"
        f"checked = c.check([Path({str(GOLDEN / 'three')!r})]); print(c.text(checked)); sys.exit(checked.exit_code)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1, done.stderr
    assert done.stderr == ""
    first = Counter(line.split(":")[0].strip() for line in done.stdout.splitlines() if "recorded" in line)
    assert any(field.startswith(("state.", "says[")) for field in first), done.stdout
    mixed = next(s for s in states(GOLDEN / "three" / "r2.mcap") if s.rule == "mix")
    step = next(line for line in done.stdout.splitlines() if "first at step" in line and " r2" in line)
    assert abs(int(step.split()[3]) - mixed.seq * 4) <= 8  # a state each fourth step
