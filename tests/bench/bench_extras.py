"""What each optional part of the package adds to the disk: files of distributions that the core does without.

Only what is installed is weighed; for all of them, install '.[enhance,train,view,validate,oracles,test]' first.
"""

from __future__ import annotations

import json
import sys
from importlib import metadata
from typing import Any

from packaging.requirements import Requirement

PACKAGE = "aucamp"
MB = 1e6


def run() -> dict[str, dict[str, Any]]:
    core = needed(PACKAGE, "")
    rows = {"extras_none": row(core, "the package with what it needs")}
    for extra in sorted(metadata.metadata(PACKAGE).get_all("Provides-Extra") or ()):
        try:
            rows[f"extras_{extra}"] = row(needed(PACKAGE, extra) - core, "beside that")
        except metadata.PackageNotFoundError as missing:
            sys.stderr.write(f"extra {extra}: {missing} is not installed, so not weighed\n")
    return rows


def needed(distribution: str, extra: str) -> set[str]:
    """Names of all distributions that this one needs here with this extra, and that those need; without itself.

    Raises PackageNotFoundError if one is not installed.
    """
    found: set[str] = set()
    waiting = [(distribution, extra)]
    seen = set(waiting)
    while waiting:
        name, wanted = waiting.pop()
        for line in metadata.requires(name) or ():
            requirement = Requirement(line)
            if requirement.marker and not requirement.marker.evaluate({"extra": wanted}):
                continue
            for each in ("", *requirement.extras):
                if (step := (requirement.name, each)) not in seen:
                    seen.add(step)
                    waiting.append(step)
            found.add(metadata.distribution(requirement.name).metadata["Name"].lower().replace("_", "-"))
    return found - {PACKAGE}


def row(distributions: set[str], against: str) -> dict[str, Any]:
    value = sum(size_mb(name) for name in distributions)
    return {"value": value, "unit": f"MB in {len(distributions)} packages", "against": against, "ratio": None}


def size_mb(distribution: str) -> float:
    """Of all files that an installed distribution lists and that are there."""
    paths = (path.locate() for path in metadata.files(distribution) or ())
    return sum(path.stat().st_size for path in paths if path.is_file()) / MB


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
