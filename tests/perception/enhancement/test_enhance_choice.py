import sys

import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.perception.enhancement import enhance as face

FRAME = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)


def test_without_torch_it_is_the_classic_way_and_says_so(monkeypatch):
    monkeypatch.setattr(face, "find_spec", lambda name: None if name == "torch" else sys)
    way = face.enhancer("auto")
    assert way.variant == "classic" and "pip install" in way.why
    assert way.apply(FRAME).shape == FRAME.shape
    with pytest.raises(ConfigError, match="pip install"):
        face.enhancer("fast")


def test_without_weights_it_is_the_classic_way_and_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr(face, "shipped_weights", lambda: tmp_path / "none.safetensors")
    assert "weights" in face.enhancer("auto").why or "pip" in face.enhancer("auto").why
    with pytest.raises(ConfigError, match=r"--variant plain: .*--variant classic"):
        face.enhancer("plain")


class TestWithTorch:
    torch = None

    @pytest.fixture
    def net(self):
        pytest.importorskip("torch", reason="the network needs torch")
        pytest.importorskip("safetensors")
        from tests.perception.enhancement.random_network import random_network

        return random_network(2)

    def test_folded_and_plain_paint_the_same_picture(self, net):
        plain, quick = (face.network_enhancer(net, variant).apply(FRAME) for variant in ("plain", "folded"))
        assert np.abs(plain.astype(int) - quick).max() <= 1

    @pytest.mark.parametrize(
        ("folded_ms", "fast_ms", "chosen"), [(20, 5, "folded"), (200, 20, "fast"), (900, 90, "classic")]
    )
    def test_the_most_faithful_within_the_budget_is_chosen(self, net, folded_ms, fast_ms, chosen):
        """Time as a list: each try reads the clock before and after."""
        ticks = [t for each in (folded_ms, fast_ms) for k in range(face.TRIALS) for t in (0.0, each / 1e3)]
        way = face.choose(net, 33.0, (48, 64), clock=iter(ticks).__next__)
        assert way.variant == chosen
        assert str(folded_ms) in way.why and (chosen == "folded" or str(fast_ms) in way.why)

    def test_where_nothing_waits_it_is_the_fast_way_on_any_machine(self, net, tmp_path):
        from agent.perception.enhancement.lu2net import save

        save(net, tmp_path / "own.safetensors")
        assert face.enhancer("auto", tmp_path / "own.safetensors", budget_ms=None).variant == "fast"

    def test_weights_with_a_wrong_hash(self, net, tmp_path):
        from agent.perception.enhancement.lu2net import save

        path = tmp_path / "own.safetensors"
        save(net, path)
        assert face.enhancer("plain", path).variant == "plain"
        path.write_bytes(path.read_bytes()[:-1] + b"x")
        with pytest.raises(ConfigError, match="does not match") as caught:
            face.enhancer("auto", path)
        assert "\n" not in str(caught.value)
