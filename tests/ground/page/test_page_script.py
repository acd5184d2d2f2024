"""What an open page says of robots that come and go, of stops, and of a server that does not answer."""

import json
from typing import Any

import pytest

from agent.core.topics import STATE
from agent.ground.page.rows import Rows
from agent.ground.page.server import hello
from tests.ground.page.page_in_node import NODE, page_does
from tests.ground.page.shown import FLEET, NOW_NS, row, state

pytestmark = pytest.mark.skipif(NODE is None, reason="there is no node to run the page's script")

ROWS, S, NOW_MS = Rows(FLEET), 1_000_000_000, NOW_NS * 1e-6
HELLO = hello(FLEET, "live", console="ann")
STOPPED = "return [says('stopped').replace(/^[0-9:]+ /, ''), $('stopped').className]"
CLOCK = {"k": "clock", "now_ms": NOW_MS, "rate": 1.0}


def said(robot: str, age_s: float = 0.0, ahead_s: float = 0.0, **about: Any) -> dict[str, Any]:
    """A robot's State that came `age_s` ago, by a clock that is ahead of the server's."""
    arrived_ns = NOW_NS - round(age_s * S)
    sent = state(robot, sent_ns=arrived_ns + round(ahead_s * S), **about)
    return json.loads(ROWS.message(*row(sent, STATE, robot=robot, target=sent.target), arrived_ns))


# --- who is there ---


def test_a_page_that_is_opened_later_knows_how_old_the_last_word_of_a_robot_is() -> None:
    dead, alive = said("r1", age_s=20.0, ahead_s=3600.0), said("r2", age_s=0.2)
    sentence, age = page_does(
        "say(greeting, note, dead, alive); passes(100); return [says('sentence'), age('r1')]",
        greeting=HELLO,
        note=CLOCK,
        dead=dead,
        alive=alive,
    )
    assert sentence.startswith("1 of 2 robots heard. The ball: seen by r2,") and age == "silent for 20 s"


def test_a_robot_that_starts_again_with_another_clock_is_there() -> None:
    first, again = said("r1"), said("r1", age_s=-1.0, ahead_s=-600.0, incarnation=NOW_NS + S)
    other = {**said("r1", target="stone"), "t": -1}  # of before, and about something else
    age, place, seen = page_does(
        """say(greeting, note, first, other); passes(1000); say(again); passes(500);
        order(["r1"], "hold");
        return [age('r1'), silent(robots.get("r1")), sent.at(-1).order?.seen.r1]""",
        greeting=HELLO,
        note=CLOCK,
        first=first,
        other=other,
        again=again,
    )
    assert (age, place) == ("0.5 s ago", False)
    assert seen == again["seen"], "what is looked at is the newest, not what has the highest stamp"


def test_a_word_that_was_long_on_its_way_is_as_old_as_it_is() -> None:
    prompt, late = said("r1"), said("r1", age_s=-1.0)
    late["sent_ms"] -= 5000.0
    age = page_does(
        "say(greeting, note, prompt); passes(1000); say(late); passes(500); return age('r1')",
        greeting=HELLO,
        note=CLOCK,
        prompt=prompt,
        late=late,
    )
    assert age == "silent for 5.5 s"


# --- what stands beside STOP ALL ---


def stop_of_all(at_ms: float = NOW_MS, **second: Any) -> dict[str, Any]:
    """The lines of a stop that r1 has done, and what r2 answered."""
    order = {"k": "order", "n": 1, "verb": "stop", "args": {}, "asked": ["r1", "r2"], "at_ms": at_ms}
    outcome = {"k": "outcome", "n": 1, "ok": True, "why": "", "id": "17", "at_ms": at_ms}
    return {"k": "lines", "lines": [order, {**outcome, "robot": "r1"}, {**outcome, "robot": "r2", **second}]}


def test_a_robot_that_is_armed_again_is_no_more_called_stopped() -> None:
    late = said("r1", age_s=-0.4)  # its module has not told yet
    off = [said("r1", age_s=-2.0, armed=False), said("r2", age_s=-2.0, armed=False)]
    again, both = said("r1", age_s=-3.0), said("r2", age_s=-3.0)
    given = {"greeting": HELLO, "note": CLOCK, "lines": stop_of_all(), "late": late, "off": off}
    assert page_does(f"say(greeting, note); say(lines, late, ...off); {STOPPED}", **given) == [
        "all stopped: r1 and r2",
        "note good",
    ]
    given |= {"again": again, "both": both}
    turned = page_does(f"say(greeting, note); say(lines, late, ...off, again); say(...off); {STOPPED}", **given)
    assert turned == ["stopped: r2; armed again: r1", "note warn"]
    turned = page_does(f"say(greeting, note); say(lines, ...off, again, both); {STOPPED}", **given)
    assert turned == ["armed again: r1 and r2", "note warn"]
    given["lines"] = stop_of_all(ok=None, why="did not answer")
    turned = page_does(f"say(greeting, note); say(lines, ...off, again); {STOPPED}", **given)
    assert turned == ["armed again: r1; no answer from r2", "note bad"]


def test_a_page_that_is_opened_later_does_not_say_that_all_are_stopped() -> None:
    armed = [said("r1"), said("r2")]
    given = {"greeting": HELLO, "note": CLOCK, "armed": armed, "lines": stop_of_all(NOW_MS - 60_000)}
    assert page_does(f"say(greeting, note, ...armed, lines); {STOPPED}", **given)[0] == ""
    given["lines"] = stop_of_all(NOW_MS - 60_000, ok=None, why="did not answer")
    assert "no answer from r2" in page_does(f"say(greeting, note, ...armed, lines); {STOPPED}", **given)[0]


# --- a server that says nothing ---

UNCONFIRMED = ["STOP not confirmed: use the kill switch, or aucamp order", "note bad"]
GOES_ON = "const time = () => { if (wall_ms % 500 === 0) say({...note, now_ms: note.now_ms + wall_ms - 1000}); };"
BEGUN = {"greeting": HELLO, "note": CLOCK, "there": [said("r1"), said("r2")], "lines": stop_of_all()}
SHOWN = "[says('kind'), document.body.classList.contains('lost'), says('sentence')]"


def test_a_server_that_says_nothing_for_three_seconds_is_no_connection_until_it_does() -> None:
    before, soon, then, after = page_does(
        f"""{GOES_ON} say(greeting, note, ...there); passes(10000, time); const before = {SHOWN};
        passes(2500); const soon = {SHOWN}; passes(1000); const then = [...{SHOWN}, says("banner")];
        time(); passes(1000, time); return [before, soon, then, {SHOWN}];""",
        **BEGUN,
    )
    assert before[:2] == soon[:2] == after[:2] == ["LIVE", False]
    assert then[:3] == ["NO CONNECTION", True, "No robot is heard any more."]
    assert then[3].startswith("Connection lost at ")


def test_a_page_that_draws_nothing_waits_for_nothing() -> None:
    """A tab behind others acknowledges nothing, so nothing is sent to it."""
    asleep = f"frames.length = 0; say(greeting, note, ...there); passes(60000); return {SHOWN};"
    assert page_does(asleep, **BEGUN)[:2] == ["LIVE", False]


def test_a_stop_without_an_outcome_is_not_confirmed() -> None:
    press = f"{GOES_ON} say(greeting, note, ...there); passes(1000, time); press('s');"
    assert page_does(f"{press} passes(2500); {STOPPED}", **BEGUN)[0] == "stopping…"
    assert page_does(f"{press} passes(3500); {STOPPED}", **BEGUN) == UNCONFIRMED
    assert page_does(f"{press} passes(3500, time); {STOPPED}", **BEGUN) == UNCONFIRMED, "it says the time, and no more"
    late = page_does(f"{press} passes(3500); say(lines); passes(5000, time); {STOPPED}", **BEGUN)
    assert late == ["all stopped: r1 and r2", "note good"]
    half = {"k": "lines", "lines": BEGUN["lines"]["lines"][:2]}
    waits = page_does(f"{press} passes(500, time); say(half); {STOPPED}", **BEGUN, half=half)
    assert waits == ["stopped: r1; waiting for r2", "note warn"]
    assert page_does(f"{press} say(half); passes(3500, time); {STOPPED}", **BEGUN, half=half) == UNCONFIRMED
    again = f"{press} passes(3500); press('s'); {STOPPED}"
    assert page_does(again, **BEGUN) == UNCONFIRMED, "nothing is known to go out"


def test_a_stop_that_cannot_be_sent_is_not_confirmed_by_one_of_before() -> None:
    gone = "say(greeting, note, ...there, lines); WebSocket.last.readyState = 3; WebSocket.last.onclose();"
    told = page_does(f"{gone} press('s'); {STOPPED}", **BEGUN)
    assert told == UNCONFIRMED
    back = f"{gone} press('s'); passes(1100); say(greeting, note, ...there, lines); passes(100);"
    assert page_does(f"{back} {STOPPED}", **BEGUN) == UNCONFIRMED
    stopped = page_does(f"{back} press('s'); say(lines); {STOPPED}", **BEGUN)
    assert stopped == ["all stopped: r1 and r2", "note good"], "what came back can be used again"


def test_a_stop_of_one_robot_is_told_too() -> None:
    one = {"k": "lines", "lines": [{**stop_of_all()["lines"][0], "asked": ["r1"]}, stop_of_all()["lines"][1]]}
    press = f"{GOES_ON} say(greeting, note, ...there); order(['r1'], 'stop'); passes(3500, time);"
    assert page_does(f"{press} {STOPPED}", **BEGUN) == UNCONFIRMED
    assert page_does(f"{press} say(one); {STOPPED}", **BEGUN, one=one)[0] == ""
