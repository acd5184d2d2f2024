"""What it takes a process to load the functions that every agent calls: linked, and by numba."""

from __future__ import annotations

import json
import subprocess
import sys

from agent.core.config import ConfigError
from agent.experiments.claim import Figure, Row
from hw.compiled import LINKED, linked_library
from tests.bench.timing import Settings, claim_of_costs
from tests.places import ROOT

# As an agent does before its first frame. Both are said to the parent: what the imports alone take falls on both alike.
LOADS = """
import json, sys, time
from hw import compiled
if sys.argv[1] == "numba":
    compiled.linked_library = lambda module: None
import numpy as np
from agent.process import agent_process
from agent.perception import clarity, tags
imported_s = time.process_time()
clarity.prepare()
edge = np.full((40, 40), 200, np.uint8)
edge[20:] = 20
ends, lens, line = np.array([[4.0, 20.0], [36.0, 20.0]]), np.array([700.0, 20.0, 20.0, 0.0]), np.empty(4)
assert tags.fit_edge(edge, tags.light_of_bytes(2.2), *ends, lens, *tags.room(6.0), line) >= 0.0
took_ms = 1e3 * (time.process_time() - imported_s)
kb = {name: float(rest.split()[0]) for name, _, rest in (row.partition(":") for row in open("/proc/self/smaps_rollup"))
      if rest.endswith("kB\\n")}
json.dump({"rss_mb": kb["Rss"] / 1024, "own_mb": kb["Anonymous"] / 1024, "cpu_ms": took_ms}, sys.stdout)
"""
WAYS = ("linked", "numba")


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises ConfigError where nothing is linked."""
    if any(linked_library(module) is None for module in LINKED):
        raise ConfigError("experiment compiled: nothing is linked: python -m hw.compiled")
    row: Row = {}
    for way in WAYS:
        command = [sys.executable, "-c", LOADS, way]
        said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True).stdout
        row |= {f"{way}_{key}": value for key, value in json.loads(said).items()}
    return [row]


CLAIM = claim_of_costs(
    run=run,
    cases=("agent",),
    figures=(
        Figure("agent.linked_rss_mb", "a process with the linked functions: resident memory", "MB"),
        Figure(
            "agent.linked_rss_mb/numba_rss_mb",
            "resident memory of a process with the linked functions, against numba's",
            "times",
            most=0.6,
        ),
        Figure("agent.linked_own_mb/numba_own_mb", "of it what no other process shares, against numba's", "times"),
        Figure("agent.linked_cpu_ms", "to load them and call each once", "ms"),
        Figure("agent.linked_cpu_ms/numba_cpu_ms", "the same, against numba's, whose code is in its cache", "times"),
    ),
    explanation="""A new process imports what an agent imports, and calls clarity and the edges of tags once, as an
        agent does before its first frame: by the libraries that `python -m hw.compiled` has linked, and by numba. A
        running agent has frames and its network beside that.""",
)
