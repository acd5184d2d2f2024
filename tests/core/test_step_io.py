"""Outputs of a step: what neighbours are told is one list, also of recordings that had a field for each topic."""

import msgpack
import pytest

from agent.core.codec import Refusal, decode, encode
from agent.core.step_io import OLDER, Outputs, Said, SetPoint
from agent.core.topics import CLAIM, NEAR
from tests.sample_messages import presence

NEW = Outputs(
    set_point=SetPoint(depth_m=0.3),
    outgoing=tuple(Said(topic="near", to=to, payload=encode(presence("r1", to))) for to in ("r2", "r3")),
)


def older(**fields: object) -> bytes:
    """Outputs as they were recorded before."""
    kept = {name: held for name, held in msgpack.unpackb(encode(NEW)).items() if name != "outgoing"}
    return msgpack.packb(kept | fields)


def test_an_older_recording_says_the_same() -> None:
    words = [msgpack.unpackb(each.payload) for each in NEW.outgoing]
    assert decode(older(near=words), Outputs) == NEW
    assert list(decode(older(near=words), Outputs).said(NEAR)) == [presence("r1", "r2"), presence("r1", "r3")]


def test_what_is_told_is_found_by_its_topic() -> None:
    assert [said.dst for said in NEW.said(NEAR)] == ["r2", "r3"] and not list(NEW.said(CLAIM))


@pytest.mark.parametrize("field", OLDER)
@pytest.mark.parametrize("held", [3, {"a": 1}, [3], [{"seq": 1}], "near"])
def test_what_no_recording_can_hold_is_refused(field: str, held: object) -> None:
    with pytest.raises(Refusal, match="content"):
        try:
            decode(older(**{field: held}), Outputs)
        except Refusal as refusal:
            raise Refusal(refusal.kind, refusal.kind) from None
