"""Whose word counts: by signature in fleets with keys, by mouth in fleets without."""

import pytest

from agent.core.trust import BURST, DIRECT_NS, HEARSAY, OVERDRAWN, VERIFIED_HZ, Authority

SECOND_NS = 10**9
SAYS = b"what was said"


def genuine(public: bytes, signature: bytes, said: bytes) -> bool:
    return signature == public + said


def fault(authority: Authority, src: str, origin: str, signature: bytes = b"", now_ns: int = 0) -> str | None:
    return authority.fault(src, origin, signature, lambda: SAYS, now_ns)


@pytest.fixture
def signed() -> Authority:
    authority = Authority(("r2", "r3"), genuine)
    authority.keys = {"r2": b"two", "r3": b"three"}
    return authority


def test_a_signature_counts_from_any_mouth_and_nothing_else_does(signed) -> None:
    assert fault(signed, "r2", "r3", b"three" + SAYS) is None
    assert fault(signed, "r3", "r3") == "unsigned"
    assert fault(signed, "r3", "r4", b"four" + SAYS) == "no key"
    assert fault(signed, "r3", "r2", b"three" + SAYS) == "bad signature"


def test_a_wrong_signature_empties_the_budget_of_who_passed_it_on_and_of_nobody_else(signed) -> None:
    assert fault(signed, "r2", "r3", b"wrong") == "bad signature"
    assert fault(signed, "r2", "r3", b"three" + SAYS) == OVERDRAWN
    assert fault(signed, "r3", "r3", b"three" + SAYS) is None
    signed.heard("r2", round(1.01 / VERIFIED_HZ * SECOND_NS))
    assert fault(signed, "r2", "r3", b"three" + SAYS) is None, "and it fills again"


def test_a_flood_of_genuine_signatures_is_verified_at_the_rate_that_is_bearable(signed) -> None:
    verified = 0
    for k in range(10_000):  # in one second
        signed.heard("r2", k * SECOND_NS // 10_000)
        verified += fault(signed, "r2", "r3", b"three" + SAYS) is None
    assert verified <= BURST + VERIFIED_HZ


def test_without_keys_who_is_heard_speaks_for_itself() -> None:
    authority = Authority(("r2", "r3"))
    assert fault(authority, "r3", "r2", now_ns=SECOND_NS) is None, "r2 was never heard: r3 may speak for it"
    authority.heard("r2", SECOND_NS)
    assert fault(authority, "r3", "r2", now_ns=SECOND_NS) == HEARSAY
    assert fault(authority, "r2", "r2", now_ns=SECOND_NS) is None
    assert fault(authority, "r3", "r2", now_ns=SECOND_NS + DIRECT_NS + 1) is None, "silent for long"
