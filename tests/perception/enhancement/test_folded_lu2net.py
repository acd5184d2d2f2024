import pytest

torch = pytest.importorskip("torch", reason="the network needs torch")
pytest.importorskip("safetensors")

from agent.perception.enhancement import lu2net  # noqa: E402
from tests.perception.enhancement.random_network import random_network  # noqa: E402


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size", [(64, 96), (61, 83), (1, 1), (3, 130), (240, 322)])
def test_folded_equals_plain(seed, size):
    net = random_network(seed)
    x = torch.rand(1, 3, *size, generator=torch.Generator().manual_seed(seed))
    with torch.inference_mode():
        plain = net(x)
    quick = lu2net.forward(lu2net.fold(net), x)
    assert quick.shape == plain.shape
    assert plain.std() > 1e-3 or size == (1, 1)  # else there is nothing to compare
    assert (quick - plain).abs().max() < 1e-5 * max(1.0, float(plain.abs().max()))


def test_bands_hold_all_rows_once():
    for height, values in [(4, 10**9), (480, 64 * 640), (100, 1), (6, 60_000)]:
        rows = [row for top, bottom in lu2net.bands(height, values) for row in range(top, bottom)]
        assert rows == list(range(height))
        assert all(top % 2 == 0 and bottom % 2 == 0 for top, bottom in lu2net.bands(height, values))


def test_folding_leaves_the_network_alone():
    net = random_network(1)
    before = {name: tensor.clone() for name, tensor in net.state_dict().items()}
    lu2net.fold(net)
    assert all(torch.equal(before[name], tensor) for name, tensor in net.state_dict().items())
