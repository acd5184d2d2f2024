"""`aucamp calibrate landmarks` on the twin: a film of 68 tags, each off its place as the twin draws it.

The camera is calibrated on the twin's bench first, and keeps what that got wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import mean

import msgspec
import numpy as np
from msgspec.structs import replace

from agent.core.config import Fleet, Tag
from agent.core.ranging.camera_model import Calibration, at_lens_position
from agent.core.ranging.focus import lens_position
from agent.experiments.ball_measurements import PosedRobot
from agent.experiments.claim import Claim, Figure, Row, Rows, Value, rms
from agent.experiments.still_camera import rotation_of_view
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

KNOWN = (2, 7, 20, 33, 46, 61)  # one on each wall, two on the floor
TAPE_M, TAPE_DEG = 0.005, 1.0
ROBOT, SENSOR = "r1", "imx519_640"
SHARP_M = 0.9
Truth = dict[int, PaintedTag]


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    frames: int = 250  # of the film


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """One row for each way; a seed is another basin, camera and film."""
    path = shipped_fleet("swim")
    fleet = load_fleet(path)
    fleet = replace(fleet, twin=replace(fleet.twin, seed=seed))
    assert fleet.landmarks is not None
    known = PosedRobot(fleet, ROBOT, SENSOR).calibrate()
    truth = {tag.id: tag for tag in true_tags(fleet.landmarks, seed)}
    pictures = list(fresh(film(fleet, known, list(truth.values()), settings.frames)))
    views = Views(pictures, settings.frames, float(known.camera.scale_covariance[0] ** 0.5))
    rng = np.random.default_rng(seed)
    taped = tuple(by_tape(tag, truth[tag.id], rng) for tag in fleet.landmarks.tag)
    six = replace(fleet.landmarks, tag=tuple(known_tags(fleet, KNOWN, path)))
    tape = replace(fleet.landmarks, tag=taped, sigma_m=TAPE_M, sigma_deg=TAPE_DEG)
    return [
        {"way": "six", **judged(views, replace(fleet, landmarks=six), truth, KNOWN)},
        {"way": "tape", **judged(views, replace(fleet, landmarks=tape), truth, ())},
    ]


def judged(views: Views, fleet: Fleet, truth: Truth, without: Sequence[int]) -> Row:
    """Rms over tags of errors a coordinate and an angle; the mean of NEES / 6."""
    assert fleet.landmarks is not None
    found = survey(views, fleet, fleet.landmarks.tag, flat=True).bundle
    ids = found.tags.ids
    shift_m = found.tags.middle_m - [truth[one].position_m for one in ids]
    pairs = zip(found.tags.rotation, ids, strict=True)
    turn_rad = np.array([turned_by(rotation @ truth[one].rotation.T) for rotation, one in pairs])
    free = ~np.isin(ids, without)
    error = np.hstack([shift_m, turn_rad])[free]
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(found.covariance[free]), error)
    return {
        "shift_mm": 1e3 * float(np.sqrt(np.square(error[:, :3]).mean())),
        "turn_deg": float(np.degrees(np.sqrt(np.square(error[:, 3:]).mean()))),
        "nees": float(nees.mean()) / 6.0,
    }


def by_tape(tag: Tag, true: PaintedTag, rng: np.random.Generator) -> Tag:
    """Its place on its face as measured in a hurry."""
    place = true.position_m + rng.normal(0.0, TAPE_M, 3)
    off = "xyf".index(tag.face[0])
    place[off] = tag.position_m[off]
    x, y, z = place.tolist()
    return replace(tag, position_m=(x, y, z), turn_deg=tag.turn_deg + float(rng.normal(0.0, TAPE_DEG)))


def film(fleet: Fleet, known: Calibration, tags: Sequence[PaintedTag], frames: int) -> Iterator[SurveyFrame]:
    """A camera is taken about the basin by hand, lens at rest, and looks everywhere."""
    seed = fleet.twin.seed
    rng = np.random.default_rng(seed)
    lens = draw_lens(SENSOR, generator(seed, ROBOT, "lens"))
    scene = replace(load_scene(fleet.twin.scene), camera=SENSOR)
    painter = Painter(scene, fleet.tank, fleet.water.refractive_index, lens, seed, ROBOT, tags)
    painter.prepare()
    position = round(lens_position(known.focus, SHARP_M))
    camera = at_lens_position(known.camera, position)
    for tick in range(frames):
        x, y, z = rng.uniform((0.6, 0.6, 0.25), (2.4, 1.4, 0.42)).tolist()
        yaw_deg, tilt_deg = rng.uniform((-180.0, -50.0), (180.0, 0.0)).tolist()
        eye = Eye((x, y, z), rotation_of_view(yaw_deg, tilt_deg))
        image = painter.frame(eye, lens.at_position_m(position), tick=tick)
        yield SurveyFrame(camera.f_px, camera.width_px, tuple(one.seen for one in find_tags(image, camera)))


def summary(rows: Rows) -> dict[str, Value]:
    """Over all tags of all seeds: each has as many."""
    found: dict[str, Value] = {}
    for way in ("six", "tape"):
        ours = [row for row in rows["all"] if row["way"] == way]
        found[f"{way}_shift_mm"] = rms([row["shift_mm"] for row in ours])
        found[f"{way}_turn_deg"] = rms([row["turn_deg"] for row in ours])
        found[f"{way}_nees"] = mean(row["nees"] for row in ours)
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"frames": 60},
    measured_on="twin",
    figures=tuple(
        figure
        for way, known in (("six", "six tags known"), ("tape", "all known by tape"))
        for figure in (
            Figure(f"{way}_shift_mm", f"{known}: places, a coordinate, rms", "mm"),
            Figure(f"{way}_turn_deg", f"{known}: orientations, an angle, rms", "deg"),
            Figure(f"{way}_nees", f"{known}: their errors as stated, NEES/6"),
        )
    ),
    explanation="""A camera is taken about a basin by hand and sees 68 tags, each off its surveyed place; every frame is
        rendered. Once six tags are known well and no other is listed, and once all are known as from a tape measure,
        to 5 mm and 1 degree. A NEES/6 of 1 is honest.""",
)
