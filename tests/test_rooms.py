"""Order of the house: how large files are, how many there are, and that imports run one way."""

import ast
import graphlib
import re
import tomllib

import grimp
import pytest

from tests.places import ROOT

PACKAGES = ("agent", "hw", "replay", "router_config")
PRODUCT = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
LINES_IN_A_FILE = 600
PRODUCT_FILES = 300
SMALL_LINES = 60
# A file of its own for less than that is a seam: other code, or another interpreter, takes it alone.
SMALL = {
    "hw/board_files.py": "a program: python -m hw.board_files",
}
BOARD = "hw/firmware/"  # MicroPython finds modules beside main.py, and loads one at a time into little memory
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]


def lines(paths: list) -> dict[str, int]:
    return {path.relative_to(ROOT).as_posix(): len(path.read_text().splitlines()) for path in paths}


def test_no_file_is_too_long_to_be_read_in_one_go() -> None:
    assert not {name: count for name, count in lines([*PRODUCT, *TESTS]).items() if count > LINES_IN_A_FILE}


def test_the_product_is_no_more_files_than_somebody_can_know() -> None:
    assert 200 < len(PRODUCT) <= PRODUCT_FILES


def test_a_small_file_has_a_reason() -> None:
    small = {
        name
        for name, count in lines(PRODUCT).items()
        if count < SMALL_LINES and not name.endswith("__init__.py") and not name.startswith(BOARD)
    }
    assert small == set(SMALL)


KERNEL = ("agent/core", "agent/capabilities", "agent/robot")


def test_no_object_of_the_kernel_writes_into_another() -> None:
    """An attribute is assigned or deleted through `self` alone."""
    found = []
    for path in (path for room in KERNEL for path in sorted((ROOT / room).rglob("*.py"))):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store | ast.Del):
                own = isinstance(node.value, ast.Name) and node.value.id == "self"
                found += [] if own else [f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}"]
    assert not found


def test_the_step_knows_no_capability_by_name() -> None:
    """It knows the protocols of core, and what a robot has beside capabilities; and it is short."""
    lines = (ROOT / "agent/robot/step.py").read_text().splitlines()
    assert len(lines) <= 150
    assert not [line for line in lines if "agent.capabilities" in line]


def test_no_files_import_each_other_in_a_circle() -> None:
    """Import-linter sees circles among the folders and files of one folder only; this sees all."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert any(name.startswith("hw.") for of in imports.values() for name in of)
    assert not circle(imports), "each of these files is imported by the next"


def circle(imports: dict[str, set[str]]) -> list[str]:
    """One circle; empty if there is none."""
    try:
        graphlib.TopologicalSorter(imports).prepare()
    except graphlib.CycleError as error:
        return error.args[1]
    return []


@pytest.mark.parametrize("contract", CONTRACTS, ids=lambda contract: contract["name"])
def test_contracts_name_folders_and_no_files(contract: dict) -> None:
    """A folder's contract holds for what will be put there; a list of files forgets the next one."""
    named = {name for key, value in contract.items() if isinstance(value, list) for name in value}
    modules = {module.removesuffix(".**") for name in named for module in name.split(" -> ")}
    ours = [module for module in modules if module.split(".")[0] in PACKAGES]
    assert ours
    assert not [module for module in ours if not (ROOT / module.replace(".", "/")).is_dir()]


def test_the_map_names_no_folder_that_is_gone() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    paths = set(re.findall(r"`((?:agent|hw|replay|router_config)(?:/\w+)*)`", page))
    assert len(paths) > 10
    assert not [path for path in paths if not (ROOT / path).is_dir()]
