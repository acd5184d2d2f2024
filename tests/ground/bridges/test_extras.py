"""Without the package that speaks the other language: one line that says which extra brings it."""

import sys

import pytest
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import ConfigError
from tests.places import ROOT

TANK = ROOT / "agent" / "fleets" / "tank.toml"


NEEDS = [("mavlink", "pymavlink", "mavlink"), ("ros2", "rosbags", "ros"), ("keelson", "keelson", "keelson")]


@pytest.mark.parametrize(("kind", "package", "extra"), NEEDS)
def test_a_bridge_says_what_it_needs(kind: str, package: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(sys.modules):
        if name.partition(".")[0] == package or name.startswith(f"agent.ground.bridges.{kind}"):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    done = CliRunner().invoke(app, ["bridge", kind, str(TANK)])
    assert isinstance(done.exception, ConfigError)
    assert f"needs the extra `{extra}`; in your clone: pip install -e '.[{extra}]'" in str(done.exception)
