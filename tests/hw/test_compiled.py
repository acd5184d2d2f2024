"""The cache of compiled functions: right for all of the processes that fill it at once, and for sources that change."""

import os
import subprocess
import sys
from pathlib import Path

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
