"""A disk on which there is no room, without one: a limit on how large a file may become."""

import contextlib
import resource
from collections.abc import Iterator


@contextlib.contextmanager
def room(most_bytes: int) -> Iterator[None]:
    """No file of this process grows beyond that."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
