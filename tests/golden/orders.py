"""What r1 of the golden case `orders` is ordered: every verb, sound and refused, again, and by too many."""

from __future__ import annotations

from tests.replay.step_box import Said

BOX = {"frame": 3, "x": 10.0, "y": 10.0, "width": 60.0, "height": 50.0}

ORDERS = (
    Said(0.5, "clock"),
    Said(0.6, "fly"),
    Said(0.6, "hold", {"depth_m": "deep"}),
    Said(0.6, "hold", {"depth_m": 9.0}),
    Said(0.6, "look", {}),
    Said(0.6, "look", {"pan_deg": 0.0, "roll_deg": 1.0}),
    Said(0.7, "stop", console="No Console"),
    Said(2.0, "hold", {"depth_m": 0.2}),
    Said(2.5, "look", {"pan_deg": 91.0}),
    Said(2.5, "look", {"pan_deg": 10.0, "tilt_deg": -5.0}),
    Said(3.0, "lamp", {"light": 0.5, "pan_deg": 5.0}),
    Said(3.5, "set", {"name": "sweeps", "value": 2.0}),
    Said(3.5, "set", {"name": "sweeps", "value": 0.0}),
    Said(3.5, "set", {"name": "send_hz", "value": 0.5}),
    Said(3.5, "set", {"name": "send_hz", "value": 5.0}),
    Said(3.5, "set", {"name": "preview_hz", "value": 2.0}),
    Said(3.5, "set", {"name": "speed_m_s", "value": 0.1}),
    Said(4.0, "goto", {"x_m": 0.5, "y_m": 0.5}),
    Said(4.0, "survey"),
    Said(4.2, "target_box", BOX),
    Said(4.2, "target_box", {**BOX, "target": "ball"}),
    Said(4.2, "target_box", {**BOX, "target": "thing"}),
    Said(4.2, "target_box", {**BOX, "width": 4.0}),
    Said(4.2, "target_box", {**BOX, "x": 9000.0}),
    Said(5.0, "stop"),
    Said(5.0, "arm"),
    Said(5.0, "surface"),
    Said(5.5, "arm"),
    Said(6.0, "disarm"),
    Said(6.2, "tare"),
    Said(6.5, "arm", again=True),
    Said(6.5, "arm", seen_s=5.5),
    Said(6.5, "look", {"pan_deg": 0.0}, seen_s=0.5),
    Said(6.5, "look", {"pan_deg": 0.0}, seen_s=None),
    Said(6.5, "look", {"pan_deg": 0.0}, number=3),
    Said(6.5, "surface", number=3),
    Said(7.0, "arm"),
    Said(7.5, "resume"),
    *(Said(8.0 + 0.01 * k, "clock", number=100 + k) for k in range(70)),
    Said(9.0, "hold", number=50),
    Said(9.0, "hold", number=51, seen_s=7.95),
    *(Said(9.5, "clock", console=f"bob{k}") for k in range(20)),
    Said(12.0, "look", {"pan_deg": -20.0}),
)
# While steps break (strange.py): what came with them is left out, but for a stop.
WITH_IT = ("hold", {"depth_m": 0.3}), ("stop", {}), ("fly", {})
BROKEN = tuple(Said(5.9 + 0.05 * k, verb, args) for k in range(5) for verb, args in WITH_IT)
# r2's lamp changes, whoever has the light: a sweep of r1 is spoiled.
LAMP = tuple(Said(6.0 + 0.9 * k, "lamp", {"light": 0.5 * (k % 3)}, robot="r2") for k in range(9))
