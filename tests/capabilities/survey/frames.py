"""Keyframes of a small tank, drawn, and a fleet that surveys it."""

import numpy as np

from agent.capabilities.survey.coverage_map import Grid, grid_of, quaternion
from agent.capabilities.survey.survey import lens_of, sigma_of
from agent.core.capability_messages import Blocks, Frame, place_of, quantised
from agent.core.ranging.camera_model import Calibration
from agent.experiments.navigation.swimmers import FOCUS
from agent.experiments.reconstruction.coverage import (
    SIZE_M,
    SURFACE_M,
    SURVEY_CAMERA,
    draw_scene,
    fleet_of,
    gimbal_eye,
    look,
    sigma_m,
)

FLEET = fleet_of()
GRID: Grid = grid_of(FLEET)
SCENE = draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), 3)
LENS, ROWS = lens_of(SURVEY_CAMERA, None)
SIGMA = sigma_of(Calibration(robot="r1", made="", source="", focus=FOCUS, camera=SURVEY_CAMERA))


def frame(origin: str = "r1", number: int = 1, incarnation: int = 1, servos=(1500.0, 1300.0), seed: int = 0) -> Frame:
    """What that robot sees with its gimbal there, with noise."""
    rng = np.random.default_rng(seed)
    eye = gimbal_eye(FLEET, origin, servos)
    seen = look(SCENE, np.array(eye.position_m), np.array(eye.rotation), SURVEY_CAMERA, LENS.block)
    sigma = sigma_m(np.minimum(seen.z_m, 5.0))
    shows = np.isfinite(seen.z_m) & (rng.random(seen.z_m.size) < 0.8)
    z = [float(d + s * rng.normal()) if ok else None for d, s, ok in zip(seen.z_m, sigma, shows, strict=True)]
    sigmas = tuple(float(s) if ok else 0.0 for s, ok in zip(sigma, shows, strict=True))
    packed = quantised(Blocks(LENS.cols, tuple(z), sigmas))
    return Frame(origin, incarnation, number, place_of(eye.position_m), quaternion(eye.rotation), LENS, *packed)


def drawn_frames(count: int, seed: int = 0) -> list[Frame]:
    """Of all robots in turn, with the gimbal anywhere."""
    rng, names = np.random.default_rng((seed, 1)), list(FLEET.robot)
    found = []
    for k in range(count):
        servos = tuple(float(us) for us in rng.uniform((800.0, 900.0), (2200.0, 1550.0)))
        found.append(frame(names[k % len(names)], k // len(names) + 1, 1, servos, seed=k))
    return found
