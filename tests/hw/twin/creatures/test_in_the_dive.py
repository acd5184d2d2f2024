"""Creatures in a dive: what is kept of them, what is told, and that robots' own chances are as without them."""

import csv
from pathlib import Path

import msgspec
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.robot.fleet_reader import load_fleet
from hw.twin.camera_device import DiveCamera, FrameClock
from hw.twin.creatures import Lookout
from hw.twin.dive import Dive
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Outline
from hw.twin.physics.tank import TICK_NS
from hw.twin.scene import Current, Startle, load_scene
from tests.hw.twin.devices.test_camera_device import Notebook

FLEET = load_fleet(Path(__file__).parent.parent / "swim.toml")
SCENE = load_scene("fish")


def dived(scene, ticks):
    dive = Dive(FLEET, list(FLEET.robot), 0, scene=scene)
    dive.states["held"] = 0
    for _ in range(ticks):
        dive.tick(0.0)
    return dive


def test_robots_are_where_they_are_without_creatures():
    alone = dived(msgspec.structs.replace(SCENE, creature=()), 60)
    together = dived(SCENE, 60)
    assert alone.states.tobytes() == together.states.tobytes()
    assert alone._readings_pa == together._readings_pa
    assert not alone.school and alone.history.creatures_at(0) == []


def test_the_current_takes_a_creature_along():
    flowing = msgspec.structs.replace(SCENE, current=Current(velocity_m_s=(0.1, 0.0, 0.0)))
    still = msgspec.structs.replace(SCENE, current=Current())
    with_it, without = (np.array(dived(scene, 60).school.attitudes[0][:3]) for scene in (flowing, still))
    np.testing.assert_allclose(with_it - without, (0.06, 0.0, 0.0), atol=0.01)


def test_cameras_see_a_creature_where_it_was_then():
    dive = dived(SCENE, 60)
    assert dive.history.creatures_at(60 * TICK_NS) == dive.school.attitudes
    before, between, after = (
        np.array(dive.history.creatures_at(t_ns)[0]) for t_ns in (300_000_000, 302_500_000, 310_000_000)
    )
    np.testing.assert_allclose(between, before + 0.25 * (after - before))
    notebook, told = Notebook(), []
    notebook.outlines = lambda moment, distance_m: [Outline("fish", (0, 0, 1, 1), 1, 1)]
    lens = draw_lens(SCENE.camera, np.random.default_rng(0))
    where = (dive.history, lens, notebook, notebook, (0.1, 0.0, 0.0), dive.stage, FrameClock(0), lambda: 0)
    camera = DiveCamera(0, *where, creatures=SCENE.creature, witness=lambda *row: told.append(row))
    camera._frame(7, 302_500_000, None)
    (seen,) = notebook.moments[-1].creatures
    middle_m = np.array([part.position_m for part in seen.parts[:6]]).mean(0)
    assert np.linalg.norm(middle_m - between[:3]) < 0.01
    assert [row[:2] for row in told] == [(302_500_000, 7)]


def test_a_startle_is_of_a_creature_that_is_there():
    startle = Startle(at_s=0.1, creature="fish", speed_m_s=0.5, for_s=1.0)
    dive = dived(msgspec.structs.replace(SCENE, event=(startle,)), 60)
    way_m = np.subtract(dive.school.attitudes[0][:3], dive.history.creatures_at(50 * TICK_NS)[0][:3])
    assert np.linalg.norm(way_m) / 0.1 == pytest.approx(0.5, rel=0.05)
    nobody = msgspec.structs.replace(startle, creature="whale")
    with pytest.raises(ConfigError, match="no creature 'whale'; name one of fish"):
        dived(msgspec.structs.replace(SCENE, event=(nobody,)), 0)


def test_the_truth_is_written_for_who_judges(tmp_path):
    dive = dived(SCENE, 0)
    dive.lookout = lookout = Lookout(["fish"], tmp_path)
    for _ in range(20):
        dive.tick(0.0)
    lookout.frame("r1", 5, 3, [Outline("fish", (1, 2, 3, 4), 10, 4)])
    lookout.close()
    lookout.frame("r1", 6, 4, [])  # a camera that is late
    rows = list(csv.DictReader((tmp_path / "creatures.csv").read_text().splitlines()))
    assert [int(row["t_ns"]) for row in rows] == [50_000_000, 100_000_000, 150_000_000, 200_000_000]
    names = ("x_m", "y_m", "z_m", "heading_rad", "pitch_rad")
    assert [float(rows[-1][name]) for name in names] == pytest.approx(dive.school.attitudes[0][:5], abs=1e-5)
    assert (tmp_path / "boxes.csv").read_text().splitlines()[1:] == ["5,r1,3,fish,1,2,3,4,10,4"]
