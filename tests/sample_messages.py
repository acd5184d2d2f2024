"""Messages with everything filled in that must be: a test names only what matters to it."""

from typing import Any

from agent.kernel.messages import Estimate
from agent.kernel.step_io import Telemetry


def estimate(src: str = "r2", dst: str = "r1", **about: Any) -> Estimate:
    """What `src` says to `dst` about the ball of fleet "tank"; without an estimate unless x_m and cov_m2 are given."""
    rest = {"fleet": "tank", "incarnation": 1, "seq": 0, "sent_ns": 0, "target": "ball", "t": 0, "valid": False}
    return Estimate(src=src, dst=dst, **{**rest, **about})


def telemetry(t_ns: int, depth_m: float = 0.4, **about: Any) -> Telemetry:
    """A robot that hangs level at `depth_m` with its motors on and idle."""
    rest = {
        "board_us": 0,
        "roll_deg": 0.0,
        "pitch_deg": 0.0,
        "sensor_depth_m": (depth_m,) * 4,
        "pulses_us": (1500,) * 8,
        "servos_us": (1500,) * 4,
        "battery_v": 14.0,
        "armed": True,
        "ladder": 0,
        "flags": 0,
        "loop_us": 0,
    }
    return Telemetry(t_ns=t_ns, depth_m=depth_m, **{**rest, **about})
