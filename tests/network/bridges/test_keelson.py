"""`aucamp bridge keelson` over real links and a router of Zenoh, read by the program `zenoh` with keelson's decoder."""

import importlib.util
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("keelson", reason="pip install 'aucamp[keelson]'")

from agent.core.config import Fleet
from agent.ground.bridges.keelson import Keelson
from tests.network.bridges.elsewhere import shown_elsewhere

SUBJECTS = {"roll_deg", "pitch_deg", "yaw_deg", "frame_transform", "vehicle_armed", "vehicle_mode", "image_compressed"}


@pytest.mark.skipif(not importlib.util.find_spec("zenoh_cli"), reason="pip install zenoh-cli")
@pytest.mark.slow
def test_its_own_decoder_reads_ours(make_fleet: Callable[..., Fleet], tmp_path: Path) -> None:
    pair = {"r1": ("r2",), "r2": ("r1",)}
    with shown_elsewhere(make_fleet(pair), tmp_path, Keelson) as port:
        zenoh = [sys.executable, "-u", "-c", "import zenoh_cli; zenoh_cli.main()"]
        command = [*zenoh, "--mode", "client", "--connect", f"tcp/127.0.0.1:{port}"]
        command += ["subscribe", "-k", "test/@v0/**", "--decoder", "keelson-uncover-to-json", "--line", "{key} {value}"]
        read: dict[str, str] = {}
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
            for line in process.stdout:
                key, _, value = line.strip().partition(" ")
                if key.startswith("test/@v0/"):
                    read[key] = value
                if len(read) == 2 * len(SUBJECTS):
                    break
            process.kill()
    assert {(key.split("/")[2], key.split("/")[4]) for key in read} == {(r, s) for r in pair for s in SUBJECTS}
    assert '"value": "ALT_HOLD"' in read["test/@v0/r1/pubsub/vehicle_mode/control"]
    assert '"child_frame_id": "r2"' in read["test/@v0/r2/pubsub/frame_transform/place"]
