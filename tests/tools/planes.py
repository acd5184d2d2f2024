"""Two textured planes, each sharp at a lens position of its own: photographs of them, and cameras that look at them."""

import cv2
import numpy as np

from agent.core.ranging.camera_model import Calibration, CameraFit, FocusFit
from hw.camera.camera import FocusRange, Frame, Roi

FOCUS = FocusFit(
    u_inf_m=0.05, b_m=200.0, rho0=-300.0, covariance=(0, 0, 0, 0, 0, 0), noise=1.0, width=80.0,
    lowest=0, highest=1023, r2=1.0, rmse_m=0.0, held_out_rmse_m=0.0,
)  # fmt: skip
PINHOLE = CameraFit(width_px=240, height_px=160, f_px=800.0, cx_px=120.0, cy_px=80.0)
CALIBRATION = Calibration(robot="r1", made="2024-01-01", source="invented", focus=FOCUS, camera=PINHOLE)


def quiet(done, total):
    pass


def blurred(texture, sharp_at, lens_position, per_position):
    """The texture as a lens shows it whose blur grows with the distance from its sharp lens position."""
    return cv2.GaussianBlur(texture, (0, 0), 0.5 + per_position * abs(lens_position - sharp_at))


def two_planes(lens_position, left, right, per_position):
    """160x240: one plane at `left`, one at `right`, and from row 110 on plain grey."""
    texture = np.random.default_rng(3).integers(0, 256, (160, 240, 3)).astype(np.uint8)
    halves = ((texture[:, :120], left), (texture[:, 120:], right))
    image = np.hstack([blurred(half, sharp_at, lens_position, per_position) for half, sharp_at in halves])
    image[110:] = 128
    return image


class Lens:
    """A camera with 1024 lens positions that reports one less than it was told, as a driver with a coarse step does."""

    size = (240, 160)

    def __init__(self):
        self.lens_position = 700
        self.visited = []

    def focus_range(self):
        return FocusRange(0, 1023, 1)

    def set_focus(self, position):
        self.lens_position = max(position - 1, 0)
        self.visited.append(self.lens_position)
        return self.lens_position

    def read(self, roi=None, settle_s=0.0, timeout_s=1.0):
        return Frame(0, 0, two_planes(self.lens_position, 400.4, 640.7, 1 / 100), Roi(0, 0, *self.size))

    def close(self):
        pass


class Breathing(Lens):
    """Its picture grows by five percent about the middle, as that of a lens does that focuses nearer."""

    size = (300, 300)
    texture = cv2.GaussianBlur(np.random.default_rng(5).normal(128, 60, (1200, 1200)), (0, 0), 3.0)

    def read(self, roi=None, settle_s=0.0, timeout_s=1.0):
        k = 0.5 * (1 + 0.05 * self.lens_position / 1023)
        warp = np.array([[k, 0, 149.5 - k * 599.5], [0, k, 149.5 - k * 599.5]])
        image = cv2.warpAffine(blurred(self.texture, 500.0, self.lens_position, 1 / 200), warp, self.size)
        grey = np.clip(image, 0, 255).astype(np.uint8)
        return Frame(0, 0, np.repeat(grey[:, :, None], 3, axis=2), Roi(0, 0, *self.size))
