"""Whether balls of two colours are told apart, in the light of their pictures and in others.

Each search is asked about the other's paint, by the rules by which it judges what it finds in a frame. A sample brings
the paint with it, as its picture shows it. A named colour has one of the hue at which it is looked for, moderately
strong, on grey.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agent.perception.detection.colour import ColourModel, Sample, tone_of, weights
from agent.perception.detection.other_light import LIGHTS, Change
from agent.perception.detection.picture import ENCODED

GREY = 0.07  # light around a named paint: dark enough for none of the lights to burn the paint out
STRENGTH = 1.0  # of a named paint against it, logarithm of light: between a ball near by and one far away


class Sought(NamedTuple):
    """A colour that is looked for, and how a thing of it looks."""

    model: ColourModel
    sample: Sample


def named_paint(model: ColourModel) -> Sample:
    """One pixel of a paint of the model's hue, and one of grey around it."""
    light = GREY * np.exp(STRENGTH * np.stack([weights(model.hue_rad) / 1.5, np.zeros(3)]))  # 1.5: see weights()
    values = np.rint(255.0 * light ** (1.0 / ENCODED)).astype(np.uint8)
    return Sample(values[:1], values[1:])


def mistaken_in(one: Sought, other: Sought) -> str | None:
    """The first of LIGHTS in which a thing of one colour counts for the other as well; None where there is none."""
    pairs = (one.model, other.sample), (other.model, one.sample)
    for name, change in LIGHTS.items():
        if any(model.fits(tone_of(_in_light(change, sample)), 0.0) for model, sample in pairs):
            return name
    return None


def _in_light(change: Change, sample: Sample) -> Sample:
    return Sample(change(sample.thing), change(sample.around))
