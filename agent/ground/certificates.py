"""Whether the certificates of a secured fleet can be used on this computer, and for how long."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature

from agent.core.config import ConfigError, Fleet
from agent.ground.addresses import is_here
from agent.ground.finding import Finding, tried
from agent.process.certificates import (
    AUTHORITY,
    certificate_file,
    common_name,
    days_left,
    hosts_of,
    key_file,
    read_certificate,
)
from agent.process.fleet_certificates import credentials, hosts
from agent.process.robot_keys import keys_folder

SOON_DAYS = 14.0  # before a certificate ends


def certificate_findings(fleet: Fleet, name: str, path: Path) -> Iterator[Finding]:
    """A party's own certificate, as it lies on this computer; nothing of an open fleet."""
    try:
        folder = credentials(fleet, name, path)
    except ConfigError as error:
        yield Finding("wrong", name, str(error))
        return
    if folder is None:
        return
    yield tried(name, lambda: good(fleet, name, folder, datetime.now(UTC)))
    yield from _ending(folder, name)
    if name in fleet.robot:
        yield from _too_much(fleet, name, folder)


def watchers_here(fleet: Fleet, path: Path) -> list[str]:
    """Observers and consoles whose certificates lie on this computer."""
    folder = keys_folder(fleet, path) if fleet.secured else None
    names = (*fleet.access.observers, *fleet.access.consoles) if folder is not None else ()
    return [name for name in names if folder is not None and certificate_file(folder, name).exists()]


def good(fleet: Fleet, name: str, folder: Path, now: datetime) -> str:
    """What is good about a certificate. Raises ConfigError, one line, where others would refuse it."""
    path = certificate_file(folder, name)
    certificate, ca = read_certificate(path), read_certificate(certificate_file(folder, AUTHORITY))
    again = f"make it again where ca.key is: remove {path.name} and {name}.key there, then aucamp keys --only {name}"
    if not issued_by(certificate, ca):
        raise ConfigError(
            f"{path}: not by the authority in {AUTHORITY}.pem ({common_name(ca)}); copy both from where they were made"
        )
    for one, file in ((certificate, path.name), (ca, f"{AUTHORITY}.pem")):
        if days_left(one, now) <= 0:
            raise ConfigError(f"{path.with_name(file)}: ended on {one.not_valid_after_utc:%Y-%m-%d}; {again}")
        if now < one.not_valid_before_utc:
            began = f"begins on {one.not_valid_before_utc:%Y-%m-%d}"
            raise ConfigError(f"{path.with_name(file)}: {began}, and this computer's clock says {now:%Y-%m-%d}; set it")
    for host in hosts(fleet, name):
        if host not in hosts_of(certificate):
            where = " and ".join(hosts_of(certificate)) or "nowhere"
            raise ConfigError(f"{path}: good at {where}, and {name} listens at {host}; {again}")
    return f"certificate by {common_name(ca)}, {days_left(certificate, now):.0f} days left"


def issued_by(certificate: x509.Certificate, ca: x509.Certificate) -> bool:
    """Whether this authority signed it, and not another one of the same name."""
    try:
        certificate.verify_directly_issued_by(ca)
    except (InvalidSignature, ValueError, TypeError):
        return False
    return True


def _ending(folder: Path, name: str) -> Iterator[Finding]:
    left = days_left(read_certificate(certificate_file(folder, name)), datetime.now(UTC))
    if 0 < left <= SOON_DAYS:
        text = f"{certificate_file(folder, name)}: ends in {left:.0f} days; make a new one, and start {name} again"
        yield Finding("warning", name, text)


def _too_much(fleet: Fleet, name: str, folder: Path) -> Iterator[Finding]:
    """Keys that have no business on a robot's own computer."""
    elsewhere = [other for other in fleet.robot if other != name and not is_here(fleet.robot[other].listen)]
    if not elsewhere:
        return  # all robots are here: so is who made the keys
    if key_file(folder, AUTHORITY).exists():
        text = f"{key_file(folder, AUTHORITY)}: makes anybody's certificate; keep it on no robot's computer"
        yield Finding("warning", name, text)
    foreign = [other for other in elsewhere if key_file(folder, other).exists()]
    if foreign:
        text = f"{folder}: holds NAME.key of {', '.join(foreign)}, for whom this computer can speak; remove them"
        yield Finding("warning", name, text)
