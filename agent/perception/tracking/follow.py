"""Follow a thing from a box that is drawn around it, say when it is lost, and find it again.

The tracker's own score says nothing: it is as high on the thing, beside it and without it. Four things have to hold
instead. The box moves on as it moved before, and keeps its size. Most of it lies in the picture. It shows the colours
that the thing had in its first picture. It looks like that picture, or like the newest that was certain. Else it is
lost, and the whole picture is searched. What is like it there is taken for it only where it can have got to by now and
where no look-alike can be; where one can, or two places are equally like it, that is ambiguous. So it is from where a
look-alike that was seen beside it and the box come to be one, until both are seen and each goes on as it went.

The tracker is NanoTrack where its files are given, else a correlation filter.
"""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError, read_file
from agent.perception.tracking.appearance import (
    ANY_SCALE,
    NEAR_SCALES,
    NEARLY,
    RIM,
    Appearance,
    Box,
    Colours,
    Image,
    Likeness,
    Place,
    balanced,
    beside,
    chance_of,
    coloured,
    cut,
    fitted,
    gains_of,
    learn,
    likeness,
    remember,
    renewed,
    same,
    search,
    uncut,
)
from agent.perception.tracking.distractors import (
    BETTER,
    CERTAIN,
    LookAlike,
    Meeting,
    Motion,
    Seen,
    Surveys,
    beginning,
    followed,
    merged,
    touched,
    unexplained,
)

# --- the follower ---

# Chosen on clips made of goldfish_turns and of seven buoys (tests/perception/tracking/loss_clips.py, tuned).
HOLD_SHAPE, SURE_SHAPE = 0.40, 0.60  # a turning fish has 0.9 and more from frame to frame, after half a second 0.4
# A shape as strong as that is held with few of the colours: those of a plain fish fade into grey water as it turns. It
# is not certain, so that nothing is learnt from it.
STRONG_SHAPE, LEAST_COLOUR = 0.65, 0.20
LATELY = 0.1  # weight of the newest picture in that: a third of a second
FOUND_LIKE = 0.70  # of a place that is taken for it; with 0.60 a tetra and a buoy that were away were found elsewhere
# The same where others of its kind are about: of the fish that is away other fish reach 0.8, buoys come back with 0.9.
# Where nothing is somewhat like it, one that has turned meanwhile is still found.
AGAIN_LIKE = 0.84
RIVAL_LIKE = 0.40  # from here on a place is taken for a look-alike
CLEAR = 0.9  # of the most: a tenth may be hidden
LEAST_SHARE = 0.4  # of the box that has to be in the picture: what is left does not tell what it is
MIN_SIDE_PX = 8  # of a box that can be followed


class Limits(NamedTuple):
    """How soon a thing is said to be lost: points of one curve, between never wrong and never let go."""

    hold_colour: float  # likeness in colour below which it is lost, unless its shape is strong
    sure_colour: float  # certain from here on, of what it was lately: a fish turns slowly, what hides it comes at once
    patience: int  # frames in a row that need not be certain


# Marked boxes: goldfish 0.70 to 1, buoys 0.73 to 1, a neon tetra that turns 0.48; red as yellow 0. STRICT waits
# for less than half a second. With KEEP 29 % instead of 44 % of 706 frames of other fish, which were there, were called
# lost; on the clips of experiment track-loss the two differ by 1 %.
STRICT, KEEP = Limits(0.45, 0.75, 12), Limits(0.25, 0.5, 45)
LIMITS = {"strict": STRICT, "keep": KEEP}

State = Literal["followed", "found again", "ambiguous", "lost"]
FOLLOWED: tuple[State, State] = ("followed", "found again")


class Followed(NamedTuple):
    box: Box  # while it is lost or ambiguous: where it was last seen
    score: float  # 0 to 1, the weaker witness; 0 while it is lost or ambiguous
    state: State
    reach_px: float = 0.0  # while it is lost or ambiguous: how far from there its middle may be by now

    @property
    def lost(self) -> bool:
        """Whether nothing can be measured."""
        return self.state not in FOLLOWED


class Follower:
    """Give it every frame of one size; it begins to follow at start(), or to look around at expect()."""

    def __init__(self, tracker: BoxTracker, limits: Limits = STRICT) -> None:
        self._tracker, self._limits = tracker, limits
        self._appearance: Appearance | None = None
        self._motion = Motion(Box(0, 0, 0, 0))
        self._whole = Box(0, 0, 0, 0)  # the newest that no border cut
        self._lost, self._seen = True, False
        self._unsure = 0  # frames since it was certain
        self._colour = 1.0  # likeness in colour lately
        self._pictures: deque[tuple[float, Image]] = deque(
            maxlen=limits.patience
        )  # the newest, with their likeness in colour
        self._beside: list[LookAlike] = []  # seen near by while it is followed
        self._meeting: Meeting | None = None  # with one of these
        self._others: list[LookAlike] | None = None  # None: there was no look since it was lost
        self._frame = 0  # frames since it was started
        self._surveys = Surveys()

    def expect(self, picture: Image, box: Box) -> None:
        """Look for what is in this box of another picture: it may be anywhere, and nearer or farther.

        Raises ConfigError as start() does.
        """
        check_box(box, (picture.shape[1], picture.shape[0]))
        self._appearance, self._motion, self._whole = remember(picture, box), Motion(box), box
        self._lost, self._seen, self._others, self._colour = True, False, None, 1.0
        self._surveys.clear()

    def start(self, image: Image, box: Box) -> None:
        """Follow what is in this box from now on. Raises ConfigError for one that is not in the picture."""
        check_box(box, (image.shape[1], image.shape[0]))
        self._tracker.start(image, box)
        self._appearance, self._motion, self._whole = remember(image, box), Motion(box), box
        self._lost, self._seen, self._unsure, self._colour = False, True, 0, 1.0
        self._beside, self._meeting, self._others = [], None, None
        self._surveys.clear()
        self._survey(image, self._appearance, box)

    def look(self, image: Image) -> Followed:
        """Where it is in the next picture. Raises RuntimeError before start() or expect()."""
        if self._appearance is None:
            raise RuntimeError("call start() or expect() before look()")
        self._frame += 1
        return self._search(image, self._appearance) if self._lost else self._follow(image, self._appearance)

    def _survey(self, image: Image, appearance: Appearance, box: Box) -> None:
        """What else is like it, in a frame in which it is surely in this box."""
        places = self._lately(search(appearance, image, box, NEAR_SCALES))
        others = [place for place in places if place.like.least >= RIVAL_LIKE and not same(place.box, box)]
        self._surveys.add(self._frame, [Seen(place.box, place.like.least) for place in others])

    def _follow(self, image: Image, appearance: Appearance) -> Followed:
        box = self._tracker.follow(image)
        size = image.shape[1], image.shape[0]
        whole = uncut(box, self._whole, size)
        inside = whole.inside(size)
        share = inside.area_px / whole.area_px
        like = Likeness(-1.0, 0.0)
        if usable(inside) and self._motion.allows(whole) and share >= LEAST_SHARE:
            like = likeness(appearance, image, whole)
        sure = like.shape >= SURE_SHAPE and like.colour >= self._limits.sure_colour * self._colour
        strong = like.shape >= STRONG_SHAPE and like.colour >= LEAST_COLOUR
        self._unsure = 0 if sure else self._unsure + (not strong)
        weak = like.shape < HOLD_SHAPE or (like.colour < self._limits.hold_colour and not strong)
        if weak or self._unsure > self._limits.patience:
            self._lost, self._others = True, self._beside or None
            if self._pictures:
                appearance = self._appearance = appearance._replace(newest=_clearest(self._pictures))
            return self._search(image, appearance)  # it may have jumped
        near = [Seen(place.box, place.like.least) for place in beside(appearance, image, whole, like)]
        others = [one for one in followed(self._beside, near) if one.seen > 1 or not touched([one], whole)]
        if other := merged(others, whole, like.least - NEARLY):  # from here on the tracker may be on either
            self._lost, self._others, self._meeting = True, others, Meeting(self._motion, other.motion)
            return self._search(image, appearance)
        self._beside = others
        self._motion = self._motion.seen(whole)
        if sure:
            self._colour += LATELY * (like.colour - self._colour)
        if share > 0.999 and sure and not touched(others, whole.grown(RIM)):
            self._whole = whole
            self._appearance = renewed(appearance, image, box)
            self._pictures.append((like.colour, self._appearance.newest))
            self._tracker.learn(image, box)
        if sure and self._surveys.due(self._frame):
            self._survey(image, appearance, whole)
        return Followed(box, max(like.least, 0.0), "followed")

    def _search(self, image: Image, appearance: Appearance) -> Followed:
        places = self._lately(search(appearance, image, self._whole, NEAR_SCALES if self._seen else ANY_SCALE))
        if not self._seen:
            return self._choose(image, appearance, [place for place in places if place.like.least >= FOUND_LIKE], [])
        if self._meeting is not None:
            least = max(FOUND_LIKE, places[0].like.least - BETTER) if places else 0.0
            both = [place for place in places if place.like.least >= least and self._meeting.reaches(place.box)]
            if both:
                return self._part(image, appearance, self._meeting, both)
            self._meeting = None  # neither is seen: whatever comes up is searched for
        rivals = [Seen(place.box, place.like.least) for place in places if place.like.least >= RIVAL_LIKE]
        tinted = [box for box in coloured(appearance, image, self._whole) if not any(same(box, r.box) for r in rivals)]
        rivals += [Seen(box, RIVAL_LIKE) for box in tinted]
        free = unexplained(self._others or (), rivals)
        near = [place for place in places if self._motion.reaches(place.box)]
        elsewhere = [place for place in rivals if place.box not in free or not self._motion.reaches(place.box)]
        least = max(self._enough, self._surveys.surpass(self._frame, elsewhere) + NEARLY)
        mine = [place for place in near if place.like.least >= least and place.box in free]
        result = self._choose(image, appearance, mine, [place for place in near if place.box not in free])
        if result.lost:
            self._others = followed(self._others or (), elsewhere)
            self._motion = self._motion.missed()
            if self._surveys.due(self._frame):
                self._surveys.add(self._frame, elsewhere)
        return result

    @property
    def _enough(self) -> float:
        """How like it a place has to be at least that is taken for it."""
        return FOUND_LIKE if self._surveys.empty else AGAIN_LIKE

    def _lately(self, places: Iterable[Place]) -> list[Place]:
        """The same, best first, by how much of the colours each shows that the thing showed lately, not at first.

        But what would not be held is not found, or each finding would lower the measure for the next.
        """
        usual = max(self._colour, self._limits.hold_colour / self._enough)
        fair = [
            place._replace(like=place.like._replace(colour=min(place.like.colour / usual, 1.0))) for place in places
        ]
        return sorted(fair, key=lambda place: -place.like.least)

    def _choose(self, image: Image, appearance: Appearance, mine: list[Place], others: list[Place]) -> Followed:
        """The one place that it can be; ambiguous where there are two, or one that a look-alike can be at."""
        if not mine or (len(mine) > 1 and mine[1].like.least > mine[0].like.least - NEARLY):
            unclear = bool(mine) or any(place.like.least >= FOUND_LIKE for place in others)
            return self._unseen("ambiguous" if unclear else "lost")
        return self._take(image, appearance, mine[0], self._others or ())

    def _part(self, image: Image, appearance: Appearance, meeting: Meeting, both: list[Place]) -> Followed:
        """It and a look-alike have met, and are at these places, or one of them behind the other."""
        boxes = {place.box: place for place in both}
        self._meeting = meeting.next(apart=len(boxes) > 1)
        parted = meeting.parted([*boxes])
        if parted is None:
            self._motion = self._motion.missed()
            return self._unseen("ambiguous")
        mine, its = parted
        found = self._take(image, appearance, boxes[mine], [beginning(Seen(its, boxes[its].like.least), CERTAIN)])
        self._motion = self._motion._replace(step_px=meeting.thing.step_px)  # they may still be close
        return found

    def _unseen(self, state: State) -> Followed:
        return Followed(self._motion.box, 0.0, state, self._motion.reach_px)

    def _take(self, image: Image, appearance: Appearance, place: Place, others: Collection[LookAlike]) -> Followed:
        """It is here."""
        box, like = fitted(appearance, image, place)
        self._tracker.start(image, box)
        again: State = "found again" if self._seen else "followed"
        self._motion, self._whole, self._lost, self._seen = Motion(box), box, False, True
        self._unsure, self._colour, self._meeting = 0, like.colour, None
        self._pictures.clear()
        self._beside = [other for other in others if not same(other.motion.box, box)]
        return Followed(box, like.least, again)


def _clearest(pictures: Collection[tuple[float, Image]]) -> Image:
    """The newest that shows nearly as much of the thing's colours as any: later ones may show what hides it."""
    most = max(colour for colour, _ in pictures)
    return [picture for colour, picture in pictures if colour >= CLEAR * most][-1]


def usable(box: Box) -> bool:
    return min(box.width, box.height) >= MIN_SIDE_PX


def parse_box(text: str) -> Box:
    """X,Y,W,H in pixels. Raises ConfigError."""
    try:
        box = Box(*(float(side) for side in text.split(",")))
    except (TypeError, ValueError):
        raise ConfigError(f"--box {text}: write four numbers X,Y,W,H, pixels from the upper left corner") from None
    if not all(math.isfinite(side) for side in box):
        raise ConfigError(f"--box {text}: not finite; write four numbers X,Y,W,H")
    return box


def check_box(box: Box, size: tuple[int, int]) -> None:
    """Raises ConfigError for a box too small to follow or not inside a picture of size (width, height)."""
    inside = box.x >= 0 and box.y >= 0 and box.x + box.width <= size[0] and box.y + box.height <= size[1]
    if not inside or not usable(box):
        raise ConfigError(
            f"box {','.join(f'{side:g}' for side in box)}: draw it inside the {size[0]}x{size[1]} picture, "
            f"at least {MIN_SIDE_PX} pixels wide and high"
        )


# --- trackers of a box from frame to frame ---
#
# NanoTrack is a small siamese network that OpenCV runs (cv2.TrackerNano). It is version 2, as published in
# HonglinChu/SiamTrackers (NanoTrack/models/nanotrackv2, Apache-2.0); version 3 has another head, on which OpenCV 5.0
# fails in its first update.

# SHA-256 of the published files; the follower's thresholds were measured with them.
MOST_BYTES = 2**24  # of one of its two files, which have 1 MB
BACKBONE = ("nanotrack_backbone_sim.onnx", "530bdd0cd00f19afab79a863e71ba71e3312395a5dc9151af675082bdaaa2fc4")
NECK = ("nanotrack_head_sim.onnx", "0d8c0637be849f092cc7236cae02e55c8b9455ebe37ba50601d6115db4247cd9")


class BoxTracker(Protocol):
    """Follows whatever it was started on, and never says that it is gone."""

    def start(self, image: Image, box: Box) -> None: ...

    def follow(self, image: Image) -> Box:
        """Where it is now, or whatever is taken for it. Call start() first."""

    def learn(self, image: Image, box: Box) -> None:
        """This is the thing, beyond doubt."""


class Nano:
    """NanoTrack V2, of `load_nano`."""

    def __init__(self, tracker: cv2.TrackerNano) -> None:
        self._tracker = tracker

    def start(self, image: Image, box: Box) -> None:
        self._tracker.init(image, whole_pixels(image, box))

    def follow(self, image: Image) -> Box:
        _, box = self._tracker.update(image)  # its flag is always true, and its score is high without a target too
        return Box(*(float(side) for side in box))

    def learn(self, image: Image, box: Box) -> None:
        """It keeps to the picture with which it was started."""


def whole_pixels(image: Image, box: Box) -> tuple[int, int, int, int]:
    """What of a box lies in the picture, at least two pixels each way."""
    height, width = image.shape[:2]
    left, top = min(max(round(box.x), 0), width - 2), min(max(round(box.y), 0), height - 2)
    right, bottom = min(round(box.x + box.width), width), min(round(box.y + box.height), height)
    return left, top, max(right - left, 2), max(bottom - top, 2)


def model_files(folder: Path) -> tuple[Path, Path]:
    """Backbone and neck by the names under which they are published."""
    return folder / BACKBONE[0], folder / NECK[0]


def load_box_tracker(nanotrack: tuple[Path, Path] | None) -> BoxTracker:
    """NanoTrack from its two files, backbone and neck, else a correlation filter. Raises ConfigError as load_nano."""
    return CorrelationTracker() if nanotrack is None else load_nano(*nanotrack)


def load_nano(backbone: Path, neckhead: Path) -> Nano:
    """Raises ConfigError for files that are not the published ones of NanoTrack V2."""
    for path, (name, digest) in ((backbone, BACKBONE), (neckhead, NECK)):
        data = read_file(path, MOST_BYTES, "give the two ONNX files of NanoTrack V2 as backbone and neck")
        if hashlib.sha256(data).hexdigest() != digest:
            raise ConfigError(f"{path}: is not {name} of NanoTrack V2 (its SHA-256 differs); take it from its authors")
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # it warns of targets that are not asked for
    try:
        parameters = cv2.TrackerNano.Params()
        parameters.backbone, parameters.neckhead = str(backbone), str(neckhead)
        return Nano(cv2.TrackerNano.create(parameters))
    finally:
        cv2.utils.logging.setLogLevel(level)


# --- correlation filter: needs no file, learns what it follows, and keeps its colours ---
#
# What makes the box's middle ring and everything around it silent, in the least squares sense, is a filter whose
# spectrum is a quotient of sums over the pictures learnt so far (MOSSE, Bolme 2010; several channels over one
# denominator as in DSST, Danelljan 2014). Its answer is mixed with where the thing's colours are (Staple, Bertinetto
# 2016), because a fish that turns changes its outline but not its colours. Three sizes are tried in each frame.

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
