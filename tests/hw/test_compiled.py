"""The cache of compiled functions: right for all of the processes that fill it at once, and for sources that change.
And linked functions, which do what numba's do."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import TypingError

from agent.perception import clarity, tags
from hw import compiled

KERNEL = """
from hw.compiled import compiled

@compiled()
def total(a):
    s = 0.0
    for i in range(a.shape[0]):
        s += a[i]
    return s
"""

# Whoever has read the index waits with writing it until the other one has read it too, if there is no lock.
MEET = """
import os, sys, time
from pathlib import Path
import numpy as np
from numba.core.caching import IndexDataCacheFile

save = IndexDataCacheFile._save_index

def meet(self, overloads):
    Path(f"read-{os.getpid()}").touch()
    until_s = time.monotonic() + 1.0
    while len(list(Path().glob("read-*"))) < 2 and time.monotonic() < until_s:
        time.sleep(0.01)
    save(self, overloads)

IndexDataCacheFile._save_index = meet
from kernel import total
assert total(np.ones(9, sys.argv[1])) == 9
"""

LATER = """
import numpy as np
from kernel import total

for kind in ("uint8", "float64"):
    assert total(np.ones(9, kind)) == 9
assert not total.stats.cache_misses and sum(total.stats.cache_hits.values()) == 2
"""


def test_two_signatures_compiled_at_once_do_not_take_each_others_place(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    both = [subprocess.Popen([sys.executable, "-c", MEET, kind], cwd=tmp_path) for kind in ("uint8", "float64")]
    assert [process.wait(60) for process in both] == [0, 0]
    done = subprocess.run([sys.executable, "-c", LATER], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


MEET_BEFORE = """
import os, sys, time
from pathlib import Path
import numpy as np
from kernel import total

Path(f"here-{os.getpid()}").touch()
while len(list(Path().glob("here-*"))) < 2:
    time.sleep(0.001)
assert total(np.ones(9)) == 9
print(sum(total.stats.cache_misses.values()))
"""


def test_of_two_processes_at_once_one_compiles(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    command = [sys.executable, "-c", MEET_BEFORE]
    both = [subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert sorted(process.communicate(timeout=60)[0] for process in both) == ["0\n", "1\n"]


PAIR = """
from typing import NamedTuple
import numpy as np
from hw.compiled import compiled

class NAME(NamedTuple):
    a: float
    b: float

@compiled()
def total(pair):
    return pair.a + pair.b

assert total(NAME(1.0, 2.0)) == 3.0
"""


def test_a_class_that_was_renamed_since_is_compiled_for_anew(tmp_path: Path) -> None:
    for age, name in enumerate(("Before", "After", "After")):
        source = tmp_path / "pair.py"
        source.write_text(PAIR.replace("NAME", name))
        os.utime(source, (1e9 + min(age, 1), 1e9 + min(age, 1)))  # the third finds what the second has left
        done = subprocess.run(
            [sys.executable, "-c", "from pair import total; print(sum(total.stats.cache_hits.values()))"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, done.stderr
    assert done.stdout == "1\n"


@pytest.fixture
def linked():
    """Skips where the library is not there."""
    for module in compiled.LINKED:
        if compiled.linked_library(module) is None:
            pytest.skip(f"{module} is not linked: python -m hw.compiled")


def both(function, *arguments) -> list[bytes]:
    """What the last argument becomes, and what is returned: by the library, and by numba."""
    kept = []
    for run in (function, function.dispatcher):
        arguments[-1][:] = 0
        returned = run(*arguments)
        kept.append(arguments[-1].tobytes() + repr(returned).encode())
    return kept


def test_linked_functions_give_numbas_own_bytes(linked) -> None:
    rng = np.random.default_rng(0)
    image, edges = rng.integers(0, 256, (40, 60 * 3), np.uint8), np.array([0, 17, 40])
    inside = rng.random((40, 60)) < 0.5
    sums = np.empty((2, 2), np.int64)
    for region in (clarity.EVERYWHERE, inside):
        ours, numbas = both(clarity._sums, image, 3, edges, edges, region, sums)
        assert ours == numbas and sums.all()
    x = np.linspace(0.0, 1.0, 20)
    curves = 1.0 / (1.0 + ((x - rng.random((30, 1))) / 0.1) ** 2) + rng.normal(0.0, 0.01, (30, 20))
    out = np.empty((5, 30))
    ours, numbas = both(clarity._solve, x, curves, x, np.full(20, 0.1), 1e-4, out)
    assert ours == numbas and np.abs(out[0] - 0.5).max() < 0.6
    plane = np.where(np.arange(80)[:, None] > 40.3 + 0.1 * np.arange(80), 20, 200).astype(np.uint8)
    start, end, lens = np.array([8.0, 41.0]), np.array([70.0, 47.5]), np.array([700.0, 40.0, 40.0, 0.1])
    line = np.empty(4)
    ours, numbas = both(tags.fit_edge, plane, tags.light_of_bytes(2.2), start, end, lens, *tags.room(6.0), line)
    assert ours == numbas and line.any()


def test_other_types_than_the_librarys_go_by_numba(linked) -> None:
    image, edges, sums = np.zeros((8, 8), np.uint8), np.array([0, 8]), np.empty((1, 1), np.int64)
    clarity._sums(image[:, ::2], 1, np.array([0, 8]), np.array([0, 4]), clarity.EVERYWHERE, sums)
    clarity._sums(image.astype(np.uint16), 1, edges, edges, clarity.EVERYWHERE, sums)
    with pytest.raises(TypingError):
        clarity._sums(None, 1, edges, edges, clarity.EVERYWHERE, sums)
    with pytest.raises(TypeError):
        clarity._sums(image, 1)


def test_a_library_of_other_sources_is_not_taken(tmp_path, monkeypatch) -> None:
    """Its own source and those that it imports from, whose constants are in its code."""
    source, place = compiled._source, {}

    def copied(module: str) -> Path:
        if module not in place:
            place[module] = tmp_path / f"{module}.py"
            if source(module).is_file():
                shutil.copy(source(module), place[module])
        return place[module]

    monkeypatch.setattr(compiled, "_source", copied)
    paths = [compiled._library_path("agent.perception.tags")]
    for module in ("agent.perception.tags", "agent.core.ranging.camera_model"):
        place[module].write_text(place[module].read_text() + "\n")
        paths.append(compiled._library_path("agent.perception.tags"))
    assert len(set(paths)) == 3


def test_a_file_that_is_no_library_is_passed_over(tmp_path, monkeypatch) -> None:
    (tmp_path / "library.so").write_bytes(b"of another system")
    monkeypatch.setattr(compiled, "_library_path", lambda module: tmp_path / "library.so")
    assert compiled.linked_library.__wrapped__("agent.perception.tags") is None
