"""The navigation experiment in small: what it draws, the filter that is its bound, and a result to read."""

import io
import json
import math
from importlib import import_module
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console
from typer.testing import CliRunner

from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.plane_odometry import odometry
from agent.capabilities.swim.projection import view
from agent.capabilities.swim.tag_fix import Map, priors, tag_fix, whole
from agent.cli.experiments import EXPERIMENTS, OWN_PICTURES, Experiment, app, parts
from agent.core.attitude import Attitude
from agent.core.config import ConfigError, Pose
from agent.core.linear_algebra import wrap
from agent.core.messages import Estimate
from agent.core.ranging.fix import Fix
from agent.experiments.experiment import WATERS, ExperimentResult, Sensor, perform, write_result
from agent.experiments.navigation import basin
from agent.experiments.navigation.around_ball import crossing
from agent.experiments.navigation.basin import CAMERA, PlanarBodies
from agent.experiments.navigation.joint_filter import JointFilter, full
from agent.experiments.navigation.manoeuvres import ORBIT_M, ORBIT_M_S, SUMMARIES, goto, off_orbit, settled_s
from agent.experiments.navigation.navigation import (
    BARS,
    CASES,
    Result,
    Shown,
    aid_table,
    bars_table,
    figures,
    fixes_table,
    met,
    spread_table,
    table,
    worlds,
)
from agent.experiments.navigation.swimmers import DrawnCamera, Swimmers
from agent.process.command import Failed
from hw.twin.dive import RobotPose
from hw.twin.optics.lens import PRESETS
from hw.twin.optics.shade import KD_PER_M

S = 1_000_000_000
LEVEL = Attitude(basin.DEPTH_M, 0.0, 0.0)
SURE = (1e-18, 0.0, 0.0, 1e-18, 0.0, 1e-18)
RANDOM, STAYS = (4e-6, 1e-6, 0.0, 9e-6, 0.0, 1e-6), (2e-6, 0.0, 0.0, 1e-6, 0.0, 3e-6)


def pose_at(x, y, psi, tilt_deg) -> RobotPose:
    c, s = math.cos(psi), math.sin(psi)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return RobotPose(np.array([x, y, basin.TANK.surface_m - basin.DEPTH_M]), rotation, 0.0, tilt_deg)


def one_robot(seed=0):
    return basin.fleet({"r1": basin.robot("r1", Pose(x_m=1.0, y_m=1.0, yaw_deg=0.0))}, seed)


# --- what is drawn ----------------------------------------------------------------------------------------------


def test_drawn_tags_are_as_wrong_as_the_kernel_believes() -> None:
    """Other surveys, places and ways to look: the twin's geometry there, the kernel's here."""
    nees = []
    for seed in range(16):
        fleet, rng = one_robot(seed), np.random.default_rng(seed)
        camera, known = DrawnCamera(fleet, "r1", CAMERA), Map(fleet.landmarks, markers(fleet.landmarks))
        for _ in range(4):
            x, y, psi = rng.uniform((0.6, 0.6, -3.0), (2.4, 1.4, 3.0))
            tags, _ = camera.expose(pose_at(x, y, psi, -40.0), 0)
            of = view(CAMERA, fleet.body, basin.TANK.surface_m, None)
            level = Attitude(basin.DEPTH_M + rng.normal(0.0, 7e-4), *rng.normal(0.0, 0.1, 2))
            gimbal = rng.normal((0.0, -40.0), 0.02)
            fix = tag_fix(of, priors(level, gimbal, 0.0, turning=False), known, tags.tags, (x + 0.02, y, psi))
            if tags.tags:
                e = np.array([fix.theta[0] - x, fix.theta[1] - y, wrap(fix.theta[2] - psi)])
                nees.append(e @ np.linalg.solve(full(fix.covariance), e) / 3.0)
    assert len(nees) > 35 and 0.7 < np.mean(nees) < 1.3


def test_drawn_points_say_how_it_moved() -> None:
    fleet = one_robot()
    camera = DrawnCamera(fleet, "r1", CAMERA)
    of = view(CAMERA, fleet.body, basin.TANK.surface_m, None)
    at = whole((0.0, 0.0, 0.0), priors(LEVEL, (0.0, -40.0), 0.0, turning=False))
    camera.expose(pose_at(1.0, 1.0, 0.5, -40.0), S)
    _, flow = camera.expose(pose_at(1.0 + 0.03 * math.cos(0.5), 1.0 + 0.03 * math.sin(0.5), 0.52, -40.0), 2 * S)
    water_m = (*basin.TANK.size_m[:2], basin.TANK.surface_m)
    at = whole((1.0, 1.0, 0.5), priors(LEVEL, (0.0, -40.0), 0.0, turning=False))
    moved = odometry(of, at, at, flow.pairs, water_m, 0.0)
    assert flow.since_ns == S and moved.pose == pytest.approx((0.03, 0.0, 0.02), abs=1e-3)
    camera.interrupt()
    assert camera.expose(pose_at(1.0, 1.0, 0.5, -40.0), 3 * S)[1] is None


# --- the bound --------------------------------------------------------------------------------------------------


def sample(at_m) -> Fix:
    return Fix(at_m, RANDOM, STAYS)


def test_samples_of_one_robot_share_what_stays_and_those_of_two_do_not() -> None:
    for robots in (1, 2):
        joint = JointFilter(robots)
        for i in range(robots):
            joint.begin(i, S, (float(i), 0.0, 0.0), SURE)
            for _ in range(5):
                joint.add_sample(i, sample((1.0, 1.0, 0.1)), (0.0,) * 6)
        at, covariance = joint.target
        expected = (full(RANDOM) / 5 + full(STAYS)) / robots
        np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-11)
        np.testing.assert_allclose(at, (1.0, 1.0, 0.1), atol=1e-6)


def test_who_does_not_know_its_yaw_learns_it_of_a_target_that_others_know() -> None:
    """J P J' + R of the first sample; after the other's, all of what they share."""
    joint, unsure = JointFilter(2), (1e-6, 0.0, 0.0, 1e-6, 0.0, 4e-4)
    joint.begin(0, S, (0.0, 0.0, 0.0), unsure)
    joint.begin(1, S, (1.0, 0.5, 0.0), SURE)
    joint.add_sample(0, sample((1.0, 1.0, 0.1)), (0.0,) * 6)
    J = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
    alone = J @ full(unsure) @ J.T + full(RANDOM) + full(STAYS)
    np.testing.assert_allclose(joint.target[1], alone, rtol=1e-4, atol=1e-9)
    joint.add_sample(1, sample((1.0, 1.0, 0.1)), (0.0,) * 6)
    sure = full(RANDOM) + full(STAYS)
    np.testing.assert_allclose(
        joint.target[1], np.linalg.inv(np.linalg.inv(alone) + np.linalg.inv(sure)), rtol=1e-3, atol=1e-10
    )
    assert math.sqrt(joint.P[2, 2]) < 0.3 * 0.02


def test_it_coasts_and_remembers_its_key_frame() -> None:
    joint = JointFilter(1)
    joint.begin(0, S, (0.0, 0.0, 0.3), SURE)
    joint.x[3:5] = 0.02, 0.01
    joint.keep_key(0, S)
    joint.predict(0, 2 * S)
    x, y, psi = joint.pose(0)
    assert 0.01 < x < 0.02 and y == pytest.approx(0.5 * x) and psi == pytest.approx(0.3)
    before = joint.P[0, 0]
    joint.add_flow(
        0, S, (math.hypot(x, y) * math.cos(math.atan2(y, x) - 0.3), 0.0, 0.0), (4e-6, 0.0, 0.0, 4e-6, 0.0, 1e-6)
    )
    assert joint.P[0, 0] < 0.1 * before
    joint.add_flow(
        0, S - 1, (9.0, 9.0, 0.0), (1e-12, 0.0, 0.0, 1e-12, 0.0, 1e-12)
    )  # of a key frame that it does not have
    assert joint.pose(0)[0] == pytest.approx(x, abs=5e-3)


# --- what is swum -----------------------------------------------------------------------------------------------


def test_when_it_settles_and_how_far_it_is_off_an_orbit() -> None:
    t = np.arange(1.0, 6.0)
    assert settled_s(t, np.array([3.0, 0.5, 2.0, 0.5, 0.5]), 1.0) == 4.0
    assert settled_s(t, np.array([3.0, 0.5, 0.5, 0.5, 2.0]), 1.0) is None and settled_s(t, 0.0 * t, 1.0) == 0.0
    t = np.linspace(0.0, 20.0, 200)
    way = 0.7 + ORBIT_M_S / ORBIT_M * t
    late = np.column_stack([t, 1.0 + ORBIT_M * np.cos(way - 0.1), 2.0 + ORBIT_M * np.sin(way - 0.1), way])
    assert off_orbit(late, (1.0, 2.0)).max() < 1e-9, "a steady lag is none"
    late[:, 1] += 0.01
    assert off_orbit(late, (1.0, 2.0)).mean() == pytest.approx(0.01, abs=0.002)


def test_robots_that_cross_hear_each_other_and_are_measured_by_the_truth() -> None:
    row = crossing(3, robots=3, seconds=2.5)
    apart = [np.linalg.norm(row["path"][:, a] - row["path"][:, b], axis=1).min() for a, b in ((0, 1), (0, 2), (1, 2))]
    assert row["path"].shape == (50, 3, 2) and row["least_m"] == pytest.approx(min(apart))
    names = ("r1", "r2")
    fleet = basin.fleet(
        {
            name: basin.robot(name, Pose(x_m=1.0 + k, y_m=1.0, yaw_deg=0.0), neighbours=(names[1 - k],))
            for k, name in enumerate(names)
        },
        0,
    )
    swimmers = Swimmers(fleet, PlanarBodies(fleet))
    for _ in range(5):
        swimmers.step()
    assert {heard.src for heard in swimmers.inputs["r1"].heard} <= {"r2"}
    said = [each for each in swimmers.outputs["r2"].says if isinstance(each, Estimate)]
    swimmers.step()
    assert [heard.src for heard in swimmers.inputs["r1"].heard] == ["r2"] * len(said)


def test_half_a_metre_on_the_twin_s_body_under_the_board_s_firmware() -> None:
    (row,) = worlds(goto, 100, 0, 1)
    assert 1.5 < row["s"] < 6.0 and row["overshoot_mm"] < 60.0
    assert row["path"].shape[1] == 4 and np.isfinite(row["path"]).all()


# --- what is told -----------------------------------------------------------------------------------------------

PATH = np.column_stack([np.linspace(0.0, 1.0, 5)] * 4)
FIX = {
    "at_rest": True,
    "tags": 2,
    "blur_px": 1.0,
    "distance_m": 0.6,
    "error_mm": 2.0,
    "error_deg": 0.1,
    "nees": 1.0,
    "sigma_mm": 2.0,
}
DRAWS = {
    "fix": [FIX, {**FIX, "at_rest": False, "blur_px": 9.0, "error_mm": 50.0}, {**FIX, "tags": 0, "distance_m": None}],
    "hold": [{"rms_mm": 3.0, "yaw_rms_deg": 0.3, "path": PATH}, {"rms_mm": 4.0, "yaw_rms_deg": 0.4, "path": PATH}],
    "goto": [{"s": 3.0, "overshoot_mm": 5.0, "path": PATH}, {"s": 4.0, "overshoot_mm": 9.0, "path": PATH}],
    "turn": [{"s": 2.0, "path": PATH}, {"s": None, "path": PATH}],
    "orbit": [{"rms_mm": 3.0, "path": PATH}],
    "orbit with gaps": [{"rms_mm": 5.0, "path": PATH}],
    "separation": [{"robots": 3, "least_m": 0.3, "arrived": 1.0, "path": np.zeros((4, 3, 2))}],
    "target": [
        {"robots": 3, "told": 3, "error_mm": [1.1] * 3, "nees": [1.0] * 3, "samples": 9}
        | {"bound_mm": 1.0, "bound_nees": 1.0}
    ],
    "follow": [{"off_mm": 50.0, "gap_deg": 20.0, "least_m": 0.6, "speed_m_s": 0.1}],
    "search": [{"s": 20.0, "least_m": 0.5}],
    "search alone": [{"s": None, "least_m": math.inf}],
}
AID = {
    "own_mm": [1.0, 6.0],
    "aided_mm": [1.0, 3.0],
    "joint_mm": [1.0, 2.0],
    "known": [1.0, 0.5],
    "nees": [0.5, 1.5],
} | {
    "target_mm": 1.0,
    "target_nees": 0.8,
    "joint_target_mm": 0.9,
}
DRAWS |= {"aid": [AID], "aid with gyro": [AID]}


def result_of(draws, verdict=True) -> Result:
    return Result(**{case: SUMMARIES[case](draws) for case in CASES}, shown=Shown(draws, verdict))


def test_a_result_has_these_keys_and_no_others(tmp_path) -> None:
    result = result_of(DRAWS)
    write_result(result, tmp_path)
    told = json.loads((tmp_path / "result.json").read_text())
    assert {case: set(figures) for case, figures in told.items()} == {
        "fix": {"p90_mm", "p90_deg", "nees"},
        "hold": {"rms_mm", "yaw_rms_deg"},
        "goto": {"s", "overshoot_mm"},
        "turn": {"s"},
        "orbit": {"rms_mm", "gap_rms_mm"},
        "separation": {"least_m"},
        "target": {"ratio_to_bound", "nees"},
        "aid": {"own_mm", "aided_mm", "nees"},
        "follow": {"rms_mm", "gap_deg", "least_m"},
        "search": {"s", "alone_s", "least_m"},
    }
    assert told["aid"] == {"own_mm": 6.0, "aided_mm": 3.0, "nees": 1.0}, "of those whose tags are rare"
    assert {(bar.case, bar.key) for bar in BARS} == {(case, key) for case, keys in told.items() for key in keys}
    assert told["fix"]["p90_mm"] == 2.0, "blurred frames have no bar"
    assert told["hold"]["rms_mm"] == pytest.approx(math.sqrt(12.5)) and told["goto"]["s"] == 4.0
    assert told["turn"]["s"] is None and told["target"]["ratio_to_bound"] == pytest.approx(1.1)
    assert result.missed == ["turn s", "separation least_m"] and result.failed
    assert result_of(DRAWS, verdict=False).missed is None and not result_of(DRAWS, verdict=False).failed


def test_a_bar_is_missed_on_either_side_and_by_no_number() -> None:
    nees = next(bar for bar in BARS if (bar.case, bar.key) == ("fix", "nees"))
    assert [met(nees, {"nees": value}) for value in (0.7, 1.0, 1.4, None)] == [False, True, False, False]
    assert met(nees, {}) is None


def test_tables_and_figures() -> None:
    result = result_of(DRAWS)
    assert bars_table(result).row_count == len(BARS)
    assert fixes_table(DRAWS["fix"]).row_count == 2 and spread_table(DRAWS).row_count == 11
    assert aid_table(DRAWS).row_count == 6
    said = [str(part) for part in table(result).renderables if isinstance(part, str)]
    assert said[-1] == "missed: turn s, separation least_m"
    drawn = dict(figures(result))
    assert [name for name in drawn if name.endswith(".png")] == [
        "navigation_paths.png",
        "navigation_fixes.png",
        "navigation_crossing.png",
    ]
    assert [len(drawn[name].axes) for name in drawn if name.endswith(".svg")] == [10, 2, 1]
    only = Result(**{case: {} for case in CASES} | {"turn": {"s": 2.0}}, shown=Shown({"turn": DRAWS["turn"]}, False))
    assert bars_table(only).row_count == 1
    assert str(table(only).renderables[-1]).startswith("no verdict")


# --- perform ---
# What every verb of `aucamp experiment` does with its experiment: folder, bar, result.json, figures, table.


class Found(ExperimentResult, frozen=True, kw_only=True):
    schema: int = 1
    value: float
    shown: str


def find(settings, progress):
    progress(1, 1)
    return Found(value=settings, shown="beside")


def drawn(result):
    for suffix in ("svg", "png"):
        yield f"picture.{suffix}", Figure(figsize=(1, 1))


def test_result_and_figures_are_in_the_folder_and_the_table_is_shown(tmp_path: Path) -> None:
    console = Console(file=io.StringIO())
    found = perform(find, 0.5, lambda result: result.shown, tmp_path / "new", console, "parts", drawn)
    assert found == Found(value=0.5, shown="beside")
    assert json.loads((tmp_path / "new" / "result.json").read_text()) == {"schema": 1, "value": 0.5}
    assert list(json.loads((tmp_path / "new" / "result.json").read_text())) == ["schema", "value"]
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"result.json", "picture.svg", "picture.png"}
    said = console.file.getvalue()
    assert "parts" in said and "beside" in said and f"written to {tmp_path / 'new'}" in said.replace("\n", "")


class Missed(Found, frozen=True, kw_only=True):
    @property
    def failed(self):
        return True


def test_the_answer_no_is_said_when_all_is_written_and_is_exit_code_1(tmp_path: Path) -> None:
    console = Console(file=io.StringIO())
    with pytest.raises(Failed, match=r"a target is missed; the tables say which, and .*result\.json"):
        perform(lambda *_: Missed(value=1, shown="x"), 1, lambda result: "table", tmp_path, console, "parts", drawn)
    assert len(list(tmp_path.iterdir())) == 3 and "table" in console.file.getvalue()


@pytest.mark.parametrize("verb", EXPERIMENTS)
def test_a_folder_with_a_result_is_left_alone(verb: str, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}")
    done = CliRunner().invoke(app, [verb, "--out", str(tmp_path)])
    assert isinstance(done.exception, ConfigError)
    assert "not empty, and nothing is overwritten; give --out a new folder" in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]
    assert (tmp_path / "result.json").read_text() == "{}"


@pytest.mark.parametrize("which", [*EXPERIMENTS.values(), OWN_PICTURES], ids=lambda which: which.module)
def test_options_become_settings_that_the_experiment_has(which: Experiment) -> None:
    module = import_module(f"agent.experiments.{which.module}")
    fields = {which.seeds or "seed", *(part.field for part in which.only), *(["quick"] if which.quick else [])}
    if which is not OWN_PICTURES:
        assert fields | {"seed"} <= set(module.Settings.__struct_fields__)
        assert module.Settings(seed=3).seed == 3
    for part in which.only:
        for name in part.names:
            asked = parts("x", which, [name])
            assert list(asked) == [part.field]
            msgspec.convert({"seed": 0, **asked}, module.Settings, strict=False)
    assert callable(module.run) and callable(module.table)


def test_what_only_names_is_kept_by_its_kind() -> None:
    scenes = parts("reconstruction", EXPERIMENTS["reconstruction"], ["coastal", "scenes", "tap", "exact"])
    assert scenes == {"only": "scenes", "waters": ("tap", "coastal"), "poses": ("exact",)}
    assert parts("following", EXPERIMENTS["following"], ["share", "3"]) == {"only": "share", "robots": "3"}
    assert parts("lighting", EXPERIMENTS["lighting"], []) == {}


def test_names_that_may_be_given_are_those_of_the_twin() -> None:
    assert get_args(Sensor) == tuple(PRESETS)
    assert tuple(KD_PER_M) == WATERS
