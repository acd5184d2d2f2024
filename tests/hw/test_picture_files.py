"""What a picture file holds as 8 bits, whatever it was written with; what is no picture is one line."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.core.picture_head import cut_off, kind_of, orientation, stated_size
from hw.camera.files import SUFFIXES, folder_of_pictures, picture_files, read_picture, turned, white_of_all

COLOURS = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
LEVELS = np.array([[0, 100, 128, 129, 257, 4095, 20000, 65535]], np.uint16)
ROUNDED = [0, 0, 0, 1, 1, 16, 78, 255]


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tiff"])
def test_8_bits_are_as_they_were_written(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), COLOURS)
    assert np.array_equal(read_picture(path), COLOURS) and np.array_equal(read_picture(path, stretch=True), COLOURS)


def test_grey_becomes_three_equal_colours_and_colours_become_luminance(tmp_path):
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), COLOURS[:, :, 0])
    assert np.array_equal(read_picture(path), np.repeat(COLOURS[:, :, :1], 3, axis=2))
    assert np.array_equal(read_picture(path, grey=True), COLOURS[:, :, 0])
    cv2.imwrite(str(path), COLOURS)
    luminance = cv2.cvtColor(COLOURS, cv2.COLOR_BGR2GRAY)
    assert np.abs(read_picture(path, grey=True).astype(int) - luminance).max() <= 1


def test_an_alpha_plane_is_left_out(tmp_path):
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.dstack([COLOURS, COLOURS[:, :, 0]]))
    assert np.array_equal(read_picture(path), COLOURS)


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_16_bits_are_comparable_unless_they_are_stretched(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), LEVELS)
    assert read_picture(path, grey=True)[0].tolist() == ROUNDED  # in every format alike
    cv2.imwrite(str(path), LEVELS[:, :-2])  # 12 bits
    assert read_picture(path, grey=True)[0].tolist() == ROUNDED[:-2]
    assert read_picture(path, grey=True, stretch=True)[0].tolist() == [0, 6, 8, 8, 16, 255]


def test_pictures_of_16_bits_are_white_where_all_of_them_together_end(tmp_path):
    """Of a camera of 12 bits, and none of them by itself."""
    paths = [tmp_path / "dark.png", tmp_path / "light.png"]
    for path, largest in zip(paths, (700, 4000), strict=True):
        cv2.imwrite(str(path), np.array([[0, 16, largest]], np.uint16))
    assert white_of_all(paths) == 4095.0 and white_of_all(paths[:1]) == 1023.0
    assert read_picture(paths[0], grey=True, white=4095.0)[0].tolist() == [0, 1, 44]
    cv2.imwrite(str(paths[0]), np.array([[0, 7, 200]], np.uint8))
    assert white_of_all(paths[:1]) is None


def test_floating_point_is_white_at_one(tmp_path):
    path = tmp_path / "a.tiff"
    cv2.imwrite(str(path), np.array([[-0.5, 0.0, 0.5, 1.0, 2.0]], np.float32))
    assert read_picture(path, grey=True)[0].tolist() == [0, 0, 128, 255, 255]
    assert read_picture(path, grey=True, stretch=True)[0].tolist() == [0, 0, 64, 128, 255]
    assert read_picture(path)[0].tolist() == [[level] * 3 for level in (0, 0, 128, 255, 255)]
    cv2.imwrite(str(path), np.array([[[0.5, 0.5, 0.5], [1.0, 0.0, 0.0], [0.0, 1.0, 2.0]]], np.float32))
    assert read_picture(path)[0].tolist() == [[128, 128, 128], [255, 0, 0], [0, 255, 255]]
    assert read_picture(path, grey=True)[0].tolist() == [128, 29, 255]
    cv2.imwrite(str(path), np.array([[0.0, np.nan]], np.float32))
    with pytest.raises(ConfigError, match=r"a\.tiff: holds values that are not finite"):
        read_picture(path, grey=True)


def test_what_cannot_be_read_is_one_line(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.png: no such file"):
        read_picture(tmp_path / "none.png")
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(ConfigError, match=r"a\.png: not an image that OpenCV can read"):
        read_picture(tmp_path / "a.png")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".webp"])
def test_the_size_is_read_in_the_head_of_every_format(suffix: str) -> None:
    for image in (COLOURS, COLOURS[:, :, 0], np.dstack([COLOURS, COLOURS[:, :, 0]])):
        written, data = cv2.imencode(suffix, image)
        assert written and stated_size(data.tobytes()) == (30, 20)
    lossy = cv2.imencode(".webp", COLOURS, [cv2.IMWRITE_WEBP_QUALITY, 50])[1].tobytes()
    assert stated_size(lossy) == (30, 20)


def large(suffix: str) -> bytes:
    """A small file whose head says 60000 x 60000."""
    data = bytearray(cv2.imencode(suffix, COLOURS)[1].tobytes())
    if suffix == ".bmp":
        struct.pack_into("<ii", data, 18, 60000, 60000)
    else:  # the entries 256 and 257 of the directory, of kind 3 or 4
        (at,) = struct.unpack_from("<I", data, 4)
        for entry in range(at + 2, len(data) - 12, 12):
            if struct.unpack_from("<H", data, entry)[0] in (256, 257):
                struct.pack_into("<HII", data, entry + 2, 4, 1, 60000)
    return bytes(data)


@pytest.mark.parametrize("suffix", [".bmp", ".tif"])
def test_a_head_that_says_too_much_is_refused_before_memory_is_taken(tmp_path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(large(suffix))
    with pytest.raises(ConfigError, match="says that it has 60000 x 60000 pixels; give a smaller picture"):
        read_picture(path)


def test_a_chunk_that_says_it_is_longer_than_the_file_is_no_picture(tmp_path) -> None:
    """A decoder would set aside 4 GB for it."""
    data = bytearray(cv2.imencode(".png", COLOURS)[1].tobytes())
    struct.pack_into(">I", data, 33, 0xF8000074)
    (tmp_path / "a.png").write_bytes(data)
    assert stated_size(bytes(data)) is None
    with pytest.raises(ConfigError, match=r"not an image that OpenCV can read; give a PNG, JPEG, BMP, TIFF or WebP"):
        read_picture(tmp_path / "a.png")


def test_the_pictures_of_a_folder_in_order(tmp_path):
    with pytest.raises(ConfigError, match="none: no such folder"):
        picture_files(tmp_path / "none")
    (tmp_path / "notes.txt").touch()
    with pytest.raises(ConfigError, match="no pictures in this folder"):
        picture_files(tmp_path)
    names = [f"{k}{suffix.upper() if k % 2 else suffix}" for k, suffix in enumerate(SUFFIXES)]
    for name in reversed(names):
        (tmp_path / name).touch()
    assert [path.name for path in picture_files(tmp_path)] == names
    for name in (numbered := [f"take 2 {k}.png" for k in (9, 10, 11, 100)]):
        (tmp_path / name).touch()
    assert [path.name for path in picture_files(tmp_path)] == [*names, *numbered], "numbers count as numbers"


# --- what a file says of its picture ---


def held(suffix: str, how: int) -> bytes:
    """A picture whose EXIF says how the camera was held."""
    entry = struct.pack("<HHIHH", 0x0112, 3, 1, how, 0)
    exif = b"II*\0" + struct.pack("<IH", 8, 1) + entry + struct.pack("<I", 0)
    data = cv2.imencode(suffix, COLOURS)[1].tobytes()
    if suffix == ".jpg":
        body = b"Exif\0\0" + exif
        return data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]
    if suffix == ".png":
        chunk = b"eXIf" + exif
        return data[:33] + struct.pack(">I", len(exif)) + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:]
    if suffix == ".webp":
        size = struct.pack("<I", 29)[:3] + struct.pack("<I", 19)[:3]
        parts = b"WEBPVP8X" + struct.pack("<II", 10, 0x08) + size + data[12:]
        parts += b"EXIF" + struct.pack("<I", len(exif)) + exif
        return b"RIFF" + struct.pack("<I", len(parts)) + parts
    raise AssertionError(suffix)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_pixels_are_the_sensors_and_whoever_looks_at_them_turns_them(tmp_path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(held(suffix, 6))
    assert orientation(path.read_bytes()) == 6
    assert read_picture(path).shape == (20, 30, 3)
    assert read_picture(path, grey=True).shape == (20, 30)
    if suffix != ".webp":  # of which OpenCV does not read it
        assert read_picture(path, upright=True).shape == (30, 20, 3)
    (tmp_path / f"b{suffix}").write_bytes(held(suffix, 1))
    line = turned(picture_files(tmp_path))
    assert line is not None and line.startswith("1 of 2 pictures have an EXIF orientation") and f"a{suffix}" in line
    assert turned([tmp_path / f"b{suffix}"]) is None


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_a_picture_that_is_cut_off_is_named(tmp_path, suffix: str) -> None:
    whole = cv2.imencode(suffix, COLOURS)[1].tobytes()
    (tmp_path / f"whole{suffix}").write_bytes(whole + bytes(64))  # what cameras put behind it is nobody's business
    read_picture(tmp_path / f"whole{suffix}")
    path = tmp_path / f"cut{suffix}"
    for end in (len(whole) - 1, len(whole) - 20, len(whole) // 2):
        path.write_bytes(whole[:end])
        with pytest.raises(ConfigError, match=f"cut\\{suffix}: not an image that OpenCV can read"):
            read_picture(path)


def test_a_thumbnails_end_is_not_the_pictures(tmp_path) -> None:
    whole, thumbnail = (cv2.imencode(".jpg", one)[1].tobytes() for one in (COLOURS, COLOURS[:8, :8]))
    inside = whole[:2] + b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail + whole[2:]
    assert not cut_off(inside)
    assert cut_off(inside[:-40])


OTHERS = {
    "HEIC": b"\0\0\0\x18ftypheic",
    "AVIF": b"\0\0\0\x1cftypavif",
    "JPEG XL": b"\xff\x0a\x10",
    "JPEG 2000": b"\0\0\0\x0cjP  \r\n",
    "GIF": b"GIF89a",
    "camera raw": b"II*\0\x10\0\0\0CR",
}


def test_pictures_of_other_kinds_are_left_out_by_name_whatever_they_are_called(tmp_path) -> None:
    for n, (kind, head) in enumerate(OTHERS.items()):
        assert kind_of(head) == kind
        (tmp_path / f"{n}.jpg").write_bytes(head + bytes(40))
    with pytest.raises(ConfigError, match=r"no pictures in this folder; 0\.jpg: is HEIC, which is not read"):
        folder_of_pictures(tmp_path)
    (tmp_path / "no_ending").write_bytes(cv2.imencode(".jpg", COLOURS)[1].tobytes())
    (tmp_path / "dng.dng").write_bytes(cv2.imencode(".tif", COLOURS)[1].tobytes())  # its first picture is a thumbnail
    (tmp_path / "notes.csv").write_text("file")
    (tmp_path / "._0.jpg").write_bytes(b"\0\5\x16\7")  # what another system keeps beside each file
    found = folder_of_pictures(tmp_path)
    assert [path.name for path in found.files] == ["no_ending"]
    said = [line.rpartition("/")[2] for line in found.left_out]
    what = [*OTHERS, "camera raw"]
    names = [*(f"{n}.jpg" for n in range(len(OTHERS))), "dng.dng"]
    assert said == [
        f"{name}: is {kind}, which is not read; convert it to PNG or JPEG"
        for name, kind in zip(names, what, strict=True)
    ]


@pytest.mark.parametrize("suffix", [".png", ".webp", ".tif"])
def test_several_pictures_in_one_file_are_refused(tmp_path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".tif":
        cv2.imwritemulti(str(path), [COLOURS, COLOURS])
    else:
        both = cv2.Animation()
        both.frames, both.durations = [COLOURS, 255 - COLOURS], [100, 100]
        cv2.imwriteanimation(str(path), both)
    with pytest.raises(ConfigError, match="holds several pictures; save each as a file of its own"):
        read_picture(path)
