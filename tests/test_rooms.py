"""Order of the house: rooms and files stay small, imports run one way, and contracts speak of rooms."""

import graphlib
import re
import tomllib

import grimp
import pytest

from tests.places import ROOT

PACKAGES = ("agent", "hw", "replay", "router_config")
SOURCES = sorted(path for room in (*PACKAGES, "tests") for path in (ROOT / room).rglob("*.py"))
FILES_IN_A_ROOM = 20
# MicroPython finds modules beside main.py, and the board's flash is one folder.
ROOMIER = {"hw/firmware": 28}
LINES_IN_A_FILE = 300
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]


def test_no_room_has_more_files_than_the_eye_takes_in() -> None:
    rooms = [path.parent.relative_to(ROOT) for path in SOURCES]
    counts = {str(room): rooms.count(room) for room in set(rooms)}
    assert not {room: n for room, n in counts.items() if n > ROOMIER.get(room, FILES_IN_A_ROOM)}


def test_no_file_is_longer_than_one_idea() -> None:
    lines = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in SOURCES}
    assert len(lines) > 400
    assert not {name: count for name, count in lines.items() if count > LINES_IN_A_FILE}


def test_no_files_import_each_other_in_a_circle() -> None:
    """Import-linter sees circles among the rooms and files of one folder only; this sees all."""
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
def test_contracts_name_rooms_and_no_files(contract: dict) -> None:
    """A room's contract holds for what will be put there; a list of files forgets the next one."""
    named = {name for key, value in contract.items() if isinstance(value, list) for name in value}
    modules = {module.removesuffix(".**") for name in named for module in name.split(" -> ")}
    ours = [module for module in modules if module.split(".")[0] in PACKAGES]
    assert ours
    assert not [module for module in ours if not (ROOT / module.replace(".", "/")).is_dir()]


def test_the_map_names_no_room_that_is_gone() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    paths = set(re.findall(r"`((?:agent|hw|replay|router_config)(?:/\w+)*)`", page))
    assert len(paths) > 10
    assert not [path for path in paths if not (ROOT / path).is_dir()]
