"""From a row of the network to a message of the page, and what is shown to nobody."""

import json

import pytest

from agent.core.capability_messages import TURN_ONE, Claim, Has, Lens, View
from agent.core.codec import Refusal, encode
from agent.core.messages import Answer
from agent.core.topics import ANSWER, CLAIM, IMAGE, LIGHT, LINK, LOG, NEAR, STATE
from agent.ground.page.rows import Rows
from tests.ground.page.shown import FLEET, NOW_NS, image, log, received, row, state
from tests.sample_messages import estimate, presence

ROWS = Rows(FLEET)


def test_a_state_says_which_one_it_is_to_the_last_digit() -> None:
    shown = json.loads(ROWS.message(*row(state(), STATE, robot="r1", target="ball")))
    assert shown["k"] == "state/r1/ball" and shown["knows"] == "sees"
    assert shown["seen"] == [str(NOW_NS - 5), str(NOW_NS)]
    assert shown["sent_ms"] == pytest.approx(NOW_NS * 1e-6, abs=1e-3)
    assert not [name for name in shown if name.endswith("_ns")], "no number that JavaScript would round"


def test_a_picture_goes_as_it_came_behind_robot_frame_and_time() -> None:
    seen = image("r2", frame=4711)
    (shown,) = received(ROWS.message(*row(seen, IMAGE, robot="r2")))
    assert shown == {"k": "image/r2", "frame": 4711, "t_ns": NOW_NS, "jpeg": seen.jpeg}


def test_what_is_told_to_several_neighbours_is_one_thing() -> None:
    cov = (1e-6, 0.0, 0.0, 2e-6, 0.0, 3e-6)
    said = estimate("r1", "r2", fleet="test", x_m=(0.7, 0.5, 0.1), cov_m2=cov)
    topic, chunks, payload = row(said, LINK, src="r1", dst="r2", target="ball")
    assert ROWS.key(topic, chunks) == ROWS.key(topic, {**chunks, "dst": "r9"}) == "link/r1/ball"
    assert json.loads(ROWS.message(topic, chunks, payload))["cov_m2"] == list(cov)
    near = json.loads(ROWS.message(*row(presence("r1", "r2", t_ns=NOW_NS), NEAR, src="r1", dst="r2")))
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
    shown = json.loads(ROWS.message(*row(said, CLAIM, src="r1", dst="r2")))
    assert shown["looks"]["x_m"] == pytest.approx([1.2, 0.3, 0.25])
    assert shown["looks"]["ahead"] == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)
    assert (shown["keyframes"], shown["keyframes_held"], shown["share"]) == (3, 7, 0.5)


def test_an_answer_names_its_order_to_the_last_digit() -> None:
    answer = Answer(robot="r1", console="ann", id=NOW_NS, order="stop", ok=True, arrived_ns=NOW_NS, sent_ns=NOW_NS + 1)
    shown = json.loads(ROWS.message(*row(answer, ANSWER, robot="r1", console="ann")))
    assert shown["id"] == str(NOW_NS) and shown["console"] == "ann" and shown["ok"] is True


def test_strangers_and_what_is_not_shown_have_no_key() -> None:
    assert ROWS.key(STATE, {"robot": "r9", "target": "ball"}) is None
    assert ROWS.key(STATE, {"robot": "r1", "target": "gold"}) is None
    assert ROWS.key(LIGHT, {"src": "r1", "dst": "r2"}) is None


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
        ROWS.message(*row(said, topic, **chunks))


def test_bytes_that_are_no_message_are_refused() -> None:
    with pytest.raises(Refusal):
        ROWS.message(STATE, {"robot": "r1", "target": "ball"}, b"\xc1")
    with pytest.raises(Refusal):
        ROWS.message(LOG, {"robot": "r1"}, encode(state()))
