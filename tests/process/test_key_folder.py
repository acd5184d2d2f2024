"""A folder of public keys under the eyes of a diving robot: what is a change, and what is an accident."""

import shutil
from pathlib import Path

import pytest

from agent.ground.new_fleet import make_keys
from agent.process import keys as key_folder
from agent.process.keys import KeyFolder, read_public

ROBOTS = ("r1", "r2", "r3")
SECOND_NS = 1_000_000_000


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    make_keys(ROBOTS, tmp_path / "keys")
    return tmp_path / "keys"


def public(folder: Path, *names: str) -> dict[str, bytes]:
    return {name: read_public(folder / f"{name}.sign.pub") for name in names}


def test_all_at_first_then_nothing_until_one_goes_and_all_that_are_left_then(keys: Path) -> None:
    watched, everybody = KeyFolder(keys, ROBOTS), public(keys, *ROBOTS)
    assert watched.changed(0) == everybody
    assert watched.changed(SECOND_NS) is None
    (keys / "r2.sign.pub").unlink()
    assert watched.changed(2 * SECOND_NS) == public(keys, "r1", "r3")
    assert watched.changed(3 * SECOND_NS) is None
    make_keys(["r2"], keys.parent / "new")
    shutil.copy(keys.parent / "new" / "r2.sign.pub", keys)
    renewed = watched.changed(4 * SECOND_NS)
    assert renewed == {**everybody, **public(keys, "r2")} != everybody


def test_none_left_is_an_answer_too(keys: Path) -> None:
    watched = KeyFolder(keys, ROBOTS)
    watched.changed(0)
    for name in ROBOTS:
        (keys / f"{name}.sign.pub").unlink()
    assert watched.changed(SECOND_NS) == {}


def test_it_looks_once_a_second_however_often_it_is_asked(keys: Path, monkeypatch) -> None:
    looked_ns = []
    now_ns = 0

    def noting(folder, robots):
        looked_ns.append(now_ns)
        return real(folder, robots)

    real = key_folder.read_keys
    monkeypatch.setattr(key_folder, "read_keys", noting)
    watched = KeyFolder(keys, ROBOTS)
    for now_ns in range(0, 5 * SECOND_NS, SECOND_NS // 20):
        watched.changed(now_ns)
    assert looked_ns == [k * SECOND_NS for k in range(5)]


def test_a_key_that_is_missing_is_a_fault_without_a_path_of_this_machine(keys: Path) -> None:
    (keys / "r3.sign.pub").unlink()
    watched = KeyFolder(keys, ROBOTS)
    assert watched.changed(0) == public(keys, "r1", "r2")
    assert watched.fault == "nothing of r3 is believed without r3.sign.pub"
    shutil.copy(keys / "r2.sign.pub", keys / "r3.sign.pub")  # a slip
    assert watched.changed(SECOND_NS) is None
    assert watched.fault == "r3.sign.pub: the same key as r2.sign.pub; give each robot its own"
    make_keys(["r3"], keys.parent / "new")
    shutil.copy(keys.parent / "new" / "r3.sign.pub", keys)
    assert watched.changed(2 * SECOND_NS) == public(keys, *ROBOTS)
    assert watched.fault is None


def test_a_half_copied_key_withdraws_nothing(keys: Path) -> None:
    watched = KeyFolder(keys, ROBOTS)
    everybody = watched.changed(0)
    whole = (keys / "r2.sign.pub").read_bytes()
    for k, part in enumerate((b"", whole[:50]), start=1):
        (keys / "r2.sign.pub").write_bytes(part)
        assert watched.changed(k * SECOND_NS) is None
        assert watched.fault == "r2.sign.pub: no public key in PEM; copy the file again, whole"
    (keys / "r2.sign.pub").write_bytes(whole)
    assert watched.changed(3 * SECOND_NS) is None and watched.fault is None
    (keys / "r2.sign.pub").unlink()
    assert watched.changed(4 * SECOND_NS) == {name: everybody[name] for name in ("r1", "r3")}


def test_a_folder_that_is_gone_withdraws_nothing_and_is_told(keys: Path) -> None:
    watched = KeyFolder(keys, ROBOTS)
    watched.changed(0)
    keys.rename(keys.with_name("away"))
    assert watched.changed(SECOND_NS) is None
    assert watched.fault == "their folder cannot be read; those read before are kept"
    keys.with_name("away").rename(keys)
    assert watched.changed(2 * SECOND_NS) is None and watched.fault is None


def test_keys_of_strangers_are_none_of_its_business(keys: Path) -> None:
    make_keys(["r9"], keys)
    (keys / "notes.txt").write_text("r9 comes on Monday")
    watched = KeyFolder(keys, ROBOTS)
    assert watched.changed(0) == public(keys, *ROBOTS) and watched.fault is None
