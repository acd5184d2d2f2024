from itertools import islice

import numpy as np
import pytest

from agent.core.config import ConfigError

torch = pytest.importorskip("torch", reason="the extra `enhance` is not installed")

from agent.perception.enhancement import lu2net  # noqa: E402
from agent.perception.enhancement.enhance import white_balance  # noqa: E402
from agent.perception.enhancement.lu2net import LU2Net  # noqa: E402
from agent.tools.evaluate_enhance import kept_warm  # noqa: E402
from tests.bench.pictures import bench_warm  # noqa: E402


@pytest.fixture(scope="module")
def net() -> LU2Net:
    torch.manual_seed(0)
    return LU2Net().eval()


def picture(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_it_has_the_published_number_of_parameters(net):
    assert sum(parameter.numel() for parameter in net.parameters()) == 175_571


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 2), (37, 50), (64, 48)])
def test_any_size_goes_in_and_comes_out(net, height, width):
    image = picture(height, width)
    out = lu2net.run(net, image)
    assert out.shape == image.shape and out.dtype == np.uint8


def test_padding_repeats_the_border(net):
    x = torch.rand(1, 3, 6, 9)
    by_hand = torch.nn.functional.pad(x, (0, 3, 0, 2), mode="replicate")
    with torch.inference_mode():
        assert torch.equal(net(x), net(by_hand)[:, :, :6, :9])


def test_outside_is_blue_green_red_and_inside_is_red_green_blue():
    image = np.zeros((2, 2, 3), np.uint8)
    image[:, :, 0] = 255  # blue
    tensor = lu2net.to_tensor(image)
    assert tensor[0, :, 0, 0].tolist() == [0.0, 0.0, 1.0]
    assert np.array_equal(lu2net.to_image(tensor), image)


def test_attention_is_the_only_thing_that_sees_beyond_its_neighbourhood(net):
    """Gains held, a far pixel changes nothing: the convolutions reach less than 64 pixels."""
    x = torch.rand(1, 3, 8, 256)
    far = x.clone()
    far[:, :, :, -4:] = 0
    with torch.inference_mode():
        assert not torch.equal(net(x)[:, :, :, :64], net(far)[:, :, :, :64])
        held = LU2Net().eval()
        for module in held.modules():
            if isinstance(module, lu2net.ChannelAttention):
                torch.nn.init.zeros_(module.excite.weight)  # sigmoid(0): every gain 1/2
        assert torch.equal(held(x)[:, :, :, :64], held(far)[:, :, :, :64])


def test_weights_survive_the_file(net, tmp_path):
    file = tmp_path / "weights.safetensors"
    lu2net.save(net, file)
    assert np.array_equal(lu2net.run(lu2net.load(file), picture(20, 24)), lu2net.run(net, picture(20, 24)))
    assert file.stat().st_size < 1_000_000


def test_wrong_weights_are_one_line(net, tmp_path):
    file = tmp_path / "weights.safetensors"
    with pytest.raises(ConfigError, match="no such file"):
        lu2net.load(file)
    lu2net.save(net, file)
    file.write_bytes(file.read_bytes()[:-1] + b"\x01")
    with pytest.raises(ConfigError, match="does not match"):
        lu2net.load(file)


def test_weights_of_another_network_are_one_line(tmp_path):
    import hashlib

    from safetensors.torch import save as save_tensors

    file = tmp_path / "other.safetensors"
    file.write_bytes(save_tensors({"last.weight": torch.zeros(3, 4)}))
    lu2net.hash_file(file).write_text(hashlib.sha256(file.read_bytes()).hexdigest())
    with pytest.raises(ConfigError, match="not the weights of this network"):
        lu2net.load(file)


@pytest.mark.parametrize("name", ["own", "real"])
def test_shipped_weights_bring_new_pictures_closer_to_their_targets_and_keep_what_is_warm(name):
    from agent.perception.enhancement.enhance import WEIGHTS
    from agent.tools.evaluate_enhance import kept_hue, psnr
    from agent.tools.training_scenes import landscape, pair, with_things

    file = WEIGHTS / f"{name}.safetensors"
    assert file.stat().st_size < 1_000_000
    net = lu2net.load(file)
    gains, warm = [], []
    for seed in range(6):
        rng = np.random.default_rng([12345, seed])
        picture, z, vivid = with_things(*landscape(96, rng), rng)
        raw, target = pair(picture, z, rng, vivid)
        out = lu2net.run(net, raw)
        gains.append(psnr(out, target) - psnr(raw, target))
        warm.append(kept_hue(out, target))
    assert np.mean(gains) > 2  # dB
    assert sum(k.kept for k in warm) > 0.5 * sum(k.pixels for k in warm)


@pytest.mark.skipif(not bench_warm.BALLS.is_dir(), reason="the real pictures of balls are absent (AUCAMP_DATA)")
def test_real_buoys_stay_warm():
    from agent.perception.enhancement.enhance import enhancer

    apply, found = enhancer("fast").apply, []
    for image, discs in islice(bench_warm.balls(bench_warm.BALLS), 36, None, 5):  # the two runs with large balls
        found += [kept_warm(apply(image), white_balance(image), disc) for disc in discs]
    assert sum(k.kept for k in found) > 0.7 * sum(k.pixels for k in found) > 0
