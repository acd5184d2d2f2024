"""foxglove.CompressedImage: a picture as viewers draw it, and as replay reads it again."""

from __future__ import annotations

from typing import Any

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError

from agent.core.codec import Refusal
from replay.files.protobuf import stamp


def image(robot: str, data: bytes, format_: str, t_ns: int) -> Any:
    """The message of one picture; `format_` is jpeg or png."""
    return CompressedImage(timestamp=stamp(t_ns), frame_id=f"{robot}/camera", data=data, format=format_)


def compressed(message: bytes) -> bytes:
    """The JPEG or PNG in the bytes of such a message. Raises Refusal where they are none."""
    try:
        return bytes(CompressedImage.FromString(message).data)
    except DecodeError:
        raise Refusal("garbage", "is no foxglove.CompressedImage") from None
