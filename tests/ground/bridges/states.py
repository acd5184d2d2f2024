"""States of robots, as bridges hear them."""

from typing import Any

from agent.core.messages import State

S = 1_000_000_000
START_NS = 1_700_000_000 * S


def state(robot: str = "r1", sent_ns: int = START_NS, **about: Any) -> State:
    """Of a moored robot of fleet "tank" that hangs at 0.4 m, started 10 s ago; its bow a little down, left side up."""
    rest = {"seq": 1, "target": "ball", "knows": "blind", "t": 0, "depth_m": 0.4, "roll_deg": 2.0, "pitch_deg": 5.0}
    return State(
        fleet="tank", robot=robot, sent_ns=sent_ns, **{"incarnation": START_NS - 10 * S, "armed": True, **rest, **about}
    )
