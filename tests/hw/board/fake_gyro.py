"""An ICM-42688-P at the level of bytes on its SPI, by its data sheet: registers, and when it measures."""

from __future__ import annotations

WHO_AM_I, PWR_MGMT0, GYRO_CONFIG0, GYRO_ACCEL_CONFIG0, GYRO_DATA_Z1 = 0x75, 0x4E, 0x4F, 0x52, 0x29
ACCEL_CONFIG0, ACCEL_DATA_X1 = 0x50, 0x1F
STARTING = 3  # readings of 20 ms that it takes


class FakeGyro:
    """A machine.SPI with the chip behind it, and its select line. `raw`, `pull_g`: what it measures."""

    def __init__(self) -> None:
        self.there, self.listens, self.raw = True, False, 0
        self.pull_g = (0.0, 0.0, 1.0)
        self.power_on()

    def power_on(self) -> None:
        """As after a reset: off, 2000 degrees a second."""
        self.registers = {WHO_AM_I: 0x47, PWR_MGMT0: 0, GYRO_CONFIG0: 0x06, GYRO_ACCEL_CONFIG0: 0x11}
        self.registers[ACCEL_CONFIG0] = 0x06
        self.read = 0

    def select(self, level: int) -> None:
        self.listens = not level

    def write(self, order: bytes) -> None:
        assert self.listens and len(order) == 2 and order[0] in self.registers, "that is not the firmware's business"
        if self.there:
            self.registers[order[0]] = order[1]

    def write_readinto(self, order: bytes, answer: bytearray) -> None:
        assert self.listens and len(order) == len(answer) and order[0] & 0x80
        register = order[0] & 0x7F
        answer[:] = b"\xff" * len(answer)
        if not self.there:
            return
        if register == GYRO_DATA_Z1:
            answer[1:3] = self._measured().to_bytes(2, "big", signed=True)
        elif register == ACCEL_DATA_X1:
            per_g = 2048 << (self.registers[ACCEL_CONFIG0] >> 5)
            measured = [round(g * per_g) if self._measured() != -32768 else -32768 for g in self.pull_g]
            answer[1:7] = b"".join(value.to_bytes(2, "big", signed=True) for value in measured)
        else:
            answer[1] = self.registers[register]

    def _measured(self) -> int:
        if self.registers[PWR_MGMT0] & 0b1111 != 0b1111:
            return -32768
        self.read += 1
        full_scale = 2000 >> (self.registers[GYRO_CONFIG0] >> 5)
        return self.raw if full_scale == 250 and self.read > STARTING else 12345
