"""Serial ports by name: which path to open for a fleet file's address, and why one cannot be used."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from agent.core.config import ConfigError


def open_port_path(url: str, twin_dir: Path) -> str:
    """The path to open for a fleet file's `serial`: "twin:r1" is r1's pty, anything else is a path already."""
    scheme, colon, name = url.partition(":")
    if scheme != "twin" or not colon:
        return url
    if not name:
        raise ConfigError(f"serial = '{url}': no robot is named; write twin:r1")
    return str(twin_dir / f"{name}.serial")


def reason(error: OSError) -> str:
    """Why a port cannot be used, once: pyserial's own text has the path and the system's words twice."""
    if error.errno == errno.EWOULDBLOCK:
        return "another program uses this port; end that one"
    return os.strerror(error.errno) if error.errno else str(error)
