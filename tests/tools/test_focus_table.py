"""The verb on a synthetic table that has the paper's curve, noise and span; it is not the paper's data."""

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from agent.core.config import ConfigError, read_toml
from agent.process.command import plain_console
from agent.tools import focus_calibration
from agent.tools.focus_calibration import paper_gauge, read_table, run

K, F_CM, C_CM = 0.3922, 0.7431, 0.7577  # the paper's printed fit; centimetres is the only plausible unit
RHO0, B_CM, U_INF_CM = F_CM / K, F_CM * F_CM / K, F_CM + C_CM
NOISE_RHO = 6.15e-4  # what gives the paper's RMSE over this span


def table(path: Path, seed: int, noise: float = NOISE_RHO, distances_cm=range(10, 135, 5)) -> Path:
    random = np.random.default_rng(seed)
    lines = ["u_mm,code,repeat,medium"]
    for u in distances_cm:
        for repeat in range(3):
            rho = RHO0 + B_CM / (u - U_INF_CM) + random.normal(0.0, noise)
            lines.append(f"{10 * u},{rho!r},{repeat},water")
    path.write_text("\n".join(lines) + "\n")
    return path


def quiet() -> Console:
    return Console(quiet=True)


def test_the_papers_curve_comes_back_without_noise(tmp_path: Path) -> None:
    paper = paper_gauge(run(table(tmp_path / "t.csv", 0, noise=0.0), None, quiet()))
    assert paper.f_m * 100 == pytest.approx(F_CM, rel=1e-6)
    assert paper.c_m * 100 == pytest.approx(C_CM, rel=1e-5)
    assert paper.k * 100 == pytest.approx(K, rel=1e-6)


def test_the_papers_r2_and_rmse_come_back_with_its_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        focus_calibration, "figure", lambda *_: Figure()
    )  # the plots of fifteen tables take most of the time
    fits = [run(table(tmp_path / "t.csv", seed), None, quiet()) for seed in range(15)]
    assert 3.1 < 100 * np.median([fit.rmse_m for fit in fits]) < 3.8
    assert np.median([fit.r2 for fit in fits]) == pytest.approx(0.99, abs=0.004)
    for u_cm, limit_mm in ((30, 1.5), (50, 2.7), (100, 13.0)):
        rho = RHO0 + B_CM / (u_cm - U_INF_CM)
        errors = [1e3 * (f.u_inf_m + f.b_m / (rho - f.rho0)) - 10 * u_cm for f in fits]
        assert math.sqrt(np.mean(np.square(errors))) < 1.6 * limit_mm  # 15 tables: rms of rms is 18 %


def test_the_file_keeps_its_other_table_and_its_former_self(tmp_path: Path) -> None:
    out = tmp_path / "r1.toml"
    out.write_text('robot = "r1"\nmade = "m"\nsource = "s"\n[camera]\nf_px = 1000.0\n')
    run(table(tmp_path / "t.csv", 0), out, quiet())
    content = read_toml(out)
    assert content["camera"] == {"f_px": 1000.0}
    assert content["focus"]["r2"] > 0.98
    assert "focus" not in read_toml(tmp_path / "r1.toml.before")
    assert content["source"].startswith("s; [focus] on 20") and content["made"] == "m"
    assert (tmp_path / "t.png").stat().st_size > 5000


def test_nothing_is_lost_when_a_table_is_measured_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, console = tmp_path / "r1.toml", plain_console()
    for seed in range(3):
        run(table(tmp_path / "t.csv", seed), out, console)
    said = capsys.readouterr().out
    assert f"[focus] written to {out}, the calibration of robot 'r1'\n" in said
    assert "[camera] is missing; a robot needs it: aucamp calibrate camera" in said
    first, second = (read_toml(tmp_path / name) for name in ("r1.toml.before", "r1.toml.2.before"))
    assert f"[focus] of {out} replaced; the file as it was: {tmp_path / 'r1.toml.2.before'}" in said
    assert len({each["focus"]["b_m"] for each in (first, second, read_toml(out))}) == 3
    assert {file.name for file in tmp_path.iterdir()} == {
        "r1.toml", "r1.toml.before", "r1.toml.2.before", "t.csv", "t.png", "t.2.png", "t.3.png"
    }  # fmt: skip


@pytest.mark.parametrize(("name", "text", "expected"), [
    ("fleet.toml", 'fleet = "tank"\n[robot.r1]\n', "fleet.toml: is no calibration file; give --out a new name"),
    ("r1.txt", "", "r1.txt: give --out a name that ends in .toml"),
])  # fmt: skip
def test_another_file_gets_no_table_of_ours(tmp_path: Path, name: str, text: str, expected: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=expected):
        run(table(tmp_path / "t.csv", 0), tmp_path / name, quiet())
    assert (tmp_path / name).read_text() == text and not (tmp_path / "t.png").exists()


BAD = {
    "unknown column 'colour'": "u_mm,code,colour\n100,2,red\n",
    "column 'code' is missing": "u_mm\n100\n",
    "line 3, column 'code': 'x' is no number": "u_mm,code\n100,2\n200,x\n",
    "a range is positive": "u_mm,code\n-100,2\n",
    "mixes down, up": "u_mm,code,direction\n100,2,up\n200,3,down\n",
    "no rows": "u_mm,code\n",
    "measure at least 6": "u_mm,code\n100,2.06\n200,1.97\n300,1.94\n",
    "bring the board nearer": "u_mm,code\n" + "".join(f"{u},{1.9 + 1 / u}\n" for u in range(900, 1000, 10)),
}


@pytest.mark.parametrize("message", BAD)
def test_a_bad_table_is_one_line(tmp_path: Path, message: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(BAD[message])
    with pytest.raises(ConfigError) as caught:
        run(path, None, quiet())
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_width_is_taken_where_it_is_given(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("u_mm,code,width\n100,2.06,0.02\n200,1.97,\n")
    assert [row.width for row in read_table(path).level] == [0.02, 0.02]


def test_tilted_rows_tell_the_sag_and_leave_the_curve_alone(tmp_path: Path) -> None:
    level = "".join(f"{u},{102 + 136e3 / u:.6f},0\n" for u in (220, 260, 320, 400, 520, 750, 1200))
    tilted = "".join(
        f"{u},{102 + 136e3 / u + 5.0 * math.sin(math.radians(t)):.6f},{t}\n" for u in (400, 450) for t in (-20, 20)
    )
    fits = []
    for name, lines in (("level", level), ("both", level + tilted)):
        path = tmp_path / f"{name}.csv"
        path.write_text("u_mm,code,tilt_deg\n" + lines)
        fits.append(run(path, tmp_path / f"{name}.toml", quiet()))
    plain, both = fits
    assert both.sag == pytest.approx(5.0, abs=0.01) and plain.sag_sigma is None
    assert (both.u_inf_m, both.b_m, both.rho0) == (plain.u_inf_m, plain.b_m, plain.rho0)
    assert "sag =" in (tmp_path / "both.toml").read_text() and "sag_sigma" not in (tmp_path / "level.toml").read_text()
