"""Drawn skins: grey textures of a face with lips, brows, lashes, beard, spots and make-up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from research.face_dense.mesh import LANDMARKS, SKIN, FaceKit

SIZE = 768
"""Pixels of a texture's side."""
Mask: TypeAlias = np.ndarray[Any, np.dtype[Any]]
"""Share (SIZE, SIZE) of a colour in each pixel."""


@dataclass(frozen=True, eq=False)
class Skin:
    """A drawn skin.

    Attributes:
        texture: (SIZE, SIZE) uint8, albedo.
        brows: (10, 2) texture coordinates of the middle lines of both brows, the right one first.
    """

    texture: ImageArray
    brows: FloatArray


class SkinPainter:
    """Draws random skins in the texture coordinates of the face.

    Args:
        kit: the face model, for the places of landmarks in the texture.
    """

    def __init__(self, kit: FaceKit) -> None:
        at = np.zeros((len(kit.neutral), 2))
        skin = kit.kinds == SKIN
        at[kit.triangles[skin]] = kit.corners[skin]
        self._at = at[LANDMARKS] * SIZE

    def paint(self, rng: np.random.Generator) -> Skin:
        """Return a random skin."""
        base = rng.uniform(0.15, 0.85)
        skin = base * (
            1.0 + _clouds(rng, 5, rng.uniform(0.0, 0.12)) + _clouds(rng, 60, rng.uniform(0.0, 0.07))
        )
        skin *= 1.0 + _clouds(rng, 200, rng.uniform(0.0, 0.10))
        skin = self._shadows(skin, rng)
        skin = self._lips(skin, base, rng)
        skin = self._beard(skin, base, rng)
        skin = self._lids(skin, rng)
        skin, brows = self._brows(skin, base, rng)
        for _ in range(rng.integers(0, 8)):
            spot = rng.uniform(0.15, 0.9, 2) * SIZE
            skin = _mixed(skin, _disc(spot, rng.uniform(1.0, 5.0)), base * rng.uniform(0.3, 1.2))
        return Skin(np.round(255.0 * np.clip(skin, 0.01, 1.0)).astype(np.uint8), brows / SIZE)

    def _shadows(self, skin: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Darken or brighten the surroundings of eyes, nose and mouth, as make-up and wrinkles do."""
        for place in (*self._at[[37, 44]], *self._at[[41, 46]], *self._at[[31, 35, 48, 54, 8, 27]]):
            centre = place + rng.normal(0.0, 0.01 * SIZE, 2)
            spot = cv2.GaussianBlur(_disc(centre, rng.uniform(8.0, 40.0)), (0, 0), rng.uniform(4.0, 14.0))
            skin = skin * (1.0 + rng.uniform(-0.35, 0.15) * spot)
        for side in (0, 1):  # folds from the nose to the mouth
            start, end = self._at[[31, 48]] if side == 0 else self._at[[35, 54]]
            shift = np.array([(-1.0, 1.0)[side] * rng.uniform(0.01, 0.04) * SIZE, 0.0])
            line = _line([start + shift, (start + end) / 2 + 1.4 * shift, end + shift], rng.uniform(1.0, 4.0))
            skin = skin * (
                1.0 - rng.uniform(0.0, 0.35) * cv2.GaussianBlur(line, (0, 0), rng.uniform(1.0, 4.0))
            )
        return skin

    def _lips(self, skin: FloatArray, base: float, rng: np.random.Generator) -> FloatArray:
        outer = self._at[48:60] + rng.normal(0.0, 0.003 * SIZE, (12, 2))
        outer = outer + (outer - outer.mean(axis=0)) * rng.normal(0.0, 0.03)
        colour = base * rng.uniform(0.35, 1.15)
        lips = cv2.GaussianBlur(_polygon(outer), (0, 0), rng.uniform(1.0, 6.0))
        texture = colour * (1.0 + _clouds(rng, (160, 12), rng.uniform(0.0, 0.25)))
        skin = _mixed(skin, lips * rng.uniform(0.4, 1.0), texture)
        # where the lips meet they are darker
        inner = np.vstack([self._at[60], self._at[61:64], self._at[64], self._at[65:68]])
        seam = cv2.GaussianBlur(_polygon(inner), (0, 0), rng.uniform(1.0, 4.0))
        return skin * (1.0 - rng.uniform(0.0, 0.5) * seam)

    def _beard(self, skin: FloatArray, base: float, rng: np.random.Generator) -> FloatArray:
        strength = rng.uniform(0.2, 1.0) if rng.random() < 0.45 else rng.uniform(0.0, 0.12)
        jaw = self._at[2:15]
        cheek = rng.uniform(0.1, 0.45)
        upper = self._at[33] * (1.0 - cheek) + self._at[51] * cheek
        area = np.vstack(
            [
                jaw + np.array([0.0, 0.05 * SIZE]),
                self._at[54] + [0.08 * SIZE, -0.02 * SIZE],
                upper,
                self._at[48] + [-0.08 * SIZE, -0.02 * SIZE],
            ]
        )
        mask = _polygon(area)
        if rng.random() < 0.55:  # a moustache, or a chin beard alone
            chin = _polygon(np.vstack([self._at[[6, 7, 8, 9, 10]], self._at[[55, 57, 59]]]))
            lip = _polygon(np.vstack([self._at[[48, 49, 50, 51, 52, 53, 54]], self._at[[35, 33, 31]]]))
            mask = (chin if rng.random() < 0.5 else lip) if rng.random() < 0.6 else np.maximum(chin, lip)
        soft = cv2.GaussianBlur(mask, (0, 0), rng.uniform(3.0, 12.0))
        lips = cv2.GaussianBlur(_polygon(self._at[48:60]), (0, 0), 3.0)
        hair = base * rng.uniform(0.05, 0.7) * (1.0 + _clouds(rng, (250, 90), 0.4))
        return _mixed(skin, np.clip(soft - rng.uniform(0.3, 1.0) * lips, 0.0, 1.0) * strength, hair)

    def _lids(self, skin: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw lash lines, lid creases and liner."""
        for first in (36, 42):
            ring = self._at[first : first + 6]
            upper, lower = ring[:4], ring[[3, 4, 5, 0]]
            for line, strength in ((upper, rng.uniform(0.1, 0.9)), (lower, rng.uniform(0.0, 0.6))):
                lashes = cv2.GaussianBlur(_line(line, rng.uniform(1.0, 4.5)), (0, 0), rng.uniform(0.7, 2.5))
                skin = skin * (1.0 - strength * np.clip(lashes, 0.0, 1.0))
            lift = np.array([0.0, -rng.uniform(0.012, 0.035) * SIZE])
            crease = cv2.GaussianBlur(
                _line(upper + lift, rng.uniform(1.0, 4.0)), (0, 0), rng.uniform(1.0, 4.0)
            )
            skin = skin * (1.0 + rng.uniform(-0.45, 0.05) * crease)
            shade = cv2.GaussianBlur(_polygon(np.vstack([upper, upper[::-1] + lift])), (0, 0), 3.0)
            skin = skin * (1.0 + rng.uniform(-0.4, 0.3) * shade)
        return skin

    def _brows(
        self, skin: FloatArray, base: float, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Draw brows; return the skin and their middle lines (10, 2), which may differ from the landmarks."""
        lines = []
        colour = base * rng.uniform(0.08, 0.85)
        density, thickness = rng.uniform(0.25, 1.0), rng.uniform(6.0, 20.0)
        lower = np.array([0.0, rng.uniform(-0.004, 0.026) * SIZE])
        bend, longer = rng.normal(0.0, 0.006 * SIZE), rng.normal(0.0, 0.02 * SIZE)
        for side in (0, 1):
            arc = (self._at[17:22] if side == 0 else self._at[26:21:-1]).copy() + lower
            arc[2:4, 1] += bend
            arc[[0, 4], 0] += np.array([-longer, longer]) * (1.0, -1.0)[side]
            arc += rng.normal(0.0, 0.002 * SIZE, arc.shape)
            lines.append(arc)
            mask = np.zeros((SIZE, SIZE), np.float32)
            fine = _resampled(arc, 24)
            for place, share in zip(fine, np.linspace(0.0, 1.0, 24), strict=True):
                radius = thickness * 0.5 * (0.35 + 0.65 * min(1.0, 1.4 * share))
                cv2.circle(mask, _pixel(place), max(1, round(radius * 16)), 1.0, -1, cv2.LINE_AA, 4)
            soft = cv2.GaussianBlur(mask, (0, 0), rng.uniform(1.0, 4.0))
            hair = np.clip(soft * (1.0 + _clouds(rng, (110, 220), rng.uniform(0.1, 0.6))), 0.0, 1.0)
            skin = _mixed(skin, hair * density, colour)
        return skin, np.vstack(lines)


def _mixed(below: FloatArray, share: Mask, colour: Mask | float) -> FloatArray:
    return np.asarray(below * (1.0 - share) + colour * share)


def _pixel(place: FloatArray) -> tuple[int, int]:
    """Return a place in sixteenths of a pixel."""
    return round(float(place[0]) * 16), round(float(place[1]) * 16)


def _disc(centre: FloatArray, radius: float) -> Mask:
    mask = np.zeros((SIZE, SIZE), np.float32)
    cv2.circle(mask, _pixel(centre), max(1, round(radius * 16)), 1.0, -1, cv2.LINE_AA, 4)
    return mask


def _polygon(ring: FloatArray) -> Mask:
    mask = np.zeros((SIZE, SIZE), np.float32)
    cv2.fillPoly(mask, [np.round(ring * 16).astype(np.int32)], 1.0, cv2.LINE_AA, 4)
    return mask


def _line(places: FloatArray | list[FloatArray], width: float) -> Mask:
    mask = np.zeros((SIZE, SIZE), np.float32)
    cv2.polylines(
        mask,
        [np.round(_resampled(np.array(places), 16) * 16).astype(np.int32)],
        False,
        1.0,
        max(1, round(width)),
        cv2.LINE_AA,
        4,
    )
    return mask


def _resampled(places: FloatArray, count: int) -> FloatArray:
    at = np.linspace(0.0, len(places) - 1.0, count)
    return np.stack([np.interp(at, np.arange(len(places)), places[:, axis]) for axis in range(2)], axis=1)


def _clouds(rng: np.random.Generator, cells: int | tuple[int, int], strength: float) -> Mask:
    """Return smooth noise (SIZE, SIZE) with this number of cells, or of rows and columns of cells."""
    across, down = (cells, cells) if isinstance(cells, int) else (cells[1], cells[0])
    noise = rng.standard_normal((down, across)).astype(np.float32) * strength
    return cv2.resize(noise, (SIZE, SIZE), interpolation=cv2.INTER_CUBIC)
