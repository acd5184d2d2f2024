"""What an origin signs, and whether a signature is its own. Ed25519 (RFC 8032): verifying has no clock and no chance.

A relay may carry an entry or a sample anywhere; it cannot change one, nor make one up. Signed is all that gives the
evidence its meaning: fleet, target and epoch too, so that nothing old or foreign can be shown again elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgpack
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from agent.core.messages import Entry, Epoch, Proposal, Sample

KEY_BYTES = 32  # of a public key
SIGNATURE_BYTES = 64


def entry_bytes(fleet: str, target: str, epoch: Epoch, entry: Entry) -> bytes:
    """What the origin of an entry signs."""
    when = [epoch.counter, epoch.moving, epoch.proposer]
    sums = [_floats(entry.information), _floats(entry.vector), _floats(entry.systematic_m2)]
    who = [entry.origin, entry.incarnation, entry.count]
    return bytes(msgpack.packb(["aucamp.entry.1", fleet, target, when, *who, *sums]))


def sample_bytes(fleet: str, target: str, epoch: Epoch, sample: Sample) -> bytes:
    """What the origin of a sample signs; its age is the relays' business, and no part of it."""
    when = [epoch.counter, epoch.moving, epoch.proposer]
    who = [sample.origin, sample.incarnation, sample.number, sample.t_ns]
    what = [_floats(sample.information), _floats(sample.vector)]
    return bytes(msgpack.packb(["aucamp.sample.1", fleet, target, when, *who, *what]))


def proposal_bytes(fleet: str, target: str, proposal: Proposal) -> bytes:
    """What the proposer of an epoch signs."""
    what = [proposal.proposer, proposal.since_ns, proposal.counter, proposal.moving]
    return bytes(msgpack.packb(["aucamp.epoch.1", fleet, target, *what]))


def _floats(numbers: Iterable[float]) -> list[float]:
    """Numbers as they come out of a message: a 0 that somebody wrote as an integer has arrived as 0.0."""
    return list(map(float, numbers))


def verify(public: bytes, signature: bytes, signed: bytes) -> bool:
    """Whether this signature was made with the private half of `public`, KEY_BYTES long."""
    if len(signature) != SIGNATURE_BYTES or len(public) != KEY_BYTES:
        return False
    try:
        Ed25519PublicKey.from_public_bytes(public).verify(signature, signed)
    except (InvalidSignature, ValueError):
        return False
    return True
