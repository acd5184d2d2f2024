"""How good depth from focus is on the reference stacks: errors in focus steps, the log-parabola on the same blocks.

Nothing is printed where the stacks (AUCAMP_DATA, else ../shared/data) are absent. The offset between the simulated
stack's truth and every method's peaks, 0.3 steps, is counted as error. Smooth on the real stack: the share of blocks
within one focus step of the median of the 3 x 3 around them; a bracket is piecewise flat.
"""

import numpy as np

from agent.pictures.depth_sweep import measure, sweep
from hw.camera.files import open_stack
from tests.places import DATA

STACKS = DATA / "focal_stacks"
STEP, REAL_STEP = 0.02, 0.1  # between photographs, in the unit of positions.csv


def run() -> dict[str, dict]:
    if not STACKS.is_dir():
        return {}
    return {**simulated(12), **simulated(13), **real()}


def simulated(block: int) -> dict[str, dict]:
    stack = STACKS / "bracket_simulated"
    taken = sweep(open_stack(stack), block, lambda done, total: None)
    ours, parabola = measure(taken, block, None), measure(taken, block, None, "parabola")
    with np.load(stack / "truth.npz") as truth:
        depth, mask = truth["depth"], truth["mask"]
    rows, cols = ours.blocks.lens_position.shape
    shape = rows, block, cols, block
    inside = mask[: rows * block, : cols * block].reshape(shape).all(axis=(1, 3))
    true = depth[: rows * block, : cols * block].reshape(shape).mean(axis=(1, 3))
    kept = inside & ours.blocks.accepted
    e, f = (np.abs(m.blocks.lens_position - true)[kept] / STEP for m in (ours, parabola))
    rmse, theirs = (float(np.sqrt(np.mean(x**2))) for x in (e, f))
    share = float(kept.sum() / inside.sum())
    name = f"stack_simulated_{block}px"
    return {
        f"{name}_rmse": row(rmse, "steps", "log-parabola, same blocks", rmse / theirs),
        f"{name}_median": row(float(np.median(e)), "steps", "log-parabola, same blocks", np.median(e) / np.median(f)),
        f"{name}_kept": row(share, "share", "0.7 wanted", share / 0.7),
    }


def real() -> dict[str, dict]:
    found = measure(sweep(open_stack(STACKS / "bracket_real"), 32, lambda done, total: None), 32, None)
    lens_position = np.where(found.blocks.accepted, found.blocks.lens_position, np.nan)
    rows, cols = lens_position.shape
    around = np.stack([lens_position[r : rows - 2 + r, c : cols - 2 + c] for r in range(3) for c in range(3)])
    rough = np.abs(lens_position[1:-1, 1:-1] - np.median(around, axis=0))
    share, smooth = (
        float(np.isfinite(found.lens_position_on_parts()).mean()),
        float(np.mean(rough[np.isfinite(rough)] <= REAL_STEP)),
    )
    return {
        "stack_real_32px_accepted": row(share, "share", "0.95 wanted", share / 0.95),
        "stack_real_32px_smooth": row(smooth, "share", "0.95 wanted", smooth / 0.95),
    }


def row(value: float, unit: str, against: str, ratio: float) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": float(ratio)}
