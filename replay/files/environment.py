"""What a recording was made with: code, versions and machine, the first suspects when a replay differs."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from functools import cache
from pathlib import Path

import numpy as np

PACKAGES = (
    "aucamp",
    "eclipse-zenoh",
    "numpy",
    "opencv-python-headless",
    "numba",
    "torch",
    "msgpack",
    "msgspec",
    "mcap",
)
FEATURES = ("sse4_2", "avx", "avx2", "fma", "avx512f", "asimd", "sve")  # on which numerical libraries choose their code
THREADS = ("OPENBLAS_NUM_THREADS", "OPENBLAS_CORETYPE", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
GIT_S = 2.0  # a checkout on a slow network drive is not worth waiting for


@cache
def environment() -> dict[str, str]:
    """Entries for the metadata `aucamp.run`; what cannot be found out is "unknown"."""
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    return {
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "libc": " ".join(platform.libc_ver()).strip() or "unknown",
        **_cpu(),
        "blas": f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip(),
        **{name: os.environ[name] for name in THREADS if name in os.environ},
        **_checkout(Path(__file__).parents[2]),
        **{f"version.{package}": version(package) for package in PACKAGES},
    }


def version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def _cpu() -> dict[str, str]:
    """Model, and those of its instruction sets that decide how floating point is computed (Linux)."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    facts = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    flags = facts.get("flags", facts.get("Features", "")).split()
    return {
        "cpu": facts.get("model name") or platform.processor() or "unknown",
        "cpu.features": " ".join(feature for feature in FEATURES if feature in flags) or "unknown",
    }


def _checkout(root: Path) -> dict[str, str]:
    """Commit, and whether the files differ from it; an installed package has neither."""
    if not (root / ".git").exists():
        return {"commit": "unknown", "dirty": "unknown"}
    commit = _git(root, "rev-parse", "HEAD")
    changes = _git(root, "status", "--porcelain", "--untracked-files=no")
    return {
        "commit": commit or "unknown",
        "dirty": "unknown" if changes is None else "yes" if changes else "no",
    }


def _git(root: Path, *arguments: str) -> str | None:
    # Without optional locks: a robot that starts must not stand in the way of somebody who commits.
    command = ["git", "--no-optional-locks", "-C", str(root), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=GIT_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
