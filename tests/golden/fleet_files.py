"""What the kernel says of fleet files and calibrations: a row a file, sound or wrong, in fleet_files.jsonl.

A replay reads the fleet file that is in the recording, and that is sound already. Here each fleet that ships is read,
and copies of them with mistakes in them; all the rules that a copy breaks are listed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from agent.core.config import ConfigError, dump
from agent.core.ranging.camera_model import load_calibration, load_focus
from agent.core.trust import common
from agent.robot.fleet_reader import broken_rules, load_fleet, load_robot, read_fleet, two_worlds, with_behaviour
from tests.network.scripted_agent import CALIBRATION
from tests.places import GOLDEN, ROOT

FLEETS = ROOT / "agent" / "fleets"
FILE = GOLDEN / "fleet_files.jsonl"

# Copies of a fleet: its name, and texts with what stands there instead.
WRONG: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
    ("tank", (("[tank]", "[tank"),)),
    ("tank", (("radius_m = 0.07", "radius_m = 0.07\nshape = 'round'"),)),
    ("tank", (("radius_m = 0.07", "radius_m = 'big'"),)),
    ("tank", (("radius_m = 0.07", "radius_m = 0.07\ncolour = 'blue'"),)),
    ("tank", (('fleet = "tank"', ""),)),
    ("tank", (("[robot.r5]", "[robot.R5]"),)),
    ("tank", (("x_m = 1.25", "x_m = inf"), ("surface_m = 0.5", "surface_m = 5.0"), ("127.0.0.1:17402", "nowhere"))),
    (
        "tank",
        (
            ('neighbours = ["r2", "r3", "r4", "r5"]', 'neighbours = ["r1", "r9", "r9"]'),
            ("radius_m = 0.07", "radius_m = 70.0\nspeed_m_s = 0.1"),
            ("pan_deg = -60.0", "pan_deg = -160.0"),
            ("x_m = 1.25", "x_m = 125.0"),
            ("127.0.0.1:17401", "0.0.0.0:17401"),
            ("127.0.0.1:17403", "127.0.0.1:40000"),
            ('camera = "twin:r2"', 'camera = "twin:r1"'),
            ('serial = "twin:r1"', 'serial = "twin:r1"\nlamp = true\ndepth_m = 0.9\nbehaviour = { kind = "hold" }'),
            ("[estimation]", "[link]\nsend_hz = 1\n[body]\ntilt_limit_deg = [30, -60]\n[coverage]\n[estimation]"),
        ),
    ),
    (
        "tank",
        (
            ("127.0.0.1:17402", "127.0.0.1:17401"),
            ("tcp/127.0.0.1:17403", "tls/[::1]:17403"),
            ("[estimation]", "[access]\nkeys = ''\nconsoles = ['ca', 'r1', 'ann']\n[estimation]"),
            ("radius_m = 0.07", "radius_m = 0.07\n[target.fish]\nradius_m = 0.1\ncolour = 'orange'"),
            ('serial = "twin:r4"', 'serial = "/dev/ttyACM0"'),
        ),
    ),
    ("tank", (("[estimation]", "[budget]\nlevel_m = 0.003\n[estimation]"),)),
    ("tank", (("[estimation]", "[budget]\nlevel_m = -1\n[estimation]"),)),
    ("tank", (("tcp/", "tls/"),)),
    ("tank", (('detector = "ball"\nradius_m = 0.07', 'detector = "box"\nbox = [1, 2, 30, 0]\ncolour = "red"'),)),
    ("tank", (("radius_m = 0.07", "radius_m = 0.07\npicture = 'x.png'\nmodels = 'nano'"),)),
    ("tank", (("radius_m = 0.07", "radius_m = 0.07\npicture = 'x.png'\nbox = [1, 2, 3, 4]\ncolour = 'red'"),)),
    ("night", (("lamp = true", "lamp = false"),)),
    ("night", (("[lighting]", "[lighting]\nguard_s = 0.05"), ('"r2", ', ""))),
    ("survey", (('kind = "survey"', 'kind = "hold"'),)),
    (
        "swim",
        (
            ("y_m = 0.50", "y_m = 0.05"),
            ("x_m = 2.40", "x_m = 0.80"),
            ("{ id = 3, ", "{ id = 2, "),
            ("[0.70, 0.30, 0.00]", "[0.32, 0.30, 0.00]"),
            ("[0.70, 0.70, 0.00]", "[0.70, 0.70, 0.10]"),
            ("[0.70, 1.30, 0.00]", "[0.01, 1.30, 0.00]"),
            ("[0.00, 0.62, 0.20]", "[0.00, 0.62, 0.48]"),
        ),
    ),
    *(
        ("swim", (('calibration = "r1.toml"', f'calibration = "r1.toml"\nbehaviour = {{ {behaviour} }}'),))
        for behaviour in (
            'kind = "goto", x_m = 1.0, y_m = 1.0, depth_m = 0.9',
            'kind = "goto", x_m = 0.1, y_m = 1.0',
            'kind = "follow", target = "wreck", standoff_m = 0.5',
            'kind = "follow", target = "ball", standoff_m = 5.0',
            'kind = "orbit", x_m = 1.5, y_m = 1.0, radius_m = 0.4, speed_m_s = 2.0',
            'kind = "orbit", x_m = 1.5, y_m = 1.0, radius_m = 0.9',
            'kind = "trial", x_m = 1.5, y_m = 1.0, half_m = 1.4',
            'kind = "survey"',
            'kind = "fly"',
        )
    ),
)
UNREADABLE = {
    "nested": f"a = {'[' * 60}{']' * 60}",
    "digits": f"fleet = {'1' * 5000}",
    "large": "#" * (2**20 + 1),
    "strange names": "[\"a'b\\n\"]\nfleet = 'tank'",
}
BEHAVIOURS = ('{ kind = "hold" }', "{", '{ kind = "fly" }', '{ kind = "goto", x_m = 0.0, y_m = 1.0 }')
TAG = "{{id: {0}, size: 0.08, x: 0.7, y: {1}, z: {2}, qw: {3}, qx: 0.0, qy: 0.0, qz: 0.0}}"
POSE = '{{"ID": {0}, "pose": {{"translation": {{"x": 0.7, {1}"z": 0.0}}, "rotation": {{"quaternion": {2}}}}}}}'
LYING = '{"W": 0.5, "X": -0.5, "Y": -0.5, "Z": -0.5}'  # on the floor


def bundle(*tags: str) -> str:
    return f"tag_bundles: [{{layout: [{', '.join(tags)}]}}]"


def field(*tags: str) -> str:
    return f'{{"tags": [{", ".join(tags)}]}}'


# Tags in a file of their own: its name, its text, and what stands beside `file` in [landmarks].
LAYOUTS = (
    ("t.toml", "[landmarks]\nsize_m = 0.08\ntag = [{id = 7, face = 'y0', position_m = [0.4, 0.0, 0.2]}]", ""),
    ("t.yaml", bundle(TAG.format(1, 0.4, 0.0, 1.0), TAG.format(2, 0.8, 0.0, 1.0)), ""),
    ("t.yaml", bundle(TAG.format(1, 0.4, 0.3, 1.0)), ""),
    ("t.yaml", bundle(TAG.format(1, 0.4, 0.0, 3.0)), ""),
    ("t.yaml", bundle(TAG.format(600, 0.4, 0.0, 1.0)), ""),
    ("t.yaml", bundle(TAG.format(1, 0.4, 0.0, 1.0)), "size_m = 0.1"),
    ("t.yaml", bundle(TAG.format(1, 0.4, 0.0, 1.0), TAG.format(2, 0.8, 0.0, 1.0).replace("0.08", "0.1")), ""),
    ("t.yaml", "tag_bundles: []", ""),
    ("t.yaml", "a: [", ""),
    ("t.json", field(POSE.format(3, '"y": 0.6, ', LYING)), "size_m = 0.08\nsigma_deg = 0.3"),
    ("t.json", field(POSE.format(3, '"y": 0.6, ', LYING)), ""),
    ("t.json", field(POSE.format(3, "", LYING)), "size_m = 0.08"),
    ("t.csv", "", ""),
)


def rows() -> Iterator[dict[str, object]]:
    """Each file, and what is said of it."""
    for path in sorted(FLEETS.glob("*.toml")):
        yield {"file": path.name, "says": said(path), "digest": common(load_fleet(path))}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "fleet.toml"
        for name, changes in WRONG:
            text = (FLEETS / f"{name}.toml").read_text()
            for old, new in changes:
                assert old in text, f"{name}.toml has no {old}"
                text = text.replace(old, new)
            path.write_text(text)
            yield {"file": name, "with": changes, "says": said(path)}
        tank = dump(load_fleet(FLEETS / "tank.toml"))
        for name, text, beside in LAYOUTS:
            (path.parent / name).write_text(text)
            path.write_text(f'{tank}\n[landmarks]\nfile = "{name}"\n{beside}\n')
            yield {"file": name, "with": [text, beside], "says": said(path)}
        yield {"file": "none", "says": said(path.parent / "none.toml")}
        path.write_bytes(b"\xff\xff")
        yield {"file": "no text", "says": said(path)}
        for what, text in UNREADABLE.items():
            path.write_text(text)
            yield {"file": what, "says": said(path)}
        yield {"file": "a name that is none", "says": outcome(lambda: dump(read_fleet(Path("\0"))))}
        path.unlink()
        path.mkdir()
        yield {"file": "a folder", "says": said(path)}
    swim = load_fleet(FLEETS / "swim.toml")
    for behaviour in BEHAVIOURS:
        yield {"behaviour": behaviour, "says": outcome(lambda text=behaviour: dump(with_behaviour(swim, "r1", text)))}
    yield {"robot": "r9", "says": outcome(lambda: dump(load_robot(swim, "r9", Path("swim.toml"))))}
    yield from calibrations()


def calibrations() -> Iterator[dict[str, object]]:
    """A calibration file: whole, and without each of its tables."""
    for lacking in ("", "focus", "camera"):
        with TemporaryDirectory() as folder:
            path = Path(folder) / "r1.toml"
            path.write_text(dump(CALIBRATION).replace(f"[{lacking}]", "[other]"))
            yield {
                "calibration without": lacking,
                "says": [about(path, load_calibration), about(path, lambda path: load_focus(path)[0])],
            }


def said(path: Path) -> list[str]:
    """What a fleet file is, or what is wrong with it: all rules that it breaks; the reader stops at the first."""
    try:
        fleet = read_fleet(path)
    except ConfigError as error:
        return [without_folder(str(error), path)]
    broken = [f"{key}: {remedy}" for key, remedy in broken_rules(fleet)]
    return [*broken, about(path, load_fleet), two_worlds(fleet) or "one world"]


def about(path: Path, load: Callable[[Path], msgspec.Struct]) -> str:
    """The digest of what is read from a file, or why nothing is; wherever its folder is."""
    return outcome(lambda: without_folder(dump(load(path)), path), path)


def outcome(text: Callable[[], str], path: Path = Path("nowhere")) -> str:
    """The digest of a text, or why there is none."""
    try:
        return hashlib.sha256(text().encode()).hexdigest()
    except ConfigError as error:
        return without_folder(str(error), path)


def without_folder(text: str, path: Path) -> str:
    return text.replace(f"{path.parent}/", "").replace(path.parent.name, "folder") if path.parent.name else text


def lines() -> list[str]:
    """Of the file."""
    return [json.dumps(row) for row in rows()]


def write(file: Path = FILE) -> None:
    file.write_text("\n".join(lines()) + "\n")
