"""`aucamp calibrate landmarks` on the twin: a film of the basin's tags, of which six are known and no other listed.

Each tag is off where it should be, as the twin draws it. The camera is calibrated on the twin's bench first, and keeps
what that got wrong. Errors are those of the tags that nobody listed; NEES / 6 is 1 where the stated sigmas are honest.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec.structs import replace

from agent.calibration.landmarks import known_tags, survey
from agent.calibration.rotation import turned_by
from agent.calibration.survey_bundle import SurveyFrame
from agent.calibration.survey_views import Views, fresh
from agent.experiments.posed_robot import PosedRobot
from agent.fleet_files import shipped_fleet
from agent.kernel.config import Fleet
from agent.kernel.fleet_reader import load_fleet
from agent.kernel.ranging.calibration import Calibration, at_lens_position
from agent.kernel.ranging.focus import lens_position
from agent.perception.landmarks.tags import find_tags
from hw.twin.landmarks import PaintedTag, true_tags
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.view import Eye
from hw.twin.scene import generator, load_scene

SEEDS = range(100, 101)
FRAMES = 250
KNOWN = (2, 7, 20, 33, 46, 61)  # one on each wall, two on the floor
ROBOT, SENSOR = "r1", "imx519_640"
SHARP_M = 0.9
Array = np.ndarray


def run() -> dict[str, dict]:
    shift_m, turn_rad, nees, sigma = (np.concatenate(each) for each in zip(*map(surveyed, SEEDS), strict=True))
    turn_deg, stated_deg = np.degrees(rms(turn_rad)), np.degrees(rms(sigma[:, 3:]))
    return {
        "survey_shift_rms": row(1e3 * rms(shift_m), "mm a coordinate", 1e3 * rms(sigma[:, :3])),
        "survey_turn_rms": row(turn_deg, "deg an angle", stated_deg),
        "survey_nees": row(float(nees.mean()) / 6, f"{len(nees)} tags", 1.0),
    }


def surveyed(seed: int) -> tuple[Array, ...]:
    """Of the tags that nobody listed: shift (n, 3), m, turn (n, 3), rad, NEES (n,), stated sigmas (n, 6)."""
    path = shipped_fleet("swim")
    fleet = load_fleet(path)
    assert fleet.landmarks is not None
    fleet = replace(fleet, twin=replace(fleet.twin, seed=seed))
    known = known_tags(fleet, KNOWN, path)
    camera = PosedRobot(fleet, ROBOT, SENSOR).calibrate()
    truth = {tag.id: tag for tag in true_tags(fleet.landmarks, seed)}
    frames = list(fresh(film(fleet, camera, list(truth.values()))))
    fleet = replace(fleet, landmarks=replace(fleet.landmarks, tag=tuple(known)))
    found = survey(Views(frames, FRAMES, float(np.sqrt(camera.camera.scale_covariance[0]))), fleet, known, flat=True)
    tags = found.bundle.tags
    shift_m = tags.middle_m - [truth[one].position_m for one in tags.ids]
    pairs = zip(tags.rotation, tags.ids, strict=True)
    turn_rad = np.array([turned_by(rotation @ truth[one].rotation.T) for rotation, one in pairs])
    error, sigma = np.hstack([shift_m, turn_rad]), np.sqrt(np.einsum("kii->ki", found.bundle.covariance))
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(found.bundle.covariance), error)
    free = ~np.isin(tags.ids, KNOWN)
    return shift_m[free], turn_rad[free], nees[free], sigma[free]


def film(fleet: Fleet, known: Calibration, tags: Sequence[PaintedTag]) -> Iterator[SurveyFrame]:
    """Somebody takes the camera about the basin, lens at rest, and looks everywhere."""
    seed = fleet.twin.seed
    rng = np.random.default_rng(seed)
    lens = draw_lens(SENSOR, generator(seed, ROBOT, "lens"))
    scene = replace(load_scene(fleet.twin.scene), camera=SENSOR)
    painter = Painter(scene, fleet.tank, fleet.water.refractive_index, lens, seed, ROBOT, tags)
    painter.prepare()
    position = round(lens_position(known.focus, SHARP_M))
    camera = at_lens_position(known.camera, position)
    for tick in range(FRAMES):
        eye_m = rng.uniform((0.6, 0.6, 0.25), (2.4, 1.4, 0.42))
        yaw, tilt = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(-50, 0))
        ahead = np.array([np.cos(yaw) * np.cos(tilt), np.sin(yaw) * np.cos(tilt), np.sin(tilt)])
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        eye = Eye(tuple(eye_m), np.stack([right, np.cross(ahead, right), ahead], axis=1))
        image = painter.frame(eye, lens.at_position_m(position), tick=tick)
        yield SurveyFrame(camera.f_px, camera.width_px, tuple(one.seen for one in find_tags(image, camera)))


def rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def row(value: float, unit: str, stated: float) -> dict:
    return {"value": value, "unit": unit, "against": f"stated {stated:.3g}", "ratio": value / stated}
