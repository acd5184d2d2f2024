"""The golden log of vision: one sweep of a painted ball, every frame of it, and what vision made of them.

Its frames are JPEG, as a robot records them; vision saw them before they were compressed.
"""

from __future__ import annotations

import sys
from pathlib import Path

from agent.config import dump
from agent.messages import Sighting, encode
from agent.perception.again import see_again
from agent.runtime import run_facts
from replay.backlog import Entry
from replay.frames import FRAME, VISION, picture
from replay.mcap_file import Part
from tests.network.scripted_agent import CALIBRATION

sys.path.insert(0, str(Path(__file__).parents[1] / "perception"))
from painted import PX_PER_POSITION, ball_frame, sharp_position

CENTRE_M = (0.03, -0.02, 0.62)
POSITIONS = range(-3, 4)  # steps of the sweep, from where the ball is sharp
STEP = 90  # lens positions
PART = (208, 40, 340, 324)  # x, y, width, height: what a robot reads while it sweeps


def paint(fleet, out: Path, start_ns: int, step_ns: int) -> None:
    """Write r1.mcap into the folder `out`."""
    see, sharp = see_again(fleet, CALIBRATION.camera), sharp_position(CENTRE_M[2])
    x, y, width, height = PART
    box = Part(out / "r1.mcap")
    attachments = {"fleet.toml": dump(fleet), "calibration.toml": dump(CALIBRATION)}
    box.start(run_facts(fleet, "r1", start_ns), attachments)
    first = None
    for n, k in enumerate(POSITIONS):
        focus, now_ns = round(sharp + k * STEP), start_ns + n * step_ns
        image = ball_frame(CENTRE_M, abs(focus - sharp) * PX_PER_POSITION)[y : y + height, x : x + width]
        target = next(iter(fleet.target))
        then = Sighting(t_ns=now_ns, frame=n, sweep=1, index=n + 1, focus=focus, target=target, found=False)
        then = see(image, PART, then, first)
        first = first or then
        for channel, data in ((FRAME, picture(image, PART, then, False)), (VISION, encode(then))):
            box.add(Entry(channel, now_ns, now_ns, n, data, "msgpack", {}))
    box.finish("aucamp.end", {"cause": "clean"})
