"""What a neighbour lacks is sent again, what nobody can have measured is refused, and nothing of it stops a robot."""

import itertools
import random

import pytest
from msgspec.structs import replace

from agent.capabilities.survey.coverage_map import CoverageMap
from agent.capabilities.survey.exchange import Exchange, holdings
from agent.core.capability_messages import MOST_NUMBER, Claim, Keyframe, View
from agent.core.codec import Refusal, encode
from agent.core.config import Fleet
from agent.core.step_io import Heard, Inputs
from agent.experiments.reconstruction.coverage import SIZE_M, SURFACE_M, World, fleet_of
from agent.experiments.reconstruction.drawn_scene import draw_scene
from agent.robot.step import Agent
from tests.capabilities.survey.frames import FLEET, GRID, LENS, ROWS, drawn_frames

FRAMES = drawn_frames(10)
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def line_of_three() -> Fleet:
    """r1 - r2 - r3."""
    links = {"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)}
    robots = {name: replace(FLEET.robot[name], neighbours=of) for name, of in links.items()}
    return replace(FLEET, robot=robots)


class Net:
    """Exchanges alone, with words that get lost by a rule."""

    def __init__(self, fleet: Fleet, lost=lambda k: False) -> None:
        self.robots = {n: Exchange(fleet, n, 1, CoverageMap(GRID)) for n in fleet.robot}
        self.now, self.sent, self._lost, self._k = START, 0, lost, itertools.count()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 20)):
            self.now += SECOND // 20
            said = [w for e in self.robots.values() for w in (*e.say(None, 0, self.now), *e.send(self.now))]
            for e in self.robots.values():
                e.end_step()
            for word in said:
                self.sent += isinstance(word, Keyframe)
                if not self._lost(next(self._k)):
                    to = self.robots[word.dst]
                    hear = to.hear_claim if isinstance(word, Claim) else to.hear_keyframe
                    hear(word.src, word, self.now)

    def digests(self) -> set[str]:
        return {e.known.digest() for e in self.robots.values()}


def give(net: Net) -> None:
    for one in FRAMES:
        if one.origin in net.robots:
            net.robots[one.origin].known.add(one)


def test_without_loss_each_keyframe_goes_to_each_neighbour_once():
    net = Net(FLEET)
    give(net)
    net.run(6.0)
    assert len(net.digests()) == 1 and net.sent == len(FRAMES) * 4


@pytest.mark.parametrize("loss", [0.3, 0.6])
def test_what_is_lost_is_sent_again_until_all_maps_are_alike(loss):
    draw = random.Random(7)
    net = Net(FLEET, lambda k: draw.random() < loss)
    give(net)
    net.run(25.0)
    assert len(net.digests()) == 1
    maps = {e.known.as_bytes() for e in net.robots.values()}
    assert len(maps) == 1 and all(len(e.known.held) == len(FRAMES) for e in net.robots.values())


def test_along_a_line_the_middle_passes_on_what_both_ends_saw():
    net = Net(line_of_three())
    give(net)
    net.run(8.0)
    held = {name: set(e.known.held) for name, e in net.robots.items()}
    assert held["r1"] == held["r3"] == held["r2"] and {key[0] for key in held["r1"]} == {"r1", "r2", "r3"}


def test_who_restarts_gets_back_what_it_saw_before():
    net = Net(line_of_three())
    give(net)
    net.run(6.0)
    before = net.digests()
    net.robots["r1"] = Exchange(line_of_three(), "r1", net.now, CoverageMap(GRID))
    net.run(6.0)
    assert net.digests() == before and len(before) == 1


def word(frame, src="r2", seq=1, **about) -> Keyframe:
    said = Keyframe(fleet="survey", src=src, dst="r1", incarnation=1, seq=seq, sent_ns=START, frame=frame)
    return replace(said, **about)


def test_an_origin_that_speaks_is_believed_from_its_own_mouth_alone():
    exchange = Exchange(FLEET, "r1", 1, CoverageMap(GRID))
    claim = Claim(fleet="survey", src="r3", dst="r1", incarnation=1, seq=1, sent_ns=START)
    exchange.hear_claim("r3", claim, START)
    of_r3 = next(f for f in FRAMES if f.origin == "r3")
    exchange.hear_keyframe("r2", word(of_r3), START + SECOND)
    assert not exchange.known.held
    exchange.hear_keyframe("r2", word(of_r3, seq=2), START + 10 * SECOND)  # r3 has been silent since
    assert len(exchange.known.held) == 1


GOOD = FRAMES[1]
TWICE = tuple(2 * q for q in GOOD.turn)


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        (replace(GOOD, depths=GOOD.depths[:-1]), "content"),
        (replace(GOOD, sigmas=b"", depths=b""), "content"),
        (replace(GOOD, sigmas=GOOD.sigmas[:-1], depths=GOOD.depths[:-2]), "content"),
        (replace(GOOD, place=(10**6, 0, 0)), "content"),
        (replace(GOOD, turn=(0, 0, 0, 0)), "content"),
        (replace(GOOD, turn=TWICE), "content"),
        (replace(GOOD, origin="r9"), "content"),
        (replace(GOOD, incarnation=START + 4 * 3600 * SECOND), "clock"),
    ],
)
def test_what_nobody_can_have_measured_is_refused(frame, kind):
    exchange = Exchange(FLEET, "r1", 1, CoverageMap(GRID))
    with pytest.raises(Refusal) as refused:
        exchange.hear_keyframe("r2", word(frame), START)
    assert refused.value.kind == kind and not exchange.known.held
    exchange.hear_keyframe("r2", word(GOOD), START)
    assert len(exchange.known.held) == 1


def test_a_robot_that_hears_anything_at_all_goes_on_surveying():
    fleet = fleet_of(count=2)
    world = World(fleet, draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), 1), 1, True, 0.0)
    agent: Agent = world.agents["r1"]
    view = View(GOOD.place, GOOD.turn, replace(LENS, f=10**6, cx=-(10**6), bend=-20_000, block=1000), ROWS, 1)
    payloads = [
        encode(word(replace(GOOD, lens=replace(LENS, f=100, bend=20_000, ahead=-5000)))),
        encode(word(replace(GOOD, number=MOST_NUMBER, sigmas=b"\xff" * 475, depths=b"\xff\xff" * 475), seq=2)),
        encode(word(GOOD, seq=3))[:-3],
        encode(
            Claim(fleet="survey", src="r2", dst="r1", incarnation=1, seq=1, sent_ns=START, view=view, until_ns=2**62)
        ),
        b"\x93" * 200,
        b"",
    ]
    for k in range(240):
        heard = tuple(
            Heard(arrived_ns=world.now_ns, src="r2", payload=payload, topic=topic)
            for topic in ("keyframe", "claim")
            for payload in (payloads if k % 60 == 30 else ())
        )
        world._post["r1"] += heard
        world.step()
    assert agent.transaction.fault(world.now_ns) is None
    assert agent.capabilities["survey"].surveyor.keyframes >= 1 and sum(agent.inbox.refused.values()) > 10


def test_a_fleet_without_the_table_says_none_of_it_and_believes_none():
    fleet = replace(
        fleet_of(count=2),
        coverage=None,
        robot={n: replace(r, behaviour=None) for n, r in fleet_of(count=2).robot.items()},
    )
    world = World(fleet_of(count=2), draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), 1), 1, True, 0.0)
    agent = Agent(fleet, "r1", world.calibration, START)
    for k in range(60):
        now = START + k * SECOND // 20
        heard = (Heard(arrived_ns=now, src="r2", payload=encode(word(GOOD)), topic="keyframe"),) if k == 30 else ()
        outputs = agent.step(Inputs(heard=heard), now)
        assert b"claims" not in encode(outputs) and b"keyframes" not in encode(outputs)
    assert agent.inbox.refused == {"fleet file": 1}


def test_three_robots_with_thirty_percent_loss_have_the_same_map():
    world = World(fleet_of(count=3), draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), 2), 2, True, 0.3)
    for _ in range(260):
        world.step()
    world.stop()
    for _ in range(160):
        world.step()
    assert world.equal() and len(world.all.held) >= 3
    known = [agent.capabilities["survey"].surveyor.known for agent in world.agents.values()]
    assert {each.as_bytes() for each in known} == {world.all.as_bytes()}
    assert [len(holdings(each)) for each in known] == [3, 3, 3]
