"""Which end of a lens's numbers is near differs between drivers, and is measured, not asked."""

import numpy as np
import pytest

from agent.core.control.sweep import full_positions
from agent.core.ranging.camera_model import Calibration, CameraFit
from agent.core.ranging.focus import h
from agent.tools.bench_calibration import describe
from agent.tools.focus_calibration import FocusRow, fit_focus

CAMERA = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5)


@pytest.mark.parametrize(("b_m", "rho0", "nearer"), [(130.0, 100.0, "larger"), (-130.0, 900.0, "smaller")])
def test_calibration_finds_the_direction_and_sweeps_follow_it(b_m, rho0, nearer):
    noise = np.random.default_rng(3).normal(0.0, 0.5, 12)
    distances_m = 1.0 / np.linspace(1.0 / 1.2, 1.0 / 0.22, 12)
    rows = [FocusRow(u, rho0 + b_m / u + e, 60.0) for u, e in zip(distances_m, noise, strict=True)]
    focus = fit_focus(rows)
    assert focus.b_m == pytest.approx(b_m, rel=0.05) and focus.rho0 == pytest.approx(rho0, abs=10)
    assert h(focus, rho0 + b_m / 0.5) == pytest.approx(0.5, abs=0.005)
    said = describe(Calibration(robot="r1", made="2026-01-01", source="test", focus=focus, camera=CAMERA))
    assert f"{nearer} ones are nearer" in said
    lens_positions = full_positions(focus, 30)
    assert list(lens_positions) == sorted(lens_positions)  # from one side, whichever is near
    assert lens_positions[0] < rho0 < lens_positions[-1]
