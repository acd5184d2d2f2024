"""`aucamp calibrate run`: sets up the bench, runs the procedure, writes the calibration file."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from rich.console import Console

from agent.core.config import ConfigError, Fleet, dump
from agent.core.ranging.camera_model import Calibration
from agent.process.command import Show, with_bar, with_spinner
from agent.robot.fleet_reader import load_fleet, load_robot
from agent.tools.bench import bench_by_hand, twin_bench
from agent.tools.procedure import calibrate, setting


def run(fleet_path: Path, name: str, out: Path | None, console: Console) -> None:
    """Calibrate one robot of a fleet file; the result goes to `out`, else where the fleet file says.

    Raises ConfigError, CameraError and Failed (CalibrationRefused is one), one line each.
    """
    fleet = load_fleet(fleet_path)
    robot = load_robot(fleet, name, fleet_path)
    file = out or fleet_path.parent / robot.calibration
    if file.exists():
        raise ConfigError(
            f"{file}: is there already, and nothing is overwritten; move it away, or give --out another name"
        )
    file.parent.mkdir(parents=True, exist_ok=True)  # what cannot be made is said before the work
    if robot.camera.startswith("twin:"):
        calibration = _on_the_twin(fleet, name, console)
    else:
        with bench_by_hand(fleet, name) as (camera, place):  # its questions say how far it is
            calibration = calibrate(fleet, name, camera, place, lambda done, total: None)
    file.write_text(dump(calibration), encoding="utf-8")
    console.print(describe(calibration))
    console.print(f"written to {file}")


def _on_the_twin(fleet: Fleet, name: str, console: Console) -> Calibration:
    with ExitStack() as stack:
        with with_spinner(console, f"calibrating {name}: starting the twin's bench"):
            camera, place = stack.enter_context(twin_bench(fleet, name))

        def work(show: Show) -> Calibration:
            def told(done: int, total: int) -> None:
                show(done, total, f"calibrating {name}: {setting(done)}")

            return calibrate(fleet, name, camera, place, told)

        return with_bar(console, f"calibrating {name}", work)


def describe(calibration: Calibration) -> str:
    """What the fit is worth, in two lines."""
    focus, camera = calibration.focus, calibration.camera
    nearer = "larger" if focus.b_m > 0.0 else "smaller"  # u = u_inf + b / (rho - rho0): 0 for infinity is custom only
    return (
        f"focus: R² {focus.r2:.4f}, rms {1e3 * focus.rmse_m:.1f} mm, held out {1e3 * focus.held_out_rmse_m:.1f} mm, "
        f"one peak ± {focus.noise:.2f} lens positions, "
        f"{nearer} ones are nearer\n"
        f"camera: f {camera.f_px:.1f} px, pan zero {camera.pan_zero_deg:+.2f}° gain {camera.pan_gain:.4f}, "
        f"tilt zero {camera.tilt_zero_deg:+.2f}° gain {camera.tilt_gain:.4f}, residual {camera.noise_px:.2f} px"
    )
