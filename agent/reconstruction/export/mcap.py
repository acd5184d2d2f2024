"""A surface as an MCAP file of Foxglove's own messages, for Foxglove and Rerun: a cloud of points, and the cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from agent.reconstruction.export.encoded import encoded
from agent.reconstruction.export.pinhole import quaternion
from agent.reconstruction.extract import Mesh
from agent.reconstruction.view import View
from replay.files.backlog import Entry
from replay.files.channels import PROTOBUF
from replay.files.mcap_file import Part
from replay.files.protobuf import schema
from replay.viewers.foxglove import Turn, world_cloud, world_poses

POINTS, CAMERAS = "/scene/points", "/scene/cameras"
T_NS = 0  # a scene stands: it is seen by what it says of no time


def write_mcap(views: list[View], mesh: Mesh, path: Path) -> None:
    """World frame, metres, z up. A point has `sigma_m` and `views` beside its colour; a camera looks along z, y down.

    Raises ConfigError where the file cannot be written, or is there.
    """
    beside = {"sigma_m": mesh.sigma_m.astype("<f4"), "views": mesh.views.astype("u1")}
    cloud = world_cloud(mesh.vertices_m.astype(np.float32), encoded(mesh.colours), beside, T_NS)
    poses = world_poses([_vector(view) for view in views], [_turn(view) for view in views], T_NS)
    file = Part(path)
    file.start({"kind": "scene"}, {})
    for number, (channel, message) in enumerate(((POINTS, cloud), (CAMERAS, poses))):
        file.add(
            Entry(
                channel=channel,
                log_time_ns=T_NS,
                publish_time_ns=T_NS,
                sequence=number,
                data=message.SerializeToString(),
                encoding=PROTOBUF,
                metadata={},
                schema=schema(message.__class__),
            )
        )
    file.finish("aucamp.end", {"kind": "scene"})


def _vector(view: View) -> Any:
    return tuple(view.position_m.tolist())


def _turn(view: View) -> Turn:
    w, x, y, z = quaternion(view.rotation).tolist()
    return x, y, z, w
