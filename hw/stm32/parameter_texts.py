"""What people are told about the parameters of hw.firmware.parameters: unit and meaning of each, by name."""

from __future__ import annotations

TEXTS: dict[str, tuple[str, str]] = {
    "law": ("", "0 pi, 1 pid, 2 observer"),
    "pid_set": ("", "gains of pid: 0 for thrusters of 10 N and 0.10 s, 1 for 5 N and 0.15 s"),
    "heave_kg": ("kg", "mass with the water that moves along"),
    "tilt_kgm2": ("kg m2", "moment of inertia in roll and pitch, with the water"),
    "lag_s": ("s", "first-order lag of a thruster with its ESC"),
    "thrust_max_N": ("N", "of one thruster, forward, at 1900 us and curve_battery_mV"),
    "net_weight_N": ("N", "weight less buoyancy; a robot that sinks has it positive"),
    "water_kg_m3": ("kg/m3", "998.2 fresh at 20 C, 1025 sea"),
    "curve_battery_mV": ("mV", "battery at which thrust_max_N was found"),
    "battery_min_mV": ("mV", "below it the robot surfaces; 3.0 V a cell of four"),
    "slew_N": ("N", "largest change of a thruster's force in one cycle of 10 ms"),
    **{f"zero_{k}_us": ("us", f"neutral pulse of T{k}") for k in range(1, 9)},
    "pulse_frame_us": ("us", "from one pulse of a thruster to the next, as short as its ESC takes"),
}
