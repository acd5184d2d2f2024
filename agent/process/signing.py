"""A robot's signature under what it measured itself, put there as a message leaves: nothing recorded needs the key.

The kernel gives its own entries, samples and proposals without one, and passes on those of others with theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec.structs import replace

from agent.core.messages import Entry, Estimate, Proposal, Sample
from agent.core.trust import entry_bytes, proposal_bytes, sample_bytes

KEPT = 1024  # signatures: 48 samples of each of 20 targets, and room for entries and proposals

Sign = Callable[[Estimate], Estimate]


def unsigned(estimate: Estimate) -> Estimate:
    """What a fleet without keys says: the same."""
    return estimate


def signing(robot: str, private: Ed25519PrivateKey) -> Sign:
    """What signs for this robot. The same entry to several neighbours, or again, costs one signature.

    Signed is what carries the robot's name, has no signature, and is of this start or later: what it said in an earlier
    life comes back from others with its signature, or is not its own.
    """
    signature = lru_cache(KEPT)(private.sign)  # Ed25519 has no chance in it: equal bytes, equal signature

    def sign(estimate: Estimate) -> Estimate:
        gossip = estimate.gossip
        if gossip is None:
            return estimate
        fleet, target, epoch, start = estimate.fleet, estimate.target, gossip.epoch, estimate.incarnation

        def own(name: str, began_ns: int, said: Entry | Sample | Proposal) -> bool:
            return name == robot and not said.signature and began_ns >= start

        return replace(
            estimate,
            gossip=replace(
                gossip,
                entries=tuple(
                    replace(e, signature=signature(entry_bytes(fleet, target, epoch, e)))
                    if own(e.origin, e.incarnation, e)
                    else e
                    for e in gossip.entries
                ),
                samples=tuple(
                    replace(s, signature=signature(sample_bytes(fleet, target, epoch, s)))
                    if own(s.origin, s.incarnation, s)
                    else s
                    for s in gossip.samples
                ),
                proposals=tuple(
                    replace(p, signature=signature(proposal_bytes(fleet, target, p)))
                    if own(p.proposer, p.since_ns, p)
                    else p
                    for p in gossip.proposals
                ),
            ),
        )

    return sign
