"""What a robot that swims is told: the same twice, undone, late, twice over, or no number at all."""

from collections import deque

import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.swim.swim import swimmer_of
from agent.core.codec import encode
from agent.core.step_io import Flow, SeenTag
from agent.core.step_transaction import Revertible
from agent.robot.step import Agent
from tests.capabilities.swim.swimming_agent import CALIBRATION, DEPTH_M, STEP_NS
from tests.sample_messages import telemetry

SQUARE = ((-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05))


def memory(of):
    """All that one object of the kernel remembers."""
    if isinstance(of, Revertible):
        return {key: memory(value) for key, value in of.__dict__.items()}
    if isinstance(of, dict):
        return {key: memory(value) for key, value in of.items()}
    return [memory(each) for each in of] if isinstance(of, list | deque) else of


def test_the_same_inputs_give_the_same_bytes(swum) -> None:
    one, told = swum
    again = Agent(one.fleet, "r1", CALIBRATION, incarnation=7)
    for now_ns, inputs, outputs, *_ in told[:120]:
        assert encode(again.step(inputs, now_ns)) == encode(outputs)


def test_a_step_that_raises_is_undone(swum, monkeypatch) -> None:
    one, told = swum
    agent = Agent(one.fleet, "r1", CALIBRATION, incarnation=7)
    for now_ns, inputs, *_ in told[:60]:
        agent.step(inputs, now_ns)
    now_ns, inputs = next((now_ns, inputs) for now_ns, inputs, *_ in told[60:] if inputs.landmarks)
    before, ring = memory(swimmer_of(agent.capabilities)), swimmer_of(agent.capabilities).localizer._ring
    assert ring is not None and ring._events

    def broken(*_):
        assert memory(swimmer_of(agent.capabilities)) != before
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(Agent, "_set_point", broken)
        held = agent.step(inputs, now_ns).set_point
    assert agent.transaction.holds
    assert told[59][2].set_point.force_n != (0.0, 0.0), "it was on its way"
    assert (*held.force_n, held.yaw_moment_nm) == (0.0, 0.0, 0.0), "and does not go on blindly"
    assert memory(swimmer_of(agent.capabilities)) == before and swimmer_of(agent.capabilities).localizer._ring is ring
    agent.step(inputs, now_ns + STEP_NS)
    assert not agent.transaction.holds and memory(swimmer_of(agent.capabilities)) != before


NUMBERS = [float("nan"), float("inf"), -1e300, 1e150, 1e20, 1e4]


def damaged(seen_tag, number):
    """One slope of a corner is that; so is all else of a tag that is one number."""
    (_, v), *rest = seen_tag.corners
    return replace(seen_tag, corners=((number, v), *rest), size_px=number, rho_px=number)


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("known", [False, True])
def test_numbers_that_cannot_be_are_refused(swum, known, number) -> None:
    """Of own vision alone, so nobody's malice: but nothing is raised, nor does the pose suffer."""
    one, told = swum
    agent = Agent(one.fleet, "r1", CALIBRATION, incarnation=7)
    whole = [k for k, (_, inputs, *_) in enumerate(told) if inputs.landmarks and len(inputs.landmarks[0].tags) == 3]
    k = next(k for k in whole if k >= (70 if known else 28))  # by then the gimbal is at rest, and not yet on its way
    for now_ns, inputs, *_ in told[:k]:
        agent.step(inputs if known else replace(inputs, landmarks=()), now_ns)
    place = swimmer_of(agent.capabilities).localizer
    before = place.at(now_ns)
    assert (before is not None) is known and not place.refused
    now_ns, inputs, *_ = told[k]
    (frame,) = inputs.landmarks
    pairs = tuple((0.02 * i, 0.1, number, number) for i in range(20)) if np.isfinite(number) else ()
    flow = Flow(t_ns=frame.t_ns, since_ns=frame.t_ns - 100_000_000, pairs=pairs)
    odd = replace(frame, tags=tuple(damaged(each, number) for each in frame.tags))
    agent.step(replace(inputs, landmarks=(odd,), flow=(flow,)), now_ns)
    assert place.refused and agent.transaction.fault(now_ns) is None
    after = place.at(now_ns)
    assert (after is not None) is known
    if known:
        assert after.pose == pytest.approx(before.pose, abs=0.02)  # it swims
        assert not {"3 flow", "4 key"} & {event.kind for event in place._ring._events}
    if number == 1e4 and not known:
        return  # small enough to weigh on a first fix, which is refused as a whole
    # What is sound in the same frame still counts.
    later = replace(frame, tags=(damaged(frame.tags[0], number), *frame.tags[1:]), t_ns=frame.t_ns + 1)
    agent.step(replace(inputs, telemetry=(), landmarks=(later,)), now_ns + 1)
    assert not place.refused and agent.transaction.fault(now_ns + 1) is None
    assert place.at(now_ns).covariance[0] < (1.0 if before is None else after.covariance[0])


def test_points_that_are_no_numbers_cannot_even_be_said() -> None:
    with pytest.raises(ValueError, match="pairs is not finite"):
        Flow(t_ns=2, since_ns=1, pairs=((0.0, 0.1, float("nan"), 0.0),))


def test_tags_that_nobody_surveyed_say_nothing(swum) -> None:
    one, told = swum
    agent = Agent(one.fleet, "r1", CALIBRATION, incarnation=7)
    for now_ns, inputs, *_ in told[:35]:
        strangers = [
            replace(frame, tags=tuple(SeenTag(586, SQUARE, 93.0, 0.0, True) for _ in frame.tags))
            for frame in inputs.landmarks or ()
        ]
        agent.step(replace(inputs, landmarks=tuple(strangers)), now_ns)
    assert (
        swimmer_of(agent.capabilities).lost and "no tag of the map" in swimmer_of(agent.capabilities).localizer.refused
    )


def test_frames_come_late_twice_or_in_another_order(swum) -> None:
    one, told = swum
    frames = [frame for _, inputs, *_ in told[:64] for frame in inputs.landmarks or () if frame.tags]
    *_, before, last, newest = frames

    def after(*batches):
        agent = Agent(one.fleet, "r1", CALIBRATION, incarnation=7)
        held = {frame.t_ns for batch in batches for frame in batch}
        now_ns = 0
        for now_ns, inputs, *_ in told[:64]:
            rest = tuple(frame for frame in inputs.landmarks or () if frame.t_ns not in held)
            agent.step(replace(inputs, landmarks=rest), now_ns)
        for k, batch in enumerate(batches, start=1):
            agent.step(replace(inputs, telemetry=(telemetry(now_ns, DEPTH_M),), landmarks=batch), now_ns + k)
            assert agent.transaction.fault(now_ns + k) is None
        ring = swimmer_of(agent.capabilities).localizer._ring
        return ring.at(now_ns), ring

    in_order, _ = after((before, last, newest))
    assert after((before, last, newest, newest, before))[0] == in_order
    # Each fix begins where it was believed to be and knows how fast it was, so this is not to the bit; sigma is 3 mm.
    assert after((newest, before, last))[0].pose == pytest.approx(in_order.pose, abs=1e-4)
    # Without a frame, other forces are asked for than those that moved the body. While it turns that matters:
    # without frame 5, 6, 10 or 12 it is still too far off here.
    _, ring = after((frames[8],), (before, last, newest))
    assert ring.dropped == 1 and ring.at(told[63][0]).pose == pytest.approx(in_order.pose, abs=0.01)
