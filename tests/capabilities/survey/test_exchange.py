"""What a neighbour lacks is sent again, what nobody can have measured is refused, and nothing of it stops a robot."""

import itertools
import random

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec.structs import replace

from agent.capabilities.survey.coverage_map import STARTS, SUMS, CoverageMap, Held
from agent.capabilities.survey.exchange import Exchange, holdings
from agent.core.capability_messages import MOST_NUMBER, SHORT_MASK, Claim, Frame, Keyframe, View
from agent.core.codec import Refusal, decode, encode
from agent.core.config import Fleet
from agent.core.step_io import Heard, Inputs, Said
from agent.core.topics import KEYFRAME
from agent.experiments.reconstruction.coverage import SIZE_M, SURFACE_M, World, draw_scene, fleet_of
from agent.process.keys import signing
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

    def __init__(self, fleet: Fleet, lost=lambda k: False, keys: bool = False) -> None:
        self.robots = {n: Exchange(fleet, n, 1, CoverageMap(GRID)) for n in fleet.robot}
        for exchange in self.robots.values() if keys else ():
            exchange.trust(PUBLIC)
        self._leaves = as_it_leaves if keys else lambda word: word
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
                    if isinstance(word, Claim):
                        to.hear_claim(word.src, word, self.now)
                    else:
                        to.hear_keyframe(word.src, self._leaves(word), self.now)

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
    assert len(maps) == 1 and all(len(e.known.all_keys()) == len(FRAMES) for e in net.robots.values())


def test_along_a_line_the_middle_passes_on_what_both_ends_saw():
    net = Net(line_of_three())
    give(net)
    net.run(8.0)
    held = {name: set(e.known.all_keys()) for name, e in net.robots.items()}
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
    assert len(exchange.known.all_keys()) == 1


# --- what a liar's words cost, and what they undo -----------------------------------------------------------------


def many(origin: str, count: int, incarnation: int = 1) -> list[Frame]:
    return [replace(FRAMES[k % 10], origin=origin, incarnation=incarnation, number=k + 1) for k in range(count)]


def test_a_restart_costs_no_step_more_than_its_share_of_keyframes(monkeypatch):
    """r2 has said forty keyframes and starts again and again: in no step are more than SUMS added or let go."""
    exchange = Exchange(FLEET, "r1", 1, CoverageMap(GRID))
    for one in many("r2", 40):
        exchange.known.add(one)
    exchange.known.let_go()
    sums, sound = [], exchange.known._sum
    monkeypatch.setattr(exchange.known, "_sum", lambda frame, sign: (sums.append(1), sound(frame, sign)))
    for step in range(60):
        now = START + step * SECOND // 20
        for k, src in enumerate(("r2", "r2", "r3", "r4", "r5")):
            began = 2 + 10 * step + k if src == "r2" else 1
            frame = replace(FRAMES[k], origin=src, incarnation=began, number=step + 1)
            exchange.hear_keyframe(src, word(frame, src, 10 * step + k + 1, sent_ns=now), now)
        exchange.end_step()
        assert 0 < len(sums) <= SUMS
        sums.clear()
    assert len(exchange.known.leaving) <= 1
    assert {"r2", "r3", "r4", "r5"} == {key[0] for key in exchange.known.all_keys()}


def test_what_a_silent_robot_saw_stays_whatever_is_relayed():
    """Four relayed messages of newer starts; then the robot comes back, and counts more than what was invented."""
    exchange = Exchange(FLEET, "r1", 1, CoverageMap(GRID))
    for one in many("r3", 40):
        exchange.known.add(one)
    exchange.known.let_go()
    share, now = exchange.known.share(), START
    for k in range(8):
        now += SECOND
        exchange.hear_keyframe(
            "r2", word(replace(FRAMES[2], incarnation=1000 + k, number=1), seq=k + 1, sent_ns=now), now
        )
        exchange.end_step()
    assert len([key for key in exchange.known.all_keys() if key[:2] == ("r3", 1)]) == 40
    assert exchange.known.share() >= share
    back = word(replace(FRAMES[2], incarnation=500, number=1), "r3", incarnation=500, sent_ns=now)
    exchange.hear_keyframe("r3", back, now)
    assert {("r3", 1), ("r3", 500)} < {key[:2] for key in exchange.known.all_keys()}


def test_who_says_nothing_of_what_it_has_is_sent_no_more_than_it_could_say():
    exchange = Exchange(FLEET, "r1", 1, CoverageMap(GRID))
    exchange.known.held["r1", 1] = {one.number: Held(one, True, b"") for one in many("r1", 400)}
    now, sent = START, []
    for _ in range(200):
        now += SECOND // 20
        sent += [said.frame.number for said in exchange.send(now) if said.dst == "r2"]
    assert set(sent) == set(range(1, 2 + SHORT_MASK))
    assert max(map(len, exchange._sent.values())) == 1 + SHORT_MASK


# --- with keys ----------------------------------------------------------------------------------------------------

KEYS = {name: Ed25519PrivateKey.from_private_bytes(name.encode().ljust(32)) for name in FLEET.robot}
PUBLIC = {name: key.public_key().public_bytes_raw() for name, key in KEYS.items()}


def with_keys(fleet: Fleet) -> Fleet:
    return replace(fleet, access=replace(fleet.access, keys="keys"))


def as_it_leaves(said: Keyframe) -> Keyframe:
    """Signed where it is the robot's own."""
    left = signing(said.src, KEYS[said.src])(Said(topic="keyframe", to=said.dst, payload=encode(said)))
    assert isinstance(left, Said)
    return decode(left.payload, Keyframe, KEYFRAME.limit)


def test_with_keys_a_keyframe_counts_by_its_origins_signature_whoever_passes_it_on():
    exchange = Exchange(with_keys(FLEET), "r1", 1, CoverageMap(GRID))
    own = as_it_leaves(word(FRAMES[2], "r3"))
    with pytest.raises(Refusal, match="no key"):
        exchange.hear_keyframe("r3", own, START)
    exchange.trust(PUBLIC)
    for said, why in (
        (word(FRAMES[2], seq=2), "unsigned"),
        (word(replace(own.frame, number=9), signature=own.signature, seq=3), "bad signature"),
        (as_it_leaves(word(FRAMES[2], seq=4)), "unsigned"),  # nobody signs what another measured
    ):
        exchange.hear_claim(
            "r2", Claim(fleet="survey", src="r2", dst="r1", incarnation=1, seq=said.seq, sent_ns=START), START
        )
        with pytest.raises(Refusal, match=why) as refused:
            exchange.hear_keyframe("r2", said, START + said.seq * 10 * SECOND)
        assert refused.value.kind == "signature"
    exchange.hear_keyframe("r2", replace(own, src="r2", seq=5), START + 60 * SECOND)
    assert exchange.known.held["r3", 1][1] == (own.frame, True, own.signature)


@pytest.mark.parametrize("keys", [False, True])
def test_a_newer_start_that_is_passed_on_pushes_out_an_older_one_where_it_is_signed_alone(keys):
    """r1 starts once more than STARTS times; r3 hears of it through r2."""
    fleet = with_keys(line_of_three()) if keys else line_of_three()
    net = Net(fleet, keys=keys)
    for start in range(STARTS + 1):
        net.robots["r1"] = Exchange(fleet, "r1", net.now, CoverageMap(GRID))
        if keys:
            net.robots["r1"].trust(PUBLIC)
        net.robots["r1"].known.add(replace(FRAMES[start], origin="r1", incarnation=net.now, number=1))
        net.run(3.0)
    began = [key[1] for key in net.robots["r3"].known.all_keys()]
    newest = max(key[1] for key in net.robots["r2"].known.all_keys())
    assert len(began) == STARTS and (newest in began) == keys
    before = net.sent
    net.run(3.0)
    assert net.sent == before  # nothing is sent again and again to who does not take it


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
    assert len(exchange.known.all_keys()) == 1


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
    assert world.equal() and len(world.all.all_keys()) >= 3
    known = [agent.capabilities["survey"].surveyor.known for agent in world.agents.values()]
    assert {each.as_bytes() for each in known} == {world.all.as_bytes()}
    assert [len(holdings(each)) for each in known] == [3, 3, 3]
