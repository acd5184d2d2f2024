"""hw/README.md says what the firmware does: its tables name every parameter, message and file."""

from __future__ import annotations

import re
from pathlib import Path

from hw.firmware import parameters, pwm, wire
from hw.stm32 import Stm32

README = (Path(wire.__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def test_every_parameter_with_its_default_and_range():
    for name, unit, default, lowest, highest, _, _ in parameters.TABLE:
        if not name.startswith("zero_"):
            assert f"| `{name}` | {unit} | {default:g} | {lowest:g} to {highest:g} |" in README


def test_every_message_with_its_size():
    for kind, name, _, _ in wire.TABLE:
        assert any(
            line.startswith(f"| 0x{kind:02x} | {name} | ") and f" {wire.SIZE[kind]} B" in line
            for line in README.splitlines()
        ), name


def test_every_pin():
    for *_, pin in [*pwm.THRUSTERS, *pwm.SERVOS, pwm.LAMP, *pwm.KILL]:
        assert pin in README


def test_every_file_is_copied_to_the_board_but_those_for_a_computer():
    lines = [line for line in README.splitlines() if line.strip().startswith("mpremote cp ")]
    copied = {word for line in lines for word in line.split() if word.endswith(".py")}
    there = {path.name for path in Path(wire.__file__).parent.glob("*.py")}
    assert copied == there - {"__init__.py", "bus.py", "hal_unix.py"}


def test_what_is_typed_at_the_bench_is_python_and_the_drivers():
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        compile(block, "README", "exec")
    asked = set(re.findall(r"board\.(\w+)", README))
    assert {"start", "tare", "arm", "close"} <= asked <= set(dir(Stm32))
