"""A camera without optics: a drawn ball whose blur depends on the lens position, in frames that take no time."""

import numpy as np

from agent.core.config import Camera as CameraSettings
from agent.core.config import Fleet, Pose, Robot, Target
from hw.camera.camera import CameraGone, FocusRange, Frame, Roi
from tests.perception.painted import sharp_position

CENTRE_M = (0.02, 0.01, 0.9)
EMPTY = np.full((480, 640, 3), 90, np.uint8)


class ScriptedCamera:
    """A ball whose blur depends on the lens position; `gone` makes the next reads fail. Frames take no time."""

    size = (640, 480)

    def __init__(self, focusable=True, images=None):
        self.lens_position, self.seq, self.closed, self.gone = 0, 0, False, False
        self.focusable, self.calls = focusable, []
        self.images = images

    def focus_range(self):
        return FocusRange(0, 1023, 1) if self.focusable else None

    def set_focus(self, position):
        self.calls.append(("focus", position))
        self.lens_position = min(max(position, 0), 1023)
        return self.lens_position

    def read(self, roi=None, settle_s=0.0, timeout_s=1.0):
        if self.gone:
            raise CameraGone("no frame")
        self.calls.append(("read", roi, settle_s))
        self.seq += 1
        blur = 0.021 * abs(self.lens_position - sharp_position(CENTRE_M[2] - 0.07))
        image = self.images(blur)
        roi = roi or Roi(0, 0, 640, 480)
        part = image[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width]
        return Frame(1_000_000 * self.seq, self.seq, part, roi)

    def close(self):
        self.closed = True


def fleet_of_one(settle_s=0.03):
    robot = Robot(
        listen="tcp/127.0.0.1:17401", serial="x", camera="x", pose=Pose(x_m=0, y_m=0, yaw_deg=0), calibration="x"
    )
    return Fleet(
        fleet="tank",
        target={"ball": Target(radius_m=0.07)},
        robot={"r1": robot},
        camera=CameraSettings(settle_s=settle_s),
    )
