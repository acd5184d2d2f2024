"""The page docs/extend.md: its files and changes go into a copy of the product, and its programs run there."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.places import ROOT

PAGE = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w+) (\S+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
BLOCKS = BLOCK.findall(PAGE)  # (language, file, text)

# `aucamp check` of one file after the other, in one process, as most of its time goes into its start.
CHECKS = """
import sys
from agent.__main__ import main
for file in sys.argv[1:]:
    sys.argv = ["aucamp", "check", file]
    try:
        main()
    except SystemExit:
        pass
    sys.stdout.flush()
    print("\\f", flush=True)
"""
OPENS = """
import sys
from pathlib import Path
from hw.camera import open_camera
for url in sys.argv[1:]:
    try:
        open_camera(url, Path(), (640, 480))
    except Exception as error:
        print(error)
"""


def blocks(language: str, file: str | None = None) -> list[tuple[str, str]]:
    return [(name, text) for kind, name, text in BLOCKS if kind == language and file in (None, name)]


def changed(text: str, change: str) -> str:
    """The text with one change of the page in it, which fits in one place."""
    lines = change.splitlines(keepends=True)
    old = "".join(line[1:] or "\n" for line in lines if line[0] != "+")
    new = "".join(line[1:] for line in lines if line[0] != "-")
    assert text.count(old) == 1, f"the page changes what is not there:\n{old}"
    return text.replace(old, new)


class Clone:
    """A copy of the product that a test may change."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._printed: dict[str, str] = {}
        halves = shutil.ignore_patterns("*.pyc.*", "*.tmp.*")  # of byte code and kernels that somebody is writing
        for package in ("agent", "hw", "replay", "router_config"):
            shutil.copytree(ROOT / package, path / package, ignore=halves)
        (path / "tests").symlink_to(ROOT / "tests")

    def run(self, *words: str) -> str:
        """What a program prints, errors too. It reads the byte code that was copied; a file that is changed back within
        a second would be taken for that of before."""
        environment = {**os.environ, "PYTHONPATH": str(self.path), "PYTHONDONTWRITEBYTECODE": "1", "COLUMNS": "400"}
        about = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        done = subprocess.run([sys.executable, *words], cwd=self.path, env=environment, timeout=120, **about)
        return done.stdout

    def printed(self, program: str) -> str:
        """By a program of the page, which runs once."""
        if program not in self._printed:
            self._printed[program] = self.run(program)
        return self._printed[program]

    def checks(self, *files: str) -> list[str]:
        *found, rest = self.run("-c", CHECKS, *files).split("\f\n")
        assert len(found) == len(files) and not rest, rest
        return found

    @contextmanager
    def edited(self, file: str, old: str, new: str) -> Iterator[None]:
        """For as long as this lasts."""
        text = (self.path / file).read_text()
        assert text.count(old) == 1
        (self.path / file).write_text(text.replace(old, new))
        yield
        (self.path / file).write_text(text)

    def fleet(self, name: str, more: str) -> str:
        """The page's fleet file, with more at its end."""
        text = (self.path / "fleet.toml").read_text().split("\n[extend.blink]")[0]
        (self.path / name).write_text(f"{text}\n{more}\n")
        return name

    def torch(self, name: str, more: str) -> str:
        """The page's fleet file with a torch in place of its ball."""
        whole = (self.path / "fleet.toml").read_text().split("\n[extend.blink]")[0]
        text = re.sub(r"\[target\.ball\].*?\n\n", "", whole, flags=re.DOTALL)
        (self.path / name).write_text(f"{text}\n{blocks('toml', 'torch.toml')[0][1]}{more}\n")
        return name


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Clone:
    """As somebody has it who has followed the page."""
    clone = Clone(tmp_path_factory.mktemp("extend") / "clone")
    clone.run("-m", "agent", "init", "--twin", "--robots", "2", "--out", "fleet.toml")
    (shell,) = re.findall(r"^\$ printf '(.*)' >> fleet.toml$", PAGE, re.MULTILINE)
    with (clone.path / "fleet.toml").open("a") as file:
        file.write(shell.replace("\\n", "\n"))
    for name, text in blocks("python"):
        assert not (clone.path / name).exists()
        (clone.path / name).write_text(text)
    for name, change in blocks("diff"):
        (clone.path / name).write_text(changed((clone.path / name).read_text(), change))
    clone.torch("torch.toml", "")
    return clone


def told(message: str) -> str:
    """A message that is on the page."""
    assert f"`{message}`" in PAGE
    return message


def test_programs_print_what_the_page_says(clone: Clone) -> None:
    programs = blocks("text")
    assert [name for name, _ in programs] == ["try_blink.py", "try_brightest.py", "try_stills.py"]
    for name, text in programs:
        printed = clone.printed(name)
        assert printed.startswith(text) if name == "try_blink.py" else printed == text


def test_the_lamp_burns_after_each_sweep_and_as_long_as_the_file_says(clone: Clone) -> None:
    rows = re.findall(r"([\d.]+) s  (r\d): the lamp is with (\w+), power ([\d.]+)", clone.printed("try_blink.py"))
    assert {name for _, name, _, _ in rows} == {"r1", "r2"} and len(rows) > 10
    for robot in "r1", "r2":
        own = [(float(at_s), holder, float(power)) for at_s, name, holder, power in rows if name == robot]
        assert [holder for _, holder, _ in own] == ["blink", "nobody"] * (len(own) // 2) + ["blink"] * (len(own) % 2)
        assert all(power == (0.6 if holder == "blink" else 0.0) for _, holder, power in own)
        burned = {round(off[0] - on[0], 2) for on, off in zip(own[::2], own[1::2], strict=False)}
        assert burned == {0.5}


def test_no_lamp_burns_without_the_table(clone: Clone) -> None:
    program = (clone.path / "try_blink.py").read_text().replace("fleet.toml", clone.fleet("none.toml", ""))
    assert clone.run("-c", program) == ""


def test_what_is_said_of_a_wrong_capability(clone: Clone) -> None:
    wrong = told("key 'extend.blink.power': expected `float` <= 1.0; correct the value")
    name = told(
        "key 'extend.blnk': no capability has this table; correct its name, or add the row in agent/robot/arbiter.py"
    )
    lent = told("key 'extend.blink': its robots lend their lamps to each other; remove this table or [lighting]")
    water = "water = { absorption_per_m = [0.5, 0.4, 0.4], scattering_per_m = [1.8, 1.8, 1.8] }"
    said = clone.checks(
        "fleet.toml",
        clone.fleet("power.toml", "[extend.blink]\npower = 6"),
        clone.fleet("name.toml", "[extend.blnk]"),
        clone.fleet("lent.toml", f"[lighting]\n{water}\n[extend.blink]"),
    )
    assert all(wanted in one for wanted, one in zip(("ready to start", wrong, name, lent), said, strict=True)), said


def test_what_is_said_of_rows_that_do_not_fit(clone: Clone) -> None:
    file = "agent/capabilities/blink.py"
    rows = "operator, sweep, lent, lease, camera"
    place = told(f"capability 'blink': its row of the lamp is to stand above 'cam'; write one of {rows}")
    with clone.edited(file, 'above="camera"', 'above="cam"'):
        assert place in clone.run("-m", "agent", "check", "fleet.toml")
    with clone.edited(file, 'name: ClassVar[str] = "blink"', 'name: ClassVar[str] = "swim"'):
        taken = told("capability Blink: another one has name = 'swim'; write one of its own")
        assert taken in clone.run("-m", "agent", "check", "fleet.toml")
    row = told("degraded: LookupError: no row 'blnk' of the lamp in the table of priorities")
    with clone.edited(file, 'Proposal("lamp", "blink"', 'Proposal("lamp", "blnk"'):
        assert row in clone.run("try_blink.py")


def test_what_is_said_of_a_wrong_detector(clone: Clone) -> None:
    sound, of_radius, of_cues = clone.checks(
        "torch.toml",
        clone.torch("radius.toml", "radius_m = 0.07"),
        clone.torch("cues.toml", '[ranging]\ncues = "size"'),
    )
    assert "they look for torch" in sound and re.findall(r"^wrong +(\w+):", sound, re.MULTILINE) == ["twin"]
    radius = told("key 'target.torch.radius_m': only a ball has one; remove it, or correct the detector")
    assert radius in of_radius
    cues = told("key 'ranging.cues': the size of 'torch' is not known; take 'both' or 'focus'")
    assert cues in of_cues
    choice = told("key 'target.torch.detector': 'brightest' is no choice; write one of ball, box, creature")
    with clone.edited("agent/core/config.py", ', "brightest"]', "]"):
        assert choice in clone.run("-m", "agent", "check", "torch.toml")


def test_what_is_said_of_a_wrong_camera(clone: Clone) -> None:
    clone.printed("try_stills.py")
    (clone.path / "empty").mkdir()
    unknown, none, small = clone.run("-c", OPENS, "still:pictures", "stills:empty", "stills:pictures").splitlines()
    known = "twin:ROBOT, stack:DIR, video:FILE, v4l2:/dev/video0 or NAME, libcamera:0, stills:DIR"
    assert told(f"camera 'still:pictures': no such kind of camera; write one of {known}") in unknown
    empty = "no pictures in this folder; it needs a PNG, JPEG, BMP, TIFF or WebP"
    assert told(f"camera 'stills:empty': empty: {empty}") in none
    size = "delivers 320x240 pixels, not 640x480; correct width_px and height_px under [camera]"
    assert told(f"camera 'stills:pictures': {size}") in small
