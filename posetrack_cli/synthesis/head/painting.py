"""A head's texture: what is painted on its skin, from lips and eyes to hair."""

from __future__ import annotations

import functools
from functools import partial

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.head.face.points import MEAN_SHAPE
from posetrack_cli.synthesis.head.canvas import Box, Canvas, blob, inside
from posetrack_cli.synthesis.head.form import (
    LENGTH,
    MOUTH_X,
    MOUTH_Y,
    LidPlaces,
)
from posetrack_cli.synthesis.head.identity import Looks, hair_share
from posetrack_cli.synthesis.head.paint_skin import paint_skin, shade_folds
from posetrack_cli.synthesis.head.smooth import smooth_field

EYES: tuple[Box, Box] = ((-54.0, -12.0, -14.0, 18.0), (12.0, 54.0, -14.0, 18.0))
IRIS_MM, PUPIL_MM = 5.9, 2.1
IRIS_ALONG, IRIS_ABOVE = 0.5, 1.1
SCLERA = 0.58
"""Hardly brighter than skin: it lies in the lids' shade."""
BROW_INNER = (float(MEAN_SHAPE[9, 0]), float(MEAN_SHAPE[9, 1]))
BROW_OUTER_X = 54.0
BROWS: tuple[Box, Box] = ((-60.0, -8.0, 8.0, 40.0), (8.0, 60.0, 8.0, 40.0))

MOUTH: Box = (-36.0, 36.0, -88.0, -52.0)
NOSE: Box = (-20.0, 20.0, -54.0, -34.0)
NOSTRIL = (float(MEAN_SHAPE[7, 0]), float(MEAN_SHAPE[7, 1]))
NOSTRIL_MM = (3.3, 1.9)
TOOTH_MM = 8.0


@functools.lru_cache(maxsize=2)  # of a person who is recorded again
def head_texture(looks: Looks) -> ImageArray:
    """Return the texture (rows, columns, 2) uint8 of a head, reflectance and gloss; read-only."""
    skin, hair, brows, mouth, eyes = np.random.default_rng(looks.texture_seed).spawn(5)
    canvas = Canvas(looks.skin)
    paint_skin(canvas, looks, skin)
    shade_folds(canvas, looks)
    paint_lips(canvas, looks, mouth)
    paint_nostrils(canvas)
    paint_brows(canvas, looks, brows)
    paint_eyes(canvas, looks, eyes)
    paint_hair(canvas, looks, hair)
    paint_pocket(canvas, mouth)
    texture = canvas.texture()
    texture.setflags(write=False)
    return texture


def paint_eyes(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint both eyes; the corners of their openings are the feature points."""
    rays = rng.standard_normal(24)
    for box in EYES:
        canvas.change(box, lambda x, y, old: _lids(looks.lids(x, y), old, looks.wrinkles))
        canvas.change(box, lambda x, y, old: _opening(looks.lids(x, y), old, looks, rays))
        canvas.polish(box, 0.35, lambda x, y: _open(looks.lids(x, y), 0.6))


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


def _lids(at: LidPlaces, old: Float32Array, wrinkles: float) -> FloatArray:
    """The crease above the upper lid, and the shade of the lower."""
    s, above, top, bottom = at
    ends = inside(s + 0.02, 0.12) * inside(1.10 - s, 0.2)
    crease = ends * np.exp(-0.5 * ((above - top - 3.4 + 1.0 * (2 * s - 1) ** 2) / 0.75) ** 2)
    bag = ends * np.exp(-0.5 * ((above - bottom + 3.0) / 0.9) ** 2)
    return old * (1.0 - 0.42 * crease) * (1.0 - 0.12 * wrinkles * bag)


def _open(at: LidPlaces, soft: float) -> FloatArray:
    """How far (...) places lie in the opening: 1 inside."""
    s, above, top, bottom = at
    along = inside(s * LENGTH, soft) * inside((1.0 - s) * LENGTH, soft)
    opening: FloatArray = inside(top - above, soft) * inside(above - bottom, soft) * along
    return opening


def _opening(at: LidPlaces, old: Float32Array, looks: Looks, rays: FloatArray) -> FloatArray:
    """The eyeball in the opening, and the lashes around it."""
    s, above, top, bottom = at
    shown = _open(at, 0.7)
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


def paint_lips(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint the lips with fine upright lines, the dark line between them and the mouth's corners."""
    window = canvas.window(MOUTH)
    texel = canvas.texel_mm
    lines = smooth_field(canvas.reflectance.shape, (5.0 / texel, 0.9 / texel), rng)[window]
    canvas.change(
        MOUTH,
        lambda x, y, old: old + 0.85 * _lips(x, y, looks) * (looks.lips * (1.0 + 0.09 * lines) - old),
    )
    canvas.polish(MOUTH, 0.16, lambda x, y: _lips(x, y, looks))
    canvas.paint(MOUTH, 0.07, _line)


def paint_nostrils(canvas: Canvas) -> None:
    """Paint the nostrils dark around their feature points, softly towards the wings."""
    canvas.shade(
        NOSE, lambda x, y: 1.0 - 0.3 * blob(np.abs(x), y, (NOSTRIL[0] + 1.5, NOSTRIL[1] + 0.4), (5.0, 2.6))
    )
    canvas.paint(NOSE, 0.05, _nostril)
    canvas.polish(NOSE, 0.0, _nostril)


def paint_pocket(canvas: Canvas, rng: np.random.Generator) -> None:
    """Paint the texture's part behind the lips: teeth of both jaws, darkness behind them."""
    rows = np.flatnonzero((canvas.pocket > 0.0) & (canvas.pocket < 1.0))
    x = canvas.places[rows[0], :, 0]
    columns = np.flatnonzero((np.abs(x) < MOUTH_X) & (canvas.places[rows[0], :, 2] > 0.0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    shown = _teeth(x[None, columns], canvas.pocket[rows][:, None])
    canvas.reflectance[window] = shown * (1.0 + 0.05 * smooth_field(shown.shape, 4.0, rng))
    canvas.gloss[window] = 0.0


def _teeth(x: FloatArray, pocket: FloatArray) -> FloatArray:
    """Reflectance behind the lips: gums, a row of teeth on either side, darkness between them."""
    depth = np.minimum(pocket, 1.0 - pocket)
    gap = np.abs((np.abs(x) / TOOTH_MM + 0.5) % 1.0 - 0.5) * TOOTH_MM
    tooth = inside(gap - 0.25, 0.5) * inside(depth - 0.05, 0.03) * inside(0.30 - depth, 0.04)
    tooth = tooth * inside(19.0 - np.abs(x), 4.0) * np.where(pocket < 0.5, 0.72, 0.5)
    gums = 0.20 * (1.0 - np.clip(4.0 * depth, 0.0, 1.0)) + 0.03
    return np.maximum(gums, tooth)


def _lips(x: FloatArray, y: FloatArray, looks: Looks) -> FloatArray:
    """Opacity of both lips: a bow above, an arc below."""
    across = np.clip(np.abs(x) / (MOUTH_X + 0.5), 0.0, 1.0)
    bow = 1.0 - across**1.7 - 0.16 * np.exp(-0.5 * (x / 3.4) ** 2)
    top, bottom = MOUTH_Y + looks.upper_lip * bow, MOUTH_Y - looks.lower_lip * (1.0 - across**2.4)
    lips: FloatArray = inside(top - y, 1.3) * inside(y - bottom, 2.2) * inside(MOUTH_X + 1.0 - np.abs(x), 2.5)
    return lips


def _line(x: FloatArray, y: FloatArray) -> FloatArray:
    """Opacity of the line between the lips, which ends in the corners."""
    up = y - MOUTH_Y
    width = 0.75 + 0.35 * np.clip(np.abs(x) / MOUTH_X, 0.0, 1.0) ** 3
    line = np.exp(-0.5 * (up / width) ** 2) * inside(MOUTH_X + 0.3 - np.abs(x), 1.4)
    corner = 0.75 * np.exp(-0.5 * ((np.abs(x) - MOUTH_X + 0.8) / 1.5) ** 2 - 0.5 * (up / 1.6) ** 2)
    opacity: FloatArray = np.clip(np.maximum(0.9 * line, corner), 0.0, 1.0)
    return opacity


def _nostril(x: FloatArray, y: FloatArray) -> FloatArray:
    """Opacity of the openings: ellipses, higher towards the outside."""
    dx, dy = np.abs(x) - NOSTRIL[0], y - NOSTRIL[1]
    dy = dy - 0.25 * dx
    radius = np.hypot(dx / NOSTRIL_MM[0], dy / NOSTRIL_MM[1])
    opening: FloatArray = inside((1.0 - radius) * NOSTRIL_MM[1], 0.9)
    return opening


def paint_hair(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint the hair over the skin, thin at its edge."""
    size, texel = canvas.reflectance.shape, canvas.texel_mm
    strands = smooth_field(size, (26.0 / texel, 1.3 / texel), rng)
    locks = smooth_field(size, (40.0 / texel, 9.0 / texel), rng)
    edge = smooth_field(size, (8.0 / texel, 1.6 / texel), rng)
    share = hair_share(canvas.places, looks, soft_mm=10.0)
    cover = np.clip(1.6 * share - 0.3 + 0.25 * edge * (share > 0.0), 0.0, 1.0) * (share > 0.0)
    tone = looks.hair * (1.0 + 0.30 * strands + 0.22 * locks)
    canvas.reflectance += (cover * (np.clip(tone, 0.02, 0.6) - canvas.reflectance)).astype(np.float32)
    canvas.gloss += (cover * (0.12 - canvas.gloss)).astype(np.float32)
