"""How much faster than the clock the twin's water is: three robots, physics alone and with sensors and history."""

from __future__ import annotations

import time
from importlib import resources
from pathlib import Path

from agent.robot.fleet_reader import load_fleet
from hw.twin.dive import Dive
from hw.twin.physics.tank import STEP_S, STEPS_PER_TICK, TICK_NS, advance

TICKS, REPEATS = 1000, 5


def run() -> dict[str, dict]:
    """CPU time of this thread; the best of a few repeats, for others use this machine too."""
    fleet = load_fleet(Path(str(resources.files("agent") / "fleets" / "tank.toml")))
    dive = Dive(fleet, ["r1", "r2", "r3"], start_ns=0)
    dive.states["held"] = 0
    dive.move()

    def physics() -> None:
        advance(
            dive.bodies,
            dive.states,
            dive._pulses_us,
            dive._nominal_deg,
            dive._size_m,
            dive._surface_m,
            STEP_S,
            STEPS_PER_TICK,
        )

    def best_s(work) -> float:
        times = []
        for _ in range(REPEATS):
            start = time.thread_time()
            for _ in range(TICKS):
                work()
            times.append(time.thread_time() - start)
        return min(times) / TICKS

    step_s, tick_s = best_s(physics), best_s(dive.move)
    tick = TICK_NS * 1e-9
    return {
        "twin_physics_3_robots": {
            "value": round(STEPS_PER_TICK / step_s),
            "unit": "steps/CPU s",
            "against": "500 steps/s of real time",
            "ratio": round(tick / step_s, 1),
        },
        "twin_tick_3_robots": {
            "value": round(1 / tick_s),
            "unit": "ticks/CPU s",
            "against": "100 ticks/s of real time; with sensors and history, without firmware and cameras",
            "ratio": round(tick / tick_s, 1),
        },
    }


if __name__ == "__main__":
    print(run())
