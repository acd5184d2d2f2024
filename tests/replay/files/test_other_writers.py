"""MCAP as its specification has it, whoever wrote it: each way to leave something out, to compress, or to add bytes."""

import gzip
import itertools
import struct
import zlib
from io import BytesIO
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from agent.core.config import ConfigError
from replay.files.info import describe, info
from replay.files.log import read
from replay.files.mcap_walk import MAGIC, Message, Tear, records
from replay.files.recover import recover
from tests.places import GOLDEN

DIVE = GOLDEN / "three" / "r1.mcap"

# --- a small writer: what the conformance files of the format have ---

OPTIONS = ("chunked", "padded", "indexed", "summary", "unknown", "crcs")
COMPRESSIONS = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.ZstdCompressor().compress}


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def written(*options: str, compression: str = "") -> bytes:
    """One schema, one channel, three messages, an attachment and a note."""
    pad = b"\x01\x02\x03" if "padded" in options else b""

    def record(opcode: int, content: bytes, more: bytes = pad) -> bytes:
        return struct.pack("<BQ", opcode, len(content + more)) + content + more

    def crc(data: bytes) -> bytes:
        return struct.pack("<I", zlib.crc32(data) if "crcs" in options else 0)

    schema = record(0x03, struct.pack("<H", 1) + text("Example") + text("c") + struct.pack("<I", 1) + b"x")
    channel = record(0x04, struct.pack("<HH", 1, 1) + text("example") + text("a") + struct.pack("<I", 0))
    messages = [record(0x05, struct.pack("<HIQQ", 1, n, 2 + n, 3) + b"data", b"") for n in range(3)]
    body = b"".join([schema, channel, *messages])
    strange = record(0x80, b"of a private kind") if "unknown" in options else b""
    data = MAGIC + record(0x01, text("") + text("somebody's")) + strange
    if "chunked" in options:
        packed, start = COMPRESSIONS[compression](body), len(data)
        head = struct.pack("<QQQ", 2, 4, len(body)) + crc(body) + text(compression)
        chunk = record(0x06, head + struct.pack("<Q", len(packed)) + packed)
        data += chunk
        places = (struct.pack("<QQ", 2 + n, len(schema + channel) + n * len(messages[0])) for n in range(3))
        index = record(0x07, struct.pack("<HI", 1, 48) + b"".join(places))
        data += index if "indexed" in options else b""
    else:
        data += body
    attached = struct.pack("<QQ", 1, 1) + text("a.txt") + text("text/plain") + struct.pack("<Q", 2) + b"hi"
    data += record(0x09, attached + crc(attached)) + record(0x0C, text("note") + struct.pack("<I", 0))
    data += record(0x0F, crc(data))
    summary_at, summary = len(data), b""
    if "summary" in options:
        summary = schema + channel + strange
        summary += record(0x0B, struct.pack("<QHIIIIQQI", 3, 1, 1, 1, 1, int("chunked" in options), 2, 4, 0))
        if "chunked" in options:
            sizes = text(compression) + struct.pack("<QQ", len(packed), len(body))
            summary += record(0x08, struct.pack("<QQQQIQ", 2, 4, start, len(chunk), 0, 0) + sizes)
    content = struct.pack("<QQ", summary_at if summary else 0, 0)
    head = struct.pack("<BQ", 0x02, 20 + len(pad)) + content
    return data + summary + head + crc(summary + head) + pad + MAGIC


WAYS = [chosen for n in range(len(OPTIONS) + 1) for chosen in itertools.combinations(OPTIONS, n)]


def test_every_way_to_write_a_file_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for options, compression in itertools.product(WAYS, COMPRESSIONS):
        if compression and "chunked" not in options:
            continue
        path.write_bytes(written(*options, compression=compression))
        if "padded" not in options and "unknown" not in options:  # the oracle: the format's own reader
            assert make_reader(BytesIO(path.read_bytes())).get_header().library == "somebody's"
        found = list(records(path))
        assert [each.data for each in found if isinstance(each, Message)] == [b"data"] * 3, (options, compression)
        about = info(path)
        assert about.complete and not about.damage, (options, compression, about.damage)
        said = describe(path, about)
        assert "whole, but not written by Aucamp, but by 'somebody's'" in said and "killed" not in said
        assert recover(path).summary == "whole, nothing to mend"


def copied(path: Path, library: str = "somebody's tool", **how: object) -> Path:
    """A dive as another tool writes it anew."""
    with DIVE.open("rb") as source, path.open("wb") as out:
        reader, writer = make_reader(source), Writer(out, **how)
        writer.start(library=library)
        for note in reader.iter_metadata():
            writer.add_metadata(note.name, note.metadata)
        for file in reader.iter_attachments():
            writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        channels: dict[int, int] = {}
        for _, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, 0)
            at = channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            writer.add_message(*at)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "how",
    [
        {"compression": CompressionType.LZ4},
        {"use_chunking": False},
        {"enable_crcs": False, "enable_data_crcs": False},
        {"index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False},
    ],
)
def test_a_dive_that_another_tool_wrote_anew_is_a_copy_and_not_damaged(tmp_path: Path, how: dict) -> None:
    path = copied(tmp_path / "r1.mcap", **how)
    about = info(path)
    assert about.complete and not about.verified
    assert "whole, a copy by 'somebody's tool'; digests say nothing of it" in describe(path, about)
    assert [record.data for record in read(path)] == [record.data for record in read(DIVE)]


# --- holes ---


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A dive in many small chunks."""
    return copied(tmp_path_factory.mktemp("chunks") / "r1.mcap", "aucamp", chunk_size=4000).read_bytes()


@pytest.mark.parametrize("filling", [0, 0xFF, 0x05])
def test_behind_a_hole_the_next_record_is_looked_for(tmp_path: Path, chunks: bytes, filling: int) -> None:
    whole, path = [record.data for record in read(DIVE)], tmp_path / "hole.mcap"
    for share in (0.2, 0.5, 0.8):
        begin = int(share * len(chunks))
        path.write_bytes(chunks[:begin] + bytes([filling]) * 4096 + chunks[begin + 4096 :])
        tears = [each for each in records(path) if isinstance(each, Tear) and each.bytes]
        assert sum(each.bytes for each in tears) < 4096 + 3 * 4000
        mended = recover(path)
        assert mended.tears <= 3 and mended.out is not None
        kept = [record.data for record in read(mended.out)]
        assert len(whole) > len(kept) > 0.9 * len(whole)
        assert kept[0] == whole[0] and kept[-1] == whole[-1]
        mended.out.unlink()


def test_zeros_at_the_end_are_one_tear(tmp_path: Path, chunks: bytes) -> None:
    path = tmp_path / "zeros.mcap"
    path.write_bytes(chunks[:-20_000] + bytes(20_000))
    found = recover(path)
    assert found.tears == 1 and found.bytes_lost >= 16_000


# --- what is none ---


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "a Git LFS pointer; fetch the file itself"),
        (b"<!DOCTYPE html><html>Not found</html>", "a page of HTML"),
        (gzip.compress(b"x", mtime=0), "compressed by gzip; unpack it first with: gunzip"),
        (MAGIC.replace(b"\r\n", b"\n") + b"x", "a recording that was copied in text mode"),
        (b"\x04\x22\x4d\x18x", "compressed by lz4"),
        (b"hello", "its first bytes are not those of MCAP"),
    ],
)
def test_first_bytes_decide_what_a_file_is(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "r1.mcap"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=says) as refused:
        info(path)
    assert "ends in" not in str(refused.value) and "\n" not in str(refused.value)
