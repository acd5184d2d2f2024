"""One Ed25519 key in one PEM file: written so that nobody else can look on, read so that nothing is guessed.

`NAME.sign` is a private key (PKCS8) that its owner alone may read, `NAME.sign.pub` the public half, for everybody.
"""

from __future__ import annotations

import os
import stat
from functools import lru_cache
from pathlib import Path

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

from agent.core.config import ConfigError

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
