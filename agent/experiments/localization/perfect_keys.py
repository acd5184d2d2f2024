"""Signatures that nobody can forge and that cost nothing: hashes, in a world where nobody makes another's.

What Ed25519 costs is measured elsewhere (python -m tests.bench signing); here a dive has 10,000 signatures to check,
and only what they are good for counts. Everything else is as in the agents: who signs, what, and who looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import blake2b
from typing import cast

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from agent.process.keys import Sign, signing


class PerfectKey:
    """A robot's private key: its name."""

    def __init__(self, robot: str) -> None:
        self._secret = robot.encode()

    def sign(self, data: bytes) -> bytes:
        return blake2b(data, key=self._secret).digest()


def perfect_signing(robot: str) -> Sign:
    """What signs for this robot."""
    return signing(robot, cast(Ed25519PrivateKey, PerfectKey(robot)))


def public_keys(robots: Sequence[str]) -> dict[str, bytes]:
    """A fleet's public keys, which are the private ones."""
    return {robot: robot.encode() for robot in robots}


def verify(public: bytes, signature: bytes, signed: bytes) -> bool:
    """Whether the robot whose key this is signed it."""
    return signature == blake2b(signed, key=public).digest()
