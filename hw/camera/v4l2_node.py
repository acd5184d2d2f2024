"""The video nodes of this computer: open one, or find the camera of a name among them.

A camera that is unplugged and plugged in again may come back under another number. Its name, the port that it is
plugged into, and udev's links under /dev/v4l/by-id stay the same.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import re
import select
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from hw.camera.camera import CameraError, CameraGone
from hw.camera.v4l2_calls import Device, Identity, identity


class Node:
    """One open node; see hw.camera.v4l2_calls.Device."""

    def __init__(self, path: str, descriptor: int) -> None:
        self.path = path
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)

    def ioctl(self, request: int, argument: bytearray) -> None:
        fcntl.ioctl(self._descriptor, request, argument)

    def map(self, offset: int, length: int) -> memoryview:
        return memoryview(mmap.mmap(self._descriptor, length, offset=offset))

    def wait(self, timeout_s: float) -> bool:
        return bool(self._poll.poll(1e3 * max(timeout_s, 0.0)))

    def close(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1


class System(NamedTuple):
    """Where cameras are looked for; tests have one of their own."""

    nodes: Callable[[], Iterable[str]]  # paths, in the order of their numbers
    attach: Callable[[str], Device]  # raises OSError


def _nodes() -> list[str]:
    numbered = [(int(found[1]), str(path)) for path in Path("/dev").glob("video*") if (found := _NUMBER(path.name))]
    return [path for _, path in sorted(numbered)]


_NUMBER = re.compile(r"video(\d+)").fullmatch


def _attach(path: str) -> Node:
    return Node(path, os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC))


LINUX = System(_nodes, _attach)


def find(place: str, system: System = LINUX) -> tuple[Device, Identity]:
    """Open the camera at a path, or else the one whose name or port is `place`. The caller closes it.

    Raises CameraGone if it is not there now, CameraError if what is there is no camera, or two have the name.
    """
    return _at_path(place, system) if place.startswith("/") else _by_name(place, system)


def _at_path(path: str, system: System) -> tuple[Device, Identity]:
    device = _opened(path, system)
    try:
        who = identity(device)
        if who.captures:
            return device, who
        why = f"'{who.card}' gives no pictures here; its other nodes may"
    except OSError as error:
        why = f"not a video device ({error.strerror})"
    device.close()
    raise CameraError(f"{path}: {why}; see v4l2-ctl --list-devices")


def _opened(path: str, system: System) -> Device:
    try:
        return system.attach(path)
    except PermissionError:
        raise CameraError(f"{path}: you may not open it; join its group, video on most systems") from None
    except OSError as error:
        raise CameraGone(f"{path}: cannot be opened: {error.strerror}; see v4l2-ctl --list-devices") from None


def _by_name(name: str, system: System) -> tuple[Device, Identity]:
    found: list[tuple[Device, Identity]] = []
    there: list[str] = []  # what could not be it
    for path in system.nodes():
        try:
            device = _opened(path, system)
        except CameraGone:
            continue
        except CameraError as error:
            there.append(str(error))
            continue
        try:
            who = identity(device)
        except OSError:  # not a video device, whatever its name
            who = Identity("", "", captures=False)
        if who.captures and name in (who.card, who.bus):
            found.append((device, who))
            continue
        device.close()
        if who.captures:
            there.append(f"'{who.card}' at {who.bus}")
    if len(found) == 1:
        return found[0]
    for device, _ in found:
        device.close()
    if found:
        ports = " or ".join(f"v4l2:{who.bus}" for _, who in found)
        raise CameraError(f"{len(found)} cameras are called '{name}'; name one by its port: {ports}")
    raise CameraGone(f"no camera is called '{name}'; there is {', '.join(there) or 'none at all'}")
