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


STOPPED = "return [says('stopped').replace(/^\\S+ /, ''), $('stopped').className]"


def test_a_robot_that_is_armed_again_is_no_more_called_stopped() -> None:
    late = said("r1", age_s=-0.4)  # its module has not told yet
    off = [said("r1", age_s=-2.0, armed=False), said("r2", age_s=-2.0, armed=False)]
    again, both = said("r1", age_s=-3.0), said("r2", age_s=-3.0)
    given = {"greeting": HELLO, "note": CLOCK, "lines": stop_of_all(), "late": late, "off": off}
    assert page_does(f"say(greeting, note, lines, late, ...off); {STOPPED}", **given) == [
        "all stopped: r1 and r2",
        "note good",
    ]
    given |= {"again": again, "both": both}
    turned = page_does(f"say(greeting, note, lines, late, ...off, again); say(...off); {STOPPED}", **given)
    assert turned == ["stopped: r2; armed again: r1", "note warn"]
    turned = page_does(f"say(greeting, note, lines, ...off, again, both); {STOPPED}", **given)
    assert turned == ["armed again: r1 and r2", "note warn"]
    given["lines"] = stop_of_all(ok=None, why="did not answer")
    turned = page_does(f"say(greeting, note, lines, ...off, again); {STOPPED}", **given)
    assert turned == ["armed again: r1; no answer from r2", "note bad"]


def test_a_page_that_is_opened_later_does_not_say_that_all_are_stopped() -> None:
    armed = [said("r1"), said("r2")]
    given = {"greeting": HELLO, "note": CLOCK, "armed": armed, "lines": stop_of_all(NOW_MS - 60_000)}
    assert page_does(f"say(greeting, note, ...armed, lines); {STOPPED}", **given)[0] == ""
    given["lines"] = stop_of_all(NOW_MS - 4_000)
    again = page_does(f"say(greeting, note, ...armed, lines); {STOPPED}", **given)
    assert again == ["armed again: r1 and r2", "note warn"]
    given["lines"] = stop_of_all(NOW_MS - 60_000, ok=None, why="did not answer")
    assert "no answer from r2" in page_does(f"say(greeting, note, ...armed, lines); {STOPPED}", **given)[0]
