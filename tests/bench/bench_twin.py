"""What the twin takes: water, cameras, lamps, a board's firmware, and a robot in lock-step with all but pictures."""

from __future__ import annotations

import resource
import sys
import time
from functools import partial
from unittest.mock import patch

import cv2
import numpy as np

from agent.core.config import Pose, Tank
from agent.experiments import ball_measurements
from agent.experiments.claim import Figure, Row
from agent.experiments.dark_water import DarkWater, stand
from agent.experiments.navigation import basin
from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.still_camera import rotation_of_view
from agent.process.command import Failed
from agent.robot.fleet_reader import load_fleet
from hw.twin.dive import Dive
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye
from hw.twin.physics.tank import STEP_S, STEPS_PER_TICK, TICK_NS, advance
from hw.twin.scene import generator, load_scene
from tests.bench.timing import Settings, claim_of_costs, medians_ms, one_thread
from tests.places import ROOT

TICKS = 200  # that are timed as one
PART = (170, 90, 300, 300)
AT_M = 1.25  # from the ball
FIND_S, SWUM_S = 12.0, 20.0


def water(times: int) -> Row:
    """Three robots: how many times faster than real time; physics alone, and with sensors and history."""
    dive = Dive(load_fleet(ROOT / "agent" / "fleets" / "tank.toml"), ["r1", "r2", "r3"], start_ns=0)
    dive.states["held"] = 0
    dive.move()
    bodies = dive.bodies, dive.states, dive._pulses_us, dive._nominal_deg, dive._size_m, dive._surface_m
    ways = {"physics": partial(advance, *bodies, STEP_S, STEPS_PER_TICK), "tick": dive.move}
    row = medians_ms({way: lambda work=work: [work() for _ in range(TICKS)] for way, work in ways.items()}, times)
    return {way: 1e-6 * TICKS * TICK_NS / ms for way, ms in row.items()}


def pictures(times: int) -> Row:
    """Frames in focus and far out of it, and a region of one."""
    scene = load_scene("tank")
    lens = draw_lens(scene.camera, generator(0, "r1", "lens"))
    painter = Painter(scene, Tank(), 1.333, lens, 0, "r1")
    painter.prepare()
    eye = Eye((0.38, 0.31, 0.10), rotation_of_view(33.5, 0.0))
    sharp, far = lens.image_m(1 / 0.29), lens.at_position_m(lens.lowest)
    plain = np.random.default_rng(0).random((480, 640, 3), dtype=np.float32)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9)).astype(np.float32)
    ways = {
        "filter": lambda: cv2.filter2D(plain, -1, disc),
        "sharp": lambda: painter.frame(eye, sharp),
        "blurred": lambda: painter.frame(eye, far),
        "part": lambda: painter.frame(eye, sharp, roi=PART),
    }
    with one_thread():
        return medians_ms(ways, times, time.process_time)


def lamps(times: int) -> Row:
    """A ball in harbour water by a robot's own lamp, and by those of two neighbours too."""
    stands = {"r1": stand(AT_M, 0.0), "r2": stand(0.72, 30.0), "r3": stand(0.72, -45.0)}
    sea = DarkWater("harbour", 0)
    sea.prepare()
    lit = {"one": ("r1",), "three": tuple(stands)}
    ways = {way: partial(sea.painter.light, sea.moment("r1", stands, by), sea.sharp_m(AT_M)) for way, by in lit.items()}
    with one_thread():
        row = medians_ms(ways, times, time.process_time)
    return {**row, "lamp": (row["three"] - row["one"]) / 2.0}


def lockstep(times: int) -> Row:
    """One robot that holds its place by drawn tags. What starting takes is left out, as the difference of two dives."""
    (short_s, short_board_s), (long_s, long_board_s) = dived(0.0), dived(SWUM_S)
    own_s, board_s = long_s - short_s, long_board_s - short_board_s
    return {"firmware_core": 100.0 * board_s / SWUM_S, "speed": SWUM_S / (own_s + board_s)}


def dived(seconds: float) -> tuple[float, float]:
    """Processor seconds of this process, and of the firmware's."""
    fleet = basin.fleet({"r1": basin.robot("r1", Pose(x_m=1.0, y_m=1.0, yaw_deg=0.0))}, 0)
    began_s, boards_s = time.process_time(), ended_s()
    # MicroPython's Unix port is not there on every machine.
    with patch.object(ball_measurements, "interpreter", lambda: sys.executable), basin.twin_bodies(fleet) as bodies:
        one = Swimmers(fleet, bodies)
        if not one.until_swims("r1", FIND_S):
            raise Failed("the robot never swam: this measures the wrong thing")
        one.path("r1", seconds)
    return time.process_time() - began_s, ended_s() - boards_s


def ended_s() -> float:
    """Processor seconds of all processes that this one started and that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return children.ru_utime + children.ru_stime


CASES = {"water": water, "pictures": pictures, "lamps": lamps, "lockstep": lockstep}


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    return [CASES[case](settings.times)]


CLAIM = claim_of_costs(
    run=run,
    cases=CASES,
    figures=(
        Figure("water.physics", "physics of three robots, against real time", "times"),
        Figure("water.tick", "the same with sensors and history, against real time", "times"),
        Figure("pictures.sharp", "a frame of 640x480 in focus", "ms"),
        Figure("pictures.sharp/filter", "the same, against one filter2D with a disc of 9 px", "times"),
        Figure("pictures.blurred/sharp", "a frame far out of focus, against one in focus", "times"),
        Figure("pictures.part/sharp", "300x300 of a frame, against all of it", "times"),
        Figure("lamps.one", "a frame of 640x480 in the dark, by the own lamp", "ms"),
        Figure("lamps.lamp", "one more lamp adds light, shadows and veil", "ms", most=10.0),
        Figure("lamps.lamp/one", "the same, against a frame by the own lamp", "times"),
        Figure("lockstep.firmware_core", "a board's firmware at real time, under this Python", "% of a core", most=4.0),
        Figure("lockstep.speed", "one robot in lock-step, tags drawn, against real time", "times"),
    ),
    explanation="""Processor time, of one thread where pictures are rendered. In lock-step the water waits for the
        firmware and the kernel, so a dive takes as long as they do; nothing is rendered there.""",
)
