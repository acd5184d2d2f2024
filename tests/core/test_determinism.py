"""A rule of the kernel that no linter knows: its algebra stays off BLAS, its loops off the order of sets."""

import ast
from pathlib import Path

import pytest

from tests.places import ROOT

FOLDERS = ("core", "capabilities", "robot")
KERNEL = sorted(path for folder in FOLDERS for path in (ROOT / "agent" / folder).rglob("*.py"))
BLAS = {"dot", "matmul", "linalg", "vdot", "inner", "tensordot", "random"}


@pytest.mark.parametrize("path", KERNEL, ids=lambda p: p.name)
def test_kernel_stays_off_blas_and_off_hash_order(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        where = f"{path}:{getattr(node, 'lineno', 0)}"
        assert not isinstance(node, ast.MatMult), f"{where}: @ calls BLAS, whose bits differ between processors"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("np", "numpy"):
            assert node.attr not in BLAS, f"{where}: np.{node.attr}"
        if isinstance(node, ast.For | ast.comprehension):
            assert not isinstance(node.iter, ast.Set | ast.SetComp), f"{where}: the order of a set is not fixed"
