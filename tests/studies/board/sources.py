"""The firmware as files for the board: which modules, compiled how, and which functions can be told apart."""

from __future__ import annotations

import ast
import hashlib
import re
import subprocess
import tempfile
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from hw import board_files
from tests.studies.board.tools import BoardError

BOARD, COMPUTER = "armv7emsp", "x64"  # what mpy-cross calls them
SHIPPED = 3  # the -O of `make firmware`: no assertions, no line numbers


@dataclass(frozen=True)
class Function:
    """One that is counted by itself."""

    module: str
    owner: str  # class, or ""
    name: str

    @property
    def label(self) -> str:
        return ".".join(filter(None, (self.module, self.owner, self.name)))


@dataclass(frozen=True)
class Compiler:
    """mpy-cross for one machine."""

    path: str
    machine: str
    optimise: int

    def module(self, name: str, text: str) -> dict[str, bytes]:
        """Its .mpy file. Raises BoardError where it does not compile."""
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / (name + ".py")
            source.write_text(text)
            out = source.with_suffix(".mpy")
            options = [f"-O{self.optimise}", f"-march={self.machine}", "-s", source.name]
            command = [self.path, *options, "-o", str(out), str(source)]
            ran = subprocess.run(command, capture_output=True, text=True, check=False)
            if ran.returncode:
                raise BoardError(f"mpy-cross: {source.name}: " + ran.stderr.strip().splitlines()[-1])
            return {out.name: out.read_bytes()}

    def files(self, texts: Mapping[str, str]) -> dict[str, bytes]:
        """The board's flash: modules as .mpy, main.py in two halves as text, as on the board."""
        first, second = split_main(texts["main"])
        out = {"main_a.py": first.encode(), "main_b.py": second.encode()}
        for module, text in texts.items():
            if module != "main":
                out |= self.module(module, text)
        return out

    def size(self, texts: Mapping[str, str]) -> int:
        """Bytes of all .mpy files."""
        return sum(len(data) for name, data in self.files(texts).items() if name.endswith(".mpy"))


def candidates(folder: Path) -> dict[str, str]:
    """Text of main.py and of all that it may import from its folder, by module name, main first."""
    if not (folder / "main.py").is_file():
        raise BoardError(f"{folder} has no main.py: name the folder of the firmware")
    return {name: (folder / f"{name}.py").read_text() for name in ("main", *board_files.modules(folder))}


def digest(folder: Path) -> str:
    """Of all sources that the board may import."""
    texts = candidates(folder)
    return hashlib.sha256("".join(texts[name] for name in sorted(texts)).encode()).hexdigest()[:16]


def split_main(text: str) -> tuple[str, str]:
    """main.py before its `if __name__ ...`, and the body of that: what is defined, and what is done."""
    for node in reversed(ast.parse(text).body):
        if isinstance(node, ast.If) and "__name__" in ast.dump(node.test):
            lines = text.splitlines(keepends=True)
            body = "".join(lines[node.body[0].lineno - 1 : node.body[-1].end_lineno])
            return "".join(lines[: node.lineno - 1]), textwrap.dedent(body)
    return "", text


def with_native(texts: Mapping[str, str], names: list[str]) -> dict[str, str]:
    """The same with @micropython.native before functions module.name, module.Class.name; the last may end in *."""
    out = dict(texts)
    for wanted in names:
        module = wanted.split(".")[0]
        stem = wanted.removesuffix("*")
        chosen = [
            node
            for function, node in _functions(module, ast.parse(out.get(module, "")))
            if function.label == wanted or (stem != wanted and function.label.startswith(stem))
        ]
        if not chosen:
            raise BoardError(f"no function {wanted} in the firmware")
        lines = out[module].splitlines(keepends=True)
        for node in sorted(chosen, key=lambda node: -node.lineno):
            if not node.decorator_list:
                lines.insert(node.lineno - 1, " " * node.col_offset + "@micropython.native\n")
        out[module] = "".join(lines)
    return out


def without_native(texts: Mapping[str, str]) -> dict[str, str]:
    """The same with nothing in the functions that are compiled to machine code."""
    out = {}
    for module, text in texts.items():
        tree = ast.parse(text)
        for _, node in _functions(module, tree):
            if any(re.search(r"'(native|viper)'", ast.dump(decorator)) for decorator in node.decorator_list):
                node.body, node.decorator_list, node.returns = [ast.Pass()], [], None
                for argument in node.args.args:
                    argument.annotation = None
        changed = any("native" in line or "viper" in line for line in text.splitlines())
        out[module] = ast.unparse(tree) if changed else text
    return out


def functions(texts: Mapping[str, str]) -> list[Function]:
    """All functions and methods whose entry the interpreter shows: no generators, none that is decorated away."""
    found = []
    for module, text in texts.items():
        for function, node in _functions(module, ast.parse(text)):
            yields = any(isinstance(inner, ast.Yield | ast.YieldFrom) for inner in ast.walk(node))
            odd = any("micropython" not in ast.dump(decorator) for decorator in node.decorator_list)
            if not (yields or odd or function.name.startswith("__")):
                found.append(function)
    return found


def _functions(module: str, tree: ast.Module) -> Iterator[tuple[Function, ast.FunctionDef]]:
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            yield Function(module, "", node.name), node
        elif isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, ast.FunctionDef):
                    yield Function(module, node.name, inner.name), inner
