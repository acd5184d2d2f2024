"""A disk on which there is no room, without one: a limit on how large a file may become."""

import contextlib
import resource
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def room(most_bytes: int) -> Iterator[None]:
    """No file of this process grows beyond that. Of byte code there is none: Python would keep what was cut off."""
    before, byte_code = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
    sys.dont_write_bytecode = True
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = byte_code
