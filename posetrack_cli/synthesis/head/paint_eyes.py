"""Eyes, their lids and lashes, and brows."""

from __future__ import annotations

from functools import partial

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.head.face.points import MEAN_SHAPE
from posetrack_cli.synthesis.head.canvas import Box, Canvas, inside
from posetrack_cli.synthesis.head.eyelids import LENGTH, along_and_above, lower_edge, upper_edge
from posetrack_cli.synthesis.head.identity import Looks
from posetrack_cli.synthesis.head.noise_fields import smooth_field

EYES: tuple[Box, Box] = ((-54.0, -12.0, -14.0, 18.0), (12.0, 54.0, -14.0, 18.0))
IRIS_MM, PUPIL_MM = 5.9, 2.1
IRIS_ALONG, IRIS_ABOVE = 0.5, 1.1
SCLERA = 0.58
"""Hardly brighter than skin: it lies in the lids' shade."""
BROW_INNER = (float(MEAN_SHAPE[9, 0]), float(MEAN_SHAPE[9, 1]))
BROW_OUTER_X = 54.0
BROWS: tuple[Box, Box] = ((-60.0, -8.0, 8.0, 40.0), (8.0, 60.0, 8.0, 40.0))


def paint_eyes(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint both eyes; the corners of their openings are the feature points."""
    rays = rng.standard_normal(24)
    for box in EYES:
        canvas.change(box, lambda x, y, old: _lids(x, y, old, looks))
        canvas.change(box, lambda x, y, old: _opening(x, y, old, looks, rays))
        canvas.polish(box, 0.35, lambda x, y: _open(x, y, looks, 0.6))


def paint_brows(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint both brows; the upper corner of the inner end is the feature point."""
    texel = canvas.texel_mm
    size = canvas.reflectance.shape
    strands = 0.6 * smooth_field(size, (1.0 / texel, 2.5 / texel), rng) + 0.4 * smooth_field(
        size, 0.8 / texel, rng
    )
    for box in BROWS:
        cover = partial(_brow, strands=strands[canvas.window(box)], looks=looks)
        canvas.paint(box, looks.hair * 0.75, cover)


def _brow(x: FloatArray, y: FloatArray, strands: FloatArray, looks: Looks) -> FloatArray:
    """Opacity of a brow: a band with a corner above its inner end, thinner outwards."""
    along = np.clip((np.abs(x) - BROW_INNER[0]) / (BROW_OUTER_X - BROW_INNER[0]), 0.0, 1.0)
    top = BROW_INNER[1] + looks.brow_arch * np.sin(np.pi * np.clip(along * 0.85, 0.0, 1.0)) - 4.0 * along**3
    thick = looks.brow_thickness * (1.0 - 0.15 * along - 0.6 * along**3)
    edges = inside(top - y, 1.6) * inside(y - top + thick, 2.2)
    ends = inside(np.abs(x) - BROW_INNER[0], 1.4) * inside(BROW_OUTER_X - np.abs(x), 9.0)
    hairs = np.clip(0.85 + 0.28 * strands, 0.0, 1.0)
    opacity: FloatArray = looks.brow_density * edges * ends * hairs
    return opacity


def _lids(x: FloatArray, y: FloatArray, old: Float32Array, looks: Looks) -> FloatArray:
    """The crease above the upper lid, and the shade of the lower."""
    s, above = along_and_above(x, y)
    top, bottom = upper_edge(s, looks.upper_lid), lower_edge(s, looks.lower_lid)
    ends = inside(s + 0.02, 0.12) * inside(1.10 - s, 0.2)
    crease = ends * np.exp(-0.5 * ((above - top - 3.4 + 1.0 * (2 * s - 1) ** 2) / 0.75) ** 2)
    bag = ends * np.exp(-0.5 * ((above - bottom + 3.0) / 0.9) ** 2)
    return old * (1.0 - 0.42 * crease) * (1.0 - 0.12 * looks.wrinkles * bag)


def _open(x: FloatArray, y: FloatArray, looks: Looks, soft: float) -> FloatArray:
    """How far (...) places lie in the opening: 1 inside."""
    s, above = along_and_above(x, y)
    top, bottom = upper_edge(s, looks.upper_lid), lower_edge(s, looks.lower_lid)
    along = inside(s * LENGTH, soft) * inside((1.0 - s) * LENGTH, soft)
    opening: FloatArray = inside(top - above, soft) * inside(above - bottom, soft) * along
    return opening


def _opening(x: FloatArray, y: FloatArray, old: Float32Array, looks: Looks, rays: FloatArray) -> FloatArray:
    """The eyeball in the opening, and the lashes around it."""
    s, above = along_and_above(x, y)
    top, bottom = upper_edge(s, looks.upper_lid), lower_edge(s, looks.lower_lid)
    shown = _open(x, y, looks, 0.7)
    ball = _eyeball(s, above, looks, rays) * (1.0 - 0.5 * inside(above - top + 2.4, 3.6))
    ball *= 1.0 - 0.25 * inside(bottom + 1.0 - above, 1.6)
    ends = inside(s + 0.015, 0.05) * inside(1.025 - s, 0.05)
    upper = ends * np.exp(-0.5 * ((above - top - 0.3) / (0.75 + 0.35 * s)) ** 2)
    lower = 0.55 * ends * np.exp(-0.5 * ((above - bottom + 0.2) / 0.55) ** 2)
    corner = np.exp(-0.5 * ((s * LENGTH - 0.7) / 1.0) ** 2 - 0.5 * (above / 0.9) ** 2)
    corner += np.exp(-0.5 * (((1.0 - s) * LENGTH - 0.6) / 1.0) ** 2 - 0.5 * (above / 0.9) ** 2)
    painted = old + shown * (ball - old)
    for cover, tone in ((np.clip(0.7 * corner, 0.0, 0.7), 0.14), (0.92 * upper, 0.05), (0.8 * lower, 0.18)):
        painted = painted + cover * (tone - painted)
    return painted


def _eyeball(s: FloatArray, above: FloatArray, looks: Looks, rays: FloatArray) -> FloatArray:
    """White, iris with a dark rim and rays, pupil, a glint; the inner corner is pinker, so darker."""
    dx, dy = (s - IRIS_ALONG) * LENGTH, above - IRIS_ABOVE
    radius, angle = np.hypot(dx, dy), np.arctan2(dy, dx)
    ray = sum(
        (0.05 * rays[k] * np.cos((k + 3) * angle + rays[k + 12]) for k in range(12)), start=np.zeros(s.shape)
    )
    iris = looks.iris * (1.0 + ray) * (1.0 - 0.55 * inside(radius - IRIS_MM + 0.9, 1.0))
    iris = iris + inside(PUPIL_MM - radius, 0.6) * (0.03 - iris)
    white = SCLERA * (1.0 - 0.30 * np.abs(2.0 * s - 1.0) ** 2) * (1.0 - 0.3 * inside(0.12 - s, 0.08))
    ball = white + inside(IRIS_MM - radius, 0.9) * (iris - white)
    glint = np.exp(-0.5 * ((dx - 1.6) / 0.7) ** 2 - 0.5 * ((dy - 1.9) / 0.7) ** 2)
    shown: FloatArray = ball + 0.8 * glint * (0.95 - ball)
    return shown
