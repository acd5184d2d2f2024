"""Messages with everything filled in that must be: a test names only what matters to it."""

from typing import Any

from agent.core.messages import Estimate, Presence
from agent.core.step_io import Telemetry


def estimate(src: str = "r2", dst: str = "r1", **about: Any) -> Estimate:
    """What `src` says to `dst` about the ball of fleet "tank"; without an estimate unless x_m and cov_m2 are given."""
    rest = {"fleet": "tank", "incarnation": 1, "seq": 0, "sent_ns": 0, "target": "ball", "t": 0, "valid": False}
    return Estimate(src=src, dst=dst, **{**rest, **about})


def presence(src: str = "r2", dst: str = "r1", **about: Any) -> Presence:
    """What `src` of fleet "tank" says to `dst` of where it is: in the middle, at rest."""
    head = {"fleet": "tank", "incarnation": 1, "seq": 0, "sent_ns": 0, "t_ns": 0}
    place = {"x_m": 0.75, "y_m": 0.6, "yaw_rad": 0.0, "depth_m": 0.4, "cov": (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-3)}
    moves = {"v_x_m_s": 0.0, "v_y_m_s": 0.0, "rate_rad_s": 0.0}
    goal = {"goal_x_m": 0.75, "goal_y_m": 0.6, "goal_yaw_rad": 0.0, "behaviour": "hold"}
    return Presence(src=src, dst=dst, **{**head, **place, **moves, **goal, **about})


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
