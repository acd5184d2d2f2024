"""Vivid things for the training pictures: buoys, fish, starfish, growth, most of them red, orange or yellow.

Sea floors are dull, and a network that sees nothing else learns that warm colours are an error of the water. Green and
blue things are among them, so that it does not learn to paint every buoy yellow either.
"""

from __future__ import annotations

import colorsys
from typing import NamedTuple

import cv2
import numpy as np

from agent.tools.degrade import GAMMA, Picture, Plane
from agent.tools.landscapes import noise

WARM_SHARE = 0.75  # of the things; the others have any other hue
WARM_HUES = ((-0.04, 0.02), (0.04, 0.1), (0.12, 0.175))  # turns of HSV: red, orange, yellow
OTHER_HUES = (0.28, 0.92)  # green to violet; what looks like yellow-green is a yellow thing in green water
RADII = (0.012, 0.3)  # of the picture's side; as many small ones as large ones, by octave
MOST, NEAR = 3, (0.1, 1.2)  # things in a picture; their range, in units of the scene's median
BURNT = 0.3  # of the things have a sunlit top without colour


class Thing(NamedTuple):
    """`mask` (h, w) 0 to 1; `picture` (h, w, 3) linear light blue green red, of use where the mask is."""

    mask: Plane
    picture: Picture


def draw_thing(side: int, rng: np.random.Generator) -> Thing:
    """One thing somewhere in a picture of side x side pixels."""
    radius = float(np.exp(rng.uniform(*np.log(RADII)))) * side
    kind = int(rng.integers(0, 4))  # ball, fish, starfish, growth
    slender = float(rng.uniform(0.35, 0.7)) if kind == 1 else 1.0
    u, v, rho, angle = _coordinates(side, radius, slender, rng)
    edge = np.ones_like(rho)
    if kind == 2:
        edge = np.float32(0.6) + np.float32(0.4) * np.cos(5 * angle)
    elif kind == 3:
        edge = np.clip(np.float32(0.8) + np.float32(0.3) * noise(side, rng, (3, 9)), 0.2, 1.5)
    mask = np.clip((edge - rho) * np.float32(radius * slender) + np.float32(0.5), 0, 1)
    body = _paint(u, side, kind, rng)
    return Thing(np.asarray(mask, np.float32), _lit(body, u, v, rho, rng))


def put_into(picture: Picture, thing: Thing) -> Picture:
    """A picture with the thing in front of it, both in linear light."""
    return np.asarray(picture + thing.mask[:, :, None] * (thing.picture - picture), np.float32)


def with_things(picture: Picture, z: Plane, rng: np.random.Generator) -> tuple[Picture, Plane, Plane]:
    """A scene and its ranges with some things in it, nearer than most of the scene; third, where they are."""
    vivid = np.zeros_like(z)
    for _ in range(int(rng.integers(1, MOST + 1))):
        thing, near = draw_thing(z.shape[0], rng), np.float32(rng.uniform(*NEAR))
        picture = put_into(picture, thing)
        z = z + thing.mask * (near - z)
        vivid = np.maximum(vivid, thing.mask)
    return picture, np.asarray(z, np.float32), vivid


def vivid_colour(rng: np.random.Generator) -> Picture:
    """(3,) blue green red, linear."""
    hues = WARM_HUES[int(rng.integers(0, len(WARM_HUES)))] if rng.random() < WARM_SHARE else OTHER_HUES
    hue = rng.uniform(*hues) % 1
    coded = colorsys.hsv_to_rgb(hue, rng.uniform(0.55, 1.0), rng.uniform(0.4, 1.0))[::-1]
    return np.array(coded, np.float32) ** np.float32(GAMMA)


def _coordinates(side: int, radius: float, slender: float, rng: np.random.Generator) -> tuple[Plane, ...]:
    """u and v in the thing's own axes, 1 at its rim; distance from its middle and angle there."""
    y, x = np.mgrid[0:side, 0:side].astype(np.float32)
    cx, cy, turn = rng.uniform(0, side), rng.uniform(0, side), rng.uniform(0, 2 * np.pi)
    c, s = np.float32(np.cos(turn) / radius), np.float32(np.sin(turn) / radius)
    u = (x - np.float32(cx)) * c + (y - np.float32(cy)) * s
    v = ((y - np.float32(cy)) * c - (x - np.float32(cx)) * s) / np.float32(slender)
    return u, v, np.hypot(u, v), np.arctan2(v, u)


def _paint(u: Plane, side: int, kind: int, rng: np.random.Generator) -> Picture:
    """Albedo: one colour, or a second one in stripes or patches."""
    body = np.broadcast_to(vivid_colour(rng), (side, side, 3)).astype(np.float32)
    if kind == 0 or rng.random() < 0.4:
        return body
    wave = np.sin(u * np.float32(rng.uniform(3, 12))) if kind == 1 else noise(side, rng, (3, 9))
    share = np.clip(wave - np.float32(rng.uniform(-0.3, 1.0)), 0, 1)[:, :, None]
    other = vivid_colour(rng) if rng.random() < 0.5 else np.full(3, rng.uniform(0.02, 0.8), np.float32)
    return np.asarray(body + share * (other - body), np.float32)


def _lit(body: Picture, u: Plane, v: Plane, rho: Plane, rng: np.random.Generator) -> Picture:
    """Shaded as a ball is, by a light from anywhere in front; now and then burnt out on the side of the light."""
    height = np.sqrt(np.clip(1 - rho * rho, 0, 1))
    light = rng.normal(size=3) * (1, 1, 0.5)
    light[2] = abs(light[2]) + 0.3
    light /= np.linalg.norm(light)
    facing = np.clip(u * light[0] + v * light[1] + height * light[2], 0, 1).astype(np.float32)
    ambient = np.float32(rng.uniform(0.15, 0.7))
    shaded = body * (ambient + (1 - ambient) * facing)[:, :, None]
    if rng.random() < BURNT:
        glare = np.clip((facing - np.float32(rng.uniform(0.75, 0.95))) * 8, 0, 1)[:, :, None]
        shaded = shaded + glare * (np.float32(rng.uniform(0.7, 1.1)) - shaded)
    return np.asarray(cv2.GaussianBlur(shaded, (0, 0), 0.5), np.float32)
