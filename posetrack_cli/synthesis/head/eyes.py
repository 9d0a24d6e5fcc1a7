"""Eyes of a synthetic head: eyeballs that turn towards a target, and lids that close over them.

A person's eyeballs are spheres that do not deform. What shows between the lids is painted on the skin's
texture for each frame; the skin around the iris lies on the sphere, so the iris is right from all sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.synthesis.head.form import LENGTH, LidPlaces, eye_places, on_smooth_head
from posetrack_cli.synthesis.head.painting import Box, Canvas, head_texture, inside
from posetrack_cli.synthesis.head.person import BALL_MM, FaceSurface, Looks

# Gaze

MOST_RAD = 0.45
"""Largest angle by which the eyes turn in the head: 26 degrees."""


def gazes_at(targets: FloatArray, poses: FloatArray, eyeballs: FloatArray) -> FloatArray:
    """Return the directions (T, 2, 3) of both eyes in the head's axes.

    Both eyes look at the target, or at one at the same distance less far aside: they turn by a tanh(b / a)
    instead of b, a = ``MOST_RAD``.

    Args:
        targets: (T, 3) mm in camera axes.
        poses: (T, 7) of the head.
        eyeballs: (2, 3) centres, mm in the head's frame.
    """
    between = eyeballs.mean(axis=0)
    away = in_object(targets, poses[:, :3], poses[:, 3:]) - between
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    aside = away[:, :2]
    turn = np.arctan2(np.linalg.norm(aside, axis=1, keepdims=True), away[:, 2:])
    limited = MOST_RAD * np.tanh(turn / MOST_RAD)
    towards = aside / np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-9)
    place = between + distance * np.hstack([np.sin(limited) * towards, np.cos(limited)])
    rays = place[:, None] - eyeballs
    gazes: FloatArray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return gazes


# Lids

LID_FOLLOWS, LID_RANGE = 1.2, (0.5, 1.25)
"""Relative change of the upper lid's height per rad of the gaze upwards, and limits of the height."""
MEASURED_AT = np.array([1.0 / 3.0, 2.0 / 3.0])
"""Places along the lids where the opening is measured."""


class OpenEye(NamedTuple):
    """State of an eye.

    Attributes:
        gaze: (3,) unit vector in the head's axes.
        closing: 0 open to 1 closed, as a share of the lids' opening at that gaze.
    """

    gaze: FloatArray
    closing: float = 0.0

    @property
    def angles(self) -> FloatArray:
        """Angles (2,) of the gaze to the subject's left and up, rad."""
        x, y, z = self.gaze
        return np.array([np.arctan2(x, z), np.arcsin(y)])

    def lids(self, at: LidPlaces) -> LidPlaces:
        """Return eye coordinates with the upper lid's present edge."""
        follows = np.clip(1.0 + LID_FOLLOWS * self.angles[1], *LID_RANGE)
        return at._replace(top=at.bottom + (1.0 - self.closing) * (follows * at.top - at.bottom))


LOOKING_AHEAD = OpenEye(np.array([0.0, 0.0, 1.0]))


def lid_opening_mm(surface: FaceSurface, looks: Looks, side: int, eye: OpenEye) -> float:
    """Return the mean distance of the lids of the right (0) or left (1) eye, mm on the face at rest."""
    s, sign = MEASURED_AT, (-1.0, 1.0)[side]
    at = eye.lids(looks.lids(*eye_places(s, np.zeros(len(s)), sign)))
    edges = (surface(on_smooth_head(*eye_places(s, above, sign))) for above in (at.top, at.bottom))
    upper, lower = edges
    return float(np.linalg.norm(upper - lower, axis=1).mean())


# Painting

OPENINGS: tuple[Box, Box] = ((-48.5, -14.5, -9.0, 12.5), (14.5, 48.5, -9.0, 12.5))
IRIS_MM, PUPIL_MM = 5.9, 2.1
SCLERA = 0.58
"""Hardly brighter than skin, as it is in the shade of the lids."""
GLINT_MM, GLINT_FOLLOWS = (1.6, 1.9), 0.45
"""Place of a lamp's reflection, and share of the iris's motion with which it moves."""
GLOSS = 0.35
ALIGNED = 16
"""Windows begin and end at multiples of this many texels, so that coarser levels can be painted as well."""


class EyePainter:
    """Paints both eyes of a person on the skin's texture.

    Args:
        surface, looks: the person.
    """

    def __init__(self, surface: FaceSurface, looks: Looks) -> None:
        texture = head_texture(looks)
        canvas = Canvas(looks.skin)
        rays = np.random.default_rng([looks.texture_seed, 0x65796573]).standard_normal(24)
        self._eyes = [
            _PaintedEye(canvas, texture, surface, looks, side, rays, box) for side, box in enumerate(OPENINGS)
        ]

    def __call__(self, eyes: tuple[OpenEye, ...]) -> Iterator[tuple[tuple[int, int], ImageArray]]:
        """Yield the first row and column, and the texels (height, width, 2), of each eye's window."""
        for painted, eye in zip(self._eyes, eyes, strict=True):
            yield painted.first, painted.texels(eye)


class _PaintedEye:
    """Window of the texture around an eye."""

    def __init__(
        self,
        canvas: Canvas,
        texture: ImageArray,
        surface: FaceSurface,
        looks: Looks,
        side: int,
        rays: FloatArray,
        box: Box,
    ) -> None:
        rows, columns = (_aligned(one) for one in canvas.window(box))
        self.first = rows.start, columns.start
        x, y = canvas.seen((rows, columns))
        self._skin = texture[rows, columns].astype(np.float64) / 255.0
        self._lids, self._iris, self._rays = looks.lids(x, y), looks.iris, rays
        skin = surface(canvas.places[rows, columns])
        off = (skin - surface.eyeballs[side])[..., :2] / BALL_MM
        off /= np.maximum(1.0, np.linalg.norm(off, axis=-1, keepdims=True) / 0.98)
        depth = np.sqrt(1.0 - np.square(off).sum(axis=-1, keepdims=True))
        self._directions = np.concatenate([off, depth], axis=-1)

    def texels(self, eye: OpenEye) -> ImageArray:
        """Return reflectance and gloss (height, width, 2) of skin, eyeball and lashes."""
        at = eye.lids(self._lids)
        reflectance = self._opened(at, eye)
        gloss = self._skin[..., 1]
        gloss = gloss + _shown(at, 0.6) * (GLOSS - gloss)
        both = np.stack([reflectance, gloss], axis=-1)
        codes: ImageArray = np.rint(np.clip(both, 0.0, 1.0) * 255.0).astype(np.uint8)
        return codes

    def _opened(self, at: LidPlaces, eye: OpenEye) -> FloatArray:
        """Return the reflectance with the eyeball in the opening, and the lashes around it."""
        s, above, top, bottom = at
        ball = self._ball(s, eye.gaze) * (1.0 - 0.5 * inside(above - top + 2.4, 3.6))
        ball *= 1.0 - 0.25 * inside(bottom + 1.0 - above, 1.6)
        ends = inside(s + 0.015, 0.05) * inside(1.025 - s, 0.05)
        upper = ends * np.exp(-0.5 * ((above - top - 0.3) / (0.75 + 0.35 * s)) ** 2)
        lower = 0.55 * ends * np.exp(-0.5 * ((above - bottom + 0.2) / 0.55) ** 2)
        corner = np.exp(-0.5 * ((s * LENGTH - 0.7) / 1.0) ** 2 - 0.5 * (above / 0.9) ** 2)
        corner += np.exp(-0.5 * (((1.0 - s) * LENGTH - 0.6) / 1.0) ** 2 - 0.5 * (above / 0.9) ** 2)
        old = self._skin[..., 0]
        painted = old + _shown(at, 0.7) * (ball - old)
        for cover, tone in (
            (np.clip(0.7 * corner, 0.0, 0.7), 0.14),
            (0.92 * upper, 0.05),
            (0.8 * lower, 0.18),
        ):
            painted = painted + cover * (tone - painted)
        return painted

    def _ball(self, s: FloatArray, gaze: FloatArray) -> FloatArray:
        """Return sclera, iris with dark rim and rays, pupil and glint; the inner corner is darker."""
        across = np.cross([0.0, 1.0, 0.0], gaze)
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(gaze, across)], axis=1)
        dx, dy = np.moveaxis(BALL_MM * self._directions @ axes, -1, 0)
        radius, angle = np.hypot(dx, dy), np.arctan2(dy, dx)
        ray = sum(
            (0.05 * self._rays[k] * np.cos((k + 3) * angle + self._rays[k + 12]) for k in range(12)),
            start=np.zeros(s.shape),
        )
        iris = self._iris * (1.0 + ray) * (1.0 - 0.55 * inside(radius - IRIS_MM + 0.9, 1.0))
        iris = iris + inside(PUPIL_MM - radius, 0.6) * (0.03 - iris)
        white = SCLERA * (1.0 - 0.30 * np.abs(2.0 * s - 1.0) ** 2) * (1.0 - 0.3 * inside(0.12 - s, 0.08))
        ball = white + inside(IRIS_MM - radius, 0.9) * (iris - white)
        from_glint = BALL_MM * (self._directions[..., :2] - GLINT_FOLLOWS * gaze[:2]) - GLINT_MM
        glint = np.exp(-0.5 * np.square(from_glint / 0.7).sum(axis=-1))
        shown: FloatArray = ball + 0.8 * glint * (0.95 - ball)
        return shown


def _shown(at: LidPlaces, soft: float) -> FloatArray:
    """Return how far (...) places are inside the opening: 1 inside."""
    s, above, top, bottom = at
    along = inside(s * LENGTH, soft) * inside((1.0 - s) * LENGTH, soft)
    opening: FloatArray = inside(top - above, soft) * inside(above - bottom, soft) * along
    return opening


def _aligned(part: slice) -> slice:
    return slice(part.start // ALIGNED * ALIGNED, -(-part.stop // ALIGNED) * ALIGNED)
