"""hw/README.md and docs/control-module.md are true: they name every pin, parameter, message and file, and what is to be
typed runs."""

from __future__ import annotations

import os
import re
import sys
import threading
import time

from hw.firmware import parameters, wire, wiring
from hw.stm32.driver import TEXTS, Stm32
from tests.places import ROOT

README = (ROOT / "hw" / "README.md").read_text(encoding="utf-8")
REFERENCE = (ROOT / "docs" / "control-module.md").read_text(encoding="utf-8")
PROGRAMS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_every_parameter_with_its_default_and_range():
    assert list(TEXTS) == parameters.NAMES
    for name, default, lowest, highest, _ in parameters.TABLE:
        unit, text = TEXTS[name]
        if not name.startswith("zero_"):
            assert f"| `{name}` | {unit} | {default:g} | {lowest:g} to {highest:g} | {text} |" in REFERENCE


def test_every_message_with_its_size():
    for kind, name, _, _ in wire.TABLE:
        assert f"`0x{kind:02x} {name} {wire.SIZE[kind]} B" in REFERENCE, name


def test_every_pin():
    for *_, pin in [*wiring.THRUSTERS, *wiring.SERVOS, wiring.LAMP, *wiring.KILL]:
        assert pin in README


def test_what_is_typed_at_the_bench_is_python_and_the_drivers():
    assert len(PROGRAMS) == 2
    for program in PROGRAMS:
        compile(program, "README", "exec")
    asked = set(re.findall(r"board\.(\w+)", README))
    assert {"start", "tare", "arm", "close"} <= asked <= set(dir(Stm32))


def test_the_bench_s_program_speaks_with_a_board(put_on_desk, capsys):
    desk = put_on_desk(sys.executable)
    desk.listen = lambda: None  # the driver reads the tether
    stop = threading.Event()

    def let_time_pass() -> None:
        while not stop.is_set():
            desk.tick()
            time.sleep(0.002)

    board_clock = threading.Thread(target=let_time_pass)
    board_clock.start()
    typed: dict = {}
    try:
        exec(PROGRAMS[0].replace("/dev/ttyACM0", os.ttyname(desk.slave)), typed)
        assert typed["hold"](1.0, servos_us=(1600, 1500, 1500, 1500)).servos_us == (1600, 1500, 1500, 1500)
    finally:
        if "board" in typed:
            typed["board"].close()
        stop.set()
        board_clock.join()
    shown = capsys.readouterr().out
    assert "Greeting(" in shown and "Outcome(result='ok'" in shown and "'lag_s': 0.1" in shown


def test_every_path_is_there():
    paths = set(re.findall(r"`((?:hw|agent)/[\w./]+)`", README + REFERENCE)) | set(
        re.findall(r"\]\((\.\./[\w./-]+\.md)", README)
    )
    assert len(paths) > 6
    assert not [path for path in paths if not (ROOT / "hw" / path if path.startswith("..") else ROOT / path).exists()]


def test_the_picture_of_the_wiring_is_that_of_the_firmware():
    source = (ROOT / "docs" / "draw_wiring.py").read_text(encoding="utf-8")
    drawn: dict = {"__name__": "drawn", "__file__": str(ROOT / "docs" / "draw_wiring.py")}
    exec(compile(source, "draw_wiring.py", "exec"), drawn)
    assert (ROOT / "docs" / "wiring.svg").read_text(encoding="utf-8") == drawn["picture"]()
    shown = {pin for wire in drawn["wires"]() for pin in wire.pins.split()}
    texts = "".join((ROOT / "hw/firmware" / name).read_text(encoding="utf-8") for name in ("hal_stm32.py", "wiring.py"))
    used = set(re.findall(r'pyb\.Pin\("(P\w+)"', texts))
    assert used <= shown | {"PB10", "PB11"} and {"PC1", "PE7"} <= used
