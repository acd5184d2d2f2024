"""The chain of three with keys of this run, which go with the test's own folder."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from agent.core.config import Fleet
from tests.network.secured.parties import CHAIN, secure


class Secured(NamedTuple):
    fleet: Fleet
    keys: Path


@pytest.fixture
def secured(make_fleet: Callable[..., Fleet], tmp_path: Path) -> Secured:
    return Secured(secure(make_fleet(CHAIN), tmp_path / "keys"), tmp_path / "keys")
