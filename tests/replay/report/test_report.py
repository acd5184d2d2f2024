"""The page of a run, from a folder as the demo leaves it, looked at in a real browser where there is one."""

import html
import json
import math
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import msgspec
import numpy as np
import pytest

from agent.clock.clock import SystemClock
from agent.core.config import ConfigError, Target, dump
from agent.core.messages import LogLine
from replay.check.explain import explain
from replay.check.reexecute import open_box, open_boxes
from replay.files.channels import STEP_OUT, Entry
from replay.files.info import RateNotes
from replay.files.log import info, read
from replay.files.mcap_file import Part
from replay.report.figures import hover, thin
from replay.report.report import report
from replay.report.tables import causes, error_note, error_table, events, relative_percent, remarks, trust
from replay.report.timeline import open_run, timelines
from replay.viewers.viewer_channels import ViewerChannels
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run
from tests.replay.paced_clock import PacedClock
from tests.replay.page_tables import table
from tests.replay.rewritten import rewritten

TRUTH_M = (0.76, 0.56, 0.07)
CHROMIUM = shutil.which("chromium")
PHONE_PX, DESK_PX = 390, 1000
# The page in a frame of a phone's width, and what it measures there, as a line of JSON.
MEASURE = """<body><iframe id=f style="width:{width}px;height:2000px;border:0" srcdoc="{page}"></iframe>
<pre id=out></pre>
<script>document.getElementById("f").onload = () => {{
  const d = document.getElementById("f").contentDocument
  d.querySelectorAll("details").forEach(e => {{ e.open = true }})
  const box = e => {{ const r = e.getBoundingClientRect(); return [r.left, r.width, r.height] }}
  document.getElementById("out").textContent = JSON.stringify({{
    width: d.documentElement.scrollWidth, figures: [...d.querySelectorAll(".figures svg")].map(box),
    cells: d.querySelectorAll("td").length }})
}}</script>"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three robots of a golden log, and the summary that a demo would have left."""
    folder = Path(shutil.copytree(GOLDEN / "three", tmp_path_factory.mktemp("report") / "run"))
    boxes = open_boxes([folder])
    (folder / "fleet.toml").write_text(dump(boxes[0].fleet))
    agents = {}
    for timeline in timelines(boxes):
        x_m = timeline.beliefs[-1].state.posterior_m
        error_mm = 1e3 * float(np.linalg.norm(np.subtract(x_m, TRUTH_M)))
        agents[timeline.robot] = {"estimate_m": x_m, "error_mm": error_mm}
    summary = {"seed": 4, "truth_m": list(TRUTH_M), "agents": agents, "verdict": "fail", "reasons": ["r9 is <lost>"]}
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


@pytest.fixture(scope="module")
def page(run: Path) -> str:
    out = report(run)
    assert out == run / "report.html"
    return out.read_text(encoding="utf-8")


def test_the_page_has_all_figures_and_needs_nothing_else(page: str) -> None:
    sections = re.findall(r'<section id="(\w+)">', page)
    assert sections == [
        "ends",
        "errors",
        "trust",
        "valid",
        "axes",
        "iterations",
        "agreement",
        "near",
        "clarity",
        "calibration",
        "posture",
        "links",
    ]
    assert page.count("<svg") == page.count("</svg>") == 2 + 5 * 3 + 1 + 1
    for part in page.split("<svg")[1:]:
        ET.fromstring("<svg" + part[: part.index("</svg>") + 6])
    assert "r9 is &lt;lost&gt;" in page
    for outside in ("<script", " src=", "<link", "@import", "url(http"):
        assert outside not in page


def test_it_leads_with_what_came_of_it_and_folds_away_what_experts_want(run: Path, page: str) -> None:
    (said,) = re.findall(r'<p class="lead">(.*?)</p>', page, re.DOTALL)
    text = html.unescape(re.sub(r"<.*?>", "", said)).replace("\u00a0", " ")
    assert text.startswith("All three robots saw the ball (r1 first, after ")
    assert text.endswith("; it did not pass: “r9 is <lost>”.")
    assert page.index('<p class="lead">') < page.index('<figure class="tank"><svg') < page.index("<table>")
    folded = re.findall(r"<details><summary>.*?<section id=\"(\w+)\">", page, re.DOTALL)
    assert folded == ["axes", "iterations", "agreement", "near", "clarity", "calibration", "posture", "links"]
    head, *rows = table(page, "ends")
    for timeline, cells in zip(timelines(open_boxes([run])), rows, strict=True):
        row = dict(zip(head, cells, strict=True))
        state = timeline.beliefs[-1].state
        assert row["sure to ± mm"] == f"{1e3 * state.posterior_sigma_m:.1f}"
        assert row["off by mm"] == f"{1e3 * np.linalg.norm(np.subtract(state.posterior_m, TRUTH_M)):.1f}"


def test_in_the_dark_no_figure_has_a_colour_of_its_own_where_it_would_not_be_seen(page: str) -> None:
    assert "prefers-color-scheme: dark" in page
    figures = "".join(page.split("<svg")[3:])
    for colour in ("#000000", "#ffffff"):
        assert figures.count(colour) == figures.count(f", {colour})") > 0  # what a variable falls back to
    assert {name for name in re.findall(r"var\(--(\w+)", page)} <= set(re.findall(r"--(\w+):", page))


def test_its_numbers_are_those_of_the_recordings(run: Path, page: str) -> None:
    found = timelines(open_boxes([run]))
    head, *ends = table(page, "errors")
    assert [row[0] for row in ends] == ["r1", "r2", "r3"]
    for timeline, cells in zip(found, ends, strict=True):
        state, row = timeline.beliefs[-1].state, dict(zip(head, cells, strict=True))
        assert [row[f"{axis} mm"] for axis in "xyz"] == [f"{1e3 * x:.2f}" for x in state.posterior_m]
        assert [row["first view"], row["iterations"]] == [str(state.acquired_t), str(state.t)]
        error_mm = 1e3 * np.linalg.norm(np.subtract(state.posterior_m, TRUTH_M))
        assert float(row["error mm"]) == pytest.approx(error_mm, abs=0.005)
        assert float(row["% of |x*|"]) == pytest.approx(error_mm / (10 * np.linalg.norm(TRUTH_M)), abs=0.001)
    matrix = table(page, "links")
    assert matrix[0] == ["says", "r1", "r2", "r3"]
    for k, row in enumerate(matrix[1:]):
        assert row[1 + k] == "-"
        assert all(re.fullmatch(r"\d+ / \d+", cell) for j, cell in enumerate(row[1:]) if j != k)
    assert ["r1", "sees"] in [[row[0], row[2].split()[0]] for row in table(page, "valid")]


def test_errors_are_those_of_priors_and_late_posteriors(run: Path) -> None:
    found = timelines(open_boxes([run]))
    rows = {(row.robot, row.what, row.axis): row for row in error_table(found, TRUTH_M)}
    assert len(rows) == 3 * 2 * 4
    priors = np.array([x for _, x in found[0].priors]) - TRUTH_M
    x = rows["r1", "prior", "x"]
    assert x.n == len(priors) == found[0].beliefs[-1].state.measurements
    assert x.bias == pytest.approx(1e3 * priors[:, 0].mean())
    assert x.rmse == pytest.approx(1e3 * np.sqrt((priors[:, 0] ** 2).mean()))
    assert rows["r1", "prior", "3-D"].largest == pytest.approx(1e3 * np.linalg.norm(priors, axis=1).max())
    assert rows["r1", "posterior", "x"].within_2_sigma is not None
    # Of its measurements a robot states one sigma, of their distance in space.
    assert [rows["r1", "prior", axis].within_2_sigma for axis in "xyz"] == [None] * 3
    shown = [(np.linalg.norm(np.subtract(s.prior_m, TRUTH_M)), s.prior_sigma_m) for _, s in found[0].measured]
    inside = np.mean([error_m <= 2 * sigma_m for error_m, sigma_m in shown])
    assert rows["r1", "prior", "3-D"].within_2_sigma == pytest.approx(inside)
    assert rows["r1", "posterior", "3-D"].rmse < rows["r1", "prior", "3-D"].rmse
    assert relative_percent((1.0, 0.0, 0.01), (1.0, 0.0, 0.0)) == pytest.approx(1.0)


def test_priors_stand_at_the_iteration_that_they_went_into(run: Path) -> None:
    for timeline in timelines(open_boxes([run])):
        assert timeline.priors[0][0] == timeline.beliefs[-1].state.acquired_t
        assert len({t for t, _ in timeline.priors}) == len(timeline.priors)


def test_a_robot_that_started_again_has_one_timeline() -> None:
    found = {timeline.robot: timeline for timeline in timelines(open_boxes([GOLDEN / "outage"]))}
    assert len(found["r3"].starts_s) == len(found["r3"].boxes) == 2
    assert found["r3"].starts_s[1] > 13.0
    assert ["r3", "starts again"] in [[row[0], row[2]] for row in events(open_run(GOLDEN / "outage")).rows]


def test_what_came_again_and_again_is_one_row_and_hides_nobody_s_view(run: Path) -> None:
    texts = ["no frames for 1.0 s", "over: no frames", "stone: sees since iteration 9", "no frames for 1.5 s"]
    texts[3:] = [texts[3], f"{texts[3]} (3 times more in 1.0 s)"]
    lines = tuple((float(k), LogLine(robot="r1", sent_ns=k, level="info", text=text)) for k, text in enumerate(texts))
    about = open_run(run)
    about = about._replace(timelines=[about.timelines[0]._replace(log=lines)])
    assert events(about).rows[1:] == [["r1", "2.0", "stone: sees since iteration 9"]]
    found = remarks(about)
    assert found is not None and found.rows[1:] == [["r1", "5", "0.0", "4.0", "no frames for 1.0 s"]]
    assert remarks(about._replace(timelines=[about.timelines[0]._replace(log=lines[2:3])])) is None


def test_it_says_how_long_each_robot_trusted_its_belief_and_since_when_not(run: Path) -> None:
    found = open_run(run)
    first, *others = found.timelines
    held = [k for k, (_, state) in enumerate(first.states) if state.posterior_m is not None]
    states, half = list(first.states), held[len(held) // 2]
    at_s = [first.states[k][0] for k in (half, half + 1, half + 4)]
    for k, share in ((half, 12), (half + 1, 48), (half + 4, 31)):
        t_s, state = states[k]
        cause = f"{share} % of the sweeps are refused: r2 and focus say more than size"
        states[k] = t_s, msgspec.structs.replace(state, verdict="suspect", causes=(cause,))
    doubted = found._replace(timelines=[first._replace(states=tuple(states)), *others])
    head, r1, *rest = trust(doubted).rows
    assert head == ["robot", "consistent", "suspect", "contradicted", "missing"]
    assert r1 == ["r1", f"{100 - 300 / len(held):.1f} %", f"{300 / len(held):.1f} %", "0.0 %", "0.0 %"]
    assert [row[0] for row in rest] == ["r2", "r3"]
    _, *rows = causes(doubted).rows
    began, last = f"{at_s[0]:.1f}", f"{at_s[2]:.1f}"
    assert ["r1", began, last, "2", "31 % of the sweeps are refused: r2 and focus say more than size"] in rows


def test_of_a_recording_from_before_verdicts_it_says_none(run: Path) -> None:
    found = open_run(run)
    old = [
        each._replace(states=tuple((t_s, msgspec.structs.replace(state, schema=2)) for t_s, state in each.states))
        for each in found.timelines
    ]
    assert trust(found._replace(timelines=old)) is None and causes(found._replace(timelines=old)) is None


def test_every_table_and_figure_says_what_to_see(page: str) -> None:
    for section in re.findall(r"<section.*?</section>", page, re.DOTALL):
        notes = [len(note) for note in re.findall(r'<p class="note">(.*?)</p>', section, re.DOTALL)]
        alone = section.startswith('<section id="ends">')  # one table, and no more to say of it
        assert len(notes) == section.count("<table>") + (not alone)
        assert min(notes) > 40


@pytest.mark.usefixtures("undrawn")
def test_without_a_truth_nothing_is_compared_with_one(tmp_path: Path) -> None:
    file = shutil.copy(GOLDEN / "liar" / "r1.mcap", tmp_path)
    out = report(Path(file))
    assert out == tmp_path / "r1.html"
    shown = out.read_text()
    assert "Nobody knows the truth" in shown
    assert "error mm" not in shown
    assert "truth, by the twin" not in shown


@pytest.mark.usefixtures("undrawn")
def test_a_torn_recording_and_one_that_is_no_black_box_are_told_apart(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(GOLDEN / "torn", tmp_path / "torn"))
    rewritten(GOLDEN / "three" / "r2.mcap", folder / "fleet.mcap", run={"kind": "fleet"})
    assert "Not finished by their writer: r1.mcap" in report(folder).read_text()


def test_a_run_without_black_boxes_still_has_its_page(run: Path, tmp_path: Path) -> None:
    for name in ("summary.json", "fleet.toml"):
        shutil.copy(run / name, tmp_path)
    shown = report(tmp_path).read_text()
    assert shown.count("<svg") == 1  # robots and the truth from above
    assert "No robot of this run left a recording" in shown
    assert "r9 is &lt;lost&gt;" in shown


def test_a_folder_that_is_no_run_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no recording and no summary\.json"):
        report(tmp_path)
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(ConfigError, match=r"no usable summary\.json"):
        report(tmp_path)


def test_long_series_are_thinned_and_a_robot_that_never_dived_has_no_hover(run: Path) -> None:
    assert len(range(45_000)[thin(np.arange(45_000.0))]) <= 600
    timeline = timelines(open_boxes([run]))[0]
    assert hover(timeline) == {"depth_rms_mm": 0.0, "tilt_rms_deg": 0.0}  # the script's robots hang still
    surface = timeline.posture._replace(depth_m=np.zeros_like(timeline.posture.depth_m))
    assert hover(timeline._replace(posture=surface)) is None


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
@pytest.mark.parametrize("width", [PHONE_PX, DESK_PX])
def test_a_browser_shows_it_within_the_width_of_its_screen(page: str, width: int, tmp_path: Path) -> None:
    measure = tmp_path / "measure.html"
    measure.write_text(MEASURE.format(page=html.escape(page, quote=True), width=width), encoding="utf-8")
    flags = [
        "--headless",
        "--hide-scrollbars",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--virtual-time-budget=5000",
    ]
    command = [str(CHROMIUM), *flags, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", measure.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    (found,) = re.findall(r'<pre id="out">(.*?)</pre>', done.stdout)
    seen = json.loads(found)
    assert seen["width"] == width  # nothing to scroll sideways, except tables in their own boxes
    assert len(seen["figures"]) == 5 * 3 + 1 + 1
    columns = {round(left) for left, _, _ in seen["figures"]}
    assert len(columns) == (1 if width == PHONE_PX else 2)
    for left, wide, high in seen["figures"]:
        assert left >= 0
        assert left + wide <= width
        assert wide > 300
        assert high > 80
    assert seen["cells"] > 60


def test_of_a_thing_in_a_box_the_page_says_what_its_errors_are(run: Path) -> None:
    of_a_ball = open_run(run)
    (name,) = of_a_ball.truths_m
    box = Target(detector="box", picture="stone.jpg", box=(1.0, 2.0, 30.0, 40.0))
    of_a_box = of_a_ball._replace(fleet=msgspec.structs.replace(of_a_ball.fleet, target={name: box}))
    assert "the thing's middle" not in error_note(of_a_ball)
    assert f"Of a thing in a box ({name})" in error_note(of_a_box)


# --- report clock ---
# How a dive's clock went, on the page of its run.


def noted(source: Path, out: Path) -> Path:
    """The recording with notes of a clock that goes at 2.4 times real time, and from the middle on at 1.6 times."""
    about, records = info(source), list(read(source))
    part = Part(out)
    part.start(about.run, about.attachments)
    clock = PacedClock(records[0].log_time_ns, 2.4)
    notes = RateNotes(clock, clock.unix_ns)
    for n, record in enumerate(records):
        if n == len(records) // 2:
            clock.change_rate(1.6)
        clock.go_on(max(0, record.log_time_ns - clock.now_ns()) * 1e-9)
        part.add(Entry(*record, "msgpack", {}))
        for note in notes.due():
            part.add(note)
    part.finish("aucamp.end", {"cause": "clean"})
    return out


@pytest.mark.usefixtures("undrawn")
def test_black_boxes_tell_how_it_went(tmp_path: Path) -> None:
    for name in ("r1", "r2", "r3"):
        noted(GOLDEN / "three" / f"{name}.mcap", tmp_path / f"{name}.mcap")
    page = report(tmp_path).read_text(encoding="utf-8")
    assert told(page) == told_of(tmp_path)
    assert page.index('id="links"') < page.index('id="clock"')
    assert page[page.index('<section id="clock">') :].count("<svg") == 1


@pytest.mark.usefixtures("undrawn")
def test_a_fleet_file_tells_it_too(tmp_path: Path) -> None:
    bare = overheard_run(GOLDEN / "three", tmp_path / "bare.mcap")
    page = report(noted(bare, tmp_path / "fleet.mcap")).read_text(encoding="utf-8")
    assert told(page) == told_of(tmp_path / "fleet.mcap")


@pytest.mark.usefixtures("undrawn")
def test_one_robots_notes_are_enough(tmp_path: Path) -> None:
    """As of a run of which one recording is older than notes."""
    noted(GOLDEN / "three" / "r1.mcap", tmp_path / "r1.mcap")
    shutil.copy(GOLDEN / "three" / "r2.mcap", tmp_path)
    assert 'id="clock"' in report(tmp_path).read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
def test_a_dive_by_the_systems_clock_says_nothing(tmp_path: Path) -> None:
    """Nor does a recording without notes: its sections are listed above."""
    source = GOLDEN / "three" / "r1.mcap"
    about = info(source)
    part = Part(tmp_path / "real.mcap")
    part.start(about.run, about.attachments)
    notes = RateNotes(SystemClock())
    for record in read(source):
        part.add(Entry(*record, "msgpack", {}))
        for note in notes.due():
            part.add(note)
    part.finish("aucamp.end", {"cause": "clean"})
    page = report(part.path, tmp_path / "page.html").read_text(encoding="utf-8")
    assert "real time" not in page
    assert 'id="clock"' not in page
    assert open_box(part.path).complete


def told(page: str) -> str:
    (line,) = re.findall(r"[\d.]+ s of dive in [^.]*\.\d+ s, [\d.]+ times real time \([\d.]+ to [\d.]+\)", page)
    return line


def told_of(path: Path) -> str:
    moments = open_run(path).clock
    dive_s = (moments[-1].now_ns - moments[0].now_ns) * 1e-9
    wall_s = (moments[-1].noted.wall_ns - moments[0].noted.wall_ns) * 1e-9
    assert dive_s == pytest.approx(15.5, abs=0.6)
    assert 1.6 < dive_s / wall_s < 2.4
    return f"{dive_s:.1f} s of dive in {wall_s:.1f} s, {dive_s / wall_s:.2f} times real time (1.60 to 2.40)"


# --- several targets ---
# A run about two targets: each has its own timeline, explanation, viewer channels and sections of the report.

TWO = GOLDEN / "two"
WHERE_M = {"ball": (0.55, 0.66, 0.07), "buoy": (0.92, 0.45, 0.05)}


def test_a_timeline_is_about_one_target() -> None:
    found = timelines(open_boxes([TWO]))
    assert [(timeline.robot, timeline.target) for timeline in found] == [
        (r, t) for r in ("r1", "r2", "r3") for t in WHERE_M
    ]
    for timeline in found:
        where_m = WHERE_M[timeline.target]
        assert {state.target for _, state in timeline.states} == {timeline.target}
        assert math.dist(timeline.estimate[0], where_m) < 0.002
        assert all(math.dist(x_m, where_m) < 0.05 for _, x_m in timeline.priors)
        assert timeline.sweeps


def test_an_explanation_names_both_and_mixes_neither() -> None:
    ball, buoy = explain(TWO / "r2.mcap", "16s").split("\n\n")[1:]
    assert (ball.splitlines()[0], buoy.splitlines()[0]) == ("target ball", "target buoy")
    assert "Estimate: (549.9" in ball
    assert "Estimate: (919." in buoy
    assert "buoy:" not in ball


def test_viewers_get_a_channel_for_each_target() -> None:
    box = open_boxes([TWO / "r1.mcap"])[0]
    derive = ViewerChannels(box.fleet, "r1")
    channels = {
        made.channel for record in read(box.path) if record.channel == STEP_OUT.name for made in derive(entry(record))
    }
    for target in WHERE_M:
        for name in (f"/r1/target/{target}/estimate", f"/r1/plot/protocol/{target}", f"/r1/plot/hears/r2/{target}"):
            assert name in channels
    assert "/r1/target/estimate" not in channels


def entry(record):
    return Entry(
        record.channel, record.log_time_ns, record.publish_time_ns, record.sequence, record.data, "msgpack", {}
    )


@pytest.mark.usefixtures("undrawn")
def test_the_report_shows_each_target(tmp_path: Path) -> None:
    page = report(Path(shutil.copy(TWO / "r3.mcap", tmp_path))).read_text()
    for target in WHERE_M:
        assert f"r3, {target}" in page
