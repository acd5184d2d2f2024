"""What signatures cost a loop: to make one, to verify one, to refuse one, and to look at a folder of public keys.

Processor time of one thread. A robot signs its own word once, whoever hears it, and verifies the word of others once.
Noise is refused in 2 us where its numbers are out of range; who forges takes care that they are not.
"""

import tempfile
from collections.abc import Callable
from itertools import count
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from agent.core.codec import decode, encode
from agent.core.messages import Estimate
from agent.core.trust import entry_bytes, verify_signature
from agent.ground.new_fleet import make_keys
from agent.process.agent_process import STEP_NS
from agent.process.keys import public_bytes, read_keys, signing
from tests.bench.bench_vision import medians_s, row
from tests.process.said import EPOCH, FOREIGN, entry, said

ROBOTS = tuple(f"r{k}" for k in range(1, 11))
TIMES = 40  # of each work in one measurement


def run() -> dict[str, dict]:
    key = Ed25519PrivateKey.generate()
    public, sign = public_bytes(key.public_key()), signing("r1", key)
    message = said(entry(), *(entry(name, signature=FOREIGN) for name in ROBOTS[1:]))
    payload, signed = encode(sign(message)), entry_bytes("tank", "ball", EPOCH, entry())
    signature, forged, numbers = key.sign(signed), key.sign(b"something else"), count(1)
    assert verify_signature(public, signature, signed) and not verify_signature(public, forged, signed)
    with tempfile.TemporaryDirectory() as folder:
        make_keys(ROBOTS, Path(folder))
        works = (
            lambda: sign(said(entry(count=next(numbers)))),
            lambda: sign(message),
            lambda: verify_signature(public, signature, signed),
            lambda: verify_signature(public, forged, signed),
            lambda: read_keys(Path(folder), ROBOTS),
            lambda: encode(message),
            lambda: decode(payload, Estimate),
        )
        first, again, verified, refused, looked, encoded, decoded = medians_s(tuple(map(repeated, works)))
    ten, step = "a message of ten entries", "a step of the loop, once in twenty"
    return {
        "sign_an_entry": micro(first, f"encoding {ten}", encoded),
        "sign_it_again": micro(again, f"encoding {ten}", encoded),
        "verify_an_entry": micro(verified, f"decoding {ten}", decoded),
        "refuse_a_forgery": micro(refused, "verifying an entry", verified),
        "look_at_ten_keys": micro(looked, step, TIMES * STEP_NS * 1e-9),
    }


def repeated(work: Callable[[], object]) -> Callable[[], None]:
    def all_of_it() -> None:
        for _ in range(TIMES):
            work()

    return all_of_it


def micro(took_s: float, against: str, other_s: float) -> dict:
    """A row, of the time that TIMES of it took."""
    return row(1e6 * took_s / TIMES, "us", f"{against} ({1e6 * other_s / TIMES:.4g} us)", took_s / other_s)
