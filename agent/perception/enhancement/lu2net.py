"""LU2Net: a small encoder and decoder that paints the picture as if the water were gone (arXiv 2406.14973).

Per block a k x 1 and a 1 x k convolution of each channel alone, a gain per channel from the mean of the whole
picture, and 1x1 convolutions: 175,571 parameters, 1.4 G multiplications at 256x256. There is no residual around the
network: it paints every pixel itself.

Pictures outside are (height, width, 3) uint8, blue green red, as OpenCV has them. Tensors inside are
(batch, 3, height, width) float32, red green blue, 0 to 1; values of the output may leave that range and are clipped
when a picture is made of them.

`load` reads weights, `run` enhances a picture. `fold` makes the same network with fewer steps, for `forward`.
"""

from __future__ import annotations

import hashlib
import io
import math
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors
from torch import Tensor, nn
from torch.nn import functional as fn

from agent.core.config import ConfigError, read_file, write_whole

# --- the network ---

STRIDE = 4  # two halvings: sides are padded to multiples of it
CLOSE, WIDE = 3, 7  # taps of the axial convolutions: between the halves, and in encoder and decoder


class ChannelAttention(nn.Module):
    """x * sigmoid(W2 relu(W1 mean(x))): one gain per channel, from the mean of the whole picture."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.squeeze = nn.Conv2d(channels, channels, 1, bias=False)
        self.excite = nn.Conv2d(channels, channels, 1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        mean = x.mean((2, 3), keepdim=True)  # (n, c, 1, 1)
        return x * torch.sigmoid(self.excite(fn.relu(self.squeeze(mean))))


class AxialDepthwise(nn.Module):
    """Attention(x + down(x) + across(x)): a large field of view for 2 k weights per channel."""

    def __init__(self, channels: int, taps: int, dilation: int = 1) -> None:
        super().__init__()
        rim = taps // 2 * dilation
        self.down = nn.Conv2d(channels, channels, (taps, 1), padding=(rim, 0), dilation=dilation, groups=channels)
        self.across = nn.Conv2d(channels, channels, (1, taps), padding=(0, rim), dilation=dilation, groups=channels)
        self.attention = ChannelAttention(channels)

    def forward(self, x: Tensor) -> Tensor:
        return self.attention(x + self.down(x) + self.across(x))  # type: ignore[no-any-return]


class Encoder(nn.Module):
    """(n, c, h, w) -> (n, 4c, h/2, w/2), and what the decoder of the same size will want to see again."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.axial = AxialDepthwise(channels, WIDE)
        self.norm = nn.BatchNorm2d(channels)
        self.widen = nn.Conv2d(channels, 4 * channels, 1)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        skip = self.norm(self.axial(x))
        return fn.gelu(fn.max_pool2d(self.widen(skip), 2)), skip


class Middle(nn.Module):
    """(n, 256, h, w) -> the same, from four fields of view side by side."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        quarter = channels // 4
        self.narrow = nn.Conv2d(channels, quarter, 1)
        self.near = AxialDepthwise(quarter, CLOSE, 1)
        self.mid = AxialDepthwise(quarter, CLOSE, 2)
        self.far = AxialDepthwise(quarter, CLOSE, 3)
        self.norm = nn.BatchNorm2d(channels)
        self.mix = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        x = self.narrow(x)
        x = torch.cat([x, self.near(x), self.mid(x), self.far(x)], 1)
        return fn.gelu(self.mix(self.norm(x)))


class Decoder(nn.Module):
    """(n, 4c, h/2, w/2) and the encoder's (n, c, h, w) -> (n, c, h, w)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.merge = nn.Conv2d(5 * channels, channels, 1)
        self.norm = nn.BatchNorm2d(channels)
        self.axial = AxialDepthwise(channels, WIDE)
        self.mix = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        x = torch.cat([fn.interpolate(x, scale_factor=2.0, mode="nearest"), skip], 1)
        return fn.gelu(self.mix(self.axial(self.norm(self.merge(x)))))


class LU2Net(nn.Module):
    """(n, 3, h, w) red green blue 0 to 1 -> the same, enhanced; any h and w from 1 on.

    Layers start as PyTorch draws them, but for the attention, whose gains start near 1/2, and the last layer,
    which training sets to the least-squares answer for its first batch.
    """

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(3, 16, 7, padding=3)
        self.encoder1 = Encoder(16)
        self.encoder2 = Encoder(64)
        self.middle = Middle(256)
        self.decoder1 = Decoder(64)
        self.decoder2 = Decoder(16)
        self.last = nn.Conv2d(16, 3, 1)

    def forward(self, x: Tensor) -> Tensor:
        return self.last(self.features(x))[:, :, : x.shape[2], : x.shape[3]]  # type: ignore[no-any-return]

    def features(self, x: Tensor) -> Tensor:
        """(n, 16, H, W): what the last layer mixes to colours; H and W are h and w padded to multiples of four."""
        height, width = x.shape[2:]
        x = fn.pad(x, (0, -width % STRIDE, 0, -height % STRIDE), mode="replicate")
        x, skip1 = self.encoder1(self.first(x))  # (n, 64, H/2, W/2), (n, 16, H, W)
        x, skip2 = self.encoder2(x)  # (n, 256, H/4, W/4), (n, 64, H/2, W/2)
        x = self.decoder1(self.middle(x), skip2)  # (n, 64, H/2, W/2)
        return self.decoder2(x, skip1)  # type: ignore[no-any-return]


# --- weights, and pictures through the network ---


def load(path: Path) -> LU2Net:
    """Ready to run, on the CPU: weights from a safetensors file whose SHA-256 stands in `<path>.sha256`, or from a
    checkpoint of the network's authors (`.pth`), which has no such hash.

    Raises ConfigError: a file is missing, is not what its hash says, or holds another network.
    """
    tensors = _checkpoint(path) if is_published(path) else _hashed(path)
    net = LU2Net()
    try:
        net.load_state_dict(tensors)
    except RuntimeError as error:
        raise ConfigError(f"{path}: not the weights of this network; train them with `aucamp train`") from error
    return net.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]  # as nn.Module.to has it


def _hashed(path: Path) -> dict[str, Tensor]:
    stated = hash_file(path)
    give = "give weights that `aucamp train` wrote, hash beside"
    data, said = read_file(path, MOST_BYTES, give), read_file(stated, give=give)
    if said.decode(errors="replace").split()[:1] != [hashlib.sha256(data).hexdigest()]:
        raise ConfigError(f"{path}: does not match {stated.name}; the file is damaged, fetch or train it again")
    try:
        return load_tensors(data)
    except SafetensorError as error:
        raise ConfigError(f"{path}: not the weights of this network; train them with `aucamp train`") from error


def _checkpoint(path: Path) -> dict[str, Tensor]:
    if not path.is_file():
        raise ConfigError(f"{path}: no such file; give a checkpoint of LU2Net by its authors")
    tensors = {name: torch.from_numpy(np.array(values, order="C")) for name, values in read(path).items()}
    if any(not bool(tensor.isfinite().all()) for tensor in tensors.values()):
        raise ConfigError(f"{path}: holds values that are no numbers; fetch it again")
    return tensors


def save(net: LU2Net, path: Path) -> None:
    """Weights as float32 safetensors, and their SHA-256 beside, in the format of sha256sum."""
    data = save_tensors({name: tensor.detach().cpu().contiguous() for name, tensor in net.state_dict().items()})
    write_whole(path, data)
    write_whole(hash_file(path), f"{hashlib.sha256(data).hexdigest()}  {path.name}\n")


def hash_file(path: Path) -> Path:
    return path.with_name(path.name + ".sha256")


def run(net: LU2Net, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(height, width, 3) blue green red, 0 to 255 -> the same, enhanced; on the device where the network is."""
    with torch.inference_mode():
        return to_image(net(to_tensor(image).to(net.last.weight.device)))


def to_tensor(image: NDArray[np.uint8]) -> Tensor:
    """(h, w, 3) blue green red uint8 -> (1, 3, h, w) red green blue float32 0 to 1, channels last in memory."""
    rgb = np.ascontiguousarray(image[:, :, ::-1], np.float32) / np.float32(255)
    return torch.from_numpy(rgb).permute(2, 0, 1)[None]


def to_image(tensor: Tensor) -> NDArray[np.uint8]:
    """(1, 3, h, w) red green blue -> (h, w, 3) blue green red uint8, clipped and rounded."""
    rgb = (tensor[0].clamp(0, 1) * 255).round().to(torch.uint8).permute(1, 2, 0).cpu().numpy()
    return np.ascontiguousarray(rgb[:, :, ::-1])


# --- checkpoints of LU2Net's authors (`.pth`): their tensors under our names ---
#
# They are for users with the right to use them. A `.pth` is a zip with a pickle in it, and a pickle can run code. This
# one cannot: the few callables that it may name are replaced by functions of this file that describe a tensor, and
# whatever else it names is refused. Sizes are bounded before anything is read. Wrappers are looked into:
# {"state_dict": ...}, and DataParallel's "module." before names.
#
# Their names are those of LU2Net.py in the authors' repository (MrYangHaoDong/LU2Net, commit 7190ddc).

SUFFIXES = (".pth", ".pt")
MOST_BYTES = 32_000_000  # of the file and of what it unpacks to: weights take 0.7 MB, with an optimiser's state 2.1 MB
MOST_PICKLE = 1_000_000  # bytes; 120 tensors take 20,000

BLOCKS = {
    "conv_in": "first",
    "e1": "encoder1",
    "e3": "encoder2",
    "b5": "middle",
    "d4": "decoder1",
    "d2": "decoder2",
    "conv_out": "last",
}
ENCODER = {"dw": "axial", "bn": "norm", "pw": "widen"}
MIDDLE = {"pw1": "narrow", "dw1": "near", "dw2": "mid", "dw3": "far", "bn": "norm", "pw2": "mix"}
DECODER = {"pw": "merge", "bn": "norm", "dw": "axial", "pw2": "mix"}
LAYERS = {"e1": ENCODER, "e3": ENCODER, "b5": MIDDLE, "d4": DECODER, "d2": DECODER}
AXIAL = {"dw_h": "down", "dw_w": "across", "CAB.conv_du.0": "attention.squeeze", "CAB.conv_du.2": "attention.excite"}

DTYPES = {"FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8"}
WRAPPERS = ("state_dict", "model_state_dict", "model", "net", "params")

Array = NDArray[Any]
BROKEN = (
    *(pickle.UnpicklingError, struct.error, zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError),
    *(RuntimeError, KeyError, IndexError, ValueError, TypeError, AttributeError, OverflowError, MemoryError),
)  # what zip and pickle raise for files that are damaged or made to do damage


class Forbidden(pickle.UnpicklingError):
    """The pickle names something that is no tensor."""


class Storage(NamedTuple):
    """A type of numbers, by torch's name for it."""

    dtype: str


class Names(dict[str, Any]):
    """An OrderedDict of the pickle; torch hangs its versions on it as an attribute."""


def is_published(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES


def read(path: Path) -> dict[str, Array]:
    """A checkpoint's tensors under our names. Raises ConfigError in one line for anything else; nothing is executed."""
    try:
        found = _tensors(path)
    except Forbidden as error:
        raise ConfigError(
            f"{path}: asks for {error}, which is no tensor, and is not run; give a file of tensors alone"
        ) from None
    except BROKEN:
        raise ConfigError(
            f"{path}: not a checkpoint of LU2Net by its authors: damaged, too large, or not written by torch.save"
        ) from None
    named = {ours(name): value for name, value in found.items()}
    return {name: value for name, value in named.items() if name is not None}


def ours(name: str) -> str | None:
    """Our name of a tensor of theirs; None if it is none of theirs."""
    block, _, rest = name.removeprefix("module.").partition(".")
    if block not in BLOCKS:
        return None
    if block not in LAYERS:
        return f"{BLOCKS[block]}.{rest}"
    layer, _, rest = rest.partition(".")
    if layer not in LAYERS[block]:
        return None
    part, _, kind = rest.rpartition(".")
    inner = AXIAL.get(part, part)
    return ".".join(filter(None, (BLOCKS[block], LAYERS[block][layer], inner, kind)))


def _tensors(path: Path) -> dict[str, Array]:
    if path.stat().st_size > MOST_BYTES:
        raise ValueError("too large")
    with zipfile.ZipFile(path) as file:
        if sum(entry.file_size for entry in file.infolist()) > MOST_BYTES:
            raise ValueError("too large")
        head = next((name for name in file.namelist() if name.endswith("data.pkl")), "data.pkl")
        if file.getinfo(head).file_size > MOST_PICKLE:
            raise ValueError("too large")
        entry = cache(lambda key: file.read(f"{head.removesuffix('data.pkl')}data/{key}"))
        held = _Reader(file.read(head), entry).load()
    for wrapper in WRAPPERS:
        if isinstance(held, dict) and isinstance(held.get(wrapper), dict):
            held = held[wrapper]
    found = {n: value for n, value in dict.items(held) if isinstance(n, str) and isinstance(value, np.ndarray)}
    if sum(value.nbytes for value in found.values()) > MOST_BYTES:  # many tensors may lie over one storage
        raise ValueError("too large")
    return found


class _Reader(pickle._Unpickler):
    """Python's own unpickler in Python, for the one in C sets aside as much memory as a file asks for."""

    def __init__(self, data: bytes, entry: Callable[[str], bytes]) -> None:
        super().__init__(io.BytesIO(data))
        self._entry = entry

    def find_class(self, module: str, name: str) -> object:
        if module == "torch" and name in DTYPES:
            return Storage(DTYPES[name])
        known: dict[tuple[str, str], object] = {
            ("collections", "OrderedDict"): Names,
            ("torch._utils", "_rebuild_tensor_v2"): _tensor,
            ("torch._utils", "_rebuild_parameter"): _parameter,
        }
        if (module, name) not in known:
            raise Forbidden(f"{module}.{name}")
        return known[module, name]

    def persistent_load(self, pid: object) -> Array:
        match pid:
            case ("storage", Storage(dtype), str(key), *_):
                return np.frombuffer(self._entry(key), dtype)
        raise pickle.UnpicklingError("no storage")


def _tensor(storage: Array, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: object) -> Array:
    """A tensor laid over a storage; raises ValueError where it would reach beyond."""
    if len(size) != len(stride) or min((offset, *size, *stride)) < 0 or math.prod(size) > storage.size:
        raise ValueError("no tensor")
    if offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True)) >= storage.size:
        raise ValueError("beyond its storage")
    steps = [step * storage.itemsize for step in stride]
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps)


def _parameter(value: Array, *_: object) -> Array:
    return value


# --- the same network in fewer steps ---
#
# What is known before the picture, or once for all of it, goes into the weights.
#
# * A normalisation is a factor and an offset per channel. In the encoders and the middle it goes forward into the 1x1
#   convolution that follows, and, on the skip connection, into the part of the decoder's 1x1 that reads it; in the
#   decoders it goes backward into the 1x1 before it.
# * The gain of an attention is a factor per channel for the whole picture: it goes into the 1x1 that follows.
# * x + down(x) + across(x) is one convolution, whose taps form a plus with the identity at its centre.
# * Doubling pixels and mixing channels commute: the decoder mixes the small picture and doubles the result.
# * So do adding a bias and taking the largest of four.
#
# Nothing is approximated: only rounding differs. Pictures are (h, w, c) in here, worked on in bands of rows, so that
# the wide layers between two narrow ones stay in the cache and are never a picture of their own.

BAND_VALUES = 250_000  # float32 values of a band in its widest layer: 1 MB, the second cache of most processors


class Mix(NamedTuple):
    """A 1x1 convolution: weight (out, in), bias (out,)."""

    weight: Tensor
    bias: Tensor


class Axial(NamedTuple):
    plus: Tensor  # (c, 1, taps, taps), nought off the two axes
    bias: Tensor  # (c,)
    squeeze: Tensor  # (c, c), of the attention
    excite: Tensor  # (c, c)
    dilation: int


class FoldedEncoder(NamedTuple):
    axial: Axial
    widen: Mix


class FoldedMiddle(NamedTuple):
    narrow: Mix
    axials: tuple[Axial, Axial, Axial]
    mix: Mix


class FoldedDecoder(NamedTuple):
    low: Mix  # of the small picture; its bias is all that is added to every pixel
    skip: Tensor  # (c, c), of the encoder's skip connection
    axial: Axial
    mix: Mix


class Folded(NamedTuple):
    """What `forward` needs, made from a network by `fold`; what happens to the network later does not reach it."""

    first: Mix
    encoder1: FoldedEncoder
    encoder2: FoldedEncoder
    middle: FoldedMiddle
    decoder1: FoldedDecoder
    decoder2: FoldedDecoder
    last: Mix


@torch.inference_mode()
def forward(net: Folded, x: Tensor) -> Tensor:
    """(1, 3, h, w) red green blue 0 to 1 -> the same, equal to the plain network's to 1e-5. One picture at a time."""
    height, width = x.shape[2:]
    x = fn.pad(x, (0, -width % STRIDE, 0, -height % STRIDE), mode="replicate")
    x = fn.conv2d(x.contiguous(memory_format=torch.channels_last), *net.first, padding=net.first.weight.shape[2] // 2)
    y, skip1, gain1 = encode(net.encoder1, flat(x))
    y, skip2, gain2 = encode(net.encoder2, y)
    y = decode(net.decoder1, bottleneck(net.middle, y), skip2, gain2)
    y = decode(net.decoder2, y, skip1, gain1)
    return fn.linear(y, *net.last).permute(2, 0, 1)[None, :, :height, :width]


def encode(block: FoldedEncoder, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(h, w, c) -> (h/2, w/2, 4c); the skip connection (h, w, c) without its gain and normalisation; the gain (c,)."""
    skip, gain = axial_depthwise(block.axial, x)
    h, w, _ = x.shape
    weight = block.widen.weight * gain
    out = x.new_empty(h // 2, w // 2, len(weight))
    for top, bottom in bands(h, w * len(weight)):
        wide = fn.linear(skip[top:bottom], weight).view(-1, 2, w, len(weight))
        wide = torch.maximum(wide[:, 0], wide[:, 1]).view(-1, w // 2, 2, len(weight))
        out[top // 2 : bottom // 2] = fn.gelu(torch.maximum(wide[:, :, 0], wide[:, :, 1]).add_(block.widen.bias))
    return out, skip, gain


def bottleneck(block: FoldedMiddle, x: Tensor) -> Tensor:
    """(h, w, c) -> (h, w, c)."""
    x = fn.linear(x, *block.narrow)
    views = [axial_depthwise(axial, x) for axial in block.axials]
    gain = torch.cat([torch.ones_like(block.narrow.bias), *(gain for _, gain in views)])
    x = torch.cat([x, *(view for view, _ in views)], 2)
    return fn.gelu(fn.linear(x, block.mix.weight * gain, block.mix.bias))


def decode(block: FoldedDecoder, x: Tensor, skip: Tensor, skip_gain: Tensor) -> Tensor:
    """(h/2, w/2, 4c) and the skip connection (h, w, c) -> (h, w, c)."""
    low = fn.linear(x, *block.low)
    h, w, c = skip.shape
    x = fn.linear(skip, block.skip * skip_gain)
    x.view(h // 2, 2, w // 2, 2, c).add_(low[:, None, :, None])
    x, gain = axial_depthwise(block.axial, x)
    weight = block.mix.weight * gain
    for top, bottom in bands(h, w * c):
        x[top:bottom] = fn.gelu(fn.linear(x[top:bottom], weight, block.mix.bias))
    return x


def axial_depthwise(by: Axial, x: Tensor) -> tuple[Tensor, Tensor]:
    """x + down(x) + across(x), and the gain (c,) that the attention would give it."""
    h, w, c = x.shape
    rim = by.plus.shape[2] // 2 * by.dilation
    y = torch.empty_like(x)
    for top, bottom in bands(h, w * c):
        above, below = min(rim, top), min(rim, h - bottom)
        part = x[top - above : bottom + below].permute(2, 0, 1)[None]
        if above < rim or below < rim:
            part = fn.pad(part, (0, 0, rim - above, rim - below))
        y[top:bottom] = flat(fn.conv2d(part, by.plus, by.bias, padding=(0, rim), dilation=by.dilation, groups=c))
    return y, torch.sigmoid(by.excite @ torch.relu(by.squeeze @ y.mean((0, 1))))


def bands(height: int, values_per_row: int) -> Iterator[tuple[int, int]]:
    """First row and row after the last, of bands with an even number of rows."""
    rows = max(2, BAND_VALUES // values_per_row // 2 * 2)
    return ((top, min(top + rows, height)) for top in range(0, height, rows))


def flat(x: Tensor) -> Tensor:
    """(1, c, h, w), channels last in memory -> (h, w, c)."""
    return x[0].permute(1, 2, 0)


@torch.inference_mode()
def fold(net: LU2Net) -> Folded:
    """The network as it is in its evaluation mode."""
    return Folded(
        Mix(net.first.weight.contiguous(memory_format=torch.channels_last).clone(), bias(net.first)),
        fold_encoder(net.encoder1),
        fold_encoder(net.encoder2),
        fold_middle(net.middle),
        fold_decoder(net.decoder1, net.encoder2.norm),
        fold_decoder(net.decoder2, net.encoder1.norm),
        mix(net.last),
    )


def fold_encoder(block: Encoder) -> FoldedEncoder:
    return FoldedEncoder(fold_axial(block.axial), after(block.norm, mix(block.widen)))


def fold_middle(block: Middle) -> FoldedMiddle:
    axials = (fold_axial(block.near), fold_axial(block.mid), fold_axial(block.far))
    return FoldedMiddle(mix(block.narrow), axials, after(block.norm, mix(block.mix)))


def fold_decoder(block: Decoder, side: nn.BatchNorm2d) -> FoldedDecoder:
    """`side` is the normalisation that the encoder applies to its skip connection."""
    (weight, add), (scale, offset) = mix(block.merge), norm(block.norm)
    channels = len(weight)
    low, skip = weight[:, :-channels], weight[:, -channels:]  # in the order of the plain network's concatenation
    skip, add = after(side, Mix(skip, add))
    return FoldedDecoder(
        Mix(scale[:, None] * low, scale * add + offset), scale[:, None] * skip, fold_axial(block.axial), mix(block.mix)
    )


def fold_axial(block: AxialDepthwise) -> Axial:
    down, across = block.down.weight, block.across.weight
    centre = down.shape[2] // 2
    plus = down.new_zeros(len(down), 1, down.shape[2], across.shape[3])
    plus[:, :, :, centre] += down[:, :, :, 0]
    plus[:, :, centre, :] += across[:, :, 0, :]
    plus[:, :, centre, centre] += 1.0
    squeeze, excite = (one.weight[:, :, 0, 0].clone() for one in (block.attention.squeeze, block.attention.excite))
    return Axial(plus, bias(block.down) + bias(block.across), squeeze, excite, int(block.down.dilation[0]))


def after(block: nn.BatchNorm2d, then: Mix) -> Mix:
    """A normalisation and the 1x1 behind it, as one 1x1."""
    scale, offset = norm(block)
    return Mix(then.weight * scale, then.bias + then.weight @ offset)


def norm(block: nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Factor and offset (c,) that a normalisation is once its statistics stand."""
    mean, var = block.running_mean, block.running_var
    assert mean is not None and var is not None  # they are tracked unless asked otherwise
    scale = block.weight / torch.sqrt(var + block.eps)
    return scale, block.bias - mean * scale


def mix(block: nn.Conv2d) -> Mix:
    return Mix(block.weight[:, :, 0, 0].clone(), bias(block))


def bias(block: nn.Conv2d) -> Tensor:
    assert block.bias is not None
    return block.bias.clone()
