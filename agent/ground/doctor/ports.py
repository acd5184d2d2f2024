"""The ports of all robots, dialled at the same time, and what is to be said of each."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta

from agent.core.config import Fleet
from agent.ground.certificates import SOON_DAYS
from agent.ground.doctor.probe import Probed, probe, speaks_tls
from agent.ground.doctor.who import Who
from agent.ground.finding import Finding


def probe_all(fleet: Fleet, who: Who) -> dict[str, Probed]:
    """What came of dialling each robot once; all of it takes as long as the slowest."""

    def dial(name: str) -> Probed:
        listen = fleet.robot[name].listen
        probed = probe(listen, who.trust, who.has_pair)
        if probed.cause is None and not fleet.secured and speaks_tls(listen):
            return Probed("listens on tls/, and our file has tcp/: the fleet is secured; take its newest file")
        return probed

    with ThreadPoolExecutor(len(fleet.robot)) as pool:
        return dict(zip(fleet.robot, pool.map(dial, fleet.robot), strict=True))


def is_open(name: str, probed: Probed) -> bool:
    """Whether a link may come about: somebody answers, and is who should."""
    return probed.cause is None and probed.name in ("", name)


def port_findings(fleet: Fleet, name: str, probed: Probed) -> Iterator[Finding]:
    """What is wrong with one robot's port or with the certificates."""
    listen = fleet.robot[name].listen
    if probed.cause is not None:
        yield Finding("wrong", name, f"{listen}: {probed.cause}")
    if not is_open(name, probed) and probed.name and probed.name != name:
        text = f"shows the certificate of '{probed.name}': one of the two files names the other's address"
        yield Finding("wrong", name, f"{listen}: {text}; correct listen, or copy {name}'s own certificate there")
    if probed.ends is not None and (left := (probed.ends - datetime.now(UTC)) / timedelta(days=1)) < SOON_DAYS:
        text = f"its certificate expires in {left:.0f} days; make another, and start its agent again"
        yield Finding("warning", name, f"{listen}: {text}")
