"""The same clips as another camera, another recorder or another computer would have given them."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from agent.perception.tracking.appearance import Box
from agent.tools.track import Truth
from tests.perception.tracking.loss_clips import Clip


def gamma(clip: Clip, power: float) -> Clip:
    """Brighter below 1, darker above."""
    table = np.round(255.0 * (np.arange(256) / 255.0) ** power).astype(np.uint8)
    return clip._replace(images=[cv2.LUT(image, table) for image in clip.images])


def compressed(clip: Clip, quality: int) -> Clip:
    """JPEG of this quality, 0 to 100."""
    files = (cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1] for image in clip.images)
    return clip._replace(images=[cv2.imdecode(file, cv2.IMREAD_COLOR) for file in files])


def every_second(clip: Clip) -> Clip:
    """Half the frames: everything moves twice as far from one to the next."""
    truth = [Truth(k // 2, box, counted) for k, box, counted in clip.truth[::2]]
    return clip._replace(rate_hz=clip.rate_hz / 2.0, images=clip.images[::2], truth=truth)


def resized(clip: Clip, factor: float) -> Clip:
    """Frames of `factor` times the sides."""
    way = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    images = [cv2.resize(image, None, fx=factor, fy=factor, interpolation=way) for image in clip.images]
    truth = [row._replace(box=row.box and Box(*(side * factor for side in row.box))) for row in clip.truth]
    return clip._replace(images=images, truth=truth)


DISTURBANCES: dict[str, Callable[[Clip], Clip]] = {
    "gamma_0.7": lambda clip: gamma(clip, 0.7),
    "gamma_1.4": lambda clip: gamma(clip, 1.4),
    "jpeg_50": lambda clip: compressed(clip, 50),
    "half_rate": every_second,
    "size_0.7": lambda clip: resized(clip, 0.7),
    "size_1.5": lambda clip: resized(clip, 1.5),
}
