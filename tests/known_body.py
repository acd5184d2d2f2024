"""A robot unlike others, as `aucamp calibrate body` would have found it."""

from agent.core.ranging.camera_model import BodyFit

LIGHT = BodyFit(
    mass_kg=4.0,
    drag=3.0,
    drag2=30.0,
    inertia_kgm2=0.07,
    turn_drag=0.04,
    turn_drag2=0.15,
    lag_s=0.1,
    sigma=(0.02,) * 7,
    misfit=1.0,
    fixes=400,
)
