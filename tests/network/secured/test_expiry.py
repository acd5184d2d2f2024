"""A certificate that ends in the middle of a dive ends no link; one that is renewed counts without a restart."""

import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh

from agent.process.certificates import authority, certificate_file, issue, key_file, write
from router_config.settings import peer_config
from tests.network.secured.conftest import Secured
from tests.network.secured.parties import HERE, Ear, opened
from tests.waiting import until

pytestmark = pytest.mark.slow

LIVES_S = 3.0
KEY = "aucamp/test/link/{}/{}"


def given(keys: Path, name: str, ends: datetime) -> datetime:
    """A certificate that ends then, in the place of the one that is there."""
    pair = issue(authority(keys), name, HERE, ends=ends)
    for file in (certificate_file(keys, name), key_file(keys, name)):
        file.unlink()
    write(keys, name, pair)
    return pair.certificate.not_valid_after_utc  # whole seconds


def test_a_dive_outlives_its_certificates_and_a_renewed_one_counts_at_once(secured: Secured) -> None:
    """r2 dials r1. Both certificates end; then r1 is started anew with a good one, and r2 still has to get its own."""
    fleet, keys = secured
    ends = datetime.now(UTC) + timedelta(seconds=LIVES_S)
    last = max(given(keys, name, ends) for name in ("r1", "r2"))
    events: list[str] = []
    with opened(peer_config(fleet, "r2", keys)) as r2:
        with opened(peer_config(fleet, "r1", keys)) as r1:
            ears = {"r1": Ear(r1, ["aucamp/test/link/*/r1/**"]), "r2": Ear(r2, ["aucamp/test/link/*/r2/**"])}
            listening = r2.info.declare_link_events_listener(
                zenoh.handlers.Callback(lambda event: events.append(str(event.kind)), indirect=False)
            )

            def both_hear(word: str) -> bool:
                r1.put(KEY.format("r1", "r2"), word)
                r2.put(KEY.format("r2", "r1"), word)
                return all(any(said == word for _, said in ear.heard) for ear in ears.values())

            until(lambda: both_hear("before"))
            assert datetime.now(UTC) < last
            events.clear()
            until(lambda: datetime.now(UTC) > last + timedelta(seconds=1.0))
            until(lambda: both_hear("after"))
            assert events == []  # nobody came or went
        given(keys, "r1", datetime.now(UTC) + timedelta(days=1))
        with opened(peer_config(fleet, "r1", keys)) as r1:
            time.sleep(1.5)
            assert not list(r1.info.transports())  # what has ended makes no new link
            given(keys, "r2", datetime.now(UTC) + timedelta(days=1))
            began_s = time.monotonic()
            until(lambda: list(r1.info.transports()))
            assert time.monotonic() - began_s < 10.0
        del listening
