"""The table [lighting] of fleet.toml: water and lamps as somebody measured them, and how lamps are lent."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

Coefficient = Annotated[float, Meta(gt=0, le=20)]
Bands = tuple[Coefficient, Coefficient, Coefficient]  # blue, green, red


class Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """As config.Struct, which imports this file."""


class WaterOptics(Struct, frozen=True, kw_only=True):
    """Beam attenuation is the sum of both. Measured by an instrument: pictures do not tell one from the other."""

    absorption_per_m: Bands
    scattering_per_m: Bands


class Beam(Struct, frozen=True, kw_only=True):
    """A lamp of the fleet; all are alike. Flat to 0.8 of the half angle, nothing beyond 1.2 of it."""

    intensity_w_sr: Annotated[float, Meta(gt=0)] = 1.2  # on its axis, in each colour, at full power
    half_deg: Annotated[float, Meta(ge=5, le=60)] = 25.0  # in water
    beside_m: Annotated[float, Meta(ge=0.01, le=1)] = 0.12  # to the left of the optical centre, level with it


class Lighting(Struct, frozen=True, kw_only=True):
    """Robots that light for each other. None of it in the fleet file: no lamp burns, every decision as without."""

    water: WaterOptics
    beam: Beam = Beam()
    guard_s: Annotated[float, Meta(gt=0, le=5)] = 0.3  # a sweep waits so long for answers of those asked for light
    gain: Annotated[float, Meta(ge=0)] = 0.10  # of the information that borrowed light must bring, else the own lamp
    follow: bool = False  # lamps are agreed on for who follows what swims, too; else each burns beside its own camera
