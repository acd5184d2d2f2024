"""Processes that do not outlive the test that started them."""

import contextlib
import subprocess
from collections.abc import Iterator, Mapping


@contextlib.contextmanager
def killed_after(processes: Mapping[str, "subprocess.Popen[bytes]"]) -> Iterator[None]:
    """At the end of the block all that are in `processes` by then are killed, whatever happened in it."""
    try:
        yield
    finally:
        for process in processes.values():
            process.kill()
            process.wait()
