"""Does a box still show what it showed when somebody drew it, and if not, where in the picture could that be now?

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

from agent.perception.tracking.box import Box, Image, cut, same
from agent.perception.tracking.colours import Colours, agreement, balanced, chance_of, gains_of, learn

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
    """Places of the whole picture that are most like what is remembered, best first, no two of them the same;
    `scales` times as large as `last`. None where the picture is smaller than the thing."""
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
    """Boxes of the size of `like` that stand out from what is around them by the thing's colours, whatever their
    outline: half as much as it did itself. None where its colours do not tell it from its surroundings."""
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
