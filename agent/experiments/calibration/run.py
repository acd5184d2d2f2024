"""`aucamp experiment calibration`: the paper's fit of h(rho), on the twin's bench."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console

from agent.config import load_fleet
from agent.experiments.bench import focus_rows
from agent.experiments.calibrate_focus import draw, paper_gauge, result_table, verdict
from agent.experiments.calibrate_run import twin_bench
from agent.experiments.result import write_result
from agent.launch import run_folder, shipped_fleet, with_bar
from agent.ranging.calibrate import fit_focus, leave_one_out


def calibration(seed: int, out: Path | None, console: Console) -> dict[str, Any]:
    """Calibrate the lens that r1 has in world `seed`; writes result.json and the figure, returns the result.

    k, f and c are in the paper's gauge, lengths in metres; errors of distances left out in metres.
    """
    folder = run_folder(out)
    fleet = load_fleet(shipped_fleet())
    fleet = msgspec.structs.replace(fleet, twin=msgspec.structs.replace(fleet.twin, seed=seed))
    with twin_bench(fleet, "r1") as (camera, place):
        rows = with_bar(console, "board at known distances", lambda show: focus_rows(fleet, camera, place, show))
    fit, left_out = fit_focus(rows), leave_one_out(rows)
    paper = paper_gauge(fit)
    result = {
        "seed": seed,
        "k": paper.k,
        "f": paper.f_m,
        "c": paper.c_m,
        "r2": fit.r2,
        "rmse": fit.rmse_m,
        "leave_one_out": [{"distance": one.u_m, "error": one.error_m} for one in left_out],
        "measured": [{"distance": row.u_m, "position": row.rho} for row in rows],
    }
    write_result(folder, result)
    draw(rows, fit, left_out, folder / "calibration.png")
    console.print(result_table(fit, left_out))
    console.print(verdict(fit, left_out))
    console.print(f"written to {folder}")
    return result
