"""What an image model is worth on photographs held back, and poses before and after they were refined.

Poses that were refined are so but for a motion of everything: held-back views are carried into the model's world, and
points of its surface back into the true one, before anything is compared.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.experiments.reconstruction.render import Rendered
from agent.experiments.result import Row
from agent.reconstruction.held_back import HeldBack, judged
from agent.reconstruction.image_model import ImageModel
from agent.reconstruction.pose_evidence import Motion, apart, between, by_motion
from agent.reconstruction.views import View

Floats = NDArray[np.float64]

LEAST_DB = (30.0, 27.0)  # at known and at new stations, exact poses
MOST_LOST_DB, MOST_LOST_F = 1.0, 5.0  # by poses that had to be refined, against exact ones


def picture_row(model: ImageModel, rendered: Rendered, views: Sequence[View]) -> Row:
    """PSNR of photographs from stations that were trained on (in), and from others (new), and what the model is.

    views: those it learnt from, with the poses that they had then.
    """
    known, new = held_back(model, rendered, views)
    return {
        "psnr_in": _mean([one.psnr_db for one in known]),
        "psnr_new": _mean([one.psnr_db for one in new]),
        "unplaced_in": _mean([one.unplaced_db for one in known]),
        "unplaced_new": _mean([one.unplaced_db for one in new]),
        "image": model.kind,
        "image_steps": model.steps,
        "beta_mm": model.beta_mm,
        "beta_clamped": model.beta_clamped,
    }


def held_back(model: ImageModel, rendered: Rendered, views: Sequence[View]) -> tuple[list[HeldBack], list[HeldBack]]:
    """Photographs of known and of new stations beside what the model shows there."""
    there = inverse(between(views, rendered.trained))
    known, new = (
        judged(model.look, [by_motion(view, there) for view in group]) for group in (rendered.known, rendered.new)
    )
    return known, new


def pose_row(views: Sequence[View], rendered: Rendered) -> Row:
    """How far poses are from the true ones, mean over views, once the motion of everything is taken off."""
    motion = between(views, rendered.trained)
    metres, radians = apart([by_motion(view, motion) for view in views], rendered.trained)
    return {"place_mm": 1e3 * float(metres.mean()), "turn_deg": float(np.degrees(radians.mean()))}


def into_truth(points_m: Floats, views: Sequence[View], rendered: Rendered) -> Floats:
    """Points (n, 3) of a surface made with these views, in the world in which the twin knows where everything is."""
    motion = between(views, rendered.trained)
    return np.asarray(points_m @ motion.rotation.T + motion.shift_m)


def inverse(motion: Motion) -> Motion:
    return Motion(motion.rotation.T, -motion.rotation.T @ motion.shift_m)


def missed_pictures(cases: Sequence[Row]) -> list[str]:
    """Bars of image models and of refined poses that are not reached; cases without a model are passed over."""
    pictured = [one for one in cases if "image" in one]
    exact = {(one["seed"], one["water"]): one for one in pictured if one["poses"] == "exact"}
    found = []
    for one in pictured:
        key = one["seed"], one["water"]
        name = f"seed {key[0]}, {key[1]}"
        if one["poses"] == "exact":
            told = [("known", one["psnr_in"], LEAST_DB[0]), ("new", one["psnr_new"], LEAST_DB[1])]
            found += [f"{name}: {where} stations {value:.1f} dB" for where, value, least in told if value < least]
        elif one["poses"] == "refined" and key in exact:
            lost_db = [exact[key][field] - one[field] for field in ("psnr_in", "psnr_new")]
            lost_f = exact[key]["f5"] - one["f5"]
            for where, lost in zip(("known", "new"), lost_db, strict=True):
                if lost > MOST_LOST_DB:
                    found.append(f"{name}: refined poses lose {lost:.1f} dB at {where} stations")
            if lost_f > MOST_LOST_F:
                found.append(f"{name}: refined poses lose {lost_f:.1f} points of F")
    return found


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
