"""The state of the code that a claim measures: a hash of all modules that it imports, and of what else it runs.

Found by reading, not by importing: an import inside a function counts, as does one of a module that is not installed.
Comments and docstrings do not count, nor do the words and limits of the claim itself: its CLAIM.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]  # of a checkout, or where packages are installed
OURS = ("agent", "hw", "replay", "router_config", "tests")
# Modules that start another program: one of ours, and the board's.
STARTS, FIRMWARE = {"agent.process.launch": "agent.__main__"}, {"hw.twin.board": "hw/firmware"}
# What runs claims and writes them down measures nothing.
PLUMBING = frozenset(f"agent.experiments.{name}" for name in ("claim", "code_state", "pages", "registry", "run_claim"))


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
    tree = ast.parse(path.read_bytes())
    imports = imported(tree)
    tree.body = [node for node in tree.body if not _is_claim(node)]
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list) and body and _is_text(body[0]):
            body[0] = ast.Pass()
    return Read(imports, hashlib.sha256(ast.dump(tree).encode()).digest())


def imported(tree: ast.Module) -> frozenset[str]:
    """Our modules that a file imports; what `from x import y` takes may be a module too."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(name for name in found if name.split(".")[0] in OURS and path_of(name) is not None)


def _is_claim(node: ast.stmt) -> bool:
    return isinstance(node, ast.Assign) and [ast.unparse(target) for target in node.targets] == ["CLAIM"]


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
