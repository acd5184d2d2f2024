"""Lenses and a camera as a calibration would describe them, for tests that need one and do not care which."""

from msgspec.structs import replace

from agent.core.ranging.camera_model import CameraFit, FocusFit
from agent.experiments.navigation.swimmers import FOCUS

CAMERA = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5)

# Round numbers and errors that do not depend on each other.
PLAIN = FocusFit(
    u_inf_m=-0.01,
    b_m=130.0,
    rho0=100.0,
    covariance=(1e-6, 0.0, 0.0, 1e-2, 0.0, 1e-2),
    noise=0.5,
    width=60.0,
    lowest=180,
    highest=900,
    r2=1.0,
    rmse_m=0.001,
    held_out_rmse_m=0.001,
)
# The errors of a real fit: its three numbers are known together far better than each alone.
FITTED = FocusFit(
    u_inf_m=-0.001,
    b_m=136.0,
    rho0=102.0,
    covariance=(5.6107e-07, -4.0676e-04, 4.4365e-04, 0.30611, -0.35131, 0.44447),
    noise=0.5,
    width=90.0,
    lowest=215,
    highest=720,
    r2=0.999,
    rmse_m=0.001,
    held_out_rmse_m=0.001,
)
# What the bench finds of r1 in the tank of seed 0, rounded: for a dive that shall see its ball without a bench.
TWIN_CAMERA = CameraFit(
    width_px=640,
    height_px=480,
    f_px=1184.0,
    cx_px=319.5,
    cy_px=239.5,
    bend=0.392,
    ahead_m=-0.0009,
    pan_zero_deg=-0.56,
    tilt_zero_deg=0.31,
    pan_gain=0.992,
    tilt_gain=0.995,
)
TWIN = replace(FOCUS, sag=5.1, sag_sigma=0.8)
