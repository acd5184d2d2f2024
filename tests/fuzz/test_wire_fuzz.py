"""Both ends of the tether under random streams: seconds here, AUCAMP_FUZZED_FRAMES=1000000 for as long as one likes."""

from __future__ import annotations

import os

import pytest

from hw.firmware import failsafe
from tests.fuzz import firmware_bytes, host_bytes

FRAMES = int(os.environ.get("AUCAMP_FUZZED_FRAMES", "5000"))
SEED = int(os.environ.get("AUCAMP_FUZZ_SEED", "1"))


@pytest.mark.timeout(3600)
def test_firmware_survives_and_keeps_its_limits():
    counts = firmware_bytes.fuzz(FRAMES, SEED)
    assert counts.armed > 0.3 * counts.cycles, "mostly at rest: this tests the wrong thing"
    assert counts.levels == {failsafe.OK, failsafe.HOLD, failsafe.SURFACE, failsafe.DISARM, failsafe.LATCHED}
    assert counts.frames_ok > 0.4 * FRAMES


@pytest.mark.timeout(3600)
def test_host_survives():
    host_bytes.run(FRAMES, SEED)
