"""What bridges believe: a robot's word in its own name, of any size that its row allows."""

from agent.core.codec import encode
from agent.core.messages import MAX_JPEG, Estimate, Image, LogLine, Message
from agent.core.topics import IMAGE, LINK, LOG, STATE, Topic
from agent.ground.bridges.outward import own_word
from agent.process.transport import Received
from tests.ground.bridges.states import START_NS, state
from tests.sample_messages import estimate

PICTURE = Image(
    robot="r1", seq=1, sent_ns=9, t_ns=1, frame=1, width_px=4, height_px=3, enhanced=False, jpeg=bytes(MAX_JPEG)
)
LINE = LogLine(robot="r1", sent_ns=1, level="info", text="well")


def heard(row: Topic, message: Message, **chunks: str) -> Message | None:
    return own_word(Received(row, {"fleet": "tank", **chunks}, encode(message), START_NS))


def test_each_row_is_read_and_a_large_picture_too() -> None:
    said: Estimate = estimate("r1", "r2")
    for row, message, chunks in (
        (STATE, state("r1"), {"robot": "r1"}),
        (LINK, said, {"src": "r1", "dst": "r2"}),
        (IMAGE, PICTURE, {"robot": "r1"}),
        (LOG, LINE, {"robot": "r1"}),
    ):
        assert heard(row, message, **chunks) == message


def test_who_speaks_in_anothers_name_is_nobody() -> None:
    assert heard(STATE, state("r1"), robot="r2") is None
    assert heard(LINK, estimate("r1", "r2"), src="r3", dst="r2") is None
    assert heard(IMAGE, PICTURE, robot="r2") is None
    assert heard(LOG, LINE, robot="r2") is None


def test_what_cannot_be_read_is_nothing() -> None:
    assert own_word(Received(STATE, {"fleet": "tank", "robot": "r1"}, b"\xc1", START_NS)) is None
    assert heard(STATE, LINE, robot="r1") is None
