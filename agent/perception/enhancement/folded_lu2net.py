"""The same network in fewer steps: what is known before the picture, or once for all of it, goes into the weights.

* A normalisation is a factor and an offset per channel. In the encoders and the middle it goes forward into the 1x1
  convolution that follows, and, on the skip connection, into the part of the decoder's 1x1 that reads it; in the
  decoders it goes backward into the 1x1 before it.
* The gain of an attention is a factor per channel for the whole picture: it goes into the 1x1 that follows.
* x + down(x) + across(x) is one convolution, whose taps form a plus with the identity at its centre.
* Doubling pixels and mixing channels commute: the decoder mixes the small picture and doubles the result.
* So do adding a bias and taking the largest of four.

Nothing is approximated: only rounding differs. Pictures are (h, w, c) in here, worked on in bands of rows, so that the
wide layers between two narrow ones stay in the cache and are never a picture of their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from agent.perception.enhancement.lu2net import STRIDE, AxialDepthwise, Decoder, Encoder, LU2Net, Middle

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
        encoder(net.encoder1),
        encoder(net.encoder2),
        middle(net.middle),
        decoder(net.decoder1, net.encoder2.norm),
        decoder(net.decoder2, net.encoder1.norm),
        mix(net.last),
    )


def encoder(block: Encoder) -> FoldedEncoder:
    return FoldedEncoder(axial(block.axial), after(block.norm, mix(block.widen)))


def middle(block: Middle) -> FoldedMiddle:
    axials = (axial(block.near), axial(block.mid), axial(block.far))
    return FoldedMiddle(mix(block.narrow), axials, after(block.norm, mix(block.mix)))


def decoder(block: Decoder, side: nn.BatchNorm2d) -> FoldedDecoder:
    """`side` is the normalisation that the encoder applies to its skip connection."""
    (weight, add), (scale, offset) = mix(block.merge), norm(block.norm)
    channels = len(weight)
    low, skip = weight[:, :-channels], weight[:, -channels:]  # in the order of the plain network's concatenation
    skip, add = after(side, Mix(skip, add))
    return FoldedDecoder(
        Mix(scale[:, None] * low, scale * add + offset), scale[:, None] * skip, axial(block.axial), mix(block.mix)
    )


def axial(block: AxialDepthwise) -> Axial:
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
