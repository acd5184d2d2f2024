"""Where the product reads bytes from outside: found in its syntax tree, so that a new reader is noticed.

A reader is a function that calls a parser, or one that a session or a server calls with what arrives. Each stands in
FUZZED with who fuzzes it, a decoder or a part of `python -m tests.fuzz`, or in SAFE with the reason why nobody does.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tests.places import ROOT

PACKAGES = ("agent", "hw", "replay", "router_config")
PARSERS = frozenset((
    *("json.load", "json.loads", "msgspec.json.decode", "msgspec.yaml.decode", "msgspec.msgpack.decode"),
    *("yaml.parse", "yaml.load", "yaml.safe_load", "tomllib.load", "tomllib.loads", "msgpack.unpackb", "csv.reader"),
    *("msgpack.Unpacker", "pickle.load", "pickle.loads", "csv.DictReader", "zipfile.ZipFile", "tarfile.open"),
    *("mmap.mmap", "numpy.load", "numpy.fromfile", "numpy.frombuffer", "numpy.loadtxt", "torch.load"),
    *("safetensors.torch.load", "cv2.imread", "cv2.imdecode", "cv2.VideoCapture", "cv2.TrackerNano.create"),
    *("cv2.FileStorage", "urllib.parse.urlsplit", "urllib.parse.parse_qs", "struct.unpack", "struct.unpack_from"),
    *(f"agent.core.config.{name}" for name in ("read_toml", "read_text", "read_file", "parse_toml")),
))  # fmt: skip
METHODS = ("unpack", "unpack_from", "recv", "recv_into", "parse_buffer")  # of whatever object
TAKES = ("subscribe", "watch_tokens", "answer", "ask")  # of a session: the handlers behind the key
SERVES = "websockets.asyncio.server.serve"

FUZZED: dict[str, tuple[str, ...]] = {
    # decoders
    "answers": ("agent.ground.console:replied", "agent.ground.doctor_facts:replied"),
    "bench": ("hw.twin.calibration_bench:_answer",),
    "boxes": ("replay.report.creature_track:_true_boxes",),
    "calibration": ("agent.core.ranging.camera_model:load_calibration",),
    "certificate": ("agent.process.certificates:read_certificate",),
    "certificate-key": ("agent.process.certificates:read",),
    "clock": ("agent.clock.clock:ClockFile.__init__", "agent.clock.clock:attach"),
    "codec.State": ("agent.core.codec:decode",),
    "creatures": ("replay.report.creature_track:true_path",),
    "fleet": ("agent.core.config:parse_toml", "agent.robot.fleet_reader:read_fleet"),
    "film": ("hw.camera.files:open_video",),
    "focus": ("agent.core.ranging.camera_model:load_focus",),
    "ignored": ("replay.check.compare:load_ignored",),
    "jpeg": ("hw.camera.v4l2:decode",),
    "key-private": ("agent.process.keys:read_private",),
    "key-public": ("agent.process.keys:_public",),
    "mavlink": ("agent.ground.bridges.mavlink:_arrived",),
    "onnx": ("agent.perception.tracking.follow:load_nano",),
    "orders": ("agent.process.transport:self._box.asked",),
    "page.http": ("agent.ground.page.server:Site.answer", "agent.ground.page.server:site.answer"),
    "page.said": ("agent.ground.page.server:Site._take", "agent.ground.page.server:site.socket"),
    "paths": ("replay.report.creature_track:true_ways",),
    "picture": (
        *(
            f"agent.core.picture_head:{name}"
            for name in (
                "stated_size",
                "_jpeg_size",
                "_png_size",
                "_tiff_size",
                "_webp_size",
                "several",
                "_turned",
                "_tags",
            )
        ),
        "hw.camera.files:_decoded",
        "hw.camera.files:_pixels",
    ),
    "pth": ("agent.perception.enhancement.lu2net:_tensors",),
    "pth.pickle": ("agent.perception.enhancement.lu2net:_Reader.persistent_load",),
    "ranges": ("hw.camera.files:read_rows",),
    "reply": ("hw.camera.frame_socket:parse_reply",),
    "request": ("hw.camera.frame_socket:parse_request",),
    "safetensors": ("agent.perception.enhancement.lu2net:_hashed",),
    "samples": (
        *("agent.ground.console:self._heard", "agent.ground.console:self._token"),
        *("agent.ground.doctor_facts:ears.state", "agent.ground.doctor_facts:ears.token"),
        *("agent.process.transport:self._arrived", "agent.process.transport:self._token"),
        *("replay.recorder:arrivals.stranger", "replay.recorder:arrivals.token"),
        "replay.recorder:partial(arrivals.message, topic)",
    ),
    "scene": ("hw.twin.scene:load_scene",),
    "sessions": ("agent.ground.doctor_facts:_shown",),
    "shown": ("agent.ground.schemas:decode",),
    "stack": ("hw.camera.files:read_rows",),
    "summary": ("replay.report.timeline:_summary",),
    "survey.json": ("agent.capabilities.swim.landmarks:_json", "agent.capabilities.swim.landmarks:_read"),
    "survey.toml": ("agent.capabilities.swim.landmarks:landmarks_of",),
    "survey.yaml": ("agent.capabilities.swim.landmarks:_yaml",),
    "transforms": ("agent.reconstruction.sources:read_transforms",),
    "truth": ("hw.camera.files:read_rows",),
    # parts
    "firmware": ("hw.firmware.tether:Tether._on_frame", "hw.firmware.wire:unpack"),
    "recordings": (
        *(f"replay.check.check:{name}" for name in ("_map", "as_said")),
        *(f"replay.check.compare:{name}" for name in ("_ordinal", "differences", "opened")),
        *(f"replay.check.reexecute:{name}" for name in ("_open_box", "attached_toml")),
        *(
            "replay.export:_unpacked",
            "replay.files.frames:pixels",
            "replay.files.info:_counts",
        ),
        *(
            f"replay.files.mcap_walk:{name}"
            for name in ("Audit.attachment", "_record", "_begins", "message", "opened", "parsed")
        ),
    ),
    "wire": ("hw.stm32.protocol:HostProtocol._on_frame",),
}
SAFE = {  # a module, or one of its readers
    "agent.clock.clock:locked_by_another": "the kernel's answer",
    "agent.demo.demo": "what the twin of this run wrote",
    "agent.experiments": "figures that this checkout measured, and tables of its own data",
    "agent.ground.bridges.mavlink:_dropped": "throws away what it reads",
    "agent.ground.bridges.ros2": "hands on what `codec.Image` has read",
    "agent.ground.check:check": "says what `fleet` says",
    "agent.ground.doctor:_refusal": "looks for a byte, and at none",
    "agent.process.command:with_pictures": "copies bytes",
    "agent.process.transport:came": "reads a key by topics.chunks, as `samples` do",
    "agent.robot.fleet_reader:with_behaviour": "what who starts it types, read as `fleet` is",
    "agent.ground.check:fleet_findings": "looks for words in what `fleet` has read",
    "hw.camera.files:rows": "a part of `ranges`, `stack` and `truth`",
    "agent.tools.focus_calibration:check_file": "looks whether there is a table, by read_toml",
    "agent.tools.tag_map:check_out": "looks whether there is a table, by read_toml",
    "agent.tools.training": "what the same training wrote",
    "agent.tools.training_pairs": "what the same training wrote",
    "agent.tools.training_scenes": "a picture that it made itself",
    "hw.camera.frame_socket": "lengths that `reply` has checked; the twin of the same user",
    "hw.camera.v4l2": "the kernel's structures",
    "hw.camera.v4l2_node": "the kernel's structures",
    "hw.firmware": "the board's own chips and flash",
    "hw.twin.board": "the firmware process that it started, and a table that ships",
    "hw.twin.calibration_bench": "a line until its end; and the answer of a bench of the same user",
    "replay.files.frames:Film.finish": "the film that it has just written",
    "replay.recorder:where_the_layout_is": "compares a file with what it would write",
    "replay.story:_for_programs": "what it has just written",
    "replay.viewers.layout": "ships with the package",
    "router_config": "ships with the package; and the kernel's answers",
}


def safe(reader: str) -> str | None:
    """Why nobody fuzzes it, by the reader or by a module above; None: there is no reason."""
    module, _, _ = reader.partition(":")
    above = (module.rsplit(".", n)[0] for n in range(module.count(".") + 1))
    return next((SAFE[name] for name in (reader, *above) if name in SAFE), None)


def readers() -> set[str]:
    """All of them: module:function, or module:handler as it is handed over."""
    paths = (path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py")))
    return {reader for path in paths for reader in readers_in(path.read_text(encoding="utf-8"), module_of(path))}


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def readers_in(text: str, module: str) -> set[str]:
    tree = ast.parse(text)
    return {f"{module}:{name}" for name in _found(tree, "", dict(_imported(tree)))}


def _imported(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """What names of this file stand for, wherever in it they are imported."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.asname, alias.name) for alias in node.names if alias.asname)
        elif isinstance(node, ast.ImportFrom):
            yield from ((alias.asname or alias.name, f"{node.module}.{alias.name}") for alias in node.names)


def _found(node: ast.AST, where: str, known: dict[str, str]) -> Iterator[str]:
    for child in ast.iter_child_nodes(node):
        named = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        inner = f"{where}.{child.name}".lstrip(".") if named else where  # type: ignore[attr-defined]
        if isinstance(child, ast.Call):
            yield from _call(child, where, known)
        yield from _found(child, inner, known)


def _call(call: ast.Call, where: str, known: dict[str, str]) -> Iterator[str]:
    what = ast.unparse(call.func)
    head, dot, rest = what.partition(".")
    full, last = known.get(head, head) + dot + rest, what.rpartition(".")[2]
    if full in PARSERS or last.startswith("load_pem") or (isinstance(call.func, ast.Attribute) and last in METHODS):
        yield where
    if full == SERVES:
        given = (call.args[0], *(each.value for each in call.keywords if each.arg == "process_request"))
        yield from (ast.unparse(each) for each in given)
    if last in TAKES and what.rpartition(".")[0].endswith("session"):
        yield from (ast.unparse(each) for each in call.args[1:] if last != "ask" or "repl" in ast.unparse(each))
