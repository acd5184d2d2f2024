"""A recording that is not as it was written is called damaged by whoever opens it, and never taken for sound."""

import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.core.picture_head import stated_size
from agent.perception.vision import rerun_vision
from replay.check.check import check
from replay.check.explain import explain
from replay.check.vision_check import check_vision
from replay.files.channels import HashedFile
from replay.files.frames import Picture, pixels
from replay.files.info import describe, info
from replay.files.log import read
from replay.files.mcap_walk import Tear, records
from replay.files.recover import recover, recover_all
from replay.report.report import report
from tests.places import GOLDEN
from tests.replay.rewritten import rewritten

VERBS: tuple[Callable[[Path], object], ...] = (
    lambda path: check([path]),
    lambda path: check([path.parent]),
    explain,
    lambda path: check_vision([path], rerun_vision),
    report,
)


@pytest.fixture
def box(tmp_path: Path) -> Path:
    """A black box with digests."""
    (tmp_path / "run").mkdir()
    return rewritten(GOLDEN / "schema1" / "r1.mcap", tmp_path / "run" / "r1.mcap")


def patched(path: Path, old: bytes, new: bytes) -> None:
    """Put other bytes where some are, and all checksums right again: only digests and counts can tell."""
    data = path.read_bytes()
    assert data.count(old) > 0
    assert len(old) == len(new)
    path.write_bytes(right_checksums(data.replace(old, new, 1)))


def right_checksums(data: bytes) -> bytes:
    """The same file with checksums of attachments, data and summary that fit."""
    out = bytearray(data)
    summary = 0
    for at, opcode, length in heads(data):
        if opcode == 0x09:
            end = at + 9 + length
            struct.pack_into("<I", out, end - 4, zlib.crc32(out[at + 9 : end - 4]))
        elif opcode == 0x0F:
            struct.pack_into("<I", out, at + 9, zlib.crc32(out[:at]))
            summary = at + 9 + length
        elif opcode == 0x02:
            struct.pack_into("<I", out, at + 25, zlib.crc32(out[summary : at + 25]))
    return bytes(out)


def heads(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Place, opcode and length of each record."""
    at = 8
    while at + 9 < len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        yield at, opcode, length
        at += 9 + length


def of_summary(data: bytes, opcode: int) -> int:
    """Where the first record of a kind stands."""
    return next(at for at, kind, _ in heads(data) if kind == opcode)


def test_a_sound_one_is_verified_and_an_older_one_says_that_it_is_older(box: Path) -> None:
    assert "finished, clean\n" in describe(box, info(box))
    assert info(box).verified
    older = GOLDEN / "schema1" / "r1.mcap"
    assert info(older).complete
    assert "finished, clean; it is older than digests" in describe(older, info(older))


POSE = (b"x_m = 0.3", b"x_m = 0.7")


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        (*POSE, "fleet.toml in it is not the file that was attached"),
        (b'robot = "r1"', b'robot = "r2"', "calibration.toml in it is not the file that was attached"),
        (b"python\x06\x00\x00\x00", b"pythom\x06\x00\x00\x00", "aucamp.run is not as it was written"),
    ],
)
def test_what_an_agent_was_built_from_cannot_be_changed(box: Path, old: bytes, new: bytes, what: str) -> None:
    patched(box, old, new)
    assert f"damaged: {what}" in describe(box, info(box))
    assert not info(box).complete
    lines: list[str] = []
    assert recover_all([box], False, lines.append) == 0
    copy = box.with_name("r1.recovered.mcap")
    assert f"damaged: {what}" in lines[0]
    assert f"damaged: before it was mended {what}" in describe(copy, info(copy))
    for path in (box, copy):
        for verb in VERBS:
            with pytest.raises(ConfigError, match=r"r1\..*damaged: ") as refused:
                verb(path)
            assert "\n" not in str(refused.value)


def test_a_digest_cannot_be_left_out_of_a_chain(box: Path) -> None:
    """Without its checksums put right, the same is seen before any digest is looked at."""
    box.write_bytes(box.read_bytes().replace(*POSE, 1))
    assert [each.what for each in info(box).damage] == ["fleet.toml in it is not the file that was attached"]


@pytest.mark.parametrize(
    ("opcode", "offset", "what"),
    [
        (0x0B, 0, "its counts of messages does not fit what is in it"),  # statistics
        (0x08, 16, "its index of chunks does not fit what is in it"),
        (0x0A, 0, "its index of attachments does not fit what is in it"),
        (0x0D, 0, "its index of notes does not fit what is in it"),
        (0x07, 6, "an index of messages does not fit its chunk"),
    ],
)
def test_a_changed_index_is_found_and_a_mended_copy_is_sound(box: Path, opcode: int, offset: int, what: str) -> None:
    data = bytearray(box.read_bytes())
    data[of_summary(bytes(data), opcode) + 9 + offset] ^= 1
    box.write_bytes(right_checksums(bytes(data)))
    assert what in describe(box, info(box))
    for verb in VERBS:
        with pytest.raises(ConfigError, match="`aucamp replay recover` makes a sound copy"):
            verb(box)
    result = recover(box)
    assert result.out is not None
    assert info(result.out).damage == ()
    assert check([result.out]).results[0].verdict in ("identical", "within tolerance")
    assert list(read(result.out)) == list(read(box))


@pytest.mark.parametrize(
    ("opcode", "offset", "what"),
    [(0x0F, 9, "its data contradict their checksum"), (0x02, 25, "its index contradicts its checksum")],
)
def test_checksums_of_the_whole_are_checked(box: Path, opcode: int, offset: int, what: str) -> None:
    data = bytearray(box.read_bytes())
    data[of_summary(bytes(data), opcode) + offset] ^= 1
    if opcode == 0x0F:  # the footer's is then right
        assert what in [each.what for each in _info_of(box, bytes(data))]
    else:
        assert [each.what for each in _info_of(box, bytes(data))] == [what]


def _info_of(box: Path, data: bytes) -> tuple:
    box.write_bytes(data)
    return info(box).damage


def test_other_messages_than_were_recorded_are_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole chunks with right checksums, written by somebody who knows the format and not the digests."""
    monkeypatch.setattr(HashedFile, "before", "0" * 64)
    path = rewritten(GOLDEN / "schema1" / "r1.mcap", tmp_path / "r1.mcap")
    assert [each.what for each in info(path).damage] == ["what was recorded was changed afterwards"]
    with pytest.raises(ConfigError, match="take another copy of it"):
        check([path])


def test_a_header_that_cannot_be_read_is_told_and_not_passed_over(box: Path) -> None:
    data = box.read_bytes()
    note = of_summary(data, 0x0C)
    box.write_bytes(data[: note + 9] + bytes(40) + data[note + 49 :])
    for verb in VERBS:
        with pytest.raises(ConfigError, match="its header cannot be read"):
            verb(box)


def test_a_file_that_grows_while_it_is_read_has_no_negative_rest(box: Path) -> None:
    data = box.read_bytes()
    size = round(0.6 * len(data))
    box.write_bytes(data[:size])
    walk = records(box)
    next(walk)
    with box.open("ab") as file:
        file.write(data[size:])
    (tear,) = [each for each in walk if isinstance(each, Tear)]
    assert 0 <= tear.offset <= tear.offset + tear.bytes == size


@pytest.mark.parametrize("length", [2**25 + 1, 2**31, 2**60, 2**64 - 1])
@pytest.mark.parametrize("opcode", [0x06, 0x09, 0x0C])
def test_a_length_that_cannot_be_takes_no_memory(box: Path, length: int, opcode: int) -> None:
    data = bytearray(box.read_bytes())
    struct.pack_into("<Q", data, of_summary(bytes(data), opcode) + 1, length)
    box.write_bytes(data)
    tracemalloc.start()
    try:
        about = info(box)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert about.torn
    assert peak < 2_000_000


def test_a_chunk_that_would_fill_the_memory_is_not_opened(box: Path) -> None:
    data = bytearray(box.read_bytes())
    chunk = of_summary(bytes(data), 0x06) + 9
    struct.pack_into("<Q", data, chunk + 16, 2**60)
    box.write_bytes(data)
    assert info(box).torn


@pytest.mark.parametrize("format_", [".png", ".jpg"])
def test_an_image_says_its_size_before_it_is_decoded(format_: str) -> None:
    _, data = cv2.imencode(format_, np.zeros((48, 64, 3), np.uint8))
    assert stated_size(data.tobytes()) == (64, 48)
    assert stated_size(data.tobytes()[:12]) is None


def test_an_image_that_would_fill_the_memory_is_refused() -> None:
    _, data = cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))
    head = bytearray(data.tobytes())
    struct.pack_into(">II", head, 16, 30_000, 30_000)
    struct.pack_into(">I", head, 29, zlib.crc32(head[12:29]))
    huge = Picture(t_ns=0, frame=3, roi=(0, 0, 64, 48), format="png", data=bytes(head))
    with pytest.raises(ConfigError, match="frame 3: its png is broken"):
        pixels(huge)
