"""Whether a box still shows what it showed when it was drawn, and if not, where in the picture that could be now.

A tracker always answers: when its target leaves, it settles on whatever is there, and soon with the same score as
before. So it is checked by two witnesses that know nothing of it. *Likeness*: correlation of small pictures (with a rim
of surroundings, so that an outline counts) with the one that was drawn and with the newest that was certain; it takes
each channel's mean off, so red is like yellow to it. *Colour*: how much of the box shows colours that the thing had
in the first picture and its surroundings had not; it survives a turn, of which likeness makes another thing.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

# --- a box in a picture, and what of a picture lies in it ---

Image = NDArray[np.uint8]  # (height, width, 3), blue green red

SAME_SHARE = 0.5  # of the smaller box that lies in the larger: they are one place


class Box(NamedTuple):
    """A region of a frame, pixels from the outer corner of its upper left one."""

    x: float
    y: float
    width: float
    height: float

    @property
    def centre_px(self) -> tuple[float, float]:
        """(u, v) from the centre of the upper left pixel, as every other pixel position."""
        return self.x + self.width / 2 - 0.5, self.y + self.height / 2 - 0.5

    @property
    def area_px(self) -> float:
        return self.width * self.height

    def grown(self, factor: float) -> Box:
        """Of `factor` times the sides, about the same middle."""
        width, height = self.width * factor, self.height * factor
        return Box(self.x - (width - self.width) / 2, self.y - (height - self.height) / 2, width, height)

    def moved(self, across_px: float, down_px: float) -> Box:
        return self._replace(x=self.x + across_px, y=self.y + down_px)

    def inside(self, size: tuple[int, int]) -> Box:
        """What of it lies in a picture of (width, height); a side is 0 where nothing does."""
        left, top = max(self.x, 0.0), max(self.y, 0.0)
        right, bottom = min(self.x + self.width, size[0]), min(self.y + self.height, size[1])
        return Box(left, top, max(right - left, 0.0), max(bottom - top, 0.0))


def common_px(a: Box, b: Box) -> float:
    """Area that lies in both, pixels."""
    width = min(a.x + a.width, b.x + b.width) - max(a.x, b.x)
    height = min(a.y + a.height, b.y + b.height) - max(a.y, b.y)
    return max(width, 0.0) * max(height, 0.0)


def overlap(a: Box, b: Box) -> float:
    """Intersection over union, 0 to 1."""
    both = common_px(a, b)
    return both / (a.area_px + b.area_px - both) if both else 0.0


def same(a: Box, b: Box) -> bool:
    """Whether two boxes show one thing, if not its whole."""
    return common_px(a, b) >= SAME_SHARE * min(a.area_px, b.area_px)


def uncut(box: Box, whole: Box, size: tuple[int, int]) -> Box:
    """The box as it would be without the picture's border, at which trackers cut it: as large as when it was whole."""
    x, y, width, height = box
    if (x <= 1) != (x + width >= size[0] - 1) and whole.width > width:
        x, width = (x + width - whole.width if x <= 1 else x), whole.width
    if (y <= 1) != (y + height >= size[1] - 1) and whole.height > height:
        y, height = (y + height - whole.height if y <= 1 else y), whole.height
    return Box(x, y, width, height)


def cut(image: Image, box: Box, size: tuple[int, int]) -> Image:
    """What a box shows, resampled to size (width, height); beyond the picture its border goes on."""
    left, top = round(box.x), round(box.y)
    right, bottom = max(round(box.x + box.width), left + 1), max(round(box.y + box.height), top + 1)
    height, width = image.shape[:2]
    rows = slice(min(max(top, 0), height - 1), max(min(bottom, height), 1))
    columns = slice(min(max(left, 0), width - 1), max(min(right, width), 1))
    part = image[rows, columns]
    if (bottom - top, right - left) != part.shape[:2]:
        missing_rows, missing_columns = bottom - top - part.shape[0], right - left - part.shape[1]
        above, before = min(max(-top, 0), missing_rows), min(max(-left, 0), missing_columns)
        below, after = missing_rows - above, missing_columns - before
        part = np.asarray(cv2.copyMakeBorder(part, above, below, before, after, cv2.BORDER_REPLICATE), np.uint8)
    shrinks = size[0] < part.shape[1]
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR), np.uint8)


# --- colours that a thing has and its surroundings have not ---
#
# A histogram of colours inside the box that was drawn, and one of all around it, give for each colour the chance that
# it belongs to the thing (Bayes, with even odds). Colours are taken relative to the mean of the whole frame, channel
# by channel, so that neither the lamp nor the tint of the water counts. Pose does not count either: a fish that turns
# keeps its colours.

BINS = 16  # of each channel
BLUR_BINS = 1.0  # colours one bin apart are nearly one: exposure and distance move them by as much
SURROUNDINGS = 3.0  # boxes: what is compared with
LEVEL = 96.0  # to which a frame's mean is brought in each channel
LARGEST_GAIN = 3.0  # of a channel: water takes red away nearly wholly, and what is left is noise
RARE = 2e-4  # share of pixels below which a colour says nothing
SIDE_PX = 32  # of the pictures whose colours are counted


class Colours(NamedTuple):
    """What tells a thing from the rest of its first picture."""

    chances: NDArray[np.float32]  # (BINS, BINS, BINS), that a pixel of this colour belongs to the thing
    mixture: NDArray[np.float32]  # the same shape: how much of each colour it has, each weighted by that chance; sum 1
    weight: float  # the sum before: which part of it has colours of its own
    contrast: float  # by how much the chance is higher over the thing than over its surroundings, 0 to 1


def learn(image: Image, box: Box) -> Colours:
    """What tells the thing in this box from the rest of the picture."""
    gains = gains_of(image)
    side = round(SIDE_PX * SURROUNDINGS)
    around = balanced(cut(image, box.grown(SURROUNDINGS), (side, side)), gains)
    inside = _ellipse(side, 1.0 / SURROUNDINGS) > 0
    beyond = _ellipse(side, 1.25 / SURROUNDINGS) == 0  # the edge between is either
    its, others = _counts(around[inside]), _counts(around[beyond])
    whole = balanced(np.asarray(cv2.resize(image, (96, 72), interpolation=cv2.INTER_AREA), np.uint8), gains)
    others = np.maximum(others, 0.5 * _counts(whole.reshape(-1, 3)))
    chances = (its / (its + others + RARE)).astype(np.float32)
    weighted = chances * its
    weight = max(float(weighted.sum()), 1e-6)
    contrast = weight - float((chances * _counts(around[beyond])).sum())
    return Colours(chances, np.asarray(weighted / weight, np.float32), weight, contrast)


def gains_of(image: Image) -> NDArray[np.float32]:
    """(3,) by which a frame's channels are multiplied before its colours are compared."""
    means = np.asarray(cv2.mean(image)[:3], np.float32)
    return np.asarray(np.minimum(LEVEL / np.maximum(means, 1.0), LARGEST_GAIN), np.float32)


def balanced(image: Image, gains: NDArray[np.float32]) -> Image:
    return np.asarray(np.minimum(image * gains, 255.0), np.uint8)


def agreement(colours: Colours, image: Image, box: Box, gains: NDArray[np.float32]) -> float:
    """How much of its own colours, in their mixture, an ellipse in the box shows.

    Bhattacharyya's coefficient of the two weighted histograms: 1 for the box that was drawn, 0 where none of its
    colours is.
    """
    here = balanced(cut(image, box, (SIDE_PX, SIDE_PX)), gains)
    weighted = colours.chances * _counts(here[_ellipse(SIDE_PX, 1.0) > 0])
    return min(float(np.sqrt(weighted * colours.mixture / colours.weight).sum()), 1.0)


def chance_of(colours: Colours, image: Image) -> NDArray[np.float32]:
    """For each pixel of a balanced picture the chance that it belongs to the thing."""
    b, g, r = (image[..., channel] // (256 // BINS) for channel in range(3))
    return np.asarray(colours.chances[b, g, r], np.float32)


def _counts(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(BINS, BINS, BINS) share of the pixels (n, 3) in each bin, blurred."""
    bins = (pixels // (256 // BINS)).astype(np.int64)
    index = (bins[:, 0] * BINS + bins[:, 1]) * BINS + bins[:, 2]
    counts = np.bincount(index, minlength=BINS**3).reshape(BINS, BINS, BINS).astype(np.float32)
    counts /= max(len(pixels), 1)
    kernel = np.exp(-0.5 * (np.arange(-2, 3) / BLUR_BINS) ** 2).astype(np.float32)
    kernel /= kernel.sum()
    for axis in range(3):
        lines = np.moveaxis(counts, axis, 0).reshape(BINS, -1)
        blurred = cv2.sepFilter2D(lines, -1, np.ones(1, np.float32), kernel, borderType=cv2.BORDER_REPLICATE)
        counts = np.asarray(np.moveaxis(blurred.reshape(BINS, BINS, BINS), 0, axis), np.float32)
    return counts


def _ellipse(side: int, share_of_side: float) -> NDArray[np.uint8]:
    """(side, side) mask of an ellipse in the middle."""
    mask, middle = np.zeros((side, side), np.uint8), (side // 2, side // 2)
    radius = max(round(0.5 * share_of_side * side), 1)
    return np.asarray(cv2.circle(mask, middle, radius, 255, -1), np.uint8)


# --- likeness, and search of a whole picture ---

PATCH_PX = 24  # longer side of the small pictures: a defocused thing still looks like itself
SEARCH_PX = 14  # the same where a whole picture is searched: a third of the time
SEARCH_WIDTH_PX = 176  # of the picture that is searched, at most: small things are looked for in less detail
RIM = 1.3  # of the box is in the picture
PLAY = 0.15  # of the box: how far a good box may be off
NEAR_SCALES = (0.8, 1.0, 1.25)  # in which a lost thing is looked for: it may have come nearer or gone away
ANY_SCALE = (0.5, 0.64, 0.8, 1.0, 1.25, 1.56, 1.95)  # and one that has not been seen yet
FINE_SIZES = (0.8, 0.89, 1.0, 1.12, 1.25)  # between those of a search
PEAKS = 4  # best places in each size
PLACES = 8  # that are looked at more closely: each takes a millisecond
TELLING = 0.15  # least difference in chance between a thing and its surroundings for colours to tell it
BESIDE = 5.0  # boxes: where look-alikes of a followed thing are looked for
NEARLY = 0.1  # two places that differ by less in likeness are equally like it


class Appearance(NamedTuple):
    """What is remembered of a thing: pictures (h, w, 3), longer side PATCH_PX, of its box and a rim; its colours."""

    first: Image
    newest: Image
    colours: Colours


class Likeness(NamedTuple):
    """How much a box shows what is remembered."""

    shape: float  # correlation, -1 to 1, best over a little shift
    colour: float  # share of its colours, 0 to 1

    @property
    def least(self) -> float:
        return min(self.shape, self.colour)


class Place(NamedTuple):
    """Where something like it is."""

    box: Box
    like: Likeness


def remember(image: Image, box: Box) -> Appearance:
    patch = cut(image, box.grown(RIM), _size(box))
    return Appearance(patch, patch, learn(image, box))


def renewed(appearance: Appearance, image: Image, box: Box) -> Appearance:
    """The same thing, but the newest picture is that of `box`; colours stay those of the first."""
    return appearance._replace(newest=cut(image, box.grown(RIM), _shape(appearance)))


def likeness(appearance: Appearance, image: Image, box: Box) -> Likeness:
    """How much what is in the box is like what is remembered."""
    shape, _ = _aligned(appearance, image, box)
    return Likeness(shape, agreement(appearance.colours, image, box, gains_of(image)))


def _aligned(appearance: Appearance, image: Image, box: Box) -> tuple[float, Box]:
    """Correlation with what is remembered, and the box moved by the little shift at which it is best."""
    width, height = _shape(appearance)
    beside, below = max(round(PLAY * width), 1), max(round(PLAY * height), 1)  # whole pixels: the same grid
    size = width + 2 * beside, height + 2 * below
    wide = _about(box, box.width * RIM * size[0] / width, box.height * RIM * size[1] / height)
    here, best, moved = cut(image, wide, size), -1.0, box
    for patch in _patches(appearance):
        _, shape, _, (x, y) = cv2.minMaxLoc(_correlate(here, patch))
        if shape > best:
            step = wide.width / size[0], wide.height / size[1]
            best, moved = shape, box.moved((x - beside) * step[0], (y - below) * step[1])
    return best, moved


def fitted(appearance: Appearance, image: Image, place: Place) -> Place:
    """The same place, a little larger or smaller and moved, so that its shape is most like what is remembered."""
    shape, box = max(_aligned(appearance, image, place.box.grown(size)) for size in FINE_SIZES)
    return Place(box, Likeness(shape, agreement(appearance.colours, image, box, gains_of(image))))


def _about(box: Box, width: float, height: float) -> Box:
    """Of another size about the same middle."""
    return Box(box.x - (width - box.width) / 2, box.y - (height - box.height) / 2, width, height)


def search(appearance: Appearance, image: Image, last: Box, scales: tuple[float, ...] = NEAR_SCALES) -> list[Place]:
    """Places of the whole picture that are most like what is remembered, best first, no two of them the same.

    They are `scales` times as large as `last`. There is none where the picture is smaller than the thing.
    """
    shorter = SEARCH_WIDTH_PX / image.shape[1] * last.width * RIM / _shape(appearance)[0]
    return _places(appearance, image, _found(appearance, image, last, scales, min(SEARCH_PX / PATCH_PX, shorter)))


def beside(appearance: Appearance, image: Image, box: Box, like: Likeness) -> list[Place]:
    """Other places about a box, up to twice its size away, that are nearly as like what is remembered."""
    window = box.grown(BESIDE).inside((image.shape[1], image.shape[0]))
    left, top = int(window.x), int(window.y)
    part = image[top : int(window.y + window.height), left : int(window.x + window.width)]
    found = [
        (shape, there.moved(left, top))
        for shape, there in _found(appearance, part, box, (1.0,), SEARCH_PX / PATCH_PX)
        if shape >= like.shape - 2.0 * NEARLY and not same(there.moved(left, top), box)
    ]
    return [
        place
        for place in _places(appearance, image, found)
        if place.like.shape >= like.shape - NEARLY and place.like.colour >= like.colour - NEARLY
    ]


def _found(
    appearance: Appearance, image: Image, last: Box, scales: tuple[float, ...], shorter: float
) -> list[tuple[float, Box]]:
    """Peaks of the correlation in each size, with patches `shorter` times as long as they are remembered."""
    found: list[tuple[float, Box]] = []
    width, height = (max(3, round(side * shorter)) for side in _shape(appearance))
    patches = [cv2.resize(patch, (width, height), interpolation=cv2.INTER_AREA) for patch in _patches(appearance)]
    beyond = [round(side * (1.0 - 1.0 / RIM) / 2.0) for side in (width, height)]  # of a box at the border, its rim
    for scale in scales:
        shrink = width / (last.width * RIM * scale)
        size = round(image.shape[1] * shrink), round(image.shape[0] * shrink)
        if size[0] + 2 * beyond[0] <= width or size[1] + 2 * beyond[1] <= height:
            continue
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrink < 1.0 else cv2.INTER_LINEAR)
        wide = cv2.copyMakeBorder(small, beyond[1], beyond[1], beyond[0], beyond[0], cv2.BORDER_REPLICATE)
        alike = np.max([_correlate(np.asarray(wide, np.uint8), np.asarray(patch, np.uint8)) for patch in patches], 0)
        for shape, x, y in _peaks(alike, width // 2, height // 2):
            corner = (x - beyond[0]) / shrink, (y - beyond[1]) / shrink
            found.append((shape, Box(*corner, width / shrink, last.height * RIM * scale).grown(1.0 / RIM)))
    return found


def _places(appearance: Appearance, image: Image, found: list[tuple[float, Box]]) -> list[Place]:
    if not found:
        return []
    gains, places = gains_of(image), list[Place]()
    for _, box in sorted(found, reverse=True):
        if len(places) < PLACES and not any(same(box, other.box) for other in places):
            shape, aligned = _aligned(appearance, image, box)  # the search is too coarse to say how like it is
            places.append(Place(aligned, Likeness(shape, agreement(appearance.colours, image, aligned, gains))))
    return sorted(places, key=lambda place: -place.like.least)


def coloured(appearance: Appearance, image: Image, like: Box) -> list[Box]:
    """Boxes of the size of `like` that stand out from what is around them by the thing's colours, of any outline.

    They do so at least half as much as the thing did itself. There is none where its colours do not tell it from its
    surroundings.
    """
    if appearance.colours.contrast < TELLING:
        return []
    shrink = min(1.0, 8.0 / min(like.width, like.height))
    size = max(round(image.shape[1] * shrink), 8), max(round(image.shape[0] * shrink), 8)
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    chances = chance_of(appearance.colours, balanced(small, gains_of(image)))
    width, height = max(round(like.width * shrink), 3), max(round(like.height * shrink), 3)
    inside = cv2.blur(chances, (width, height), borderType=cv2.BORDER_REPLICATE)
    around = cv2.blur(chances, (2 * width + 1, 2 * height + 1), borderType=cv2.BORDER_REPLICATE)
    stands_out = np.asarray((inside - around) * 4.0 / 3.0, np.float32)  # around without the inside, which is a quarter
    own = appearance.colours.contrast
    return [
        Box((x + 0.5) / shrink - like.width / 2, (y + 0.5) / shrink - like.height / 2, like.width, like.height)
        for contrast, x, y in _peaks(stands_out, width // 2, height // 2, 12)
        if contrast > 0.5 * own
    ]


def _peaks(values: NDArray[np.float32], beside: int, below: int, most: int = PEAKS) -> list[tuple[float, int, int]]:
    """The highest values with their columns and rows, no two of them closer than `beside` and `below`."""
    left, peaks = values.copy(), []
    for _ in range(most):
        _, highest, _, (x, y) = cv2.minMaxLoc(left)
        if highest <= 0.0:
            break
        peaks.append((float(highest), x, y))
        left[max(y - below, 0) : y + below + 1, max(x - beside, 0) : x + beside + 1] = -1.0
    return peaks


def _patches(appearance: Appearance) -> tuple[Image, ...]:
    same = appearance.first is appearance.newest
    return (appearance.first,) if same else (appearance.first, appearance.newest)


def _size(box: Box) -> tuple[int, int]:
    longer = max(box.width, box.height)
    return max(4, round(PATCH_PX * box.width / longer)), max(4, round(PATCH_PX * box.height / longer))


def _shape(appearance: Appearance) -> tuple[int, int]:
    return appearance.first.shape[1], appearance.first.shape[0]


def _correlate(image: Image, patch: Image) -> NDArray[np.float32]:
    """-1 to 1 for every place of the patch in the image; each colour's mean is taken off first."""
    found = np.asarray(cv2.matchTemplate(image, patch, cv2.TM_CCOEFF_NORMED), np.float32)
    return np.nan_to_num(np.clip(found, -1.0, 1.0), nan=-1.0)
