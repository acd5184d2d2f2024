"""When a robot knows enough to swim, and which frames it does not go by."""

import math

import numpy as np
import pytest
from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.swim import localizer
from agent.capabilities.swim.localizer import (
    LAG_NS,
    LATE_NS,
    REST_NS,
    SILENT_NS,
    UNSURE_DEG,
    UNSURE_M,
    Carriage,
    Gimbal,
    GimbalHistory,
    Gyro,
    Localizer,
    Rate,
    foresees,
    within,
)
from agent.capabilities.swim.plane_odometry import Moved
from agent.capabilities.swim.pose_filter import AGREEING, BIAS, Drift, Hull, begin, predict
from agent.capabilities.swim.swim import swimmer_of
from agent.capabilities.swim.tag_fix import NoFix
from agent.core.attitude import Attitude
from agent.core.config import Body, Camera, Navigation
from agent.core.ranging.camera_model import servos_us
from agent.core.ranging.pointing import APPROACH_NS, PLAY_US, Pointing
from agent.core.step_io import Flow, SeenTags
from tests.capabilities.swim.swimming_agent import CALIBRATION, CAMERA, InTank, fleet
from tests.capabilities.swim.tank_with_tags import sight
from tests.sample_messages import telemetry

SURE = (4e-6, 0.0, 0.0, 4e-6, 0.0, 1e-6)
FREE = Hull(drag=0.0, drag2=0.0, turn_drag=0.0, turn_drag2=0.0)
THETA = (1.0, 0.9, 0.7, 0.3, 0.0, 0.0, 0.0, math.radians(-30.0))
LEVEL = Carriage(Attitude(0.3, 0.0, 0.0), Gimbal((0.0, -30.0), True))


def known(velocity, rate, push, twist):
    """A belief with these standard deviations."""
    variances = np.array([0.0] * 3 + [velocity] * 2 + [rate] + [push] * 2 + [twist] + [0.0] * 2) ** 2
    belief = begin(0, (1.0, 1.0, 0.0), SURE)
    return belief._replace(P=tuple(map(tuple, (np.array(belief.P) * (np.eye(11) == 0) + np.diag(variances)).tolist())))


@pytest.mark.parametrize(
    ("sigmas", "may"),
    [
        ((0.01, 0.02, 0.015, 0.05), True),
        ((0.03, 0.02, 0.015, 0.05), False),  # m/s
        ((0.01, 0.06, 0.015, 0.05), False),  # rad/s
        ((0.01, 0.02, 0.050, 0.05), False),  # m/s^2
        ((0.01, 0.02, 0.015, 0.12), False),  # rad/s^2
    ],
)
def test_who_knows_its_motion_is_still_sure_in_a_second(sigmas, may) -> None:
    belief = known(*sigmas)
    assert foresees(belief) is may
    ahead = predict(belief, FREE, Drift(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1_000_000_000)
    assert within(ahead, UNSURE_M, UNSURE_DEG) is may


def test_no_fix_by_a_rolling_shutter_while_the_robot_turns() -> None:
    for row_time_us, taken in ((0.0, True), (60.0, False)):
        one = Localizer(replace(fleet(), camera=Camera(row_time_us=row_time_us)), CALIBRATION)
        one.see(SeenTags(t_ns=10**9, frame=1, tags=tuple(sight(THETA))), LEVEL)
        began = one._ring._settled[-1]
        assert began.pose == pytest.approx(THETA[:3], abs=1e-3)
        one._ring._settled[-1] = began._replace(x=(*began.x[:5], math.radians(20.0), *began.x[6:]))
        one.see(SeenTags(t_ns=10**9 + 1_000_000, frame=2, tags=tuple(sight(THETA))), LEVEL)
        assert (one.refused == "") is taken and (len(one.events) == 1) is taken


@pytest.mark.parametrize("tags", [2, 4])
def test_where_three_tags_agree_two_frames_are_believed(tags) -> None:
    one, elsewhere = Localizer(fleet(), CALIBRATION), (THETA[0] + 0.2, THETA[1], *THETA[2:])
    for k, theta in enumerate((THETA, elsewhere, elsewhere)):
        one.see(SeenTags(t_ns=10**9 + k * 10**8, frame=k, tags=tuple(sight(theta)[:tags])), LEVEL)
    here = one.at(10**9 + 2 * 10**8)
    assert (here.restarts, here.refused) == ((1, 0) if tags >= AGREEING else (0, 2))


@pytest.mark.parametrize(
    ("strange", "frames", "said"),
    [
        (4, 9, None),  # too few to say
        (1, 10, None),
        (2, 10, "tags: suspect: 20 % of the frames with tags give no place: "),
        (8, 20, "tags: suspect: 40 % of the frames with tags give no place: "),
        (12, 25, "tags: contradicted: 48 % of the frames with tags give no place: "),
    ],
)
def test_it_says_which_share_of_the_frames_with_tags_gives_no_place(strange, frames, said) -> None:
    one = Localizer(fleet(), CALIBRATION)
    for k in range(frames):
        tags = tuple(replace(tag, id=tag.id + 500 * (k >= frames - strange)) for tag in sight(THETA))
        one.see(SeenTags(t_ns=10**9 + k * 10**8, frame=k, tags=tags), LEVEL)
    one.advance(10**9 + frames * 10**8)
    assert one.fault() == (said and said + "check tag size, map, lens or water level")
    one.advance(10**9 + 29 * SECOND)
    assert (one.fault() is None) is (said is None)
    one.advance(10**9 + 29 * SECOND + frames * 10**8 + 2 * SECOND)
    assert one.fault() is None, "of the last 30 s there is none"


def test_neither_a_turning_robot_nor_two_possible_poses_speak_against_the_tags(monkeypatch) -> None:
    one = Localizer(replace(fleet(), camera=Camera(row_time_us=60.0)), CALIBRATION)
    one.see(SeenTags(t_ns=10**9, frame=0, tags=tuple(sight(THETA))), LEVEL)
    began = one._ring._settled[-1]
    one._ring._settled[-1] = began._replace(x=(*began.x[:5], math.radians(20.0), *began.x[6:]))
    for k in range(20):
        one.see(SeenTags(t_ns=10**9 + 1000 * (k + 1), frame=k, tags=tuple(sight(THETA))), LEVEL)
    assert "turns too fast" in one.refused and one.fault() is None
    monkeypatch.setattr(localizer, "first_fix", lambda *_: NoFix("two poses", ambiguous=True))
    lost = Localizer(fleet(), CALIBRATION)
    for k in range(20):
        lost.see(SeenTags(t_ns=10**9 + k * 10**8, frame=k, tags=tuple(sight(THETA))), LEVEL)
    assert lost.refused == "two poses" and lost.fault() is None


def test_it_says_that_frames_come_too_late_to_tell_it_where_it_is() -> None:
    one = Localizer(fleet(), CALIBRATION)
    for k in range(20):
        exposed_ns = 10**9 + k * 10**8
        one.advance(exposed_ns + 9 * 10**8)
        one.sent((0.1 * (k % 2), 0.0, 0.0), exposed_ns + 9 * 10**8)
        one.see(SeenTags(t_ns=exposed_ns, frame=k, tags=tuple(sight(THETA))), LEVEL)
    assert "% of their frames are of no use, later than 0.8 s" in (one.fault() or "")


def test_a_robot_that_swims_says_what_is_wrong_with_its_tags() -> None:
    tank = InTank(fleet())
    swimmer_of(tank.agent.capabilities).localizer._judged.extend((START_NS, "none") for _ in range(20))
    assert any(fault.startswith("tags: contradicted: ") for fault in tank.agent.equipment.faults(START_NS))


class Points:
    """A robot that has seen tags for a second; its points, ten times a second, say what they are told to."""

    def __init__(self, monkeypatch) -> None:
        self.one, self.says, self.t_ns = Localizer(fleet(), CALIBRATION), "contrary", 10**9
        monkeypatch.setattr(localizer, "odometry", lambda *_: self.says)
        for _ in range(10):
            self.see()

    def see(self) -> None:
        self.t_ns += 10**8
        self.one.see(SeenTags(t_ns=self.t_ns, frame=1, tags=tuple(sight(THETA))), LEVEL)
        self.key_ns = self.t_ns

    def taken(self, says, frames) -> int:
        """How many of so many frames are told to the filter."""
        self.says, before = says, sum(event.kind == "3 flow" for event in self.one.events)
        for _ in range(frames):
            self.t_ns += 10**8
            self.one.follow(Flow(t_ns=self.t_ns, since_ns=self.key_ns, pairs=()), LEVEL, LEVEL, None, ())
        return sum(event.kind == "3 flow" for event in self.one.events) - before


STAYS = Moved((0.0, 0.0, 0.0), SURE, 64)


@pytest.mark.parametrize("contrary", ["contrary", Moved((0.4, 0.0, 0.0), SURE, 64)])
def test_points_that_contradict_for_a_second_count_for_nothing_until_tags_agree(monkeypatch, contrary) -> None:
    points = Points(monkeypatch)
    assert points.taken(STAYS, 3) == 3
    points.taken(contrary, 5)
    assert points.taken(STAYS, 1) == 1, "it can tell still"
    points.taken(contrary, 11)
    assert points.taken(STAYS, 5) == 0
    points.see()
    assert points.taken(STAYS, 5) == 5


@pytest.mark.parametrize("says", ["too few", None])
def test_a_second_without_points_is_no_contradiction(monkeypatch, says) -> None:
    points = Points(monkeypatch)
    if says is None:  # those of a key frame that was let go say nothing
        points.one.advance(points.t_ns + 10**9)
        points.t_ns += 10**9
        points.taken(STAYS, 15)
        points.key_ns = points.t_ns
    else:
        points.taken(says, 15)
    assert points.taken(STAYS, 1) == 1


# --- gimbal log ---
# Where the gimbal pointed, by what it was told.

BODY, SECOND, START_NS = Body(), 1_000_000_000, 10**18
PLAY_DEG = PLAY_US / BODY.servo_us_per_deg


@pytest.fixture
def turned():
    """(log, pointing): to 0 degrees and three seconds later to 30, each noted as late as may be."""
    pointing, log = Pointing(), GimbalHistory(CAMERA, BODY)
    for k, pan_deg in enumerate((0.0, 30.0)):
        pointing.aim(servos_us(CAMERA, BODY, pan_deg, 0.0), START_NS + 3 * k * SECOND)
        log.add(pointing)
    return log, pointing


def test_at_rest_it_is_where_it_was_told(turned) -> None:
    log, pointing = turned
    for t_ns, pan_deg in ((pointing.told_ns - 1, 0.0), (pointing.last_leg_ns + REST_NS, 30.0), (10 * START_NS, 30.0)):
        gimbal = log.at(t_ns)
        assert gimbal.rests and gimbal.deg == pytest.approx((pan_deg, 0.0), abs=0.1)


def test_on_its_way_nobody_knows(turned) -> None:
    log, pointing = turned
    below_ns = pointing.last_leg_ns - APPROACH_NS
    for t_ns in (START_NS - 1, pointing.told_ns, below_ns, below_ns + LAG_NS - 1, pointing.last_leg_ns + LAG_NS - 1):
        assert log.at(t_ns) is None


def test_while_it_settles_it_is_about_there_first_below_the_goal(turned) -> None:
    log, pointing = turned
    for t_ns, deg in (
        (pointing.last_leg_ns - 1, (30.0 - PLAY_DEG, -PLAY_DEG)),
        (pointing.last_leg_ns + LAG_NS, (30.0, 0.0)),
        (pointing.last_leg_ns + REST_NS - 1, (30.0, 0.0)),
    ):
        gimbal = log.at(t_ns)
        assert not gimbal.rests and gimbal.deg == pytest.approx(deg, abs=0.1)


# --- gyro ---
# The gyro in the kernel: believed while it works, told and left out when it does not; without one nothing changes.

PERIOD_NS = 20_000_000
NOISE = np.random.default_rng(4).normal(0.1, 0.001, 400)


def after(*spans):
    """(what was believed, fault at the end) of readings at 50 Hz; spans: seconds, and the rate of a number."""
    gyro, t_ns, believed, n = Gyro(), 0, [], 0
    for seconds, rate in spans:
        for _ in range(round(seconds / 0.02)):
            t_ns, n = t_ns + PERIOD_NS, n + 1
            believed.append(gyro.read(telemetry(t_ns, rate_rad_s=rate(n))))
    return believed, gyro.fault(t_ns)


def works(n):
    return float(NOISE[n % 400])


def test_one_that_works_is_believed_at_the_time_of_its_reading() -> None:
    believed, fault = after((4.0, works))
    assert fault is None and None not in believed
    assert believed[9] == Rate(10 * PERIOD_NS - LATE_NS, works(10))


@pytest.mark.parametrize(
    ("rate", "says"),
    [
        (lambda n: UNSET, "no reading"),
        (lambda n: math.radians(250.13), "end of its scale"),
        (lambda n: -math.radians(250.13), "end of its scale"),
        (lambda n: 0.0, "stuck at 0.00 deg/s"),
        (lambda n: 0.2, "stuck at 11.46 deg/s"),
    ],
)
def test_one_that_does_not_work_is_left_out_told_and_taken_back(rate, says) -> None:
    believed, fault = after((2.0, works), (2.5, rate))
    assert says in fault and fault.startswith("gyro: ")
    assert not any(believed[-60:])
    believed, fault = after((2.0, works), (2.5, rate), (0.1, works))
    assert fault is None and all(believed[-5:])


@pytest.mark.parametrize("rate", [math.nan, math.inf])
def test_what_is_no_number_is_no_telemetry(rate) -> None:
    with pytest.raises(ValueError, match="rate_rad_s is not finite"):
        telemetry(0, rate_rad_s=rate)


def test_a_frame_or_two_without_a_reading_are_no_fault() -> None:
    believed, fault = after((2.0, works), (0.5, lambda n: UNSET))
    assert fault is None and not any(believed[-25:])
    assert after((0.5, lambda n: UNSET))[1] is None and SILENT_NS == 1_000_000_000


# --- in an agent ------------------------------------------------------------------------------------------------


def with_gyro(gyro=True, **about):
    return replace(fleet(**about), navigation=Navigation(gyro=gyro))


def rates_of(robot, says):
    robot.rate_rad_s = says
    return robot


def test_its_bias_is_learnt_and_a_blind_turn_is_followed() -> None:
    rng, bias = np.random.default_rng(2), 0.008
    robot = rates_of(InTank(with_gyro(), seed=3), lambda body: float(body.speed[2] + bias + rng.normal(0.0, 0.001)))
    robot.run(8.0)
    belief = robot.swimmer.localizer.at(robot.now_ns)
    assert belief.x[BIAS] == pytest.approx(bias, abs=4 * math.sqrt(belief.P[BIAS][BIAS]))
    assert belief.P[BIAS][BIAS] < 0.004**2
    robot.sees_tags = False
    robot.body.speed[2] += 0.5  # something hits it
    robot.run(1.0)
    turned = robot.swimmer.localizer.at(robot.now_ns)
    assert math.degrees(abs(turned.x[2] - robot.body.at[2])) < 1.5
    assert not [fault for fault in robot.state.faults if "gyro" in fault]


def test_one_that_the_file_promises_and_nobody_fitted_is_told_and_the_robot_swims_without() -> None:
    robot, same = InTank(with_gyro(), seed=3), InTank(fleet(), seed=3)
    robot.run(2.0)
    same.run(2.0)
    assert any(fault.startswith("gyro: no reading") for fault in robot.state.faults)
    np.testing.assert_allclose(robot.body.at, same.body.at, atol=1e-12)


def test_without_it_in_the_file_what_it_says_changes_nothing() -> None:
    silent, told = InTank(fleet(), seed=3), rates_of(InTank(fleet(), seed=3), lambda body: 0.7)
    for _ in range(40):
        assert silent.step() == told.step()
