"""A history of two robots, the first of which moves and turns steadily."""

import numpy as np

from hw.twin.dive import History
from hw.twin.physics.body import quaternion
from hw.twin.physics.tank import STATE

START_NS = 1_000_000_000


def states(x_m, yaw_rad=0.0, pan_deg=0.0):
    state = np.zeros(2, STATE)
    state["position_m"] = [(x_m, 0.2, 0.1), (1.0, 0.8, 0.1)]
    state["quaternion"] = quaternion(0, 0, yaw_rad)
    state["shaft_deg"][:, 0] = pan_deg
    return state


def filled(ticks):
    history = History(2, START_NS)
    for k in range(ticks):
        history.append(states(0.001 * k, 0.01 * k, 0.1 * k))
    return history
