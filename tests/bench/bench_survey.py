"""`aucamp calibrate landmarks` on the twin: 250 pictures of 68 tags, each off its place as the twin draws it.

The camera is calibrated on the twin's bench first, and keeps what that got wrong. Once six tags are known as well as
the fleet file says and no other is listed: errors are the others'. Once all are listed, each as wrong as by a quick
look with a tape (5 mm, 1 degree). NEES / 6 is 1 where the stated sigmas are honest.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec.structs import replace

from agent.core.config import Fleet, Tag
from agent.core.ranging.camera_model import Calibration, at_lens_position
from agent.core.ranging.focus import lens_position
from agent.experiments.ball_measurements import PosedRobot
from agent.perception.tags import find_tags
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from agent.tools.tag_bundle import SurveyFrame, turned_by
from agent.tools.tag_map import Views, fresh, known_tags, survey
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye
from hw.twin.scene import generator, load_scene
from hw.twin.truth import PaintedTag, true_tags

SEEDS = range(100, 103)
FRAMES = 250
KNOWN = (2, 7, 20, 33, 46, 61)  # one on each wall, two on the floor
TAPE_M, TAPE_DEG = 0.005, 1.0
ROBOT, SENSOR = "r1", "imx519_640"
SHARP_M = 0.9
Array = np.ndarray
Truth = dict[int, PaintedTag]


def run() -> dict[str, dict]:
    rows = {}
    found = [surveyed(seed) for seed in SEEDS]
    for name, each in zip(("six_known", "by_tape"), zip(*found, strict=True), strict=True):
        error, sigma, nees = (np.concatenate(one) for one in zip(*each, strict=True))
        turn_deg, stated_deg = np.degrees(rms(error[:, 3:])), np.degrees(rms(sigma[:, 3:]))
        rows |= {
            f"survey_{name}_shift_rms": row(1e3 * rms(error[:, :3]), "mm a coordinate", 1e3 * rms(sigma[:, :3])),
            f"survey_{name}_turn_rms": row(turn_deg, "deg an angle", stated_deg),
            f"survey_{name}_nees": row(float(nees.mean()) / 6, f"{len(nees)} tags", 1.0),
        }
    return rows


def surveyed(seed: int) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    """With six known, and by tape: see `judged`."""
    path = shipped_fleet("swim")
    fleet = load_fleet(path)
    fleet = replace(fleet, twin=replace(fleet.twin, seed=seed))
    assert fleet.landmarks is not None
    camera = PosedRobot(fleet, ROBOT, SENSOR).calibrate()
    truth = {tag.id: tag for tag in true_tags(fleet.landmarks, seed)}
    views = Views(
        list(fresh(film(fleet, camera, list(truth.values())))), FRAMES, float(camera.camera.scale_covariance[0] ** 0.5)
    )
    six = replace(fleet.landmarks, tag=tuple(known_tags(fleet, KNOWN, path)))
    rng = np.random.default_rng(seed)
    taped = tuple(by_tape(tag, truth[tag.id], rng) for tag in fleet.landmarks.tag)
    tape = replace(fleet.landmarks, tag=taped, sigma_m=TAPE_M, sigma_deg=TAPE_DEG)
    return judged(views, replace(fleet, landmarks=six), truth, KNOWN), judged(
        views, replace(fleet, landmarks=tape), truth, ()
    )


def judged(views: Views, fleet: Fleet, truth: Truth, without: Sequence[int]) -> tuple[Array, Array, Array]:
    """Errors (n, 6) of each tag, shift in m and turn in rad, stated sigmas (n, 6), and NEES (n,)."""
    assert fleet.landmarks is not None
    found = survey(views, fleet, fleet.landmarks.tag, flat=True).bundle
    ids = found.tags.ids
    shift_m = found.tags.middle_m - [truth[one].position_m for one in ids]
    pairs = zip(found.tags.rotation, ids, strict=True)
    turn_rad = np.array([turned_by(rotation @ truth[one].rotation.T) for rotation, one in pairs])
    error, sigma = np.hstack([shift_m, turn_rad]), np.sqrt(np.einsum("kii->ki", found.covariance))
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(found.covariance), error)
    free = ~np.isin(ids, without)
    return error[free], sigma[free], nees[free]


def by_tape(tag: Tag, true: PaintedTag, rng: np.random.Generator) -> Tag:
    """Its place on its face as somebody measured it in a hurry."""
    place = true.position_m + rng.normal(0.0, TAPE_M, 3)
    off = "xyf".index(tag.face[0])
    place[off] = tag.position_m[off]
    x, y, z = place.tolist()
    return replace(tag, position_m=(x, y, z), turn_deg=tag.turn_deg + float(rng.normal(0.0, TAPE_DEG)))


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
