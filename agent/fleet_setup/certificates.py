"""The certificates of a secured fleet that lie on this computer: whether they are what links will ask for."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature

from agent.fleet_setup.addresses import is_here
from agent.fleet_setup.finding import Finding, tried
from agent.kernel.config import ConfigError, Fleet
from agent.keys.certificates import AUTHORITY, certificate_file, days_left, hosts_of, key_file, read_certificate
from agent.keys.fleet_certificates import credentials, hosts
from agent.keys.robot_keys import keys_folder

WARN_DAYS = 14.0  # before a certificate expires


def certificate_findings(fleet: Fleet, name: str, path: Path) -> Iterator[Finding]:
    """About the certificate of one party, and keys of others that lie beside it. Nothing is said of an open fleet."""
    folder = keys_folder(fleet, path)
    if not fleet.secured or folder is None:
        return
    usable = tried(name, lambda: f"certificate in {credentials(fleet, name, path)}")
    yield usable
    if usable.level == "ok":
        yield from problems(fleet, name, folder, datetime.now(UTC), path)
    elsewhere = [other for other, robot in fleet.robot.items() if other != name and not is_here(robot.listen)]
    if elsewhere and name in fleet.robot and key_file(folder, AUTHORITY).exists():
        text = f"{key_file(folder, AUTHORITY)}: whoever has it can make anybody's certificate"
        yield Finding("warning", name, f"{text}; no robot's computer needs it: move it away")
    if foreign := [other for other in elsewhere if key_file(folder, other).exists()]:
        text = f"{folder}: holds the keys of {', '.join(foreign)}, as whom this computer can speak; remove them"
        yield Finding("warning", name, text)


def problems(fleet: Fleet, name: str, folder: Path, now: datetime, path: Path) -> Iterator[Finding]:
    """What links will have against a certificate that can be read."""
    try:
        own, authority = (read_certificate(certificate_file(folder, who)) for who in (name, AUTHORITY))
    except ConfigError as error:
        yield Finding("wrong", name, str(error))
        return
    file = certificate_file(folder, name)
    renew = f"make another: remove {name}.pem and {name}.key, then aucamp keys {path} --out DIR --only {name}"
    if not issued_by(own, authority):
        yield Finding("wrong", name, f"{file}: not of the authority in {AUTHORITY}.pem; copy both from one place")
    for who, certificate in ((file, own), (certificate_file(folder, AUTHORITY), authority)):
        yield from dates(name, who, certificate, now, renew)
    lacking = set(hosts(fleet, name)) - set(hosts_of(own))
    if lacking:
        yield Finding("wrong", name, f"{file}: not for {', '.join(sorted(lacking))}, where it listens; {renew}")


def dates(name: str, file: Path, certificate: x509.Certificate, now: datetime, renew: str) -> Iterator[Finding]:
    """Whether it is valid, and for how long."""
    left, clock = days_left(certificate, now), f"this computer's clock ({now:%Y-%m-%d %H:%M} UTC)"
    if certificate.not_valid_before_utc > now:
        yield Finding("wrong", name, f"{file}: not valid yet by {clock}; set the clock")
    elif left < 0:
        yield Finding("wrong", name, f"{file}: expired by {clock}; {renew}")
    elif left < WARN_DAYS:
        yield Finding("warning", name, f"{file}: expires in {left:.0f} days; {renew}")


def issued_by(own: x509.Certificate, authority: x509.Certificate) -> bool:
    """Whether an authority has signed a certificate; another one of the same name has not."""
    try:
        own.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True
