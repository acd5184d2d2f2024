"""A robot that swims, whole: what its camera sees goes in, what its thrusters are asked for moves it."""

from collections import deque

import numpy as np
import pytest
from msgspec.structs import replace

from agent.kernel.codec import encode
from agent.kernel.config import Goto, Look, Orbit, Turn
from agent.kernel.core import Agent
from agent.kernel.navigation.event_ring import RING_NS
from agent.kernel.navigation.swimmer import SURFACE_M
from agent.kernel.savepoint import has_state
from agent.kernel.step_io import Flow, SeenTag
from tests.kernel.navigation.swimming_agent import CALIBRATION, DEPTH_M, POSE, STEP_NS, InTank, fleet
from tests.sample_messages import telemetry

THERE = POSE.x_m, POSE.y_m, POSE.yaw_deg
AT_REST = (0.0, 0.0, 0.0)
ASTRAY = (POSE.x_m + 0.24, POSE.y_m + 0.18, np.radians(POSE.yaw_deg + 20.0))  # 0.3 m and 20 degrees off
SQUARE = ((-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05))


@pytest.fixture(scope="module")
def swum():
    """(robot, its inputs, outputs, way off and whether it knew, of each step): from astray, 18 s."""
    one, told = InTank(fleet(), ASTRAY, seed=3), []
    for _ in range(18 * 20):
        outputs = one.step()
        told.append((one.now_ns, one.inputs, outputs, one.off(*THERE), not one.agent.swimmer.lost))
    return one, told


def memory(of):
    """All that one object of the kernel remembers."""
    if has_state(type(of)):
        return {key: memory(value) for key, value in of.__dict__.items()}
    if isinstance(of, dict):
        return {key: memory(value) for key, value in of.items()}
    return [memory(each) for each in of] if isinstance(of, list | deque) else of


def tag(number=0, corners=SQUARE, size_px=93.0, rho_px=0.0):
    return SeenTag(number, corners, size_px, rho_px, True)


# --- finding itself and getting there ---------------------------------------------------------------------------


def test_it_finds_itself_swims_to_its_pose_and_stays(swum) -> None:
    one, told = swum
    forces = [(*outputs.set_point.force_n, outputs.set_point.yaw_moment_nm) for _, _, outputs, _, _ in told]
    knew = [known for *_, known in told]
    first = knew.index(True)
    assert first < 60 and all(knew[first:])
    assert all(force == AT_REST for force in forces[:first]) and forces[first] != AT_REST
    assert told[0][3] == pytest.approx((0.3, 20.0))
    for off_m, off_deg in (off for *_, off, _ in told[15 * 20 :]):
        assert off_m < 0.03 and off_deg < 2.0
    where = one.state.whereabouts
    assert np.hypot(where.x_m - one.body.at[0], where.y_m - one.body.at[1]) < 3.0 * where.place_sigma_m < 0.03
    assert where.yaw_deg == pytest.approx(np.degrees(one.body.at[2]), abs=3.0 * where.yaw_sigma_deg)
    assert where.yaw_sigma_deg < 1.0


def test_without_landmarks_it_only_looks_around() -> None:
    one, ways = InTank(fleet()), set()
    one.sees_tags = False
    for _ in range(14 * 20):
        one.step()
        assert one.wrench == AT_REST and one.outputs.set_point.depth_m == DEPTH_M
        ways.add(one.agent.seek.pointing.goal_us)
    assert len(ways) >= 5 and np.ptp([pan for pan, _ in ways]) > 1000  # 90 degrees
    assert one.state.whereabouts is None
    one.run(17.0, 5 * STEP_NS)
    assert one.outputs.set_point.depth_m == SURFACE_M  # nothing will be seen from here
    one.sees_tags = True
    assert one.until(lambda: not one.agent.swimmer.lost, 8.0)
    assert one.outputs.set_point.depth_m == DEPTH_M


@pytest.mark.parametrize("how", ["disarmed", "failsafe", "silent"])
def test_no_force_while_the_module_may_not_turn_motors(how) -> None:
    one = InTank(fleet(), ASTRAY)
    one.armed, one.ladder = how != "disarmed", 1 if how == "failsafe" else 0
    for _ in range(40):
        one.step()
        if how != "silent":
            assert one.wrench == AT_REST
    assert not one.agent.swimmer.lost  # looking and knowing go on
    if how != "silent":
        one.armed, one.ladder = True, 0
        one.step()
        assert one.wrench != AT_REST
        return
    assert one.wrench != AT_REST
    for _ in range(12):
        one.now_ns += STEP_NS
        outputs = one.agent.step(replace(one.inputs, telemetry=()), one.now_ns)
    assert (*outputs.set_point.force_n, outputs.set_point.yaw_moment_nm) == AT_REST


# --- lost -------------------------------------------------------------------------------------------------------


def test_lost_it_drifts_looks_around_surfaces_and_goes_on_when_it_is_found() -> None:
    one = InTank(fleet(), seed=5)
    assert one.until(lambda: not one.agent.swimmer.lost, 3.0)
    one.run(1.0)
    one.sees_tags = False
    assert one.until(lambda: one.agent.swimmer.lost, 6.0)
    since_ns, ways = one.now_ns, set()
    while one.outputs.set_point.depth_m == DEPTH_M:
        one.step(4 * STEP_NS)  # a busy computer; what it does does not hang on how often
        assert one.wrench == AT_REST
        ways.add(one.agent.seek.pointing.goal_us)
    assert 30.0 < (one.now_ns - since_ns) * 1e-9 < 30.5 and one.outputs.set_point.depth_m == SURFACE_M
    assert len(ways) > 8
    one.body.at += (0.30, -0.15, np.radians(150.0))  # somebody gave it a push
    one.sees_tags = True
    assert one.until(lambda: not one.agent.swimmer.lost, 8.0)
    assert one.outputs.set_point.depth_m == DEPTH_M and one.wrench != AT_REST
    here = one.agent.swimmer.localizer.at(one.now_ns)
    assert np.hypot(*np.subtract(here.pose[:2], one.body.at[:2])) < 0.03
    assert one.until(lambda: one.off(*THERE) < (0.03, 180.0) and one.off(*THERE)[1] < 2.0, 10.0)


def test_of_times_long_past_it_does_not_count_up_to_now_again_and_again() -> None:
    """Nothing has happened for an hour: what is asked for is a second away, and no more."""
    one = InTank(fleet())
    assert one.until(lambda: not one.agent.swimmer.lost, 3.0)
    one.sees_tags = False
    assert one.until(lambda: one.agent.swimmer.lost, 6.0)
    ring = one.agent.swimmer.localizer._ring
    for _ in range(40):
        one.step(5 * STEP_NS)
        assert one.now_ns - ring.newest.t_ns <= 2 * RING_NS
    assert ring.at(one.now_ns) == ring.at(one.now_ns)


def test_a_floor_that_is_followed_keeps_it_from_being_lost() -> None:
    lost = []
    for floor in (True, False):
        one = InTank(fleet(look=Look(tilt_deg=-40.0)))
        one.sees_floor = floor
        assert one.until(lambda one=one: not one.agent.swimmer.lost, 4.0)
        one.run(1.0)
        one.sees_tags = False
        one.run(4.0)
        lost.append(one.agent.swimmer.lost)
    assert lost == [False, True]


# --- what the file says ------------------------------------------------------------------------------------------


def test_goto_is_swum() -> None:
    one = InTank(fleet(behaviour=Goto(x_m=1.3, y_m=0.8, yaw_deg=60.0, depth_m=0.35)))
    one.run(7.0)
    off_m, off_deg = one.off(1.3, 0.8, 60.0)
    assert off_m < 0.03 and off_deg < 2.0 and one.outputs.set_point.depth_m == 0.35


def test_turn_is_turned_on_the_spot() -> None:
    one = InTank(fleet(behaviour=Turn(yaw_deg=100.0)))
    one.run(6.0)
    off_m, off_deg = one.off(POSE.x_m, POSE.y_m, 100.0)
    assert off_m < 0.03 and off_deg < 2.0


def test_orbit_goes_round_and_faces_the_middle() -> None:
    middle = np.array([1.3, 0.9])
    one = InTank(fleet(pose=replace(POSE, yaw_deg=0.0), behaviour=Orbit(x_m=1.3, y_m=0.9, radius_m=0.3)))
    assert one.until(lambda: not one.agent.swimmer.lost, 5.0)
    one.run(4.0)
    arm = one.body.at[:2] - middle
    assert np.hypot(*arm) == pytest.approx(0.3, abs=0.03)
    assert one.off(*one.body.at[:2], np.degrees(np.arctan2(*-arm[::-1])))[1] < 6.0
    gone = np.arctan2(arm[1], arm[0]) % (2 * np.pi) - np.pi  # it began on the far side
    assert gone == pytest.approx(4.0 * 0.1 / 0.3, abs=0.1)  # 0.1 m/s, from when it knew where it was


def test_moored_robots_get_no_force_and_are_nowhere(swum) -> None:
    _, told = swum
    agent = Agent(fleet(swims=False), "r1", CALIBRATION, incarnation=7)
    for now_ns, inputs, *_ in told[:40]:
        outputs = agent.step(inputs, now_ns)
        assert b"whereabouts" not in encode(outputs)
        assert outputs.set_point.force_n == (0.0, 0.0) and outputs.set_point.yaw_moment_nm == 0.0


# --- the same bytes, and what cannot be ---------------------------------------------------------------------------


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
    before, ring = memory(agent.swimmer), agent.swimmer.localizer._ring
    assert ring is not None and ring._events

    def broken(*_):
        assert memory(agent.swimmer) != before
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(Agent, "_set_point", broken)
        agent.step(inputs, now_ns)
    assert agent.net.holds
    assert memory(agent.swimmer) == before and agent.swimmer.localizer._ring is ring
    agent.step(inputs, now_ns + STEP_NS)
    assert not agent.net.holds and memory(agent.swimmer) != before


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
    k = next(k for k in whole if k >= (60 if known else 28))  # by then the gimbal is at rest, and not yet on its way
    for now_ns, inputs, *_ in told[:k]:
        agent.step(inputs if known else replace(inputs, landmarks=()), now_ns)
    place = agent.swimmer.localizer
    before = place.at(now_ns)
    assert (before is not None) is known and not place.refused
    now_ns, inputs, *_ = told[k]
    (frame,) = inputs.landmarks
    pairs = tuple((0.02 * i, 0.1, number, number) for i in range(20)) if np.isfinite(number) else ()
    flow = Flow(t_ns=frame.t_ns, since_ns=frame.t_ns - 100_000_000, pairs=pairs)
    odd = replace(frame, tags=tuple(damaged(each, number) for each in frame.tags))
    agent.step(replace(inputs, landmarks=(odd,), flow=(flow,)), now_ns)
    assert place.refused and agent.net.fault(now_ns) is None
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
    assert not place.refused and agent.net.fault(now_ns + 1) is None
    assert place.at(now_ns).covariance[0] < (1.0 if before is None else after.covariance[0])


def test_points_that_are_no_numbers_cannot_even_be_said() -> None:
    with pytest.raises(ValueError, match="pairs is not finite"):
        Flow(t_ns=2, since_ns=1, pairs=((0.0, 0.1, float("nan"), 0.0),))


def test_tags_that_nobody_surveyed_say_nothing(swum) -> None:
    one, told = swum
    agent = Agent(one.fleet, "r1", CALIBRATION, incarnation=7)
    for now_ns, inputs, *_ in told[:35]:
        strangers = tuple(replace(frame, tags=tuple(tag(586) for _ in frame.tags)) for frame in inputs.landmarks or ())
        agent.step(replace(inputs, landmarks=strangers), now_ns)
    assert agent.swimmer.lost and "no tag of the map" in agent.swimmer.localizer.refused


def test_frames_come_late_twice_or_in_another_order(swum) -> None:
    one, told = swum
    frames = [frame for _, inputs, *_ in told[:100] for frame in inputs.landmarks or () if frame.tags]
    *_, before, last, newest = frames

    def after(*batches):
        agent = Agent(one.fleet, "r1", CALIBRATION, incarnation=7)
        held = {frame.t_ns for batch in batches for frame in batch}
        now_ns = 0
        for now_ns, inputs, *_ in told[:100]:
            rest = tuple(frame for frame in inputs.landmarks or () if frame.t_ns not in held)
            agent.step(replace(inputs, landmarks=rest), now_ns)
        for k, batch in enumerate(batches, start=1):
            agent.step(replace(inputs, telemetry=(telemetry(now_ns, DEPTH_M),), landmarks=batch), now_ns + k)
            assert agent.net.fault(now_ns + k) is None
        ring = agent.swimmer.localizer._ring
        return ring.at(now_ns), ring

    in_order, _ = after((before, last, newest))
    assert after((before, last, newest, newest, before))[0] == in_order
    # Each fix begins where it was believed to be and knows how fast it was, so this is not to the bit; sigma is 3 mm.
    assert after((newest, before, last))[0].pose == pytest.approx(in_order.pose, abs=1e-4)
    _, ring = after((frames[10],), (before, last, newest))
    assert ring.dropped == 1 and ring.at(told[99][0]).pose == pytest.approx(in_order.pose, abs=0.01)
