"""A correlation filter that follows a box: needs no file, learns what it follows, and keeps its colours.

What makes the box's middle ring and everything around it silent, in the least squares sense, is a filter whose spectrum
is a quotient of sums over the pictures learnt so far (MOSSE, Bolme 2010; several channels over one denominator as in
DSST, Danelljan 2014). Its answer is mixed with where the thing's colours are (Staple, Bertinetto 2016), because a fish
that turns changes its outline but not its colours. Three sizes are tried in each frame.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.perception.tracking.box import Box, Image, cut
from agent.perception.tracking.colours import Colours, balanced, chance_of, gains_of, learn

CELLS = 64  # side of the region in which it looks, in cells of the filter
MIDDLE = CELLS // 2
REGION = 2.5  # sides of a square like the box: so far does it look
LEAST_REGION = 1.7  # longer sides of the box
PEAK_SHARE = 0.1  # standard deviation of the wanted answer, in sides of a square like the box
RATE = 0.03  # of learning: half forgotten after 23 pictures
REGULAR = 1e-2  # of the filter; in units of a channel's own energy
COLOUR_SHARE = 0.3  # of the answer, Staple's
SIZES = (1.0, 0.96, 1.04)  # tried in each frame
KEEP_SIZE = 1.02  # another has to answer so much better
PLAIN = 1e-4  # of a peak's height: less is the noise of a picture that shows nothing
ORIENTATIONS = 6  # of edges, unsigned

Spectrum = NDArray[np.complex64]


class CorrelationTracker:
    """Call start() first. It learns only when it is told to, by learn()."""

    def __init__(self) -> None:
        self._box, self._base = Box(0, 0, 0, 0), Box(0, 0, 0, 0)
        self._colours: Colours | None = None
        self._numerator: Spectrum | None = None
        self._denominator = np.zeros(0, np.float32)
        self._window, self._wanted = np.zeros((0, 0), np.float32), np.zeros(0, np.complex64)

    def start(self, image: Image, box: Box) -> None:
        self._box = self._base = box
        self._colours, self._numerator = learn(image, box), None
        hann = np.hanning(CELLS + 2)[1:-1].astype(np.float32)
        self._window = np.asarray(np.outer(hann, hann), np.float32)
        self._wanted = _spectra(_peak(PEAK_SHARE * self._cells(self._side(box)))[None])[0]
        self.learn(image, box)

    def follow(self, image: Image) -> Box:
        assert self._numerator is not None  # start() comes first
        gains, best, found = gains_of(image), -np.inf, self._box
        for size in SIZES:
            box = self._box.grown(size)
            features, chances = self._features(image, box, gains)
            spectra = np.conj(self._numerator) * _spectra(features)
            filtered = np.fft.irfft2(spectra.sum(0) / (self._denominator + REGULAR), s=(CELLS, CELLS))
            coloured = self._coloured(chances)
            answer = np.asarray((1.0 - COLOUR_SHARE) * filtered + COLOUR_SHARE * coloured, np.float32)
            row, column = divmod(int(np.argmax(answer)), CELLS)
            if answer[row, column] - answer[MIDDLE, MIDDLE] < PLAIN:
                row = column = MIDDLE
            height = float(answer[row, column]) / (1.0 if size == 1.0 else KEEP_SIZE)
            if height > best:
                best, scale = height, self._side(box) / CELLS
                down, across = _finer(answer, row, column)
                found = box.moved((across - MIDDLE) * scale, (down - MIDDLE) * scale)
        self._box = found
        return found

    def learn(self, image: Image, box: Box) -> None:
        """What is in this box is the thing."""
        features, _ = self._features(image, box, gains_of(image))
        spectra = _spectra(features)
        numerator = np.conj(self._wanted) * spectra
        denominator = np.asarray((np.abs(spectra) ** 2).sum(0), np.float32)
        if self._numerator is None:
            self._numerator, self._denominator = numerator, denominator
        else:
            self._numerator = (1.0 - RATE) * self._numerator + RATE * numerator
            self._denominator = (1.0 - RATE) * self._denominator + RATE * denominator

    def _features(
        self, image: Image, box: Box, gains: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(channels, CELLS, CELLS) that the filter sees, and where the thing's colours are."""
        assert self._colours is not None
        side, (u, v) = self._side(box), box.centre_px
        region = Box(u + 0.5 - side / 2, v + 0.5 - side / 2, side, side)
        picture = balanced(cut(image, region, (CELLS, CELLS)), gains)
        chances = chance_of(self._colours, picture)
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(np.float32)
        across, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
        strength, angle = cv2.cartToPolar(across, down)
        strength /= cv2.blur(strength, (15, 15)) + 24.0  # edges count alike in light and in shade
        bins = np.mod(np.floor(angle * (ORIENTATIONS / math.pi)), ORIENTATIONS)
        edges = [cv2.blur(np.where(bins == k, strength, 0.0), (3, 3)) for k in range(ORIENTATIONS)]
        tint = picture.astype(np.float32) / 128.0
        plain = [tint.mean(2), tint[..., 2] - tint[..., 1], tint[..., 0] - 0.5 * (tint[..., 1] + tint[..., 2])]
        channels = np.stack([*(channel - channel.mean() for channel in plain), *edges, chances - chances.mean()])
        return np.asarray(channels * self._window, np.float32), chances

    def _coloured(self, chances: NDArray[np.float32]) -> NDArray[np.float32]:
        """Mean chance over the box, for a box in the middle of each cell."""
        cells = CELLS / self._side(self._box)
        width, height = (max(round(0.8 * side * cells), 1) for side in (self._box.width, self._box.height))
        return np.asarray(cv2.blur(chances, (width, height), borderType=cv2.BORDER_REPLICATE), np.float32)

    def _side(self, box: Box) -> float:
        return max(REGION * math.sqrt(box.area_px), LEAST_REGION * max(box.width, box.height))

    def _cells(self, side: float) -> float:
        return CELLS * math.sqrt(self._base.area_px) / side


def _spectra(channels: NDArray[np.float32]) -> Spectrum:
    return np.asarray(np.fft.rfft2(channels), np.complex64)


def _peak(sigma: float) -> NDArray[np.float32]:
    """The answer that is wanted: one round peak in the middle cell."""
    steps = np.arange(CELLS, dtype=np.float32) - MIDDLE
    line = np.exp(-0.5 * (steps / sigma) ** 2)
    return np.outer(line, line)


def _finer(answer: NDArray[np.float32], row: int, column: int) -> tuple[float, float]:
    """The peak between the cells, by a parabola in each direction."""

    def between(before: float, at: float, after: float) -> float:
        bend = before - 2.0 * at + after
        return 0.0 if bend >= 0.0 else max(-0.5, min(0.5, 0.5 * (before - after) / bend))

    last = CELLS - 1
    down = between(answer[max(row - 1, 0), column], answer[row, column], answer[min(row + 1, last), column])
    across = between(answer[row, max(column - 1, 0)], answer[row, column], answer[row, min(column + 1, last)])
    return float(row + down), float(column + across)
