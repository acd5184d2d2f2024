"""`aucamp enhance`, with the classic way: what it reads, writes and refuses does not depend on the network."""

import hashlib
import struct
import sys

import cv2
import numpy as np
import pytest
from rich.console import Console

from agent.__main__ import main
from agent.core.config import ConfigError
from agent.perception.enhancement.enhance import WEIGHTS
from agent.tools import enhance as enhance_source
from agent.tools import evaluate_enhance as enhance_evaluate
from agent.tools.enhance import pictures
from hw.camera.files import VideoCamera, open_video
from replay.files.frames import CODECS

NOISE = np.random.default_rng(1).integers(30, 200, (40, 60, 3), dtype=np.uint8)
PICTURE = np.asarray(NOISE * [0.9, 0.8, 0.3], np.uint8)  # as under water: red reaches not far


def enhance(source, out, **more):
    options = {"side_by_side": False, "variant": "classic", "weights": None, "frames": None, **more}
    return enhance_source.run(str(source), out, console=Console(quiet=True), **options)


def write(path, image=PICTURE):
    assert cv2.imwrite(str(path), image)
    return path


def test_an_image_beside_its_enhanced_self(tmp_path):
    source = write(tmp_path / "a.png")
    assert enhance(source, tmp_path / "out", side_by_side=True) == 0
    both = cv2.imread(str(tmp_path / "out" / "a.png"))
    assert both.shape == (40, 120, 3)
    assert np.array_equal(both[:, :60], PICTURE)
    assert not np.array_equal(both[:, 60:], PICTURE)


def test_how_much_a_picture_changed_is_said(tmp_path, capsys):
    """One under water, and one that lacks nothing."""
    (tmp_path / "in").mkdir()
    write(tmp_path / "in" / "lacks.png")
    write(tmp_path / "in" / "well.png", NOISE)
    console = Console(width=200)
    options = {"side_by_side": False, "variant": "classic", "weights": None, "frames": None}
    assert enhance_source.run(str(tmp_path / "in"), tmp_path / "out", console=console, **options) == 0
    said = capsys.readouterr().out
    assert "well.png: changed by 0.0 levels, 100 % of it left as it is" in said
    assert "lacks.png: changed by" in said and "lacks.png: changed by 0.0" not in said


def test_a_corrupt_image_of_a_folder_is_named_and_the_others_are_done(tmp_path, capsys):
    folder = tmp_path / "in"
    folder.mkdir()
    write(folder / "a.png"), write(folder / "c.jpg")
    (folder / "b.png").write_bytes(b"no picture")
    code = enhance_source.run(str(folder), tmp_path / "out", False, "classic", None, None, Console(width=300))
    assert code == 1
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["a.png", "c.png"]
    assert "b.png: not an image" in capsys.readouterr().out


def test_two_images_of_one_stem_keep_apart(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    write(folder / "a.png"), write(folder / "a.jpg")
    enhance(folder, tmp_path / "out")
    assert len(list((tmp_path / "out").iterdir())) == 2


@pytest.mark.parametrize("image", [
    np.full((1, 1, 3), 90, np.uint8),
    PICTURE[:, :, 0],
    PICTURE[:, :, 0].astype(np.uint16) * 257,
    PICTURE.astype(np.uint16) * 20,
])  # fmt: skip
def test_tiny_grey_and_16_bit_images(tmp_path, image):
    assert enhance(write(tmp_path / "a.png", image), tmp_path / "out") == 0
    out = cv2.imread(str(tmp_path / "out" / "a.png"), cv2.IMREAD_UNCHANGED)
    assert out.dtype == np.uint8 and out.shape == (*image.shape[:2], 3)


def test_16_bits_are_scaled_by_their_largest_value(tmp_path):
    read = next(pictures(str(write(tmp_path / "a.png", PICTURE.astype(np.uint16) * 20)), None).each).image
    assert read.max() == 255
    assert np.abs(read.astype(float) - PICTURE * (255 / PICTURE.max())).max() <= 0.51


@pytest.mark.parametrize(("arguments", "line"), [
    (["empty"], "no pictures in this folder"),
    (["nowhere.png"], "no such file or folder"),
    (["text.png"], "text.png: not an image"),
    (["text.avi"], "text.avi: not a video"),
    (["usb:1"], "no such kind of camera"),
    (["stack:empty"], "positions.csv"),
    (["a.png", "--out", "text.png"], "text.png: is there already, and nothing is overwritten; give --out another name"),
    (["a.png", "--out", "/proc/enhanced"], "--out /proc/enhanced"),
    (["a.png", "--variant", "best"], "'--variant': 'best' is not one of 'plain', 'folded', 'fast'"),
    (["a.png", "--variant", "classic", "--evaluate", "empty", "empty"], "either a SOURCE or --evaluate"),
    (["--evaluate", "nowhere", "empty"], "nowhere: no such folder"),
    (["--evaluate", "empty", "empty"], "no pictures in this folder"),
    (["--evaluate", "empty", "empty", "--size", "5x5"], "--size 5x5: write WIDTHxHEIGHT"),
])  # fmt: skip
def test_mistakes_are_one_line_and_exit_2(arguments, line, tmp_path, monkeypatch, capsys):
    (tmp_path / "empty").mkdir()
    write(tmp_path / "a.png")
    for name in ("text.png", "text.avi"):
        (tmp_path / name).write_bytes(b"text")
    classic = [] if "--variant" in arguments else ["--variant", "classic"]
    assert command([*arguments, *classic], tmp_path, monkeypatch) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert said[-1].startswith("aucamp: ") and line in said[-1]


@pytest.mark.parametrize(("spoil", "line"), [
    (lambda path: path.write_bytes(path.read_bytes()[:-1] + b"x"), "own.safetensors: does not match"),
    (lambda path: path.with_name("own.safetensors.sha256").unlink(), "own.safetensors.sha256: no such file"),
    (lambda path: path.unlink(), "own.safetensors: no such file"),
    (lambda path: stamp(path, b"no tensors"), "own.safetensors: not the weights of this network"),
])  # fmt: skip
def test_weights_that_cannot_be_used(spoil, line, tmp_path, monkeypatch, capsys):
    pytest.importorskip("agent.perception.enhancement.lu2net", reason="the network needs torch")
    path = tmp_path / "own.safetensors"
    stamp(path, (WEIGHTS / "own.safetensors").read_bytes())
    spoil(path)
    write(tmp_path / "a.png")
    assert command(["a.png", "--weights", str(path)], tmp_path, monkeypatch) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert said[-1].startswith("aucamp: ") and line in said[-1]


def stamp(path, data):
    path.write_bytes(data)
    path.with_name(path.name + ".sha256").write_text(f"{hashlib.sha256(data).hexdigest()}  {path.name}\n")


def command(arguments, folder, monkeypatch):
    """Exit code of `aucamp enhance`."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["aucamp", "enhance", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code


def test_nothing_is_overwritten(tmp_path):
    source = write(tmp_path / "a.png")
    for given in (source, tmp_path):
        with pytest.raises(ConfigError, match="not empty, and nothing is overwritten; give --out a new folder"):
            enhance(given, tmp_path)
    assert np.array_equal(cv2.imread(str(source)), PICTURE)
    (tmp_path / "empty").mkdir()
    assert enhance(source, tmp_path / "empty") == 0


def test_a_video_keeps_its_frames_and_a_camera_gives_as_many_as_asked(tmp_path):
    path = tmp_path / "dive.avi"
    sink = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (60, 40))
    for _ in range(5):
        sink.write(PICTURE)
    sink.release()
    assert enhance(path, tmp_path / "film") == 0
    done = cv2.VideoCapture(str(tmp_path / "film" / "dive.mp4"))
    assert (int(done.get(cv2.CAP_PROP_FRAME_COUNT)), done.get(cv2.CAP_PROP_FPS)) == (5, 10.0)
    assert enhance(f"video:{path}", tmp_path / "frames", frames=3) == 0
    assert len(list((tmp_path / "frames").iterdir())) == 3


def test_a_video_that_was_cut_off_is_named_and_what_there_is_is_done(tmp_path, capsys):
    path = tmp_path / "dive.avi"
    sink = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (60, 40))
    for _ in range(40):
        sink.write(PICTURE)
    sink.release()
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert enhance_source.run(str(path), tmp_path / "film", False, "classic", None, None, Console(width=300)) == 1
    assert "of 40 frames; it was cut off" in capsys.readouterr().out
    assert 10 < int(cv2.VideoCapture(str(tmp_path / "film" / "dive.mp4")).get(cv2.CAP_PROP_FRAME_COUNT)) < 30


def test_a_stack_is_a_camera(tmp_path):
    stack = tmp_path / "stack"
    stack.mkdir()
    for k in range(3):
        write(stack / f"{k}.png")
    (stack / "positions.csv").write_text("file,focus_position\n0.png,0\n1.png,1\n2.png,2\n")
    assert enhance(f"stack:{stack}", tmp_path / "frames", frames=2) == 0
    assert sorted(file.name for file in (tmp_path / "frames").iterdir()) == ["000000.png", "000001.png"]


def test_evaluation_knows_a_perfect_picture_and_names_a_broken_one(tmp_path):
    for name in ("raw", "reference"):
        (tmp_path / name).mkdir()
        write(tmp_path / name / "a.png"), write(tmp_path / name / "b.png")
    (tmp_path / "raw" / "b.png").write_bytes(b"")
    figures, code = enhance_evaluate.run(
        tmp_path / "raw", tmp_path / "reference", "classic", None, "64x64", Console(quiet=True)
    )
    assert code == 1 and list(figures) == ["a"]
    assert figures["a"]["identity"].psnr_db == float("inf") and figures["a"]["classic"].psnr_db < 40
    assert set(figures["a"]) == {"identity", "grey-world", "CLAHE", "classic"}


def test_evaluation_names_what_has_no_partner_or_another_size(tmp_path, capsys):
    for name, others in (("raw", "bc"), ("reference", "d")):
        (tmp_path / name).mkdir()
        for stem in "a" + others:
            write(tmp_path / name / f"{stem}.png")
    write(tmp_path / "raw" / "e.png"), write(tmp_path / "reference" / "e.png", PICTURE[:20])
    figures, code = enhance_evaluate.run(
        tmp_path / "raw", tmp_path / "reference", "classic", None, "own", Console(width=400)
    )
    said = capsys.readouterr().out
    assert code == 1 and list(figures) == ["a"]
    assert "raw: without a partner in the other folder: b.png, c.png" in said
    assert "reference: without a partner in the other folder: d.png" in said
    assert "e.png: 60x40, but its reference 60x20 pixels" in said


def test_evaluation_without_pairs(tmp_path):
    for name in ("raw", "reference"):
        (tmp_path / name).mkdir()
        write(tmp_path / name / f"{name}.png")
    with pytest.raises(ConfigError, match="no two pictures of the same name"):
        enhance_evaluate.run(tmp_path / "raw", tmp_path / "reference", "classic", None, "own", Console(quiet=True))
    write(tmp_path / "reference" / "raw.png"), write(tmp_path / "raw" / "raw.jpg")
    with pytest.raises(ConfigError, match=r"raw: raw\.jpg and raw\.png have one name, .*; leave one there"):
        enhance_evaluate.run(tmp_path / "raw", tmp_path / "reference", "classic", None, "own", Console(quiet=True))


# --- films ---

SMOOTH = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (96, 128, 3), np.uint8), (0, 0), 2)


def filmed(path, shifts):
    """A film of SMOOTH, shifted by so many pixels in each frame."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*CODECS[path.suffix]), 30, (128, 96))
    for shift in shifts:
        writer.write(np.roll(SMOOTH, shift, axis=1))
    writer.release()
    return path


def walked(path):
    found = pictures(str(path), None)
    return found, list(found.each)


def test_a_film_that_was_cut_off_is_named_with_how_far_it_came(tmp_path):
    film = filmed(tmp_path / "film.avi", range(40))
    whole, frames = walked(film)
    assert len(frames) == 40 and not whole.problems and not whole.notes
    assert [frame.t_s for frame in frames[:3]] == pytest.approx([0.0, 1 / 30, 2 / 30], abs=1e-3)
    data = film.read_bytes()
    film.write_bytes(data[: len(data) // 2])
    cut, frames = walked(film)
    assert 10 < len(frames) < 25
    assert cut.problems == [f"{film}: ends after {len(frames)} of 40 frames; it was cut off, copy or convert it again"]


def broken(path, numbers):
    """The film, with so many of its frames overwritten."""
    data = bytearray(path.read_bytes())
    at = data.index(b"movi") + 4
    for n in range(max(numbers) + 1):
        (length,) = struct.unpack_from("<I", data, at + 4)
        if n in numbers:
            data[at + 8 : at + 8 + length] = bytes(length)
        at += 8 + length + length % 2
    path.write_bytes(data)
    return path


def test_a_frame_that_cannot_be_read_is_named_and_the_film_goes_on(tmp_path, monkeypatch):
    film = broken(filmed(tmp_path / "film.avi", range(100)), {0, 50, 70, 71, 99})
    found, frames = walked(film)
    assert [frame.name for frame in frames] == [str(n) for n in range(99) if n not in {0, 50, 70, 71}]
    assert frames[-1].t_s - frames[0].t_s == pytest.approx(97 / 30, abs=1e-3)
    assert found.problems == [f"{film}: frames 0, 50, 70 to 71 cannot be read, 4 of 100; copy or convert it again"]
    assert found.notes == [f"{film}: says that it has 100 frames, and ends after 99: some may be lost at its end"]
    few = pictures(str(film), 51)
    assert len(list(few.each)) == 49 and not few.notes
    assert few.problems == [f"{film}: frames 0, 50 cannot be read, 2 of 51; copy or convert it again"]

    def uncounted(*given):
        camera = open_video(*given)
        camera.count = 0
        return camera

    monkeypatch.setattr(enhance_source, "open_video", uncounted)  # as a raw stream of H.264
    found, frames = walked(film)
    assert len(frames) == 95 and found.problems[0].startswith(f"{film}: frames 0, 50, 70 to 71 cannot be read, 4 of 99")
    assert found.notes == [
        f"{film}: does not say how many frames it has: some may be lost after its 99; convert it to MP4"
    ]


def test_frames_that_do_not_change_are_noticed(tmp_path):
    hung, _ = walked(filmed(tmp_path / "hung.avi", [*range(8), *[8] * 12, *range(9, 14)]))
    assert hung.notes == [f"{tmp_path / 'hung.avi'}: frames 8 to 19 are the same picture"] and not hung.problems
    stale, _ = walked(filmed(tmp_path / "stale.avi", [0] * 15))
    assert stale.problems[0].startswith(f"{tmp_path / 'stale.avi'}: all 15 frames are the same picture; if it is inter")
    few, _ = walked(filmed(tmp_path / "few.avi", [0] * 5))
    assert not few.problems and not few.notes


def test_a_stream_without_times_has_none(tmp_path, monkeypatch):
    """As a raw stream of H.264, of which OpenCV says that each frame is at 0."""
    film = filmed(tmp_path / "film.avi", range(4))
    read = VideoCamera.read
    monkeypatch.setattr(VideoCamera, "read", lambda self, **how: read(self, **how)._replace(t_ns=0))
    found, frames = walked(film)
    assert [frame.t_s for frame in frames] == [None] * 4
    assert found.notes == [f"{film}: its frames have no times, so that t_s is left empty; convert it to MP4"]


def test_a_picture_is_turned_as_a_viewer_turns_it(tmp_path):
    """What is written has no EXIF any more."""
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\3\0\1\0\0\0\6\0\0\0\0\0\0\0"
    data = cv2.imencode(".jpg", SMOOTH)[1].tobytes()
    head = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    (tmp_path / "a.jpg").write_bytes(data[:2] + head + data[2:])
    enhance(tmp_path / "a.jpg", tmp_path / "out")
    assert cv2.imread(str(tmp_path / "out" / "a.png")).shape == (128, 96, 3)
    assert next(pictures(str(tmp_path / "a.jpg"), None).each).image.shape == (96, 128, 3)


@pytest.mark.parametrize(("matrix", "turn_deg"), [((0, 1, -1, 0), 90), ((-1, 0, 0, -1), 180)])
def test_a_film_is_turned_as_its_file_says_for_people_alone(tmp_path, matrix, turn_deg):
    """A telephone that is held upright writes how to turn what it filmed."""
    film, whole = tmp_path / "film.mp4", filmed(tmp_path / "whole.mp4", [0])
    data = bytearray(whole.read_bytes())
    a, b, c, d = (one << 16 for one in matrix)
    struct.pack_into(">9i", data, data.index(b"tkhd") + 44, a, b, 0, c, d, 0, 0, 0, 1 << 30)
    film.write_bytes(data)
    (plain,) = walked(whole)[1]
    for source in (str(film), f"video:{film}"):
        found = pictures(source, 1)
        assert np.array_equal(next(found.each).image, plain.image)
        how = "which is not followed: pixels are counted as the sensor has them"
        assert found.notes == [f"{film}: says that it is to be turned by {turn_deg} degrees, {how}"]
        upright = pictures(source, 1, upright=True)
        assert np.array_equal(next(upright.each).image, np.rot90(plain.image, -turn_deg // 90)) and not upright.notes


def test_one_picture_of_another_kind_is_no_film(tmp_path):
    (tmp_path / "a.gif").write_bytes(b"GIF89a" + bytes(40))
    with pytest.raises(ConfigError, match=r"a\.gif: is GIF, which is not read; convert it to PNG or JPEG"):
        pictures(str(tmp_path / "a.gif"), None)


def test_one_picture_may_be_given_its_name(tmp_path):
    assert enhance(write(tmp_path / "a.png", PICTURE), tmp_path / "clear.png") == 0
    assert cv2.imread(str(tmp_path / "clear.png")).shape == PICTURE.shape
    (tmp_path / "two").mkdir()
    for name in "ab":
        write(tmp_path / "two" / f"{name}.png", PICTURE)
    for source, out in ((tmp_path / "two", "x.png"), (tmp_path / "a.png", "x.jpg"), (tmp_path / "a.png", "x.mp4")):
        with pytest.raises(ConfigError, match=f"--out .*{out}: is the name of one picture; give a folder"):
            enhance(source, tmp_path / out)
        assert not (tmp_path / out).exists()
    with pytest.raises(ConfigError, match="is there already, and nothing is overwritten"):
        enhance(tmp_path / "a.png", tmp_path / "clear.png")
