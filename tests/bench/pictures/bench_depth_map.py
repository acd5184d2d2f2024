"""What `aucamp depth-map` says of reference stacks of photographs: a rendered one, and a real one.

Errors are in focus steps; the offset between truth and every method's peaks, 0.3 steps, is counted. Where there is no
truth: the share of blocks within a step of the median of the 3 x 3 around them; the real thing is piecewise flat.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agent.experiments.claim import Claim, Figure, NoSettings, Row, Rows, Value
from agent.perception.depth_sweep import DepthSweep, measure, sweep
from hw.camera.files import open_stack
from tests.places import shared

STEP, REAL_STEP = 0.02, 0.1  # between photographs, in the unit of positions.csv


def simulated() -> Row:
    stack = shared("focal_stacks", "bracket_simulated")
    block_px, taken = 12, taken_of(stack, 12)
    found, parabola = measure(taken, block_px, None), measure(taken, block_px, None, "parabola")
    rows, cols = found.blocks.lens_position.shape
    with np.load(stack / "truth.npz") as truth:
        cut = [truth[field][: rows * block_px, : cols * block_px] for field in ("depth", "mask")]
    depth, mask = (field.reshape(rows, block_px, cols, block_px) for field in cut)
    true, inside = depth.mean(axis=(1, 3)), mask.all(axis=(1, 3))
    kept = inside & found.blocks.accepted
    ours, theirs = (np.abs(one.blocks.lens_position - true)[kept] / STEP for one in (found, parabola))
    return {
        "rms_steps": float(np.sqrt(np.mean(ours**2))),
        "parabola_rms_steps": float(np.sqrt(np.mean(theirs**2))),
        "kept": 100.0 * float(kept.sum() / inside.sum()),
    }


def real() -> Row:
    found = measure(taken_of(shared("focal_stacks", "bracket_real"), 32), 32, None)
    lens_position = np.where(found.blocks.accepted, found.blocks.lens_position, np.nan)
    rows, cols = lens_position.shape
    around = np.stack([lens_position[r : rows - 2 + r, c : cols - 2 + c] for r in range(3) for c in range(3)])
    rough = np.abs(lens_position[1:-1, 1:-1] - np.median(around, axis=0))
    return {
        "told": 100.0 * float(np.isfinite(found.lens_position_on_parts()).mean()),
        "smooth": 100.0 * float(np.mean(rough[np.isfinite(rough)] <= REAL_STEP)),
    }


def taken_of(stack: Path, block_px: int) -> DepthSweep:
    return sweep(open_stack(stack), block_px, lambda done, total: None)


# --- the claim ---

STACKS = {"simulated": simulated, "real": real}


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """Raises ConfigError where the stacks are absent."""
    return [STACKS[case]()]


def summary(rows: Rows) -> dict[str, Value]:
    return {f"{case}_{key}": value for case, (row, *_) in rows.items() for key, value in row.items()}


CLAIM = Claim(
    run=run,
    summary=summary,
    cases=tuple(STACKS),
    measured_on="real pictures",
    figures=(
        Figure("simulated_kept", "rendered stack, blocks of 12 px on the object: have a depth", "%", least=70.0),
        Figure("simulated_rms_steps", "their error, rms", "steps"),
        Figure("simulated_parabola_rms_steps", "the same blocks by a log-parabola", "steps"),
        Figure("real_told", "real stack: area that has a depth", "%", least=80.0),
        Figure("real_smooth", "blocks within a step of the median around them", "%", least=95.0),
    ),
    exact=True,
    explanation="""Focus-bracketed photographs that others made: a bracket rendered with known depth in 44 steps, and
        the real one in 16. A step is that between two photographs.""",
)
