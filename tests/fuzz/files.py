"""Files that people and other programs give: each is written, read as a verb reads it, and what came of it is used."""

from __future__ import annotations

import io
import json
import math
import struct
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from msgspec.structs import replace

from agent.clock import clock, machine
from agent.core.codec import encode
from agent.core.config import ConfigError, Fleet, dump
from agent.core.ranging.camera_model import Calibration, load_calibration, load_focus
from agent.core.step_io import Inputs
from agent.core.trust import common
from agent.ground.page.server import hello
from agent.perception.enhancement.enhance import shipped_weights
from agent.perception.tracking.follow import load_nano
from agent.process import certificates, keys
from agent.reconstruction.sources import transforms_views
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from agent.tools.enhance import WHOLE, pictures
from agent.tools.focus_calibration import read_table
from agent.tools.track import read_truth
from hw.camera import files as camera_files
from hw.camera.camera import CameraError
from hw.camera.files import open_stack, read_picture, turned
from hw.twin.scene import SCENES, load_scene
from replay.check.compare import load_ignored
from replay.report.creature_track import _true_boxes, true_path, true_ways
from replay.report.timeline import _summary, _truths
from tests.fuzz import mutate
from tests.fuzz.decoder import JSON, TOML, YAML, Decoder, Form
from tests.fuzz.kernel.swarm import private_key
from tests.network.scripted_agent import CALIBRATION
from tests.places import ROOT
from tests.sample_messages import telemetry

FLEETS = sorted((ROOT / "agent" / "fleets").glob("*.toml"))
PICTURES = (".png", ".jpg", ".bmp", ".tif", ".webp", ".ppm")
START_NS, STEP_NS = 10**18, 50_000_000
LONGEST_LINE = 1500
MOST_PIXELS = 2**20  # of a picture: fewer than in use, so that one that gets by takes time
IGNORED = '[[ignore]]\nfield = "outputs.answers"\nwhy = "a word has changed"\n'


def decoders() -> tuple[Decoder, ...]:
    refused = partial(_file, ConfigError)
    calibrations = [dump(replace(CALIBRATION, robot="r1"))]
    return (
        Decoder("fleet", partial(refused, "fleet.toml", _dive), _one_of(FLEETS), TOML, share=0.3),
        Decoder("calibration", partial(refused, "r1.toml", _calibrated), _one_of(calibrations), TOML, share=0.5),
        Decoder("focus", partial(refused, "r1.toml", load_focus), _one_of(calibrations), TOML),
        Decoder("scene", partial(refused, "s.toml", lambda path: load_scene(str(path))), _one_of(_scenes()), TOML),
        Decoder("ignored", partial(refused, "i.toml", load_ignored), _one_of([IGNORED]), TOML),
        *(
            Decoder(f"survey{ending}", partial(refused, f"tags{ending}", _surveyed), _one_of([text]), form, slow_s=1.0)
            for ending, text, form in ((".yaml", ROS, YAML), (".json", WPILIB, JSON), (".toml", SURVEY, TOML))
        ),
        Decoder("transforms", partial(refused, "transforms.json", _transforms), _one_of([TRANSFORMS]), JSON),
        Decoder("summary", partial(refused, "summary.json", _told), _one_of([SUMMARY]), JSON),
        Decoder("creatures", partial(refused, "creatures.csv", lambda path: true_path(path.parent, "f")), _creatures),
        Decoder("paths", partial(refused, "paths.csv", lambda path: true_ways(path.parent)), _paths),
        Decoder("boxes", partial(refused, "boxes.csv", lambda path: _true_boxes(path.parent, "f")), _boxes),
        Decoder("picture", partial(refused, "picture.png", _picture), _pixels),
        Decoder("film", partial(_file, (ConfigError, CameraError), "film.avi", _film), _filmed, slow_s=2.0),
        Decoder("stack", partial(_file, CameraError, "positions.csv", _stack), _positions),
        Decoder("ranges", partial(refused, "ranges.csv", read_table), _table),
        Decoder("truth", partial(refused, "truth.csv", read_truth), _truth),
        Decoder("certificate", partial(refused, "r1.pem", _certificate), _pair_of("certificate"), share=0.3),
        Decoder("certificate-key", partial(refused, "r1.key", _certificate_key), _pair_of("key"), share=0.3),
        Decoder("key-private", partial(_file, keys.UnusableKeyError, "r1.private.pem", _private), _signing, share=0.3),
        Decoder("key-public", partial(_file, keys.UnusableKeyError, "r1.public.pem", _public), _verifying),
        Decoder("onnx", partial(refused, "b.onnx", lambda path: load_nano(path, path)), lambda rng: rng.randbytes(400)),
        Decoder("clock", partial(_file, (), "clock", _clock), _clock_file, WORDS, share=0.5),
        *(_weights() if find_spec("torch") and find_spec("safetensors") else ()),
    )


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None)


def place(name: str) -> Path:
    """A folder for the files of one name, which goes with the process."""
    folder = Path(_folder().name) / name
    folder.mkdir(exist_ok=True)
    return folder


Refused = type[Exception] | tuple[type[Exception], ...]


def _file(refused: Refused, name: str, read: Callable[[Path], object], data: bytes) -> None:
    path = place(name) / name
    path.write_bytes(data)
    try:
        read(path)
    except refused as error:
        said = str(error)
        assert said and "\n" not in said and len(said) < LONGEST_LINE, "no line"


def _one_of(texts: list[Any]) -> Callable[[Random], bytes]:
    """Files, or their texts, as they are."""
    return lambda rng: text.read_bytes() if isinstance(text := rng.choice(texts), Path) else text.encode()


# --- fleets, calibrations and scenes ------------------------------------------------------------------------------


def _dive(path: Path) -> None:
    """A fleet that may dive: shown on a page, and a robot's first steps."""
    fleet = load_fleet(path)
    common(fleet)
    hello(fleet, "recording", path.parent)
    _steps(fleet, CALIBRATION)


def _calibrated(path: Path) -> None:
    _steps(load_fleet(FLEETS[-2]), load_calibration(path))


def _steps(fleet: Fleet, calibration: Calibration) -> None:
    agent = Agent(fleet, next(iter(fleet.robot)), calibration, START_NS)
    for k in range(3):
        now_ns = START_NS + k * STEP_NS
        encode(agent.step(Inputs(telemetry=(telemetry(t_ns=now_ns),)), now_ns))
        fault = agent.transaction.fault(now_ns)
        assert fault is None, f"{fault:.80}"


def _scenes() -> list[Path]:
    return sorted(SCENES.glob("*.toml"))


# --- places of tags -------------------------------------------------------------------------------------------------

ROS = """
standalone_tags: [{id: 99, size: 0.08}]
tag_bundles:
- name: tank
  layout:
  - {id: 17, size: 0.08, x: 0.7, y: 0.6, z: 0.0, qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0}
  - {id: 18, size: 0.08, x: 0.4, y: 0.6, z: 0.0, qw: 0.8, qx: 0.0, qy: 0.0, qz: 0.6}
"""
WPILIB = json.dumps({
    "tags": [
        {
            "ID": number,
            "pose": {
                "translation": {"x": 0.1 * number, "y": 0.6, "z": 0.0},
                "rotation": {"quaternion": {"W": math.sqrt(0.5), "X": 0.0, "Y": -math.sqrt(0.5), "Z": 0.0}},
            },
        }
        for number in (3, 6)
    ],
    "field": {"length": 1.5, "width": 1.2},
})  # fmt: skip
SURVEY = """
[landmarks]
family = "36h11"
size_m = 0.08
sigma_m = 0.001
tag = [
  { id = 1, face = "floor", position_m = [0.7, 0.6, 0.0], turn_deg = 10.0 },
  { id = 2, face = "x0", position_m = [0.0, 0.6, 0.25], turn_deg = 0.0 },
]
"""


def _surveyed(path: Path) -> None:
    fleet = path.with_name("fleet.toml")
    if not fleet.exists():
        beside = "" if path.suffix == ".toml" else "size_m = 0.08\n"
        tank = (ROOT / "agent" / "fleets" / "tank.toml").read_text()
        fleet.write_text(f'{tank}\n[landmarks]\nfile = "{path.name}"\n{beside}')
    load_fleet(fleet)


# --- pictures, and tables beside them -------------------------------------------------------------------------------

POSE = [[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]]
TRANSFORMS = json.dumps({
    "fl_x": 40.0, "fl_y": 40.0, "cx": 16.0, "cy": 12.0, "w": 32, "h": 24,
    "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
    "frames": [
        {"file_path": "a.png", "transform_matrix": POSE},
        {"file_path": "./b", "transform_matrix": POSE, "k1": 0.1, "k3": 0.0},
        {"file_path": "a.png", "transform_matrix": POSE, "camera_angle_x": 0.9},
    ],
})  # fmt: skip


def _transforms(path: Path) -> None:
    for name in ("a.png", "b.jpg"):
        if not path.with_name(name).exists():
            cv2.imwrite(str(path.with_name(name)), np.full((24, 32, 3), 90, np.uint8))
    for view in transforms_views(path, lambda done, total, what="": None).views:
        sound = all(np.isfinite(part).all() for part in (view.camera, view.rotation, view.position_m))
        assert sound, "no finite view"


def _pixels(rng: Random) -> bytes:
    """A picture of some format and depth, small or of one colour."""
    kind = rng.choice((np.uint8, np.uint8, np.uint16))
    planes = rng.choice((1, 3, 3, 4))
    shape = (rng.randrange(1, 9), rng.randrange(1, 9), planes)
    noise = np.frombuffer(rng.randbytes(math.prod(shape) * np.dtype(kind).itemsize), kind).reshape(shape)
    ending = rng.choice(PICTURES if kind is np.uint8 and planes != 4 else (".png", ".tif"))
    _, data = cv2.imencode(ending, noise)
    return np.asarray(data, np.uint8).tobytes()  # some formats do not take all


def _picture(path: Path) -> None:
    with patch.object(camera_files, "MOST_PIXELS", MOST_PIXELS):
        turned([path])
        image = read_picture(path)
        half = path.with_name("half.png")
        half.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with suppress(ConfigError):
            assert np.array_equal(read_picture(half), image), "a picture that is cut off passes for whole"
    assert image.size <= 3 * MOST_PIXELS, "larger than its head says"
    assert image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8, "no picture"


def _film(path: Path) -> None:
    found = pictures(str(path), 3 * FRAMES)
    frames = sum(1 for _ in found.each)
    assert found.problems or found.total is None or frames >= WHOLE * found.total, "a film that is cut passes for whole"


FRAMES = 8


def _filmed(rng: Random) -> bytes:
    """A film of a few small frames that differ."""
    path = place("filmed") / "film.avi"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, (32, 24))
    for k in range(FRAMES):
        film.write(np.full((24, 32, 3), 8 * k + rng.randrange(8), np.uint8))
    film.release()
    return path.read_bytes()


def _stack(path: Path) -> None:
    for k in range(3):
        if not (one := path.with_name(f"{k}.png")).exists():
            cv2.imwrite(str(one), np.full((6, 8, 3), 30 * k, np.uint8))
    camera = open_stack(path.parent)
    camera.set_focus(2)
    camera.read()


def _positions(rng: Random) -> bytes:
    return b"file,focus_position\n" + b"".join(b"%d.png,%d\n" % (k, 10 * k) for k in range(3))


def _table(rng: Random) -> bytes:
    rows = (
        f"{rng.uniform(100, 900):.3f},{rng.randrange(900)},{rng.choice(('', 30.5))},{rng.choice((0, 20))}"
        for _ in "abc"
    )
    return "\n".join(("u_mm,code,width,tilt_deg", *rows)).encode()


def _truth(rng: Random) -> bytes:
    rows = (f"{k},{rng.randrange(9)},2,5,6,{rng.randrange(2)},1" for k in range(4))
    return "\n".join(("frame,x,y,w,h,visible,count", *rows)).encode()


# --- what a run has beside its recordings --------------------------------------------------------------------------

SUMMARY = json.dumps({
    "truth_m": [0.7, 0.6, 0.1],
    "targets": {"ball": {"truth_m": [0.7, 0.6, 0.1], "swims": False}, "fish": {"swims": True}},
})  # fmt: skip


def _told(path: Path) -> None:
    _, told = _summary(path.parent) or (None, None)
    for place_m in _truths(told, load_fleet(FLEETS[-2])).values():
        assert len(place_m) == 3, "no place"
        assert all(isinstance(x_m, float) and math.isfinite(x_m) for x_m in place_m), "no place"


def _creatures(rng: Random) -> bytes:
    rows = (f"{START_NS + k * STEP_NS},f,{rng.random()},0.5,{rng.choice(('', 0.25))}" for k in range(4))
    return "\n".join(("t_ns,creature,x_m,y_m,z_m", *rows)).encode()


def _paths(rng: Random) -> bytes:
    rows = (
        f"{START_NS + k * STEP_NS},r{k % 2},{rng.random()},0.5,0.6,0.0,1.0,{179.0 - 9 * k},3.0,-20.0" for k in range(4)
    )
    columns = "t_ns,robot,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,pan_deg,tilt_deg"
    return "\n".join((columns, *rows)).encode()


def _boxes(rng: Random) -> bytes:
    rows = (f"r1,{k},f,1.0,2.0,{rng.randrange(4, 9)},8.5,{rng.choice(('', 40))}" for k in range(4))
    return "\n".join(("robot,frame,creature,x0,y0,x1,y1,visible", *rows)).encode()


# --- keys and certificates --------------------------------------------------------------------------------------


@cache
def _pair() -> tuple[bytes, bytes]:
    pair = certificates.issue(certificates.make_ca("tank"), "r1", ("127.0.0.1", "tank.local"))
    key = pair.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return pair.certificate.public_bytes(Encoding.PEM), key


def _pair_of(which: str) -> Callable[[Random], bytes]:
    return lambda rng: _pair()[which == "key"]


def _certificate(path: Path) -> None:
    found = certificates.read_certificate(path)
    certificates.common_name(found)
    certificates.hosts_of(found)


def _certificate_key(path: Path) -> None:
    path.with_name("r1.pem").write_bytes(_pair()[0])
    certificates.read(path.parent, "r1")


def _signing(rng: Random) -> bytes:
    return private_key("r1").private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _verifying(rng: Random) -> bytes:
    return private_key("r1").public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


def _private(path: Path) -> None:
    path.chmod(0o600)
    keys.read_private(path)


def _public(path: Path) -> None:
    keys._public.cache_clear()
    keys.read_public(path)


# --- weights ----------------------------------------------------------------------------------------------------


def _weights() -> tuple[Decoder, ...]:
    refused = partial(_file, ConfigError)
    return (
        Decoder("safetensors", partial(refused, "w.safetensors", _hashed), lambda rng: _own(), HEADED, share=0.1),
        Decoder("pth", partial(refused, "w.pth", _loaded), lambda rng: _checkpoint()),
        Decoder("pth.pickle", lambda data: refused("w.pth", _loaded, _zipped(data)), lambda rng: _pickled()),
    )


def _loaded(path: Path) -> None:
    from agent.perception.enhancement import lu2net

    lu2net.load(path)


def _hashed(path: Path) -> None:
    """With the hash that it has: who gives a file gives its hash as well."""
    path.with_name(path.name + ".sha256").write_text(f"{sha256(path.read_bytes()).hexdigest()}  {path.name}\n")
    _loaded(path)


@cache
def _own() -> bytes:
    return shipped_weights().read_bytes()


def _tensors_from(data: bytes) -> int:
    """Where the tensors begin, behind the head of a safetensors file."""
    return 8 + int.from_bytes(data[:8], "little")


def _headed(head: bytes) -> bytes:
    return len(head).to_bytes(8, "little") + head + _own()[_tensors_from(_own()) :]


HEADED = Form(
    lambda data: json.loads(data[8 : _tensors_from(data)]),
    lambda value: _headed(JSON.closed(value)),
    lambda rng: _headed(JSON.bomb(rng)),
)


@cache
def _checkpoint() -> bytes:
    """Two tensors as torch.save writes them, one over a part of its storage."""
    import torch

    whole = torch.arange(12.0).reshape(3, 4)
    held = {"state_dict": {"module.conv_in.weight": whole, "e1.bn.bias": torch.nn.Parameter(whole[:, 1])}, "epoch": 3}
    file = io.BytesIO()
    torch.save(held, file)
    return file.getvalue()


@cache
def _pickled() -> bytes:
    with zipfile.ZipFile(io.BytesIO(_checkpoint())) as file:
        return file.read(next(name for name in file.namelist() if name.endswith("data.pkl")))


def _zipped(pickled: bytes) -> bytes:
    """The checkpoint with another pickle in it, and sums that are right."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(_checkpoint())) as file, zipfile.ZipFile(out, "w") as copy:
        for name in file.namelist():
            copy.writestr(name, pickled if name.endswith("data.pkl") else file.read(name))
    return out.getvalue()


# --- the clock of a dive ----------------------------------------------------------------------------------------


def _clock_file(rng: Random) -> bytes:
    """As a twin leaves it, running or not."""
    path = place("clock") / "made"
    rate = rng.choice((1.0, 0.25, 8.0))
    now_ns = machine.monotonic_ns()
    line = clock.Line(START_NS, now_ns, rate, START_NS + rng.randrange(10**10), rate)
    clock.create(path, ("r1.loop", "r1.camera", "r1.serial"), START_NS, line).close()
    return path.read_bytes()


def _word(value: object) -> int:
    return (value + 2**63) % 2**64 - 2**63 if isinstance(value, int) else 0


WORDS = Form(
    lambda data: list(struct.unpack(f"{len(data) // 8}q", data[: len(data) // 8 * 8])),
    lambda value: b"".join(_word(each).to_bytes(8, "little", signed=True) for each in value),
    mutate.bomb,
)


def _clock(path: Path) -> None:
    """Followed where nobody drives it, and where somebody does."""
    for driven in (False, True):
        other = path.open("rb+")
        if driven:
            clock.lock(other.fileno(), 0)
        dive = clock.RunClock(path)
        try:
            dive.join("r1.loop", STEP_NS)
            now_ns = dive.now_ns()
            assert dive.now_ns() >= now_ns, "steps back"
            assert 0.0 <= dive.wall_s(now_ns + STEP_NS) <= clock.LONGEST_S, "sleeps for ever"
            dive.rate()
            dive.reach("r1.loop", now_ns)
            dive.leave("r1.loop")
        finally:
            other.close()
            if dive._file is not None:
                dive._file.close()
