"""A folder of public keys under the eyes of a diving robot: what is a change, and what is an accident."""

import shutil
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec.structs import replace

from agent.core.codec import decode, encode
from agent.core.messages import Epoch, Estimate
from agent.core.trust import entry_bytes, proposal_bytes, sample_bytes, verify_signature
from agent.ground.new_fleet import make_keys
from agent.process import keys as key_folder
from agent.process.keys import KeyFolder, public_bytes, read_public, signing, unsigned
from tests.process.said import FOREIGN, START, entry, proposal, said, sample
from tests.sample_messages import estimate

ROBOTS = ("r1", "r2", "r3")
SECOND_NS = 1_000_000_000


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    make_keys(ROBOTS, tmp_path / "keys")
    return tmp_path / "keys"


def public(folder: Path, *names: str) -> dict[str, bytes]:
    return {name: read_public(folder / f"{name}.sign.pub") for name in names}


def test_all_at_first_then_nothing_until_one_goes_and_all_that_are_left_then(keys: Path) -> None:
    watched, everybody = KeyFolder(keys, ROBOTS), public(keys, *ROBOTS)
    assert watched.changed(0) == everybody
    assert watched.changed(SECOND_NS) is None
    (keys / "r2.sign.pub").unlink()
    assert watched.changed(2 * SECOND_NS) == public(keys, "r1", "r3")
    assert watched.changed(3 * SECOND_NS) is None
    make_keys(["r2"], keys.parent / "new")
    shutil.copy(keys.parent / "new" / "r2.sign.pub", keys)
    renewed = watched.changed(4 * SECOND_NS)
    assert renewed == {**everybody, **public(keys, "r2")} != everybody


def test_none_left_is_an_answer_too(keys: Path) -> None:
    watched = KeyFolder(keys, ROBOTS)
    watched.changed(0)
    for name in ROBOTS:
        (keys / f"{name}.sign.pub").unlink()
    assert watched.changed(SECOND_NS) == {}


def test_it_looks_once_a_second_however_often_it_is_asked(keys: Path, monkeypatch) -> None:
    looked_ns = []
    now_ns = 0

    def noting(folder, robots):
        looked_ns.append(now_ns)
        return real(folder, robots)

    real = key_folder.read_keys
    monkeypatch.setattr(key_folder, "read_keys", noting)
    watched = KeyFolder(keys, ROBOTS)
    for now_ns in range(0, 5 * SECOND_NS, SECOND_NS // 20):
        watched.changed(now_ns)
    assert looked_ns == [k * SECOND_NS for k in range(5)]


def test_a_key_that_is_missing_is_a_fault_without_a_path_of_this_machine(keys: Path) -> None:
    (keys / "r3.sign.pub").unlink()
    watched = KeyFolder(keys, ROBOTS)
    assert watched.changed(0) == public(keys, "r1", "r2")
    assert watched.fault == "nothing of r3 is believed without r3.sign.pub"
    shutil.copy(keys / "r2.sign.pub", keys / "r3.sign.pub")  # a slip
    assert watched.changed(SECOND_NS) is None
    assert watched.fault == "r3.sign.pub: the same key as r2.sign.pub; give each robot its own"
    make_keys(["r3"], keys.parent / "new")
    shutil.copy(keys.parent / "new" / "r3.sign.pub", keys)
    assert watched.changed(2 * SECOND_NS) == public(keys, *ROBOTS)
    assert watched.fault is None


def test_a_half_copied_key_withdraws_nothing(keys: Path) -> None:
    watched = KeyFolder(keys, ROBOTS)
    everybody = watched.changed(0)
    whole = (keys / "r2.sign.pub").read_bytes()
    for k, part in enumerate((b"", whole[:50]), start=1):
        (keys / "r2.sign.pub").write_bytes(part)
        assert watched.changed(k * SECOND_NS) is None
        assert watched.fault == "r2.sign.pub: no public key in PEM; copy the file again, whole"
    (keys / "r2.sign.pub").write_bytes(whole)
    assert watched.changed(3 * SECOND_NS) is None and watched.fault is None
    (keys / "r2.sign.pub").unlink()
    assert watched.changed(4 * SECOND_NS) == {name: everybody[name] for name in ("r1", "r3")}


def test_a_folder_that_is_gone_withdraws_nothing_and_is_told(keys: Path) -> None:
    watched = KeyFolder(keys, ROBOTS)
    watched.changed(0)
    keys.rename(keys.with_name("away"))
    assert watched.changed(SECOND_NS) is None
    assert watched.fault == "their folder cannot be read; those read before are kept"
    keys.with_name("away").rename(keys)
    assert watched.changed(2 * SECOND_NS) is None and watched.fault is None


def test_keys_of_strangers_are_none_of_its_business(keys: Path) -> None:
    make_keys(["r9"], keys)
    (keys / "notes.txt").write_text("r9 comes on Monday")
    watched = KeyFolder(keys, ROBOTS)
    assert watched.changed(0) == public(keys, *ROBOTS) and watched.fault is None


# --- signing ---
# What a robot signs can be verified by whoever gets it, and it signs nothing but its own word of this life.

KEY = Ed25519PrivateKey.generate()
PUBLIC = public_bytes(KEY.public_key())


class CountingKey:
    """A private key that counts how often it is used."""

    def __init__(self) -> None:
        self.used = 0

    def sign(self, content: bytes) -> bytes:
        self.used += 1
        return KEY.sign(content)


def arrived(sent: Estimate) -> Estimate:
    return decode(encode(sent), Estimate)


def test_what_it_signs_verifies_at_the_other_end() -> None:
    got = arrived(signing("r1", KEY)(said(entry(), sample(), proposal())))
    gossip = got.gossip
    (one,), (two,), (three,) = gossip.entries, gossip.samples, gossip.proposals
    assert verify_signature(PUBLIC, one.signature, entry_bytes(got.fleet, got.target, gossip.epoch, one))
    assert verify_signature(PUBLIC, two.signature, sample_bytes(got.fleet, got.target, gossip.epoch, two))
    assert verify_signature(PUBLIC, three.signature, proposal_bytes(got.fleet, got.target, three))


def test_numbers_without_a_point_verify_too() -> None:
    """A zero that the algebra wrote as an integer arrives as 0.0, which has other bytes."""
    whole = {"information": (1, 0, 0, 1, 0, 1), "vector": (0, 0, 0)}
    got = arrived(signing("r1", KEY)(said(entry(**whole, systematic_m2=(0,) * 6), sample(**whole))))
    (one,), (two,) = got.gossip.entries, got.gossip.samples
    assert verify_signature(PUBLIC, one.signature, entry_bytes(got.fleet, got.target, got.gossip.epoch, one))
    assert verify_signature(PUBLIC, two.signature, sample_bytes(got.fleet, got.target, got.gossip.epoch, two))


@pytest.mark.parametrize(
    "changed",
    [
        {"fleet": "other"},
        {"target": "buoy"},
        {"epoch": Epoch(counter=4)},
        {"entry": {"count": 6}},
        {"entry": {"origin": "r2"}},
        {"entry": {"incarnation": START + 1}},
        {"entry": {"vector": (1.0, 2.0, -3.4)}},
        {"entry": {"systematic_m2": (0.0,) * 6}},
    ],
    ids=str,
)
def test_nothing_of_an_entry_can_be_shown_elsewhere_or_changed(changed: dict) -> None:
    got = signing("r1", KEY)(said(entry()))
    (one,) = got.gossip.entries
    where = {"fleet": got.fleet, "target": got.target, "epoch": got.gossip.epoch, **changed}
    shown = replace(one, **where.pop("entry", {}))
    assert not verify_signature(PUBLIC, one.signature, entry_bytes(entry=shown, **where))


def test_the_age_of_a_sample_is_the_relays_to_write() -> None:
    got = signing("r1", KEY)(said(sample()))
    older = replace(got.gossip.samples[0], age_ns=10**9)
    assert verify_signature(PUBLIC, older.signature, sample_bytes(got.fleet, got.target, got.gossip.epoch, older))


def test_the_word_of_others_passes_as_it_came() -> None:
    word = (
        entry("r2", signature=FOREIGN),
        entry("r3"),  # of a fleet where r3 has no key: not ours to vouch for
        sample("r2", signature=FOREIGN),
        sample("r3"),
        proposal("r2", signature=FOREIGN),
        proposal("r3"),
    )
    assert signing("r1", KEY)(said(*word)) == said(*word)


def test_its_own_word_of_an_earlier_life_passes_as_it_came() -> None:
    """Signed, it came back from others. Unsigned, somebody made it up: to sign that would make it true."""
    earlier = (
        entry(incarnation=START - 10, signature=FOREIGN),
        entry(incarnation=START - 20),
        sample(incarnation=START - 10),
        proposal(since_ns=START - 10),
    )
    assert signing("r1", KEY)(said(*earlier)) == said(*earlier)


def test_a_new_incarnation_of_the_entry_is_signed_as_the_first() -> None:
    got = signing("r1", KEY)(said(entry(), entry(incarnation=START + 10**10)))
    assert all(
        verify_signature(PUBLIC, one.signature, entry_bytes(got.fleet, got.target, got.gossip.epoch, one))
        for one in got.gossip.entries
    )


def test_nothing_but_signatures_is_changed() -> None:
    before = said(entry(), sample(), proposal(), x_m=(0.1, 0.2, 0.3), seq=9)
    after = signing("r1", KEY)(before)
    assert before.gossip.entries[0].signature == b"", "what is recorded stays as it was"
    bare = replace(
        after.gossip,
        entries=tuple(replace(e, signature=b"") for e in after.gossip.entries),
        samples=tuple(replace(s, signature=b"") for s in after.gossip.samples),
        proposals=tuple(replace(p, signature=b"") for p in after.gossip.proposals),
    )
    assert replace(after, gossip=bare) == before


def test_a_protocol_without_gossip_has_nothing_to_sign() -> None:
    plain = estimate("r1", "r2")
    assert signing("r1", KEY)(plain) is plain and unsigned(plain) is plain


def test_the_same_word_to_many_neighbours_and_again_is_signed_once() -> None:
    key = CountingKey()
    sign = signing("r1", key)
    for seq in range(10):
        for dst in ("r2", "r3", "r4"):
            sign(said(entry(), sample(), sample(number=8), proposal(), dst=dst, seq=seq))
    assert key.used == 4
    sign(said(entry(count=6)))
    assert key.used == 5
    sign(said(entry(count=6), target="buoy"))
    assert key.used == 6


def test_what_is_remembered_has_a_limit() -> None:
    key = CountingKey()
    sign = signing("r1", key)
    for count in range(1, 3000):
        sign(said(entry(count=count)))
    sign(said(entry(count=2999)))
    assert key.used == 2999
    sign(said(entry(count=1)))
    assert key.used == 3000
