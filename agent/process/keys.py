"""Signing keys (Ed25519): one key in one PEM file, the public keys of a fleet in a folder, signatures of what a robot
measured, and all that one robot needs to sign and to verify. Key files are written so that no other user can read
them.

`NAME.sign` is a private key (PKCS8) that its owner alone may read, `NAME.sign.pub` the public half, for everybody.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple, Protocol, TypeVar

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)
from msgspec.structs import replace

from agent.core.capability_messages import Keyframe
from agent.core.codec import decode, encode
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Entry, Estimate, Proposal, Sample
from agent.core.step_io import Said
from agent.core.topics import KEYFRAME
from agent.core.trust import entry_bytes, keyframe_bytes, proposal_bytes, sample_bytes

PRIVATE, PUBLIC = ".sign", ".sign.pub"
OWNER_ONLY, EVERYBODY = 0o600, 0o644
LONGEST = 4096  # bytes; a PEM file of such a key has 120

OTHER_KIND = "a key of another kind; only Ed25519 signs here: make it with aucamp keys"


class UnusableKeyError(ValueError):
    """A file is no key that can be used here; the text says why and what to do, but not which file."""


def private_file(folder: Path, robot: str) -> Path:
    """Where the private key of a robot lies."""
    return folder / f"{robot}{PRIVATE}"


def public_file(folder: Path, robot: str) -> Path:
    """Where the public key of a robot lies."""
    return folder / f"{robot}{PUBLIC}"


def write_pair(folder: Path, robot: str) -> tuple[Path, Path]:
    """Make a new pair; returns its two files. Raises ConfigError where one is there already, or cannot be written."""
    key = Ed25519PrivateKey.generate()
    private, public = private_file(folder, robot), public_file(folder, robot)
    write_new(private, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()), OWNER_ONLY)
    try:
        write_new(public, key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo), EVERYBODY)
    except BaseException:
        private.unlink()  # half a pair would be in the way of the next attempt
        raise
    return private, public


def read_private(path: Path) -> Ed25519PrivateKey:
    """A robot's own private key. Raises UnusableKeyError, also where others than its owner may read it."""
    content, mode = _read(path)
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise UnusableKeyError(f"others may read this private key (mode {mode:04o}); run: chmod 600 {path}")
    try:
        key = load_pem_private_key(content, password=None)
    except TypeError:
        raise UnusableKeyError("it is encrypted, and an agent cannot ask; take a key without a password") from None
    except (ValueError, UnsupportedAlgorithm):
        raise UnusableKeyError("no private key in PEM; copy the file again, whole") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise UnusableKeyError(OTHER_KIND)
    return key


def read_public(path: Path) -> bytes:
    """The 32 bytes of a public key. Raises UnusableKeyError."""
    return _public(_read(path)[0])


@lru_cache(256)  # the same files are looked at every second
def _public(content: bytes) -> bytes:
    try:
        key = load_pem_public_key(content)
    except (ValueError, UnsupportedAlgorithm):
        raise UnusableKeyError("no public key in PEM; copy the file again, whole") from None
    if not isinstance(key, Ed25519PublicKey):
        raise UnusableKeyError(OTHER_KIND)
    return public_bytes(key)


def public_bytes(key: Ed25519PublicKey) -> bytes:
    """The 32 bytes that the kernel takes for a public key."""
    return key.public_bytes(Encoding.Raw, PublicFormat.Raw)


def write_new(path: Path, content: bytes, mode: int) -> None:
    """The mode is the file's from its first moment on: between an open and a chmod anybody could open it too."""
    try:
        opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    except FileExistsError:
        raise ConfigError(f"{path}: exists, and keys are never overwritten; give --out a new folder") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); give --out another folder") from None
    try:
        with os.fdopen(opened, "wb") as file:
            file.write(content)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); give --out another folder") from None


def _read(path: Path) -> tuple[bytes, int]:
    """Content and permissions of one and the same file. Never waits for a writer, as a pipe would make it."""
    try:
        if not path.is_file():
            raise UnusableKeyError("no such file" if not path.exists() else "no file; put a key there")
        with path.open("rb") as file:
            return file.read(LONGEST), stat.S_IMODE(os.fstat(file.fileno()).st_mode)
    except OSError as error:
        raise UnusableKeyError(f"cannot be read ({error.strerror}); give this user the right to") from None


# --- public keys in a folder ---
# The public keys of a fleet as they lie in a folder, to which people add and from which they remove while robots
# dive.
#
# To remove a key is to withdraw all that its robot ever said. What a copy in progress or a disk that is gone does to
# the folder is not meant so: a key that was good stays until its file is absent from a folder that can be read.

LOOK_NS = 1_000_000_000  # between two looks


class Found(NamedTuple):
    """What a folder holds of a fleet, by robot."""

    keys: Mapping[str, bytes]  # 32 bytes each
    missing: Sequence[str]
    unusable: Mapping[str, str]  # why


def read_keys(folder: Path, robots: Collection[str]) -> Found:
    """The public keys of these robots. Files of others are none of our business."""
    keys: dict[str, bytes] = {}
    missing: list[str] = []
    unusable: dict[str, str] = {}
    for name in robots:
        path = public_file(folder, name)
        if not path.exists():
            missing.append(name)
            continue
        try:
            key = read_public(path)
        except UnusableKeyError as error:
            unusable[name] = str(error)
            continue
        same = next((other for other, known in keys.items() if known == key), None)
        if same is None:
            keys[name] = key
        else:
            unusable[name] = f"the same key as {same}{PUBLIC}; give each robot its own"
    return Found(keys, missing, unusable)


class KeyFolder:
    """Looks at a folder now and then. `fault`: what a person should mend there, in one line; None: nothing."""

    def __init__(self, folder: Path, robots: Collection[str]) -> None:
        self.fault: str | None = None
        self._folder, self._robots = folder, robots
        self._keys: Mapping[str, bytes] | None = None  # as they were last told
        self._looked_ns: int | None = None

    def changed(self, now_ns: int) -> dict[str, bytes] | None:
        """All public keys, by robot, at the first call and when one was added, changed or removed; else None.

        Looks at the folder at most once a second of the clock that `now_ns` is of.
        """
        if self._looked_ns is not None and now_ns - self._looked_ns < LOOK_NS:
            return None
        self._looked_ns = now_ns
        keys = self._look()
        if keys == self._keys:
            return None
        self._keys = keys
        return dict(keys)

    def _look(self) -> Mapping[str, bytes]:
        before = self._keys or {}
        try:
            found = read_keys(self._folder, self._robots)
            there = self._folder.is_dir()  # asked last: a folder that goes while it is read tells nothing
        except OSError:
            there = False
        if not there:
            self.fault = "their folder cannot be read; those read before are kept"
            return before
        self.fault = "; ".join(_to_mend(found)) or None
        kept = {name: before[name] for name in found.unusable if name in before}
        return {name: key for name in self._robots if (key := found.keys.get(name) or kept.get(name))}


def _to_mend(found: Found) -> list[str]:
    """Without the folder's path: faults are recorded, and a recording says nothing of the machine it is from."""
    lines = [f"{name}{PUBLIC}: {why}" for name, why in found.unusable.items()]
    if found.missing:
        lines.append(f"nothing of {', '.join(found.missing)} is believed without {found.missing[0]}{PUBLIC}")
    return lines


# --- signatures ---
# A robot's signature under what it measured itself, put there as a message leaves: nothing recorded needs the key.
#
# The kernel gives its own entries, samples, proposals and keyframes without one, and passes on those of others with
# theirs.

KEPT = 1024  # signatures: 48 samples of each of 20 targets, and room for entries and proposals

S = TypeVar("S", Estimate, Said)


class Sign(Protocol):
    """What a message leaves as."""

    def __call__(self, said: S, /) -> S: ...


def unsigned(said: S) -> S:
    """What a fleet without keys says: the same."""
    return said


def signing(robot: str, private: Ed25519PrivateKey) -> Sign:
    """What signs for this robot. The same entry to several neighbours, or again, costs one signature.

    Signed is what carries the robot's name, has no signature, and is of this start or later: what it said in an earlier
    life comes back from others with its signature, or is not its own.
    """
    signature = lru_cache(KEPT)(private.sign)  # Ed25519 has no chance in it: equal bytes, equal signature

    def sign_keyframe(said: Said) -> Said:
        """Likewise, a keyframe that is made of its own sweep."""
        keyframe = decode(said.payload, Keyframe, KEYFRAME.limit)
        frame = keyframe.frame
        if frame.origin != robot or keyframe.signature or frame.incarnation < keyframe.incarnation:
            return said
        signed = replace(keyframe, signature=signature(keyframe_bytes(keyframe.fleet, frame)))
        return replace(said, payload=encode(signed))

    def sign(said: Any) -> Any:
        if isinstance(said, Estimate):
            return sign_estimate(said)
        return sign_keyframe(said) if said.topic == KEYFRAME.name else said

    def sign_estimate(estimate: Estimate) -> Estimate:
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


# --- keys of one robot ---
# All that one robot needs to sign and to believe, from the folder that its fleet file names, read before it dives.

VARIABLE = "AUCAMP_KEYS"  # names the folder of keys on this computer; goes before the fleet file's


class RobotKeys(NamedTuple):
    """What signs for a robot, and the public keys of all."""

    sign: Sign
    changed: Callable[[int], dict[str, bytes] | None]  # now_ns -> KeyFolder.changed
    fault: Callable[[], str | None]  # what to mend in the folder


NO_KEYS = RobotKeys(unsigned, lambda now_ns: None, lambda: None)  # of a fleet that signs nothing


def robot_keys(fleet: Fleet, robot: str, fleet_path: Path) -> RobotKeys:
    """The keys of this robot, or NO_KEYS. Raises ConfigError, one line, for a file that cannot be used.

    A public key of another robot may be missing: until it is there, nothing of that robot is believed.
    """
    folder = keys_folder(fleet, fleet_path)
    if folder is None:
        return NO_KEYS
    path = private_file(folder, robot)
    if not path.exists():
        raise ConfigError(
            f"{path}: no such file; copy it from where the keys were made, or make it with: "
            f"aucamp keys {quote(str(fleet_path))} --out {quote(str(folder))} --only {robot}"
        )
    try:
        private = read_private(path)
    except UnusableKeyError as error:
        raise ConfigError(f"{path}: {error}") from None
    found = read_keys(folder, fleet.robot)
    for name, why in found.unusable.items():
        raise ConfigError(f"{public_file(folder, name)}: {why}")
    own = public_file(folder, robot)
    if robot in found.missing:
        raise ConfigError(f"{own}: no such file; copy it from where {path.name} was made")
    if found.keys[robot] != public_bytes(private.public_key()):
        raise ConfigError(f"{own}: not the public half of {path.name}; copy both files of one pair")
    watched = KeyFolder(folder, tuple(fleet.robot))
    return RobotKeys(signing(robot, private), watched.changed, lambda: watched.fault)


def keys_folder(fleet: Fleet, fleet_path: Path) -> Path | None:
    """Where this computer has the keys; None: the fleet file names none, so nothing is signed."""
    if fleet.access.keys is None:
        return None
    here = os.environ.get(VARIABLE)
    folder = Path(here) if here else fleet_path.parent / fleet.access.keys
    if not folder.exists() and fleet.twin.dir is not None:  # a demo that runs has its keys beside its twin
        beside = Path(fleet.twin.dir) / fleet.access.keys
        return beside if beside.is_dir() else folder
    return folder
