"""The table of all claims: which there are, where their code is, and the state of the code that each measures.

A claim below `tests` measures with the tests' own harness, so it runs in a checkout of the repository alone. Nothing
here is heavy: `aucamp --help` reads it.
"""

from __future__ import annotations

import ast
import hashlib
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from agent.core.config import ConfigError

if TYPE_CHECKING:
    from agent.experiments.claim import Claim


class Entry(NamedTuple):
    """Where a claim is, and what it says in one line."""

    module: str  # has the constant CLAIM
    about: str
    group: str  # its heading in docs/research/claims.md
    also: tuple[str, ...] = ()  # files and folders that it runs without importing them
    judged: str = ""  # where docs/outside.md has what programs of others measured of the same


E, B, S = "agent.experiments.", "tests.bench.", "tests.studies."
DEMO, SWIM, FISH, LIGHT = "Finding a target together", "Robots that swim", "Following what swims", "Light"
WRONG, FOCUS, PICTURES, SCENE = "When something is wrong", "Distance from focus", "Pictures", "Surveys and scenes"
OPTICS, HULL, LINKS = "optics", "body-and-the-control-law-on-it", "networks"  # headings of docs/outside.md
BODY, NETWORK, COST = "Body and board", "Networks and people", "What it costs"
SCRIPTS = ("tests/network/scripted_agent.py", "tests/network/watch_states.py")  # processes of claims of networks

# What the study of the board reads and builds; what is recorded and checked.
COUNTED = tuple(f"tests/studies/board/{name}" for name in ("count.c", "heap.txt", "prices.json", "pretended"))
RECORDED = ("agent/fleets", *(f"tests/golden/{dive}" for dive in ("three", "three_evidence", "swim")))

CLAIMS: dict[str, Entry] = {
    "demo": Entry(E + "demo", "robots find a target together, as `aucamp demo` has them", DEMO, ("agent/fleets",)),
    "localization": Entry(E + "localization.localization", "protocols against the Cramer-Rao bound", DEMO),
    "liar": Entry(S + "liar.claim", "how far robots that lie as well as they can move the others", WRONG),
    "doubt": Entry(E + "doubt", "what a fleet notices of what is wrong, and what it says", WRONG),
    "oracles": Entry(B + "bench_oracles", "what robots agree on, beside Stone Soup on the same numbers", WRONG),
    "tag-fix": Entry(E + "navigation.tag_fix", "where a robot is, by the tags of one frame", SWIM),
    "manoeuvres": Entry(E + "navigation.manoeuvres", "one robot holds, goes, turns and orbits", SWIM),
    "around-ball": Entry(E + "navigation.around_ball", "robots cross, and locate a ball", SWIM),
    "search": Entry(E + "navigation.search", "three robots, or one, search a ball", SWIM),
    "hold": Entry(B + "swim.bench_hold", "a robot holds its place by rendered frames", SWIM, ("agent/fleets",)),
    "gyro": Entry(B + "swim.bench_gyro", "yaw held against a pull, with a gyro and without", SWIM),
    "body": Entry(B + "swim.bench_body", "mass, inertia and drag of a robot from a trial", SWIM),
    "following": Entry(E + "following", "a target that swims: robots that share, or are silent", FISH),
    "bearings": Entry(B + "swim.bench_bearings", "a fish by bearings alone", FISH),
    "lighting": Entry(E + "lighting", "lamps lent in the dark: own ones, the rule, the optimum", LIGHT),
    "veil": Entry(S + "veil.claim", "a lamp's veil in twin and kernel, against Monte Carlo", LIGHT, judged=OPTICS),
    "night": Entry(B + "light.bench_night", "robots find a ball by each other's light", LIGHT, ("agent/fleets",)),
    "depth": Entry(E + "depth", "depth of whole views from focus: our peak, the paper's", FOCUS, judged=OPTICS),
    "consistency": Entry(B + "bench_consistency", "whether measurements are as wrong as they say", FOCUS),
    "peak-shift": Entry(B + "pictures.bench_peak_shift", "how far enhancement moves the focus peak", FOCUS),
    "depth-map": Entry(B + "pictures.bench_depth_map", "depth maps of stacks of photographs, by their truth", FOCUS),
    "detection-pictures": Entry(E + "detection_pictures", "balls found in pictures with a truth.csv", PICTURES),
    "eyes": Entry(B + "pictures.bench_eyes", "balls in real pictures, as other cameras would take them", PICTURES),
    "warm": Entry(B + "pictures.bench_warm", "warm colours stay warm when enhanced", PICTURES),
    "track-loss": Entry(B + "pictures.bench_track_loss", "lost is said while a thing in a box is away", PICTURES),
    "landmarks": Entry(B + "bench_landmarks", "how far off the corners of tags are, at each blur", PICTURES),
    "film-of-tags": Entry(B + "bench_survey", "places of a tank's tags from a film of them", PICTURES),
    "coverage": Entry(E + "reconstruction.coverage", "keyframes that robots need which share what they saw", SCENE),
    "survey": Entry(E + "reconstruction.survey", "what three robots that swim know of a floor", SCENE),
    "scenes": Entry(E + "reconstruction.scenes", "surfaces and pictures of scenes from focus sweeps", SCENE),
    "orientation": Entry(E + "orientation", "push and depth step under three control laws", BODY, judged=HULL),
    "board": Entry(S + "board.claim", "what a control cycle takes on the board", BODY, ("hw/firmware", *COUNTED)),
    "swarm": Entry(
        B + "bench_swarm", "twenty agents on one machine; a partition; news in hundreds", NETWORK, SCRIPTS, LINKS
    ),
    "orders": Entry(B + "network.bench_orders", "a person stops three robots, of which one hangs", NETWORK, SCRIPTS),
    "mute": Entry(
        B + "network.bench_mute",
        "links heal after a stop in the middle of a handshake",
        NETWORK,
        ("tests/network/scripted_agent.py",),
    ),
    "page": Entry(B + "network.bench_page", "a page in a browser of five robots", NETWORK),
    "mavproxy": Entry(B + "network.bench_mavproxy", "a ground station that others wrote", NETWORK, SCRIPTS),
    "frames": Entry(B + "bench_frames", "what perception takes of a frame", COST),
    "compiled": Entry(B + "bench_compiled", "what linked functions take of an agent", COST),
    "messages": Entry(B + "bench_messages", "what agreement and signatures take", COST),
    "recording": Entry(B + "bench_recording", "what recording a dive takes, and checking it again", COST, RECORDED),
    "twin": Entry(B + "bench_twin", "what the twin's water, cameras and boards take", COST, ("agent/fleets",)),
}


# Claim and figure, for the README.
HEADLINES = (("demo", "tank_error_percent"), ("demo", "loss30_error_percent"))


def load(module: str) -> Claim:
    """The claim of a module. Raises ConfigError where it is not there, or what it needs is not installed."""
    if path_of(module) is None:
        raise ConfigError(f"{module}: is not installed; run this experiment in a checkout of the repository")
    if module.startswith("tests.") and str(ROOT) not in sys.path:
        sys.path.append(str(ROOT))
    try:
        claim: Claim = import_module(module).CLAIM
    except ModuleNotFoundError as error:
        raise ConfigError(f"{module}: needs {error.name}; pip install 'aucamp[test]'") from None
    return claim


def code_of(name: str) -> str:
    """Hash of what a claim measures, in the state of today."""
    return code_hash(CLAIMS[name].module, CLAIMS[name].also)


# --- the state of the code ---
# A hash of all modules that a claim imports, and of what else it runs. It is found by reading, not by importing: an
# import inside a function counts, as does one of a module that is not installed. Comments and docstrings do not count,
# nor do the words and limits of the claim itself: its CLAIM.

ROOT = Path(__file__).parents[2]  # of a checkout, or where packages are installed
OURS = ("agent", "hw", "replay", "router_config", "tests")
# Modules that start another program: one of ours, and the board's.
STARTS, FIRMWARE = {"agent.process.launch": "agent.__main__"}, {"hw.twin.board": "hw/firmware"}
# What runs claims and writes them down measures nothing.
PLUMBING = frozenset(
    ("agent.cli.experiments", *(f"agent.experiments.{name}" for name in ("claim", "registry", "results", "run_claim")))
)


def code_hash(module: str, also: Sequence[str] = ()) -> str:
    """Of a module and all that it imports; `also`: folders and files below ROOT that it runs without importing."""
    digest = hashlib.sha256()
    waiting, seen = [module], {module}
    files = {path for name in also for path in _below(ROOT / name)}
    while waiting:
        name = waiting.pop()
        if (path := path_of(name)) is None:
            continue
        files.add(path)
        if name in FIRMWARE:
            files |= set(_below(ROOT / FIRMWARE[name]))
        found = (read(path).imports | {STARTS.get(name, name)}) - seen - PLUMBING
        seen |= found
        waiting += found
    for path in sorted(files):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + read(path).digest)
    return digest.hexdigest()[:12]


def path_of(module: str) -> Path | None:
    """The file of one of our modules."""
    plain = ROOT.joinpath(*module.split("."))
    return next((path for path in (plain.with_suffix(".py"), plain / "__init__.py") if path.is_file()), None)


class Read(NamedTuple):
    """What one file has to say."""

    imports: frozenset[str]  # of our modules
    digest: bytes  # of what it does


@cache
def read(path: Path) -> Read:
    """A module by its syntax without docstrings, another file by its bytes."""
    if path.suffix != ".py":
        return Read(frozenset(), hashlib.sha256(path.read_bytes()).digest())
    imports: set[str] = set()
    said: list[str] = []
    waiting: list[Any] = [ast.parse(path.read_bytes())]
    while waiting:  # in the order of the text; ast.dump and two walks take twice as long
        node = waiting.pop()
        if not isinstance(node, ast.AST):
            said.append(repr(node))
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            imports |= _named(node)
        said.append(node.__class__.__name__)
        for name in node._fields:
            part = getattr(node, name, None)
            if isinstance(part, list):
                if name == "body":
                    part = [one for k, one in enumerate(part) if not _says_nothing(one, k)]
                said.append(str(len(part)))
                waiting.extend(reversed(part))
            elif name != "ctx":  # where a name stands says whether it is set
                waiting.append(part)
    ours = (name for name in imports if name.split(".")[0] in OURS and path_of(name) is not None)
    return Read(frozenset(ours), hashlib.sha256("\0".join(said).encode()).digest())


def _named(node: ast.Import | ast.ImportFrom) -> set[str]:
    """What a statement imports; what `from x import y` takes may be a module too."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if not node.module or node.level:
        return set()
    return {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}


def _says_nothing(node: ast.AST, k: int) -> bool:
    """The k-th statement of a body: a docstring, or the claim's own words and limits."""
    return (k == 0 and _is_text(node)) or _is_claim(node)


def _is_claim(node: ast.AST) -> bool:
    return isinstance(node, ast.Assign) and [getattr(target, "id", "") for target in node.targets] == ["CLAIM"]


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _below(path: Path) -> Iterator[Path]:
    """A file, or all files of a folder that Git would keep. Raises FileNotFoundError for neither."""
    if path.is_dir():
        yield from (one for one in path.rglob("*") if one.is_file() and "__pycache__" not in one.parts)
        return
    if not path.is_file():
        raise FileNotFoundError(path)
    yield path
