"""From a row of the network to a message of the page, and what is shown to nobody."""

import json
import re
import shutil
import subprocess
from importlib import resources
from typing import Any

import pytest

from agent.core.capability_messages import TURN_ONE, Claim, Has, Lens, View
from agent.core.codec import Refusal, encode
from agent.core.messages import Answer
from agent.core.topics import ANSWER, CLAIM, IMAGE, KEYFRAME, LIGHT, LINK, LOG, NEAR, STATE
from agent.core.verdict import ORDER
from agent.ground.page.rows import KEPT, MOST_KEYS, MOST_SURFACES, Board, Rows, Viewer, text
from tests.ground.page.shown import FLEET, NOW_NS, image, keyframe, log, received, row, state
from tests.sample_messages import estimate, presence

ROWS = Rows(FLEET)


def test_a_state_says_which_one_it_is_to_the_last_digit() -> None:
    shown = json.loads(ROWS.message(*row(state(), STATE, robot="r1", target="ball"), NOW_NS))
    assert shown["k"] == "state/r1/ball" and shown["knows"] == "sees"
    assert shown["seen"] == [str(NOW_NS - 5), str(NOW_NS)]
    assert shown["sent_ms"] == pytest.approx(NOW_NS * 1e-6, abs=1e-3)
    assert not [name for name in shown if name.endswith("_ns")], "no number that JavaScript would round"


# --- whether a belief can be trusted ---

CAUSE = "all ranges are 2.0 % (+-0.2) long: check radius_m"
PAGE = resources.files("agent.ground.page").joinpath("index.html").read_text(encoding="utf-8")
NODE = shutil.which("node")


def run_of_page(call: str) -> Any:
    """What a call gives of the page's own words; they need no browser."""
    words = re.findall(r"^const (?:fix|millimetres|list) = .*$", PAGE, re.MULTILINE)
    (trust,) = re.findall(r"^(const TRUST = .*?)^function doing", PAGE, re.MULTILINE | re.DOTALL)
    script = "\n".join([*words, trust, f"console.log(JSON.stringify({call}))"])
    return json.loads(subprocess.run([NODE, "-e", script], check=True, capture_output=True, text=True).stdout)


def test_the_word_and_its_causes_go_with_the_state() -> None:
    said = state(verdict="contradicted", causes=(CAUSE,))
    shown = json.loads(ROWS.message(*row(said, STATE, robot="r1", target="ball"), NOW_NS))
    assert (shown["verdict"], shown["causes"]) == ("contradicted", [CAUSE])
    fine = json.loads(ROWS.message(*row(state(), STATE, robot="r1", target="ball"), NOW_NS))
    assert (fine["verdict"], fine["causes"]) == ("consistent", [])


def test_every_word_has_a_colour_on_the_page() -> None:
    colours = dict(re.findall(r'(\w+): "(\w+)"', re.findall(r"^const TRUST = \{(.*?)\}", PAGE, re.MULTILINE)[0]))
    assert tuple(colours) == ORDER, "the worse the later"
    assert list(colours.values()) == ["good", "warn", "bad", "bad"]


@pytest.mark.skipif(NODE is None, reason="there is no node to run the page's script")
def test_the_page_calls_nothing_known_that_is_not_to_be_trusted() -> None:
    good, bad, worse = (
        json.loads(ROWS.message(*row(said, STATE, robot=said.robot, target="ball"), NOW_NS))
        for said in (
            state("r1"),
            state("r1", verdict="suspect", causes=("r2 stands apart from the others", CAUSE)),
            state("r2", verdict="contradicted", causes=(CAUSE,), faults=(f"contradicted: ball: {CAUSE}", "no frames")),
        )
    )

    def sentence(*states: dict[str, Any]) -> list[list[str]]:
        said = json.dumps([[each["robot"], each] for each in states])
        return run_of_page(f"known_to('ball', 'seen by all', 0.0015, {said})")

    assert sentence(good) == [["", "The ball: seen by all, known to ± 1.5 mm. "]]
    _, (colour, text) = sentence(good, bad, worse)
    assert (colour, text) == ("bad", f"Do not trust its place: contradicted, says r2: {CAUSE}. ")
    (_, first), (colour, text) = sentence(good, bad)
    assert first == "The ball: seen by all. " and colour == "warn" and "known to" not in text
    assert run_of_page("known_to('ball', 'seen by nobody now', 0, [['r1', null]])")[0][1].startswith("Nobody knows yet")
    assert run_of_page(f"[{json.dumps(good)}, {json.dumps(bad)}].map(stated)") == ["± 1.5 mm", "says ± 1.5 mm"]
    assert run_of_page(f"others({json.dumps(worse)})") == ["no frames"]
    del good["verdict"]  # of a recording from before there was one
    assert sentence(good)[0][1].endswith("known to ± 1.5 mm. ")


def test_a_picture_goes_as_it_came_behind_robot_frame_and_time() -> None:
    seen = image("r2", frame=4711)
    (shown,) = received(ROWS.message(*row(seen, IMAGE, robot="r2"), NOW_NS))
    assert shown == {"k": "image/r2", "frame": 4711, "t_ns": NOW_NS, "jpeg": seen.jpeg}


def test_what_is_told_to_several_neighbours_is_one_thing() -> None:
    cov = (1e-6, 0.0, 0.0, 2e-6, 0.0, 3e-6)
    said = estimate("r1", "r2", fleet="test", x_m=(0.7, 0.5, 0.1), cov_m2=cov)
    topic, chunks, payload = row(said, LINK, src="r1", dst="r2", target="ball")
    assert ROWS.key(topic, chunks, payload) == ROWS.key(topic, {**chunks, "dst": "r9"}, payload) == "link/r1/ball"
    assert json.loads(ROWS.message(topic, chunks, payload, NOW_NS))["cov_m2"] == list(cov)
    near = json.loads(ROWS.message(*row(presence("r1", "r2", t_ns=NOW_NS), NEAR, src="r1", dst="r2"), NOW_NS))
    assert near["k"] == "near/r1" and near["robot"] == "r1" and near["t_ms"] == pytest.approx(NOW_NS * 1e-6)


def test_where_a_survey_looks_next_is_a_place_and_a_direction() -> None:
    half = TURN_ONE / 2**0.5
    view = View(
        place=(12000, 3000, 2500),
        turn=(round(half), 0, round(half), 0),  # a quarter about y: the camera's z is the world's x
        lens=Lens(f=5000, cx=3200, cy=2400, bend=0, ahead=0, block=32, cols=20),
        rows=15,
        sigma=10,
    )
    head = {"fleet": "test", "incarnation": 1, "seq": 0, "sent_ns": NOW_NS, "share": 0.5}
    said = Claim(src="r1", dst="r2", view=view, has=(Has("r1", 1, 3), Has("r2", 1, 4)), **head)
    shown = json.loads(ROWS.message(*row(said, CLAIM, src="r1", dst="r2"), NOW_NS))
    assert shown["looks"]["x_m"] == pytest.approx([1.2, 0.3, 0.25])
    assert shown["looks"]["ahead"] == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)
    assert (shown["keyframes"], shown["keyframes_held"], shown["share"]) == (3, 7, 0.5)


def test_what_a_sweep_showed_is_one_thing_whoever_passes_it_on() -> None:
    told = [row(keyframe(src), KEYFRAME, src=src, dst="r2") for src in ("r1", "r2")]
    assert {ROWS.key(*each) for each in told} == {"surface/r1/7/3"}
    shown = json.loads(ROWS.message(*told[1], NOW_NS))
    assert shown["cols"] == 2 and shown["from_mm"] == pytest.approx([500.0, 600.0, 400.0])
    # The first block's middle is 16 px left of and above the axis, at f = 500 px; looking down turns y over.
    assert shown["blocks"] == [[492, 608, 150], [508, 608, 150], [484, 584, -100], None]
    assert ROWS.key(*row(keyframe("r1", origin="r9"), KEYFRAME, src="r1", dst="r2")) is None
    assert ROWS.key(KEYFRAME, {"src": "r1", "dst": "r2"}, b"no keyframe") is None
    with pytest.raises(Refusal):
        ROWS.message(*row(keyframe("r1", place=(99000, 0, 0)), KEYFRAME, src="r1", dst="r2"), NOW_NS)


def test_an_answer_names_its_order_to_the_last_digit() -> None:
    answer = Answer(robot="r1", console="ann", id=NOW_NS, order="stop", ok=True, arrived_ns=NOW_NS, sent_ns=NOW_NS + 1)
    shown = json.loads(ROWS.message(*row(answer, ANSWER, robot="r1", console="ann"), NOW_NS))
    assert shown["id"] == str(NOW_NS) and shown["console"] == "ann" and shown["ok"] is True


def test_strangers_and_what_is_not_shown_have_no_key() -> None:
    assert ROWS.key(STATE, {"robot": "r9", "target": "ball"}, b"") is None
    assert ROWS.key(STATE, {"robot": "r1", "target": "gold"}, b"") is None
    assert ROWS.key(LIGHT, {"src": "r1", "dst": "r2"}, b"") is None


@pytest.mark.parametrize(
    ("said", "topic", "chunks"),
    [
        (state("r2"), STATE, {"robot": "r1", "target": "ball"}),
        (state("r1", target="gold"), STATE, {"robot": "r1", "target": "ball"}),
        (log("r2"), LOG, {"robot": "r1"}),
        (image("r2"), IMAGE, {"robot": "r1"}),
        (estimate("r2", "r1", fleet="test"), LINK, {"src": "r1", "dst": "r2", "target": "ball"}),
    ],
)
def test_what_one_robot_says_on_anothers_key_is_refused(said, topic, chunks) -> None:
    with pytest.raises(Refusal):
        ROWS.message(*row(said, topic, **chunks), NOW_NS)


def test_bytes_that_are_no_message_are_refused() -> None:
    with pytest.raises(Refusal):
        ROWS.message(STATE, {"robot": "r1", "target": "ball"}, b"\xc1", NOW_NS)
    with pytest.raises(Refusal):
        ROWS.message(LOG, {"robot": "r1"}, encode(state()), NOW_NS)


# --- board ---
# One message of a key is on its way to a page; what it has not drawn in time it never gets.


def shows(board: Board, key: str, value: int) -> None:
    board.show(key, lambda: text({"k": key, "value": value}))


def sent(board: Board, viewer: Viewer) -> list[tuple[str, int | None]]:
    """All that goes to a page which acknowledges nothing."""
    return [(fields["k"], fields.get("value")) for fields in map(json.loads, board.next_for(viewer))]


def test_a_page_that_does_not_answer_gets_one_message_of_each_key_and_then_the_newest() -> None:
    board = Board()
    viewer = board.join()
    for value in range(50):
        shows(board, "state/r1", value)
        shows(board, "state/r2", value)
        if value == 0:
            assert sent(board, viewer) == [("state/r1", 0), ("state/r2", 0)]
    assert sent(board, viewer) == []
    viewer.got(["state/r1"])
    assert sent(board, viewer) == [("state/r1", 49)]
    viewer.got(["state/r1"])
    assert sent(board, viewer) == [], "what it has it does not get again"


def test_every_page_goes_at_its_own_pace_and_a_message_is_made_once() -> None:
    board, made = Board(), []
    fast, slow = board.join(), board.join()

    def make() -> str:
        made.append(1)
        return text({"k": "a"})

    board.show("a", make)
    assert sent(board, fast) == sent(board, slow) == [("a", None)]
    assert len(made) == 1
    shows(board, "a", 2)
    fast.got(["a"])
    assert sent(board, fast) == [("a", 2)] and sent(board, slow) == []


def test_nothing_is_made_for_nobody() -> None:
    board = Board()

    def make() -> str:
        raise AssertionError("nobody looks")

    for _ in range(5):
        board.show("a", make)


def test_lines_are_a_queue_that_forgets_the_oldest() -> None:
    board = Board()
    viewer = board.join()
    for number in range(KEPT + 10):
        board.say(text({"k": "log/r1", "n": number}))
    message = json.loads(board.next_for(viewer)[0])
    assert [line["n"] for line in message["lines"]] == list(range(10, KEPT + 10))
    board.say(text({"k": "log/r1", "n": -1}))
    assert board.next_for(viewer) == []
    viewer.got(["lines"])
    assert [line["n"] for line in json.loads(board.next_for(viewer)[0])["lines"]] == [-1]


def test_who_comes_later_sees_what_is_there() -> None:
    board = Board()
    shows(board, "state/r1", 1)
    board.say(text({"k": "log/r1", "n": 5}))
    assert [key for key, _ in sent(board, board.join())] == ["state/r1", "lines"]


def test_what_is_no_message_is_counted_and_the_rest_is_shown() -> None:
    board = Board()
    viewer = board.join()

    def refuse() -> str:
        raise Refusal("garbage", "not msgpack")

    board.show("state/r1", refuse)
    shows(board, "state/r2", 2)
    assert sent(board, viewer) == [("state/r2", 2)] and board.refused == 1
    shows(board, "state/r1", 3)
    assert sent(board, viewer) == [("state/r1", 3)]


def test_who_invents_keys_fills_nothing() -> None:
    board = Board()
    viewer = board.join()
    for number in range(MOST_KEYS):
        shows(board, f"state/{number}", number)
    assert not board.full
    shows(board, "state/more", 0)
    assert len(sent(board, viewer)) == MOST_KEYS and board.full
    board.start_over()
    assert not board.full


def test_keyframes_that_are_not_shown_are_told_of() -> None:
    board = Board()
    for number in range(MOST_SURFACES):
        shows(board, f"surface/r1/{number}", number)
    assert not board.full
    shows(board, "surface/r1/more", 0)
    assert board.full and len(sent(board, board.join())) == MOST_SURFACES
    shows(board, "state/r1", 1)
    assert len(sent(board, board.join())) == MOST_SURFACES + 1


def test_another_time_of_a_recording_begins_with_saying_so() -> None:
    board = Board()
    shows(board, "hello", 0)
    viewer = board.join()
    shows(board, "state/r1", 1)
    sent(board, viewer)
    shows(board, "state/r1", 2)  # waits
    board.start_over()
    shows(board, "state/r1", 3)
    assert sent(board, viewer) == [("over", None), ("state/r1", 3)]
    assert next(key for key, _ in sent(board, board.join())) == "hello"
