"""`aucamp enhance`, with the classic way: what it reads, writes and refuses does not depend on the network."""

import cv2
import numpy as np
import pytest
from rich.console import Console

from agent import enhance_evaluate, enhance_source
from agent.config import ConfigError

PICTURE = np.random.default_rng(1).integers(30, 200, (40, 60, 3), dtype=np.uint8)


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
    read = enhance_source.read(write(tmp_path / "a.png", PICTURE.astype(np.uint16) * 20))
    assert read.max() == 255
    assert np.abs(read.astype(float) - PICTURE * (255 / PICTURE.max())).max() <= 0.51


@pytest.mark.parametrize(("source", "line"), [
    ("", "no images in this folder"), ("nowhere.png", "no such file"), ("text.png", "1"), ("usb:1", "no such file"),
])  # fmt: skip
def test_bad_sources_are_one_line(tmp_path, source, line):
    (tmp_path / "text.png").write_bytes(b"text")
    if source == "text.png":
        assert enhance(tmp_path / source, tmp_path / "out") == 1
        return
    place = tmp_path / "empty"
    place.mkdir()
    with pytest.raises(ConfigError, match=line) as caught:
        enhance(place / source if source else place, tmp_path / "out")
    assert "\n" not in str(caught.value)


def test_sources_are_never_overwritten(tmp_path):
    source = write(tmp_path / "a.png")
    for given in (source, tmp_path):
        with pytest.raises(ConfigError, match="another"):
            enhance(given, tmp_path)
    assert np.array_equal(cv2.imread(str(source)), PICTURE)


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


def test_evaluation_knows_a_perfect_picture_and_names_a_broken_one(tmp_path):
    for name in ("raw", "reference"):
        (tmp_path / name).mkdir()
        write(tmp_path / name / "a.png"), write(tmp_path / name / "b.png")
    (tmp_path / "raw" / "b.png").write_bytes(b"")
    figures, code = enhance_evaluate.run(
        tmp_path / "raw", tmp_path / "reference", "classic", None, False, Console(quiet=True)
    )
    assert code == 1 and list(figures) == ["a"]
    assert figures["a"]["identity"].psnr_db == float("inf") and figures["a"]["classic"].psnr_db < 40
    assert set(figures["a"]) == {"identity", "grey-world", "CLAHE", "classic"}


def test_evaluation_without_pairs(tmp_path):
    for name in ("raw", "reference"):
        (tmp_path / name).mkdir()
        write(tmp_path / name / f"{name}.png")
    with pytest.raises(ConfigError, match="no two pictures of the same name"):
        enhance_evaluate.run(tmp_path / "raw", tmp_path / "reference", "classic", None, False, Console(quiet=True))
