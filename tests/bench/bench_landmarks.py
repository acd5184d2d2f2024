"""How far off the corners of tags are that a frame of 640x480 shows, at each blur; OpenCV's corner finder beside them.

Pictures are drawn by the tests' own renderer: tags of 8 cm from 0.3 to 0.9 m, turned by up to 70 degrees, noise of 2 %
of full light.
"""

from __future__ import annotations

import cv2
import msgspec
import numpy as np

from agent.core.ranging.camera_model import CameraFit
from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value, rms
from agent.perception.tags import find_tags
from tests.perception.printed import WALL, bend, corner_slopes, photograph, tag_light, turned

CAMERA = CameraFit(width_px=640, height_px=480, f_px=1184.0, cx_px=319.5, cy_px=239.5, bend=0.392)
NOISE = 0.02
BLURS_PX = {"blur-0": 0.0, "blur-4": 4.0, "blur-8": 8.0, "blur-12": 12.0}  # diameters of the disc
LEAST_PX = 24  # sides of a tag that is drawn
SEED = 77  # no test's
Pixels = np.ndarray


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    draws: int = 10  # tags of a seed, each in a picture of its own


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """The error of each tag's corners; None: it is not found by its edges."""
    rng = np.random.default_rng((SEED, seed))
    return [judged(*drawn(rng), BLURS_PX[case], k) for k in range(settings.draws)]


def drawn(rng: np.random.Generator) -> tuple[Pixels, Pixels]:
    """Light of a tag that lies in the picture, and its corners."""
    while True:
        rotation = turned(*rng.uniform((-70, -60, -180), (70, 60, 180)))
        x, y, z = rng.uniform((-0.15, -0.09, 0.3), (0.15, 0.09, 0.9)).tolist()
        px = bend(CAMERA, corner_slopes(rotation, (x, y, z)))
        inside = ((px > 12) & (px < (627, 467))).all()
        if inside and np.hypot(*(np.roll(px, 1, axis=0) - px).T).min() > LEAST_PX:
            light = np.full((CAMERA.height_px, CAMERA.width_px), WALL)
            tag_light(CAMERA, 0, rotation, (x, y, z), light)
            return light, px


def judged(light: Pixels, px: Pixels, blur_px: float, noise_seed: int) -> Row:
    image = photograph(light, blur_px, NOISE, seed=noise_seed)
    for one in find_tags(image, CAMERA):
        if one.seen.edges:
            return {"ours_px": off_px(one.corners_px - px), "theirs_px": off_px(searched(image, one.corners_px) - px)}
    return {"ours_px": None, "theirs_px": None}


def searched(image: Pixels, corners_px: Pixels) -> Pixels:
    """By OpenCV, from the best start there is."""
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    start = corners_px.astype(np.float32).reshape(4, 1, 2)
    return cv2.cornerSubPix(image[..., 1].copy(), start, (5, 5), (-1, -1), stop).reshape(4, 2)


def off_px(error_px: Pixels) -> float:
    """Rms over corners and axes, less their mean."""
    return float(np.sqrt(np.mean(np.square(error_px - error_px.mean(axis=0)))))


def summary(rows: Rows) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for case, tags in rows.items():
        seen = [row for row in tags if row["ours_px"] is not None]
        ours, theirs = (rms([row[key] for row in seen]) for key in ("ours_px", "theirs_px"))
        found[f"{case}_px"] = ours
        found[f"{case}_times"] = ours / theirs if ours and theirs else None
        found[f"{case}_edges"] = Share(len(seen), len(tags))
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"draws": 5},
    cases=tuple(BLURS_PX),
    measured_on="model",
    figures=tuple(
        figure
        for case, blur_px in BLURS_PX.items()
        for figure in (
            Figure(f"{case}_px", f"blur of {blur_px:g} px: corners off their places, less the mean, rms", "px"),
            Figure(f"{case}_times", "the same, against cornerSubPix", "times"),
            Figure(f"{case}_edges", "tags that are found by their edges", "%"),
        )
    ),
    explanation="""One tag hangs somewhere before the camera, and is photographed with a blur and noise. The error is
        that of its four corners without their common shift, which is what a distance and an orientation are made of.
        cornerSubPix begins at our corners, the best start there is.""",
)
