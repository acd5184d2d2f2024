"""Where neighbours say that they are: what is believed, how it ages, and who looks for landmarks."""

import struct
from typing import Any

import pytest
from msgspec.structs import replace

from agent.capabilities.swim.deconfliction import LONGEST_NS, SILENT_NS, Neighbours
from agent.capabilities.swim.swim import swimmer_of
from agent.core.codec import Refusal, encode
from agent.core.messages import Presence
from agent.core.status import Status
from agent.core.step_io import Heard
from agent.core.topics import NEAR
from agent.robot.inbox import Inbox
from agent.robot.step import Agent
from tests import sample_messages
from tests.capabilities.swim.swimming_agent import CALIBRATION, InTank, fleet
from tests.capabilities.swim.swimming_fleet import FleetInTank, fleet_of

S = 1_000_000_000
POSES = [(0.6, 1.0, 0.0), (2.4, 1.0, 180.0), (1.5, 1.6, 0.0)]
FLEET = fleet_of(POSES)
COV = (4e-4, 1e-4, 0.0, 1e-4, 0.0, 1e-3)


def presence(src: str = "r02", dst: str = "r01", seq: int = 1, sent_ns: int = S, **about: Any) -> Presence:
    usual = {"x_m": 1.0, "y_m": 0.8, "cov": COV, "v_x_m_s": 0.2, "v_y_m_s": -0.1, "t_ns": sent_ns}
    head = {"fleet": "swim", "incarnation": 7, "seq": seq, "sent_ns": sent_ns}
    return sample_messages.presence(src, dst, **{**usual, **head, **about})


def heard(*said: Presence, at_ns: int = 2 * S) -> Neighbours:
    found = Neighbours(FLEET, "r01")
    for each in said:
        found.hear(each.src, each, at_ns)
    return found


def test_it_is_as_small_as_was_meant() -> None:
    assert 150 < len(encode(presence())) < 420 < NEAR.limit


def test_a_neighbour_is_where_it_should_be_by_now_whatever_its_clock() -> None:
    """Said half a second before it was heard on a clock that is a second behind, and heard 0.4 s ago."""
    found = heard(presence("r03"), presence(t_ns=S - S // 10))
    one, other = found.discs(2 * S + 4 * S // 10)  # in the order of their names
    assert one.at_m == pytest.approx((1.0 + 0.5 * 0.2, 0.8 - 0.5 * 0.1)) and one.clear_m == 0.34
    assert other.at_m == pytest.approx((1.0 + 0.4 * 0.2, 0.8 - 0.4 * 0.1))
    assert one.spread_m2 == (4e-4, 1e-4, 1e-4) and one.strays_m > other.strays_m > 0.0 and one.yields


def test_nobody_is_in_a_wall() -> None:
    """One that nearly does not know where it is may say so; there its ring would be in the wall."""
    (one,) = heard(presence(x_m=1.0, y_m=1.98, v_x_m_s=0.0, v_y_m_s=0.0)).discs(2 * S)
    assert one.at_m == pytest.approx((1.0, 2.0 - 0.17))


def test_a_word_that_was_queued_is_older_than_it_looks() -> None:
    found = heard(presence())
    found.hear("r02", presence(seq=2, sent_ns=S + S // 10), 2 * S + S // 2)  # 0.4 s later than it should
    (one,) = found.discs(2 * S + S // 2)
    assert one.at_m == pytest.approx((1.0 + 0.4 * 0.2, 0.8 - 0.4 * 0.1))


@pytest.mark.parametrize(
    ("about", "why"),
    [
        ({"x_m": 3.5}, "outside the tank"),
        ({"goal_y_m": -0.5}, "outside the tank"),
        ({"depth_m": 2.0}, "outside the tank"),
        ({"cov": (-1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)}, "no covariance"),
        ({"cov": (1e-4, 2e-4, 0.0, 1e-4, 0.0, 1e-4)}, "no covariance"),
        ({"cov": (50.0, 0.0, 0.0, 50.0, 0.0, 1e-4)}, "no covariance"),
        ({"v_x_m_s": 3.0}, "faster than"),
        ({"t_ns": S + 1}, "not of the time"),
        ({"sent_ns": 3 * S, "t_ns": S}, "not of the time"),
        ({"dst": "r03"}, "not addressed to us"),
        ({"fleet": "tank"}, "not addressed to us"),
        ({"src": "r09"}, "not a neighbour"),
    ],
)
def test_what_cannot_be_is_not_believed(about: dict[str, Any], why: str) -> None:
    found = heard(presence())
    with pytest.raises(Refusal, match=why):
        found.hear(about.get("src", "r02"), presence(**{"seq": 2, **about}), 2 * S)
    assert len(found.discs(2 * S)) == 1 and found.cache.senders["r02"].heard == 1


def test_no_number_of_it_may_be_none() -> None:
    with pytest.raises(ValueError, match="v_y_m_s is not finite"):
        presence(v_y_m_s=float("nan"))


def test_the_old_word_of_a_neighbour_is_not_taken_for_a_new_one() -> None:
    found = heard(presence(seq=5))
    with pytest.raises(Refusal, match="repeated or out of order"):
        found.hear("r02", presence(seq=5), 2 * S)


def taken(inbox: Inbox, *items: Heard) -> dict[str, int]:
    inbox.receive(items, (), Status("swim", "r01", 7), 3 * S)
    return inbox.refused


def test_a_step_takes_it_from_the_key_of_its_sender_alone() -> None:
    agent = Agent(FLEET, "r01", CALIBRATION, incarnation=7)
    item = Heard(arrived_ns=2 * S, src="r02", payload=encode(presence()), topic="near")
    assert taken(agent.inbox, replace(item, src="r03")) == {"address": 1}
    assert (
        taken(agent.inbox, item) == {"address": 1}
        and len(swimmer_of(agent.capabilities).deconfliction.neighbours.discs(3 * S)) == 1
    )
    assert taken(agent.inbox, replace(item, payload=b"\xc1"))["garbage"] == 1
    nan = encode(presence(seq=2)).replace(encode_float(0.2), encode_float(float("nan")))
    assert taken(agent.inbox, replace(item, payload=nan))["content"] == 1
    assert taken(agent.inbox, replace(item, payload=item.payload + bytes(NEAR.limit)))["size"] == 1
    assert len(swimmer_of(agent.capabilities).deconfliction.neighbours.discs(3 * S)) == 1


def encode_float(value: float) -> bytes:
    return b"\xcb" + struct.pack(">d", value)


def test_a_moored_robot_says_nothing_of_it_and_does_not_understand_it() -> None:
    moored = fleet(swims=False)
    agent = Agent(moored, "r1", CALIBRATION, incarnation=7)
    item = Heard(arrived_ns=2 * S, src="r02", payload=encode(presence()), topic="near")
    assert taken(agent.inbox, item) == {"fleet file": 1}
    assert "near" not in encode(agent.step(InTank(moored).inputs, S)).decode("latin1")


def test_who_is_silent_is_told() -> None:
    found = heard(presence(), presence("r03"))
    assert found.faults(2 * S + SILENT_NS) == ()
    (one, two) = found.faults(2 * S + SILENT_NS + S)
    assert one.startswith("silent neighbour: r02") and "r03" in two


# --- glances ----------------------------------------------------------------------------------------------------


def test_a_claim_ends_by_itself_on_our_clock() -> None:
    found = heard(presence(glance_until_ns=S + S // 2), presence("r03"))
    assert found.at_landmarks(2 * S + 4 * S // 10) == ("r02",) and found.at_landmarks(2 * S + S // 2) == ()
    greedy = heard(presence(glance_until_ns=S + 3600 * S))
    assert greedy.at_landmarks(2 * S + LONGEST_NS - 1) and not greedy.at_landmarks(2 * S + LONGEST_NS)


# --- in the tank --------------------------------------------------------------------------------------------------


def swapped(*, told: bool) -> tuple[FleetInTank, float, float]:
    """Two that swap places: the tank, their least distance, and how far on its left each had the other at least, m."""
    tank, least, left = FleetInTank(fleet_of(POSES[:2]), seed=4), 9.0, 9.0
    tank.silent = set() if told else {"r01", "r02"}
    for step in range((13 if told else 8) * 20):
        tank.step()
        if step == 3 * 20:
            tank.goto("r01", POSES[1][:2])
            tank.goto("r02", POSES[0][:2])
        least = min(least, tank.least_m())
        if abs(tank.places[0][0] - tank.places[1][0]) < 0.1:
            left = min(left, tank.places[1][1] - tank.places[0][1])
    return tank, least, left


def test_two_that_meet_head_on_pass_each_other_on_the_right() -> None:
    tank, least, left = swapped(told=True)
    assert least > 0.34 and left > 0.34
    assert tank.places[0][0] > 1.7 and tank.places[1][0] < 1.3  # and swim on to where they were to go


def test_without_a_word_they_would_have_met() -> None:
    assert swapped(told=False)[1] < 0.2


def test_one_of_a_fleet_looks_for_landmarks_at_a_time() -> None:
    """r02 said that it does; r01 waits for as long as it can afford to."""
    one = FleetInTank(fleet_of(POSES[:2]), seed=4).robots["r01"]
    assert one.until(lambda: not one.swimmer.lost and not one.swimmer._at_landmarks, 6.0)
    one.sees_tags, unsure = False, []
    for seq in range(1, 4 * 20):
        said = presence(seq=seq, sent_ns=one.now_ns, glance_until_ns=one.now_ns + S // 2)
        one.step(heard=[Heard(arrived_ns=one.now_ns, src="r02", payload=encode(said), topic="near")])
        here = one.swimmer.localizer.at(one.now_ns)
        unsure.append(((here.covariance[0] + here.covariance[3]) ** 0.5, one.swimmer._at_landmarks))
    waited = [sigma_m for sigma_m, glances in unsure if not glances]
    assert max(waited) > 0.032 and unsure[-1][1]
