"""The golden case of a fleet with [coverage]: two moored robots, a third of whose words are lost."""

from pathlib import Path

from agent.experiments.reconstruction.coverage import (
    SIZE_M,
    STEP_NS,
    SURFACE_M,
    SURVEY_START_NS,
    World,
    draw_scene,
    fleet_of,
)
from tests.replay.step_box import StepBox

SECONDS = 15.0  # two keyframes of each


def survey(out: Path) -> None:
    """Write it."""
    fleet = fleet_of(count=2)
    world = World(fleet, draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), 4), 4, True, 0.3)
    boxes = {n: StepBox(out / f"{n}.mcap", fleet, n, world.calibration, SURVEY_START_NS) for n in fleet.robot}
    world.record = lambda name, now_ns, inputs, outputs: boxes[name].add(now_ns, inputs, outputs)
    for _ in range(round(SECONDS * 1e9) // STEP_NS):
        world.step()
    for box in boxes.values():
        box.finish()
