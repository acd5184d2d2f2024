"""The board's own files against the type stubs of MicroPython's STM32 port."""

from __future__ import annotations

import importlib.metadata
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hw.firmware import pwm

FIRMWARE = Path(pwm.__file__).parent
BOARD_ONLY = ["boot.py", "hal_stm32.py", "pins.py", "wiring.py"]


def test_they_agree_with_the_stubs_of_the_port(tmp_path):
    """Names, arguments and results of pyb, machine and stm. Faults that the stubs have themselves are not ours."""
    try:
        packages = [importlib.metadata.distribution(f"micropython-{name}-stubs") for name in ("stm32", "stdlib")]
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("the stubs of the STM32 port are not installed")
    for package in packages:
        for file in package.files or ():
            if file.suffix == ".pyi" or file.name == "VERSIONS":
                (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(str(file.locate()), tmp_path / file)
    (tmp_path / "stubs").mkdir(exist_ok=True)
    board = tmp_path / "board"  # where its files are no package
    board.mkdir()
    for path in FIRMWARE.glob("*.py"):
        if path.name != "__init__.py":
            shutil.copy(path, board)
    (tmp_path / "mypy.ini").write_text(f"[mypy]\nmypy_path = {tmp_path}\ncustom_typeshed_dir = {tmp_path}\n")
    options = ["--check-untyped-defs", "--follow-imports", "silent", "--cache-dir", tmp_path / "cache"]
    ran = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", tmp_path / "mypy.ini", *options, *BOARD_ONLY],
        cwd=board,
        capture_output=True,
        text=True,
    )
    assert f"checked {len(BOARD_ONLY)} source files" in ran.stdout, ran.stdout + ran.stderr
    assert not [line for line in ran.stdout.splitlines() if line.startswith(tuple(BOARD_ONLY))]


def test_pins_are_connected_with_the_functions_that_the_port_knows():
    """The port's constants are named after function and peripheral: AF3_TIM8 is 3."""
    stubs = importlib.metadata.distribution("micropython-stm32-stubs")
    (file,) = (file for file in stubs.files or () if file.name == "pyb.pyi")
    text = Path(str(file.locate())).read_text()
    for timer, *_ in [*pwm.THRUSTERS, *pwm.SERVOS, pwm.LAMP]:
        number = pwm.FUNCTION[timer]
        assert f"AF{number}_TIM{timer}: Final[int] = {number}" in text
