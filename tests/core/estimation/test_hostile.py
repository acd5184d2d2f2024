"""What a robot that lies, restarts or is forged can do to the evidence of others, and what it cannot (bars L5, L7)."""

import math
from random import Random

import msgspec
import pytest

from agent.core.codec import Refusal, decode, encode
from agent.core.estimation.evidence_table import INCARNATIONS
from agent.core.estimation.interface import EstimateCache, Prior
from agent.core.link_clocks import CLOCKS_NS
from agent.core.messages import Entry, Estimate, Gossip
from agent.core.trust import CachedMessage
from tests.core.estimation.linked_robots import COV, NAMES, PUBLIC, SECOND_NS, SIGN, Net
from tests.sample_messages import estimate

LIAR = NAMES[2]
INFORMATION = (1e4, 0.0, 0.0, 1e4, 0.0, 1e4)
AT_M = (0.9, 0.5, 0.1)
VECTOR = tuple(1e4 * x for x in AT_M)
SYSTEMATIC = (0.0,) * 6


def mesh(n: int = 3, signed: bool = True) -> Net:
    """Robots that have measured for eight seconds; the target is at 0.7, 0.5, 0.1."""
    net = Net({a: tuple(b for b in NAMES[:n] if b != a) for a in NAMES[:n]}, signed=signed)
    random = Random(1)
    for _ in range(8):
        net.tick({name: Prior((0.7 + random.gauss(0, 0.01), 0.5, 0.1), COV, net.now_ns) for name in net.links})
    return net


def tell(net: Net, to: str, *entries: Entry, by: str = LIAR, sign: bool = True) -> tuple[str, ...]:
    """`by` says these entries to one robot, signed with its own key; returns what was not believed."""
    said = Gossip(net.robots[to].epoch, entries=entries)
    letter = estimate(by, to, incarnation=net.start[by], seq=10**4, sent_ns=net.now_ns, gossip=said)
    return net.robots[to].hear(CachedMessage(SIGN[by](letter) if sign else letter, net.now_ns, 0))


def entry(origin: str, incarnation: int, count: int = 20, **about: object) -> Entry:
    return Entry(origin, incarnation, count, INFORMATION, VECTOR, SYSTEMATIC, **about)


def table(net: Net, name: str):
    return net.robots[name]._mode._table.entries


@pytest.mark.parametrize("signed", [True, False])
def test_invented_incarnations_take_nothing_of_ours_away(signed) -> None:
    net, me = mesh(signed=signed), NAMES[0]
    before, own = net.robots[me].posterior, table(net, me)[me, 1]
    for origin in (me, NAMES[1]):
        refused = tell(net, me, *(entry(origin, 100 + k) for k in range(17)))
        assert refused or not signed, "whom we hear speaks for itself: what others say of it is passed over"
    assert table(net, me)[me, 1] == own
    assert net.robots[me].posterior == before
    net.tick({})


def test_a_liar_fills_no_table_with_its_own_starts() -> None:
    net, me = mesh(), NAMES[0]
    tell(net, me, *(entry(LIAR, 100 + k, 1) for k in range(17)))
    assert len([key for key in table(net, me) if key[0] == LIAR]) == INCARNATIONS


@pytest.mark.parametrize("signed", [True, False])
def test_without_keys_or_with_them_nobody_speaks_for_who_is_heard(signed) -> None:
    net, me, other = mesh(signed=signed), NAMES[0], NAMES[1]
    before = net.robots[me].posterior
    tell(net, me, entry(other, 1, 10**3), entry(other, 2), entry(me, 0), sign=False)
    assert net.robots[me].posterior == before


def test_two_words_under_one_count_end_as_one_on_all_robots_and_are_told() -> None:
    net = mesh(4)
    first, second = entry(LIAR, 1, 30), entry(LIAR, 1, 30)
    second = msgspec.structs.replace(second, vector=(7001.0, 5000.0, 1000.0))
    assert tell(net, NAMES[0], first) == ()
    assert tell(net, NAMES[1], second) == ()
    net.cut = {(LIAR, name) for name in net.links}
    for _ in range(3):
        net.tick({})
    held = {table(net, name)[LIAR, 1] for name in (NAMES[0], NAMES[1], NAMES[3])}
    assert len(held) == 1
    assert max(e.vector for e in held) == first.vector, "the larger numbers stand, whoever heard what first"


def test_a_count_that_no_time_allows_and_a_start_that_is_yet_to_come_are_refused() -> None:
    net, me = mesh(), NAMES[0]
    assert tell(net, me, entry(LIAR, 1, 10**6)) == ("too many samples",)
    assert tell(net, me, entry(LIAR, net.now_ns + CLOCKS_NS + SECOND_NS, 1)) == ("from the future",)


def test_whose_key_is_gone_does_not_count_from_this_moment_on() -> None:
    net, me = mesh(), NAMES[0]
    assert tell(net, me, entry(LIAR, 50, 20)) == ()
    net.robots[me].trust({name: PUBLIC[name] for name in net.links if name != LIAR})
    assert not any(origin == LIAR for origin, _ in table(net, me))
    assert "no key" in tell(net, me, entry(LIAR, 60, 20))
    clean = mesh()
    for key in [key for key in table(clean, me) if key[0] == LIAR]:
        clean.robots[me]._mode._table.drop(key)
    clean.robots[me]._stale = True
    assert net.robots[me].posterior == clean.robots[me].posterior


def test_a_robot_whose_clock_was_set_back_begins_after_its_former_life() -> None:
    net, me = mesh(), NAMES[0]
    net.start[me] = 0
    net.boot(me)  # an earlier start than the one that the others know
    for _ in range(15):
        net.tick({me: Prior((0.71, 0.5, 0.1), COV, net.now_ns)})
    assert net.robots[me]._me.key[1] > 1
    newest = max(key[1] for key in table(net, NAMES[1]) if key[0] == me)
    assert newest == net.robots[me]._me.key[1]


def test_a_robot_that_was_knocked_and_repaired_is_believed_at_once() -> None:
    net, wrong = mesh(), NAMES[1]
    net.restart(wrong)
    for _ in range(30):
        net.tick({name: Prior((0.7 + 0.3 * (name == wrong), 0.5, 0.1), COV, net.now_ns) for name in net.links})
    net.start[wrong] = net.now_ns
    net.boot(wrong)
    for _ in range(10):
        updates = net.tick({name: Prior((0.7, 0.5, 0.1), COV, net.now_ns) for name in net.links})
    assert updates[NAMES[0]].explain.weights[wrong] > 0.05
    assert math.dist(net.robots[NAMES[0]].posterior.x_m, (0.7, 0.5, 0.1)) < 0.004


def cache_with(**about: int) -> EstimateCache:
    box = EstimateCache("tank", "r1", "ball", ("r2", "r3"))
    told = {"incarnation": 1, "seq": 5, "sent_ns": 100 * SECOND_NS, "t": 50, **about}
    box.put("r2", estimate("r2", "r1", **told), 100 * SECOND_NS)
    return box


def test_one_wild_number_does_not_silence_a_neighbour() -> None:
    box = cache_with()
    with pytest.raises(Refusal, match="runs ahead"):
        box.put("r2", estimate("r2", "r1", incarnation=1, seq=2**63, sent_ns=100 * SECOND_NS), 101 * SECOND_NS)
    box.put("r2", estimate("r2", "r1", incarnation=1, seq=6, sent_ns=101 * SECOND_NS), 101 * SECOND_NS)
    with pytest.raises(Refusal, match="first number"):
        box.put("r3", estimate("r3", "r1", incarnation=1, seq=2**63, sent_ns=100 * SECOND_NS), 101 * SECOND_NS)


def test_a_neighbour_that_told_a_number_too_large_is_heard_again_at_its_third_word() -> None:
    box = cache_with(seq=900)
    for seq in (6, 7):
        with pytest.raises(Refusal, match="out of order"):
            box.put("r2", estimate("r2", "r1", incarnation=1, seq=seq, sent_ns=101 * SECOND_NS), 101 * SECOND_NS)
    box.put("r2", estimate("r2", "r1", incarnation=1, seq=8, sent_ns=101 * SECOND_NS), 101 * SECOND_NS)


def test_one_neighbour_alone_does_not_set_the_swarm_s_iteration() -> None:
    box, now_ns = cache_with(t=10**9), 100 * SECOND_NS
    box.put("r3", estimate("r3", "r1", incarnation=1, seq=5, sent_ns=now_ns, t=52), now_ns)
    assert box.swarm_t(now_ns, SECOND_NS) == 52


def test_two_robots_of_one_name_are_told() -> None:
    box = cache_with()
    for k, incarnation in enumerate((2, 1, 2, 1)):
        at_ns = (101 + k) * SECOND_NS
        box.put("r2", estimate("r2", "r1", incarnation=incarnation, seq=6 + k, sent_ns=at_ns), at_ns)
    assert box.doubled(105 * SECOND_NS) == ("r2",)
    assert box.doubled(200 * SECOND_NS) == ()


def test_a_schema_as_deep_as_the_stack_is_no_message() -> None:
    bomb = b"\x81\xa6schema" + 1010 * b"\x91" + b"\xc0"
    with pytest.raises(Refusal) as caught:
        decode(bomb, Estimate)
    assert len(str(caught.value)) < 200
    with pytest.raises(Refusal):
        decode(encode(estimate("r1", "r2")).replace(b"\xa6schema\x03", b"\xa6schema\x80"), Estimate)
