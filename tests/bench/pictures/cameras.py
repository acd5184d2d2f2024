"""What other cameras would have made of a picture: each change of it is one camera."""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from agent.experiments.detection_pictures import MarkedBall
from agent.perception.detection.colour import ENCODED
from agent.perception.detection.detectors import LIGHTS

NOISE = 4.0  # standard deviation, of 255
SMALLER = 0.75

Image = np.ndarray


class Changed(NamedTuple):
    """What another camera makes of a picture, and where that leaves the balls."""

    image: Callable[[Image], Image]
    ball: Callable[[MarkedBall, int], MarkedBall] = lambda ball, width_px: ball


AS_TAKEN = Changed(lambda image: image)


def noisy(image: Image) -> Image:
    noise = np.random.Generator(np.random.PCG64(1)).normal(0.0, NOISE, image.shape)
    return np.uint8(np.clip(np.rint(image + noise), 0, 255))


def jpeg(image: Image, quality: int = 50) -> Image:
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)


def drawn(seed: int) -> Changed:
    """A camera by chance: gamma, white balance, exposure, noise and JPEG at once (one sigma: 15 %, 20 %, 20 %)."""
    rng = np.random.default_rng(seed)
    power = np.exp(rng.normal(0.0, 0.15)) / ENCODED
    factors = np.exp(rng.normal(0.0, 0.2, 3) + rng.normal(0.0, 0.2))
    quality, noise = int(rng.integers(50, 96)), rng.uniform(0.0, 2.5)

    def change(image: Image) -> Image:
        light = np.clip((image / 255.0) ** ENCODED * factors, 0.0, 1.0)
        grain = np.random.default_rng(seed).normal(0.0, noise, image.shape)
        return jpeg(np.uint8(np.clip(np.rint(255.0 * light**power + grain), 0, 255)), quality)

    return Changed(change)


def mirrored(ball: MarkedBall, width_px: int) -> MarkedBall:
    return ball._replace(centre_px=(width_px - 1 - ball.centre_px[0], ball.centre_px[1]))


def smaller(ball: MarkedBall, width_px: int) -> MarkedBall:
    u, v = ((at + 0.5) * SMALLER - 0.5 for at in ball.centre_px)
    return MarkedBall(ball.colour, (u, v), ball.radius_px * SMALLER, ball.tolerance_px * SMALLER)


# Of those drawn the seeds are others than those that bench_paints.py fits on.
CHANGES: dict[str, Changed] = {
    "as_taken": AS_TAKEN,
    "mirrored": Changed(lambda image: np.ascontiguousarray(image[:, ::-1]), mirrored),
    "gamma_0.7": Changed(LIGHTS["gamma 0.7"]),
    "gamma_1.4": Changed(LIGHTS["gamma 1.4"]),
    "jpeg_50": Changed(jpeg),
    "warmer": Changed(LIGHTS["warmer light"]),
    "colder": Changed(LIGHTS["colder light"]),
    "exposure_0.7": Changed(LIGHTS["less light"]),
    "exposure_1.3": Changed(LIGHTS["more light"]),
    "noise_4": Changed(noisy),
    "size_0.75": Changed(lambda image: cv2.resize(image, None, fx=SMALLER, fy=SMALLER, interpolation=3), smaller),
    **{f"drawn_{seed}": drawn(seed) for seed in range(1, 4)},
}
