"""What agreement takes of a robot: hearing its neighbours and ticking once, bytes of a message, signatures."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from itertools import count
from random import Random
from statistics import median

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from agent.core.codec import decode, encode
from agent.core.estimation.evidence import Evidence
from agent.core.estimation.evidence_table import Bounds
from agent.core.estimation.interface import EstimateCache, Estimator, Prior
from agent.core.estimation.protocols import Paper
from agent.core.messages import Epoch, Estimate
from agent.core.trust import entry_bytes, verify_signature
from agent.experiments.claim import Figure, Row
from agent.process.keys import public_bytes, signing
from tests.bench.timing import Settings, claim_of_costs, medians_ms
from tests.process.said import EPOCH, FOREIGN, entry, said
from tests.sample_messages import estimate

SECOND_NS = 1_000_000_000  # an iteration
COV = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
PROTOCOLS = ("paper", "evidence", "moving")  # `metropolis` takes what `paper` does
MANY = 40  # signatures that are timed as one


# --- agreement ---


def agreement(neighbours: int, times: int) -> Row:
    """Of each protocol, us of an iteration and bytes of a message, of a robot in the middle of a star: it has as many
    origins as neighbours, and itself."""
    row: Row = {}
    for protocol in PROTOCOLS:
        row[f"{protocol}_us"], row[f"{protocol}_bytes"] = iterated(protocol, neighbours, times)
    return row


def iterated(protocol: str, neighbours: int, times: int) -> tuple[float, float]:
    names, random = [f"r{k}" for k in range(neighbours + 1)], Random(1)
    robots = {name: made(protocol, name, names) for name in names}
    me, *others = names
    box = EstimateCache("tank", me, "ball", tuple(others))
    boxes = {name: EstimateCache("tank", name, "ball", (me,)) for name in others}
    took_us, sizes = list[float](), list[int]()

    def sent(src: str, dst: str) -> Estimate:
        robot = robots[src]
        about = {"seq": len(took_us), "sent_ns": now_ns, "t": robot.t, "valid": robot.valid}
        payload = encode(estimate(src, dst, **about, **robot.say(dst, now_ns)._asdict()))
        sizes.append(len(payload))
        return decode(payload, Estimate)

    for now_ns in range(SECOND_NS, (times + 3) * SECOND_NS, SECOND_NS):
        letters = [(name, sent(name, me)) for name in others]
        priors = {name: Prior((0.7 + random.gauss(0, 0.01), 0.5, 0.1), COV, now_ns) for name in names}
        began_s = time.process_time()
        for name, letter in letters:
            robots[me].hear(box.put(name, letter, now_ns))
        robots[me].tick(priors[me], box, now_ns)
        took_us.append(1e6 * (time.process_time() - began_s))
        for name in others:
            robots[name].hear(boxes[name].put(me, sent(me, name), now_ns))
            robots[name].tick(priors[name], boxes[name], now_ns)
    return median(took_us[2:]), float(median(sizes[len(sizes) // 2 :]))


def made(protocol: str, name: str, names: list[str]) -> Estimator:
    neighbours = tuple(other for other in names if other != name)
    if protocol == "paper":
        return Paper(2 * SECOND_NS)
    bounds = Bounds(frozenset(names), (1.5, 1.2, 0.8), SECOND_NS)
    robot = Evidence(name, 1, neighbours, 2 * SECOND_NS, bounds)
    if protocol == "moving":
        robot.begin(Epoch(1, True, "r0"), 0)
    return robot


# --- signatures ---


def signatures(times: int) -> Row:
    """us of each. A robot signs its own word once for all neighbours, and verifies that of others once."""
    key = Ed25519PrivateKey.generate()
    public, sign = public_bytes(key.public_key()), signing("r1", key)
    message = said(entry(), *(entry(f"r{k}", signature=FOREIGN) for k in range(2, 11)))
    payload, signed = encode(sign(message)), entry_bytes("tank", "ball", EPOCH, entry())
    # Noise is refused sooner, for its numbers are out of range; a forger takes care that they are not.
    signature, forged, numbers = key.sign(signed), key.sign(b"something else"), count(1)
    assert verify_signature(public, signature, signed) and not verify_signature(public, forged, signed)
    ways = {
        "sign": lambda: sign(said(entry(count=next(numbers)))),
        "verify": lambda: verify_signature(public, signature, signed),
        "forged": lambda: verify_signature(public, forged, signed),
        "encode": lambda: encode(message),
        "decode": lambda: decode(payload, Estimate),
    }
    taken_ms = medians_ms({way: partial(many, work) for way, work in ways.items()}, times)
    return {way: 1e3 * ms / MANY for way, ms in taken_ms.items()}


def many(work: Callable[[], object]) -> None:
    for _ in range(MANY):
        work()


# --- the claim ---

NEIGHBOURS = {f"neighbours-{count}": count for count in (3, 10, 50)}


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    return [signatures(settings.times) if case == "signatures" else agreement(NEIGHBOURS[case], settings.times)]


CLAIM = claim_of_costs(
    run=run,
    cases=(*NEIGHBOURS, "signatures"),
    figures=(
        *(
            figure
            for case, who in ((case, case.replace("-", " ")) for case in NEIGHBOURS)
            for figure in (
                Figure(f"{case}.paper_us", f"{who}: an iteration by `paper`", "us", most=1e4),  # 1 % of its second
                Figure(f"{case}.paper_bytes", f"{who}: its message", "bytes", most=1400.0),  # one datagram
                Figure(f"{case}.evidence_us/paper_us", f"{who}: an iteration by evidence, against `paper`", "times"),
                Figure(f"{case}.evidence_bytes/paper_bytes", f"{who}: its message, against that", "times"),
                Figure(f"{case}.moving_us/paper_us", f"{who}: evidence of what moves, against `paper`", "times"),
                Figure(f"{case}.moving_bytes/paper_bytes", f"{who}: its message, against that", "times"),
            )
        ),
        Figure("signatures.sign", "an entry is signed, once for all neighbours", "us"),
        Figure("signatures.sign/encode", "the same, against encoding a message of ten entries", "times"),
        Figure("signatures.verify", "an entry is verified, once when it is news", "us"),
        Figure("signatures.verify/decode", "the same, against decoding that message", "times"),
        Figure("signatures.forged/verify", "a forgery is refused, against verifying", "times"),
    ),
    explanation="""A robot in the middle of a star hears all its neighbours and iterates once; the time is that of the
        processor, and the message that which it sends when it knows all of them. Signatures are Ed25519.""",
)
