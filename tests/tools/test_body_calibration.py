"""Mass, inertia and drag from a trial: a body that is known is found again, within what it is said to be known to."""

import math
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

from agent.capabilities.swim.event_ring import asked, fix
from agent.capabilities.swim.pose_filter import Hull
from agent.core.config import ConfigError, dump
from agent.core.ranging.camera_model import BodyFit, load_calibration
from agent.process.command import Failed
from agent.tools import body_calibration
from agent.tools.body_calibration import MIN_FIXES, Trial, fit_body
from agent.tools.focus_calibration import CalibrationRefused, put
from tests.capabilities.swim.planar_tank import Swimmer
from tests.capabilities.swim.swimming_agent import CALIBRATION
from tests.known_body import LIGHT
from tests.places import GOLDEN

FIX_S, SIGMA = 0.1, (0.002, 0.002, 0.002)
COVARIANCE = (SIGMA[0] ** 2, 0.0, 0.0, SIGMA[1] ** 2, 0.0, SIGMA[2] ** 2)
# Seconds, and what is asked for meanwhile: two speeds both ways, and coasts.
PUSHES = (
    (1.5, (3.0, -1.0, 0.12)),
    (2.0, (0.0, 0.0, 0.0)),
    (2.0, (-0.8, 2.5, -0.04)),
    (2.0, (0.0, 0.0, 0.0)),
    (2.0, (-2.5, -2.5, -0.10)),
    (2.0, (0.0, 0.0, 0.0)),
    (2.0, (2.0, 0.8, 0.05)),
)


def recorded(hull, seed=1):
    """What a robot of this hull would have told of PUSHES, with fixes 2 mm and 0.1 degrees wrong."""
    rng, robot, events, now_s = np.random.default_rng(seed), Swimmer.resting((1.0, 1.0, 0.3), hull), [], 0.0
    events.append(fix(0, (1.0, 1.0, 0.3), COVARIANCE, (0.0,) * 6))
    for seconds, wrench in PUSHES:
        events.append(asked(1 + round(now_s * 1e9), wrench))
        for _ in range(round(seconds / FIX_S)):
            robot.swim(wrench, FIX_S)
            now_s += FIX_S
            pose = tuple(map(float, robot.at + rng.normal(0.0, SIGMA)))
            events.append(fix(round(now_s * 1e9), pose, COVARIANCE, (0.0,) * 6))
    return Trial(tuple(sorted(events)), gyro=False)


@pytest.fixture(scope="module")
def found():
    """(true, fitted) of a body that is lighter than others, and drags more."""
    hull = Hull(4.5, 3.0, 32.0, 0.07, 0.045, 0.16, 0.10)
    return hull, fit_body(recorded(hull))


def test_a_body_is_found_within_its_sigma(found) -> None:
    hull, fit = found
    for name, sigma in zip(
        ("mass_kg", "drag", "drag2", "inertia_kgm2", "turn_drag", "turn_drag2"), fit.sigma, strict=False
    ):
        off = math.log(getattr(fit, name) / getattr(hull, name))
        assert abs(off) < 3.0 * sigma + 0.02, (name, off, sigma)
    assert fit.mass_kg == pytest.approx(hull.mass_kg, rel=0.05) and fit.sigma[0] < 0.05
    assert fit.inertia_kgm2 == pytest.approx(hull.inertia_kgm2, rel=0.05)
    for v in (0.15, 0.3):  # linear and quadratic are told apart badly, their sum is not
        drag, true = fit.drag * v + fit.drag2 * v * v, hull.drag * v + hull.drag2 * v * v
        assert drag == pytest.approx(true, rel=0.08)
    assert 0.8 < fit.misfit < 1.2


def test_what_is_no_trial_is_refused() -> None:
    trial = recorded(Hull())
    with pytest.raises(CalibrationRefused, match=f"at least {MIN_FIXES} are needed"):
        fit_body(trial._replace(events=trial.events[: MIN_FIXES // 2]))
    still = [event._replace(values=(0.1, 0.0, 0.0)) if event.kind == "1 asked" else event for event in trial.events]
    with pytest.raises(CalibrationRefused, match="that is no trial"):
        fit_body(trial._replace(events=tuple(still)))


def test_a_moored_robot_has_no_trial() -> None:
    with pytest.raises(Failed, match="was moored; record a robot that swims, with behaviour 'trial'"):
        body_calibration.run(GOLDEN / "three" / "r1.mcap", None, Console(quiet=True))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"misfit": 7.1}, "something else pushed the robot, or one of T5-T8 is dead or turns the wrong way"),
        ({"lag_s": 0.343}, "thrusters seem to answer after 0.34 s, and 0.12 s is usual"),
    ],
)
def test_a_fit_that_does_not_explain_its_trial_is_written_nowhere(tmp_path, monkeypatch, found, wrong, said) -> None:
    """As an independent simulation of a lab's body had them: a dead flat thruster, and poses stamped 0.15 s late."""
    path = tmp_path / "r1.toml"
    path.write_text(dump(CALIBRATION))
    before = path.read_bytes()
    monkeypatch.setattr(body_calibration, "open_box", lambda recording: SimpleNamespace(robot="any"))
    monkeypatch.setattr(body_calibration, "read_trial", lambda box, show: None)
    monkeypatch.setattr(body_calibration, "fit_body", lambda trial, progress: replace(found[1], **wrong))
    with pytest.raises(CalibrationRefused, match=said):
        body_calibration.run(tmp_path / "r1.mcap", path, Console(quiet=True))
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_a_fit_stands_in_the_robot_s_file_and_the_file_before_is_kept(tmp_path, found) -> None:
    path = tmp_path / "r1.toml"
    path.write_text(dump(CALIBRATION))
    before = path.read_bytes()
    fields = {name: getattr(found[1], name) for name in BodyFit.__struct_fields__}
    assert "[body] of" in put(path, "body", {**fields, "sigma": list(fields["sigma"])}, Path("r1.mcap"))
    assert load_calibration(path).body == found[1]
    assert (tmp_path / "r1.toml.before").read_bytes() == before


def test_another_robot_s_file_is_left_alone(tmp_path) -> None:
    path = tmp_path / "r2.toml"
    path.write_text(dump(CALIBRATION))
    with pytest.raises(ConfigError, match=r"is the calibration of 'any'.* is of 'r1'"):
        body_calibration.run(GOLDEN / "three" / "r1.mcap", path, Console(quiet=True))


def test_what_the_trial_did_not_show_is_said_so() -> None:
    console = Console(width=120, record=True, file=StringIO())
    console.print(body_calibration.table(replace(LIGHT, sigma=(0.02, 0.7, 0.1, 0.01, 0.69, 0.1, 0.2))))
    shown = console.export_text().splitlines()
    assert [("not seen" in line) for line in shown if "│" in line] == [False, True, False, False, True, False, True]
