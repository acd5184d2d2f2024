"""Checkpoints with the authors' names, made of our own weights: the same picture comes out, and nothing is run."""

import os
import pickle
import zipfile
from collections import OrderedDict

import numpy as np
import pytest

from agent.core.config import ConfigError

torch = pytest.importorskip("torch", reason="the extra `enhance` is not installed")

from agent.perception.enhancement import lu2net  # noqa: E402
from tests.perception.enhancement.random_network import random_network  # noqa: E402

PICTURE = np.random.default_rng(0).integers(0, 256, (20, 24, 3), dtype=np.uint8)
BLOCKS = ["conv_in", "e1", "e3", "b5", "d4", "d2", "conv_out"]  # as LU2Net.py's constructor sets them up
ENCODER, DECODER, AXIAL = (
    ["dw", "bn", "pw"],
    ["pw", "bn", "dw", "pw2"],
    ["dw_h", "dw_w", "CAB.conv_du.0", "CAB.conv_du.2"],
)
MIDDLE = ["pw1", "dw1", "dw2", "dw3", "bn", "pw2"]


@pytest.fixture(scope="module")
def net():
    return random_network(1)


def their_layers():
    """Their modules with tensors, in the order of their constructor; written apart from the table under test."""
    for block, layers in zip(BLOCKS, [None, ENCODER, ENCODER, MIDDLE, DECODER, DECODER, None], strict=True):
        for layer in layers or [None]:
            for part in AXIAL if layer and layer.startswith("dw") else [None]:
                yield ".".join(filter(None, (block, layer, part)))


@pytest.fixture(scope="module")
def theirs(net):
    """Our tensors in the order of construction, under their names in the order of theirs."""
    modules = [m for m in net.modules() if isinstance(m, torch.nn.Conv2d | torch.nn.BatchNorm2d)]
    named = zip(their_layers(), modules, strict=True)
    return OrderedDict((f"{name}.{key}", value) for name, m in named for key, value in m.state_dict().items())


@pytest.mark.parametrize("wrap", [
    lambda d: d,
    lambda d: {"epoch": 170, "state_dict": d, "optimizer": {"param_groups": [{"lr": 1e-4}]}},
    lambda d: OrderedDict((f"module.{name}", value) for name, value in d.items()),
    lambda d: {"net": {n: torch.nn.Parameter(v) if v.is_floating_point() else v for n, v in d.items()}},
])  # fmt: skip
def test_the_same_picture_comes_out(wrap, net, theirs, tmp_path):
    file = tmp_path / "LightUNet_170.pth"
    torch.save(wrap(theirs), file)
    assert np.array_equal(lu2net.run(lu2net.load(file), PICTURE), lu2net.run(net, PICTURE))


def test_memory_of_other_order_is_read_as_what_it_means(net, theirs, tmp_path):
    file = tmp_path / "turned.pth"
    turned = {n: v.contiguous(memory_format=torch.channels_last) if v.ndim == 4 else v for n, v in theirs.items()}
    torch.save(turned, file)
    assert np.array_equal(lu2net.run(lu2net.load(file), PICTURE), lu2net.run(net, PICTURE))


@pytest.mark.parametrize("change", [
    lambda d: {name: value for name, value in d.items() if name != "b5.dw2.dw_h.bias"},
    lambda d: {**d, "e1.pw.weight": d["e3.pw.weight"]},
    lambda d: {"layer1.0.weight": torch.zeros(3)},
])  # fmt: skip
def test_another_network_is_one_line(change, theirs, tmp_path):
    torch.save(change(theirs), tmp_path / "other.pth")
    with pytest.raises(ConfigError, match=r"other\.pth: not the weights of this network"):
        lu2net.load(tmp_path / "other.pth")


def test_what_is_no_number_is_one_line(theirs, tmp_path):
    torch.save({**theirs, "conv_out.bias": torch.full((3,), float("nan"))}, tmp_path / "nan.pth")
    with pytest.raises(ConfigError, match="holds values that are no numbers"):
        lu2net.load(tmp_path / "nan.pth")


class Runs:
    def __init__(self, touched):
        self.touched = str(touched)

    def __reduce__(self):
        return os.mkdir, (self.touched,)


def archive(path, data, **entries):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("archive/data.pkl", data)
        for name, content in entries.items():
            file.writestr(f"archive/data/{name}", content)


def test_nothing_that_a_file_asks_for_is_run(theirs, tmp_path):
    touched = tmp_path / "touched"
    for number, held in enumerate(({"state_dict": Runs(touched)}, [Runs(touched)], {**theirs, "more": Runs(touched)})):
        file = tmp_path / f"{number}.pth"
        torch.save(held, file)
        with pytest.raises(ConfigError, match=r"asks for posix\.mkdir, which is no tensor, and is not run"):
            lu2net.load(file)
    assert not touched.exists()


@pytest.mark.parametrize("expression", ["builtins eval", "torch load", "torch._utils _rebuild_tensor", "os system"])
def test_callables_are_refused_by_name(expression, tmp_path):
    module, name = expression.split()
    archive(tmp_path / "a.pth", f"c{module}\n{name}\n(S'1'\ntR.".encode())
    with pytest.raises(ConfigError, match=rf"asks for {module}\.{name}"):
        lu2net.read(tmp_path / "a.pth")


def tensor(size, stride, offset=0):
    """A pickle of one tensor over sixteen numbers, as torch writes it."""
    numbers = f"I{offset}\n(" + "".join(f"I{n}\n" for n in size) + "t(" + "".join(f"I{n}\n" for n in stride) + "t"
    return b"(dS'a'\nctorch._utils\n_rebuild_tensor_v2\n((S'storage'\nctorch\nFloatStorage\nS'0'\nS'cpu'\nI16\ntQ" + (
        numbers.encode() + b"I00\nNtRs."
    )


def test_a_tensor_may_be_laid_over_its_storage(tmp_path):
    archive(tmp_path / "a.pth", tensor((4, 4), (4, 1)), **{"0": np.arange(16, dtype="<f4").tobytes()})
    assert lu2net._tensors(tmp_path / "a.pth")["a"][1].tolist() == [4, 5, 6, 7]


@pytest.mark.parametrize("data", [
    tensor((5, 4), (4, 1)),
    tensor((4, 4), (4, 1), offset=1),
    tensor((1_000_000, 1_000_000), (0, 0)),
    tensor((4,), (-1,)),
    tensor((4, 4), (4,)),
    b"\x80\x04r\xff\xff\xff\x7f.",  # a memory of two milliards of entries
    b"(" * 1000 + b".",
    b"",
    b"\x80\x02X\xff\xff\xff\x7fabc.",
])  # fmt: skip
def test_tensors_that_lie_are_one_line(data, tmp_path):
    archive(tmp_path / "a.pth", data, **{"0": b"\0" * 64})
    with pytest.raises(ConfigError, match=r"a\.pth: not a checkpoint of LU2Net by its authors"):
        lu2net.read(tmp_path / "a.pth")


def test_what_unpacks_to_too_much_or_is_no_zip_is_one_line(tmp_path):
    archive(tmp_path / "bomb.pth", pickle.dumps({}), big=bytes(lu2net.MOST_BYTES))
    (tmp_path / "text.pth").write_bytes(b"text")
    (tmp_path / "old.pth").write_bytes(pickle.dumps(Runs(tmp_path / "touched")))
    with zipfile.ZipFile(tmp_path / "empty.pth", "w"):
        pass
    for name in ("bomb", "text", "old", "empty"):
        with pytest.raises(ConfigError, match=rf"{name}\.pth: not a checkpoint of LU2Net"):
            lu2net.load(tmp_path / f"{name}.pth")
    with pytest.raises(ConfigError, match=r"none\.pth: no such file"):
        lu2net.load(tmp_path / "none.pth")
