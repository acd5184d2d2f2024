"""LU2Net: a small encoder and decoder that paints the picture as if the water were gone (arXiv 2406.14973).

Per block a k x 1 and a 1 x k convolution of each channel alone, a gain per channel from the mean of the whole
picture, and 1x1 convolutions: 175,571 parameters, 1.4 G multiplications at 256x256. There is no residual around the
network: it paints every pixel itself.

Pictures outside are (height, width, 3) uint8, blue green red, as OpenCV has them. Tensors inside are
(batch, 3, height, width) float32, red green blue, 0 to 1; values of the output may leave that range and are clipped
when a picture is made of them.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors
from torch import Tensor, nn
from torch.nn import functional as fn

from agent.core.config import ConfigError
from agent.perception.enhancement.published import is_published, read

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


def load(path: Path) -> LU2Net:
    """Ready to run, on the CPU: weights from a safetensors file whose SHA-256 stands in `<path>.sha256`, or from a
    checkpoint of the network's authors (`.pth`, published.py), which has no such hash.

    Raises ConfigError: a file is missing, is not what its hash says, or holds another network.
    """
    tensors = _checkpoint(path) if is_published(path) else _hashed(path)
    net = LU2Net()
    try:
        net.load_state_dict(tensors)
    except RuntimeError as error:
        raise ConfigError(f"{path}: not the weights of this network; train them with `aucamp train enhance`") from error
    return net.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]  # as nn.Module.to has it


def _hashed(path: Path) -> dict[str, Tensor]:
    stated = hash_file(path)
    for file in (path, stated):
        if not file.is_file():
            raise ConfigError(f"{file}: no such file; give weights that `aucamp train enhance` wrote, hash beside")
    data = path.read_bytes()
    if stated.read_text(errors="replace").split()[:1] != [hashlib.sha256(data).hexdigest()]:
        raise ConfigError(f"{path}: does not match {stated.name}; the file is damaged, fetch or train it again")
    try:
        return load_tensors(data)
    except SafetensorError as error:
        raise ConfigError(f"{path}: not the weights of this network; train them with `aucamp train enhance`") from error


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
    path.write_bytes(data)
    hash_file(path).write_text(f"{hashlib.sha256(data).hexdigest()}  {path.name}\n")


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
