"""What can be known of the board's own files without a board: data sheets, timers, a bus with sensors on it."""

from __future__ import annotations

import importlib.metadata
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hw.firmware import ms5837, pwm, wire

FIRMWARE = Path(wire.__file__).parent

# The worked example of the MS5837-02BA's data sheet.
PROM = (0, 46372, 43981, 29059, 27842, 31553, 28165)
D1, D2, CELSIUS, PASCAL = 6465444, 8077636, 20.00, 110002.0


def test_data_sheet_example():
    celsius, offset, sensitivity = ms5837.temperature(PROM, D2)
    assert celsius == pytest.approx(CELSIUS, abs=0.005)
    assert (offset, sensitivity) == pytest.approx((5764707214, 3039050829), rel=1e-9)
    assert ms5837.pressure_pa(D1, offset, sensitivity) == pytest.approx(PASCAL, abs=1.0)


def compensate(d1: int, d2: int, number: type = int) -> float:
    """Pressure by the data sheet's integer recipe, or with another kind of number."""
    c = [number(word) for word in PROM]
    d1, d2 = number(d1), number(d2)
    dt = d2 - c[5] * number(256)
    temp = number(2000) + dt * c[6] / number(2**23)
    off = c[2] * number(2**17) + c[4] * dt / number(2**6)
    sens = c[1] * number(2**16) + c[3] * dt / number(2**7)
    if temp < 2000:
        off -= number(31) * (temp - number(2000)) ** 2 / number(8)
        sens -= number(63) * (temp - number(2000)) ** 2 / number(32)
    return float((d1 * (sens / number(2**21)) - off) / number(2**15))


@pytest.mark.parametrize("d2", [7500000, D2, 8500000], ids=["cold", "20 C", "warm"])
def test_floats_of_the_board_are_good_for_a_tenth_of_a_millimetre(d2):
    """1 Pa is 0.1 mm of water, and the board has 24 bits of mantissa."""
    for d1 in range(6000000, 6500000, 50021):
        _, offset, sensitivity = ms5837.temperature(PROM, d2)
        exact = ms5837.pressure_pa(d1, offset, sensitivity)
        assert exact == pytest.approx(compensate(d1, d2, float), abs=0.01)
        assert exact == pytest.approx(compensate(d1, d2, np.float32), abs=0.2)


def test_crc_of_the_application_note():
    """AN520 of the maker: these eight words, with the sum's place cleared, give 0xB."""
    assert ms5837.crc4([0x3132, 0x3334, 0x3536, 0x3738, 0x3940, 0x4142, 0x4344, 0x4500]) == 0xB


def with_crc(prom) -> list[int]:
    return [prom[0] & 0x0FFF | ms5837.crc4([prom[0] & 0x0FFF, *prom[1:], 0]) << 12, *prom[1:]]


def test_any_flipped_bit_of_a_calibration_is_found():
    prom = with_crc(PROM)
    assert ms5837.is_sound(prom)
    for i in range(7):
        for bit in range(16):
            assert not ms5837.is_sound([word ^ (1 << bit if k == i else 0) for k, word in enumerate(prom)])


class Chip:
    """One sensor as the data sheet has it; a conversion is complete when the next cycle asks."""

    def __init__(self, prom) -> None:
        self.prom, self.answer, self.converted = prom, b"", 0
        self.orders: list[int] = []

    def take(self, order: int) -> None:
        self.orders.append(order)
        if order == 0x00:
            self.answer, self.converted = self.converted.to_bytes(3, "big"), 0
        elif order >= 0xA0:
            self.answer = self.prom[(order - 0xA0) // 2].to_bytes(2, "big")
        elif order in (0x48, 0x58):
            self.converted = D1 if order == 0x48 else D2


class Bus:
    """Two wires, a multiplexer, four sensors; `dead` ones do not acknowledge."""

    def __init__(self) -> None:
        self.chips = [Chip(with_crc(PROM)) for _ in range(4)]
        self.dead: set[int] = set()
        self.channel = 0

    def _chip(self) -> Chip:
        (k,) = (k for k in range(4) if self.channel == 1 << k)
        if k in self.dead:
            raise OSError(19)
        return self.chips[k]

    def writeto(self, address: int, data: bytes) -> None:
        if address == 0x70:
            (self.channel,) = data
        else:
            assert address == 0x76
            self._chip().take(data[0])

    def readfrom_into(self, address: int, buf: bytearray) -> None:
        assert address == 0x76
        buf[:] = self._chip().answer


def test_four_sensors_behind_a_multiplexer():
    bus = Bus()
    sensors, pa = ms5837.Sensors(bus), [0.0] * 4
    assert sensors.start() == 0b1111
    answers = [sensors.step(pa) for _ in range(3)]
    assert answers == [0, 0, 0b1111], "begin the temperature, fetch it and begin the pressure, fetch that"
    assert pa == pytest.approx([PASCAL] * 4, abs=1.0) and sensors.temperature_c == pytest.approx(CELSIUS, abs=0.01)
    assert all(sensors.step(pa) == 0b1111 for _ in range(100)), "no gap where a temperature is fetched"
    conversions = [order for order in bus.chips[2].orders if order in (0x48, 0x58)]
    assert conversions.count(0x58) == pytest.approx(len(conversions) / 20, abs=1)


def test_sensors_that_are_dead_damaged_or_unplugged_do_not_answer():
    bus = Bus()
    bus.dead = {1}
    bus.chips[3].prom[4] ^= 1
    sensors, pa = ms5837.Sensors(bus), [0.0] * 4
    assert sensors.start() == 0b0101
    assert [sensors.step(pa) for _ in range(4)][-1] == 0b0101
    bus.dead.add(0)
    assert sensors.step(pa) == 0b0100
    bus.dead.clear()
    sensors.step(pa)
    assert sensors.step(pa) == 0b0101, "back as soon as it answers"
    bus.chips[0].converted = 0
    assert sensors.step(pa) == 0b0100, "a conversion that is not complete reads 0"


@pytest.mark.parametrize(("source_hz", "scale"), [(168_000_000, 167), (84_000_000, 83), (1_000_000, 0)])
def test_timers_count_microseconds(source_hz, scale):
    assert pwm.prescaler(source_hz) == scale
    assert source_hz / (scale + 1) == 1e6 and scale < 65536 and pwm.FRAME_US - 1 < 65536


@pytest.mark.parametrize("source_hz", [0, 1_500_000, 65_537_000_000])
def test_a_clock_that_makes_no_microseconds_is_told(source_hz):
    with pytest.raises(ValueError, match="makes no microseconds"):
        pwm.prescaler(source_hz)


def test_twelve_outputs_and_a_lamp_share_no_pin_and_no_channel():
    outputs = [*pwm.THRUSTERS, *pwm.SERVOS, pwm.LAMP]
    assert len({(timer, channel) for timer, channel, _ in outputs}) == len(outputs) == 13
    assert len({pin for *_, pin in [*outputs, *pwm.KILL]}) == 15
    assert [pwm.lamp_us(level) for level in (0, 500, 1000)] == [1100, 1500, 1900]


def test_hal_agrees_with_the_stubs_of_the_port(tmp_path):
    """Names, arguments and results of pyb and machine. Faults that the stubs have themselves are not ours."""
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
    (tmp_path / "mypy.ini").write_text(f"[mypy]\nmypy_path = {tmp_path}\ncustom_typeshed_dir = {tmp_path}\n")
    options = ["--check-untyped-defs", "--follow-imports", "silent", "--cache-dir", tmp_path / "cache"]
    ran = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", tmp_path / "mypy.ini", *options, "hal_stm32.py"],
        cwd=FIRMWARE,
        capture_output=True,
        text=True,
    )
    assert "checked 1 source file" in ran.stdout, ran.stdout + ran.stderr
    assert not [line for line in ran.stdout.splitlines() if line.startswith("hal_stm32.py")]
