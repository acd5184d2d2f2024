"""Control modules on a desk, under each interpreter that the firmware runs on."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hw.firmware import failsafe
from tests.hw.desk import MICROPYTHON, Desk
from tests.hw.firmware.nominal_plant import AIR_PA


@pytest.fixture(params=["cpython", "micropython"])
def interpreter(request: pytest.FixtureRequest) -> str:
    """Each interpreter that the firmware runs on."""
    if request.param == "cpython":
        return sys.executable
    if MICROPYTHON is None:
        pytest.skip("the MicroPython Unix port is not installed")
    return MICROPYTHON


@pytest.fixture
def put_on_desk(tmp_path: Path) -> Iterator[Callable[..., Desk]]:
    """put_on_desk(interpreter, flash) starts a control module; it is switched off after the test."""
    desks: list[Desk] = []

    def put(interpreter: str, flash: dict[str, Any] | None = None, times: str = "") -> Desk:
        desks.append(
            Desk(
                interpreter,
                tmp_path,
                {"tare_pa": [AIR_PA] * 4, "wiring": failsafe.WIRING} if flash is None else flash,
                times,
            )
        )
        return desks[-1]

    yield put
    for desk in desks:
        desk.close()
