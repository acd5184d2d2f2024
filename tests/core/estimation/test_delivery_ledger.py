"""What a neighbour is owed: nothing is given up before it is shown, the longest unsent goes first, restarts owe all."""

from hypothesis import given, settings
from hypothesis import strategies as st

from agent.core.estimation.modes import DIGEST_NS, LINES, DeliveryLedger
from agent.core.messages import Holding

OWN = ("r0", 1)
KEYS = [(f"r{k}", 1) for k in range(9)]


@given(st.integers(1, 4), st.lists(st.booleans(), min_size=60, max_size=60))
@settings(max_examples=60, deadline=None)
def test_whatever_is_lost_everything_arrives_and_own_evidence_goes_first(limit, arrives) -> None:
    ledger, there, versions = DeliveryLedger(), set(), dict.fromkeys(KEYS, 3)
    for arrived in [*arrives, *[True] * len(KEYS)]:
        chosen = ledger.pending(versions, OWN, limit)
        assert len(chosen) <= limit
        if OWN not in there:
            assert chosen[0] == OWN
        if arrived:
            there.update(chosen)
            for key in chosen:
                ledger.acknowledge(key, 3)
    assert there == set(KEYS)
    assert ledger.pending(versions, OWN, limit) == []


@given(st.integers(2, 4), st.integers(1, 30))
@settings(max_examples=40, deadline=None)
def test_without_an_answer_everything_goes_out_in_turns_longest_unsent_first(limit, rounds) -> None:
    ledger, sent = DeliveryLedger(), dict.fromkeys(KEYS, -1)
    for turn in range(rounds):
        chosen = ledger.pending(dict.fromkeys(KEYS, 1), OWN, limit)
        assert chosen[0] == OWN
        others = [key for key in KEYS if key not in chosen]
        assert max(sent[key] for key in chosen[1:]) <= min(sent[key] for key in others)
        sent |= dict.fromkeys(chosen, turn)


def test_an_older_version_in_a_digest_makes_it_owed_again_and_so_does_a_restart() -> None:
    ledger = DeliveryLedger()
    ledger.acknowledge(OWN, 5)
    assert ledger.pending({OWN: 5}, OWN, 4) == []
    ledger.acknowledge(OWN, 4)
    assert ledger.pending({OWN: 5}, OWN, 4) == [OWN]
    ledger.acknowledge(OWN, 5)
    ledger.forget()
    assert ledger.pending({OWN: 5}, OWN, 4) == [OWN]


def test_a_digest_goes_out_on_change_once_a_second_and_after_a_restart() -> None:
    ledger, lines = DeliveryLedger(), [Holding("r0", 1, 3)]
    assert ledger.digest(lines, 1, 0) == tuple(lines)
    assert ledger.digest(lines, 1, DIGEST_NS // 2) == ()
    assert ledger.digest(lines, 2, DIGEST_NS // 2) == tuple(lines)
    assert ledger.digest(lines, 2, DIGEST_NS // 2 + DIGEST_NS) == tuple(lines)
    ledger.forget()
    assert ledger.digest(lines, 2, DIGEST_NS // 2 + DIGEST_NS + 1) == tuple(lines)


def test_a_long_digest_goes_out_in_turns_that_leave_nothing_out() -> None:
    ledger, lines = DeliveryLedger(), [Holding("r0", k, 1) for k in range(2 * LINES + 5)]
    shown = [line for _ in range(3) for line in ledger.digest(lines, 1, 0)]
    assert shown == lines


def test_what_left_the_table_is_forgotten() -> None:
    ledger = DeliveryLedger()
    ledger.acknowledge(OWN, 7)
    ledger.drop({})
    assert ledger.pending({OWN: 7}, OWN, 4) == [OWN]
