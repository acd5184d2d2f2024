"""A chip, and the firmware's hardware layer imported on it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tests.hw.board.chip import Chip, firmware_on


@pytest.fixture
def chip() -> Chip:
    return Chip()


@pytest.fixture
def hal_stm32(chip: Chip, tmp_path: Path) -> Iterator[ModuleType]:
    with firmware_on(chip, tmp_path) as module:
        yield module
