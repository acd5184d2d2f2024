"""The page of a run, from a folder as the demo leaves it."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from agent.config import ConfigError, Fleet, Pose, Robot, Target, dump
from agent.messages import Outputs, SetPoint, State, encode
from replay.log import LogWriter
from replay.report import report

TRUTH_M = (0.7, 0.6, 0.07)


def robot(port: int, x_m: float) -> Robot:
    return Robot(
        listen=f"tcp/127.0.0.1:{port}",
        serial="twin:x",
        camera="twin:x",
        pose=Pose(x_m=x_m, y_m=0.2, yaw_deg=30.0),
        calibration="x.toml",
    )


def state(name: str, t: int) -> State:
    near = tuple(x + 0.01 / (1 + t) for x in TRUTH_M)
    return State(
        fleet="tank",
        robot=name,
        incarnation=1,
        seq=t,
        sent_ns=t,
        target="ball",
        knows="sees",
        t=t,
        acquired_t=3,
        prior_m=near if t >= 3 else None,
        posterior_m=near,
    )


@pytest.fixture
def run(tmp_path: Path) -> Path:
    fleet = Fleet(
        fleet="tank", target={"ball": Target(radius_m=0.07)}, robot={"r1": robot(18001, 0.3), "r2": robot(18002, 1.2)}
    )
    (tmp_path / "fleet.toml").write_text(dump(fleet))
    with LogWriter(tmp_path / "r1.mcap", {}) as log:  # r2 left none
        for t in range(20):
            log.write("/raw/step_in", t, t, t, b"\x80")
            log.write("/raw/step_out", t, t, t, encode(Outputs(set_point=SetPoint(depth_m=0.4), state=state("r1", t))))
    row = {"estimate_m": [0.701, 0.6, 0.07], "sigma_m": 0.0012, "error_mm": 1.0, "relative_error_percent": 0.1234}
    none = {"estimate_m": None, "sigma_m": None, "error_mm": None, "relative_error_percent": None}
    summary = {
        "schema": 1,
        "protocol": "paper",
        "seed": 4,
        "wall_s": 12.3,
        "truth_m": list(TRUTH_M),
        "agents": {"r1": row, "r2": none},
        "verdict": "fail",
        "reasons": ["r2 has <no> estimate"],
    }
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    return tmp_path


def test_the_page_shows_the_run_and_needs_nothing_else(run: Path) -> None:
    page = report(run).read_text()
    assert "0.123" in page
    assert "1.20" in page  # sigma in mm
    assert "r2 has &lt;no&gt; estimate" in page
    assert page.count("<svg") == page.count("</svg>") == 2
    for part in page.split("<svg")[1:]:
        ET.fromstring("<svg" + part[: part.index("</svg>") + 6])
    assert "<script" not in page
    assert " src=" not in page


def test_a_run_without_black_boxes_still_has_its_page(run: Path) -> None:
    (run / "r1.mcap").unlink()
    assert "no black box" in report(run).read_text()


@pytest.mark.parametrize("content", [None, "{"])
def test_a_folder_that_is_no_run_is_one_line(run: Path, content: str | None) -> None:
    (run / "summary.json").unlink()
    if content:
        (run / "summary.json").write_text(content)
    with pytest.raises(ConfigError, match=r"no usable summary\.json"):
        report(run)
