"""The live table of a survey, in 80 columns."""

import io

import msgspec
from rich.console import Console

from agent.capabilities.survey.coverage_map import CoverageMap, along, place_m, rotation
from agent.capabilities.survey.exchange import holdings
from agent.core.capability_messages import Claim, View
from agent.core.messages import Whereabouts
from agent.demo.display import floor_spot, survey_table
from agent.demo.summary import History, SurveyWatch
from tests.capabilities.survey.frames import FLEET, GRID, LENS, ROWS, SIGMA, drawn_frames
from tests.demo.test_display import STATE

FRAMES = drawn_frames(7)
VIEW = View(FRAMES[0].place, FRAMES[0].turn, LENS, ROWS, SIGMA)


def claim(src: str, frames, **more) -> Claim:
    known = CoverageMap(GRID)
    for frame in frames:
        known.add(frame)
    head = {"fleet": "survey", "src": src, "dst": "r1", "incarnation": 1, "seq": 1, "sent_ns": 3}
    return Claim(**head, has=holdings(known), share=known.share(), digest=known.digest(), **more)


def test_each_robot_has_what_it_knows_where_it_is_and_where_it_looks() -> None:
    survey = SurveyWatch(FLEET)
    all_but_one = claim("r3", FRAMES[:-1])
    for said in (claim("r1", FRAMES, view=VIEW), claim("r2", FRAMES), all_but_one):
        survey.add(said)
    at = Whereabouts(x_m=0.42, y_m=1.13, yaw_deg=9.0, place_sigma_m=0.0061, yaw_sigma_deg=1.0)
    swims = msgspec.structs.replace(STATE, whereabouts=at)
    states = {"r1": History([swims]), "r2": History([msgspec.structs.replace(STATE, robot="r2")]), "r3": History([])}
    console = Console(width=80, file=io.StringIO())
    console.print(survey_table({"ball": states}, survey, "60 s into the dive"))
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    rows = {line.split()[0]: line.split() for line in lines if line[:2] in ("r1", "r2", "r3", "r4")}
    known = f"{100 * claim('r1', FRAMES).share:.1f}"
    x, y = floor_spot(VIEW)
    assert rows["r1"][1:11] == [known, "%", "2", "7", "same", "42", "113", "6", f"{100 * x:.0f}", f"{100 * y:.0f}"]
    assert rows["r2"][1:8] == [known, "%", "2", "7", "same", "-", "-"]
    assert rows["r3"][3:] == ["1", "6", "other", "…"]
    assert rows["r4"][1:] == ["…", "-", "-", "-", "…"]


def test_where_a_view_meets_the_floor() -> None:
    x, y = floor_spot(VIEW)
    r, at = rotation(VIEW.turn), place_m(VIEW.place)
    way = along(r, (0.0, 0.0))
    assert abs(at[2] + way[2] * (x - at[0]) / way[0]) < 1e-9
    assert abs((x - at[0]) * way[1] - (y - at[1]) * way[0]) < 1e-9
    up = msgspec.structs.replace(VIEW, turn=(2**30, 0, 0, 0))  # the camera looks straight up
    assert floor_spot(up) is None
