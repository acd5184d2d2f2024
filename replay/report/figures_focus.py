"""The lens: clarity curves with their peaks, and the calibrated hyperbola with the peaks of this run on it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import h
from replay.report.robot_timeline import Array, LoggedSweep, RobotTimeline

SHOWN = 6  # sweeps in one figure; more hide each other
WIDTH_IN, HEIGHT_IN = 4.6, 3.3  # read on a phone: 10 pt stays 10 pt at the width of its screen


def clarity_curves(timeline: RobotTimeline) -> Figure:
    """Clarity T over the lens position of some sweeps spread over the run, their model and their peak ± sigma."""
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    panel = figure.subplots()
    for k, sweep in enumerate(spread(timeline.sweeps)):
        order = np.argsort(sweep.lens_positions)
        lens_positions, clarity = np.array(sweep.lens_positions)[order], np.array(sweep.clarity)[order]
        ended = "" if sweep.peak is not None else ", no peak" if sweep.outcome is not None else ", not finished"
        label = f"{sweep.t_s:.0f} s{ended}"
        panel.plot(lens_positions, clarity, ".-", color=f"C{k}", linewidth=0.8, markersize=4, label=label)
        if sweep.outcome is not None and sweep.peak is not None:
            sigma = sweep.outcome.sigma or 0.0
            panel.axvline(sweep.peak, color=f"C{k}", linewidth=0.8)
            panel.axvspan(sweep.peak - sigma, sweep.peak + sigma, color=f"C{k}", alpha=0.25, linewidth=0)
    peaks = sum(sweep.peak is not None for sweep in timeline.sweeps)
    panel.set_title(f"{timeline.label}: {len(timeline.sweeps)} sweeps, {peaks} with a peak")
    panel.set(xlabel="lens position", ylabel="clarity T (Tenengrad), grey levels²")
    if timeline.sweeps:
        panel.legend(fontsize="small", title="begun at", title_fontsize="small", loc="best")
    return figure


def calibration_fit(timeline: RobotTimeline) -> Figure:
    """h(rho), the ranges that this run's peaks gave, and below how well h is known."""
    fit = timeline.boxes[-1].calibration.focus
    figure = Figure(figsize=(WIDTH_IN, 1.35 * HEIGHT_IN), layout="constrained")
    panel, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    rho = np.linspace(fit.lowest, fit.highest, 200)
    panel.plot(rho, [h(fit, float(r)) or np.nan for r in rho], color="black", linewidth=1.0, label="h, calibrated")
    peaks = [sweep.peak for sweep in timeline.sweeps if sweep.peak is not None]
    seen = [(peak, u) for peak in peaks if (u := h(fit, peak)) is not None]
    panel.plot([p for p, _ in seen], [u for _, u in seen], ".", color="red", markersize=4, label="peaks of this run")
    errors = f"RMSE {1e3 * fit.rmse_m:.1f} mm, held out {1e3 * fit.held_out_rmse_m:.1f} mm"
    panel.set_title(f"{timeline.label}: R² {fit.r2:.5f}, {errors}", fontsize="medium")
    panel.set_ylabel("z-depth u from the gimbal, m")
    panel.legend(fontsize="small", loc="best")  # said, or matplotlib warns where the machine is busy
    below.plot(rho, 2e3 * deviation_m(fit, rho), color="black", linewidth=1.0)
    below.set(xlabel=r"lens position $\rho^*$", ylabel=r"$2\sigma$ of h, mm", ylim=(0.0, None))
    return figure


def deviation_m(fit: FocusFit, rho: Array) -> Array:
    """Standard deviation of h(rho) by the covariance of its three parameters, (n,)."""
    travel = rho - fit.rho0
    J = np.stack([np.ones_like(rho), 1.0 / travel, fit.b_m / travel**2])  # (3, n): d/du_inf, d/db, d/drho0
    c00, c01, c02, c11, c12, c22 = fit.covariance
    C = np.array([[c00, c01, c02], [c01, c11, c12], [c02, c12, c22]])
    deviation: Array = np.sqrt(np.maximum((J * (C[:, :, None] * J[None, :, :]).sum(axis=1)).sum(axis=0), 0.0))
    return deviation


def spread(sweeps: tuple[LoggedSweep, ...]) -> list[LoggedSweep]:
    """The longest sweep, and others evenly over the run."""
    if len(sweeps) <= SHOWN:
        return list(sweeps)
    longest = max(range(len(sweeps)), key=lambda k: (len(sweeps[k].lens_positions), -k))
    chosen = {longest, *np.linspace(0, len(sweeps) - 1, SHOWN - 1).round().astype(int).tolist()}
    return [sweeps[k] for k in sorted(chosen)]
