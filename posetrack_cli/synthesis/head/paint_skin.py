"""Skin: tone, blotches, pores, freckles, lines, a beard's shadow, and the shade in a face's folds."""

from __future__ import annotations

from functools import partial

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.synthesis.head.canvas import Box, Canvas, blob, inside
from posetrack_cli.synthesis.head.form import MOUTH_Y
from posetrack_cli.synthesis.head.identity import Looks
from posetrack_cli.synthesis.head.smooth import layered_field, smooth_field

FACE: Box = (-66.0, 66.0, -118.0, 75.0)
GLOSS = 0.07
BLOTCHES, PORES = 0.05, 0.04
# depth; x (both sides) and y of the middle; spreads, mm: less light comes there
_SHADES = (
    (0.30, 30.0, 8.5, 13.0, 6.5),  # under the brows
    (0.22, 16.5, 4.0, 4.5, 9.0),  # beside the nose's root
    (0.12, 33.0, -10.0, 11.0, 5.0),  # under the eyes
    (0.22, 0.0, -50.5, 8.0, 3.0),  # under the nose
    (0.26, 15.0, -41.5, 1.8, 4.0),  # behind the wings
    (0.24, 0.0, -85.0, 14.0, 3.4),  # under the lower lip
    (0.10, 0.0, -57.0, 2.0, 5.0),  # philtrum
)


def paint_skin(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint all of the canvas with skin, gloss most on forehead and nose."""
    size, texel = canvas.reflectance.shape, canvas.texel_mm
    grains = tuple(mm / texel for mm in (18.0, 7.0, 3.0))
    relative = BLOTCHES * layered_field(size, grains, rng) + PORES * _pores(size, texel, rng)
    canvas.reflectance *= 1.0 + relative
    canvas.gloss += GLOSS * (1.0 + 0.3 * smooth_field(size, 2.0 / texel, rng))
    canvas.polish(FACE, 2.0 * GLOSS, _shining)
    for _ in range(looks.freckles):
        _paint_freckle(canvas, rng)
    _paint_lines(canvas, looks, rng)
    _paint_stubble(canvas, looks, rng)


def shade_folds(canvas: Canvas, looks: Looks) -> None:
    """Darken where less light comes: under brows, nose and lip, beside the mouth, on the neck."""
    for depth, side, up, across, down in _SHADES:
        canvas.shade(
            FACE, partial(_shaded, depth=depth, middle=(side, up), spread=(across, down), mirrored=True)
        )
    canvas.shade(FACE, lambda x, y: 1.0 - 0.22 * looks.wrinkles * _fold(x, y))
    neck = np.clip((-108.0 - canvas.places[:, :1, 1]) / 30.0, 0.0, 1.0)
    canvas.reflectance *= (1.0 - 0.35 * neck).astype(np.float32)


def _pores(size: tuple[int, int], texel: float, rng: np.random.Generator) -> Float32Array:
    """Fine structure at 0.7 and 1.6 mm, with more dark than bright spots."""
    fine = smooth_field(size, 0.7 / texel, rng) + 1.2 * smooth_field(size, 1.6 / texel, rng)
    return np.asarray(0.75 * fine - 0.07 * (fine * fine - 1.0), dtype=np.float32)


def _shining(x: FloatArray, y: FloatArray) -> FloatArray:
    """Where skin is greasy: on the forehead and along the nose."""
    return 0.7 * np.maximum(blob(x, y, (0.0, 45.0), (30.0, 14.0)), blob(x, y, (0.0, -25.0), (6.0, 18.0)))


def _shaded(
    x: FloatArray,
    y: FloatArray,
    depth: float,
    middle: tuple[float, float],
    spread: tuple[float, float],
    mirrored: bool = False,
) -> FloatArray:
    """What is left of the light in a soft spot, on both sides of the face where ``mirrored``."""
    return 1.0 - depth * blob(np.abs(x) if mirrored else x, y, middle, spread)


def _fold(x: FloatArray, y: FloatArray) -> FloatArray:
    """The folds from the wings of the nose to beside the mouth."""
    along = np.clip((-43.0 - y) / 27.0, 0.0, 1.0)
    middle = 16.0 + 17.0 * along**0.8
    width = 1.3 + 1.5 * along
    ends = inside(-43.0 - y, 6.0) * inside(y + 76.0, 10.0)
    line: FloatArray = ends * np.exp(-0.5 * ((np.abs(x) - middle) / width) ** 2)
    return line


def _paint_freckle(canvas: Canvas, rng: np.random.Generator) -> None:
    """A small spot somewhere; few are as big and dark as moles."""
    x, y = rng.uniform(-60.0, 60.0), rng.uniform(-110.0, 62.0)
    size = 0.35 + 0.5 * rng.random() ** 3
    depth = rng.uniform(0.12, 0.35) if size < 0.7 else 0.5
    box = (x - 4.0 * size, x + 4.0 * size, y - 4.0 * size, y + 4.0 * size)
    canvas.shade(box, partial(_shaded, depth=depth, middle=(x, y), spread=(size, size)))


def _paint_lines(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Lines across the forehead and beside the eyes."""
    for k in range(3):
        height, bend = 38.0 + 8.5 * k + rng.uniform(-1.5, 1.5), rng.uniform(-2.0, 3.0)
        wave, reach = rng.uniform(0.0, 6.0), rng.uniform(20.0, 38.0)
        line = partial(_forehead_line, height=height, bend=bend, wave=wave, reach=reach, depth=looks.wrinkles)
        canvas.shade((-55.0, 55.0, height - 8.0, height + 8.0), line)
    for box in ((-66.0, -44.0, -14.0, 14.0), (44.0, 66.0, -14.0, 14.0)):
        for k in range(3):
            slope, start = (k - 1.0) * 0.35 + rng.uniform(-0.08, 0.08), 48.5 + rng.uniform(0.0, 1.5)
            canvas.shade(box, partial(_crows_foot, slope=slope, start=start, depth=looks.wrinkles))


def _forehead_line(
    x: FloatArray, y: FloatArray, height: float, bend: float, wave: float, reach: float, depth: float
) -> FloatArray:
    """What is left of the light in a wavy line across the forehead."""
    off = y - height - bend * (x / 35.0) ** 2 - 0.6 * np.sin(x / 5.0 + wave)
    left: FloatArray = 1.0 - 0.16 * depth * np.exp(-0.5 * (off / 0.7) ** 2 - (x / reach) ** 4)
    return left


def _crows_foot(x: FloatArray, y: FloatArray, slope: float, start: float, depth: float) -> FloatArray:
    """What is left of the light in a line that goes outwards from beside an eye."""
    along = np.abs(x) - start
    ends = inside(along, 1.5) * inside(9.0 - along, 5.0)
    left: FloatArray = 1.0 - 0.14 * depth * ends * np.exp(-0.5 * ((y - slope * along) / 0.6) ** 2)
    return left


def _paint_stubble(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """A beard's shadow, of single hairs."""
    if looks.stubble <= 0.0:
        return
    size = canvas.reflectance.shape
    hairs = np.clip(0.5 + 0.5 * smooth_field(size, 0.6 / canvas.texel_mm, rng), 0.0, 1.3)
    places = canvas.places
    x, y = np.abs(places[..., 0]), places[..., 1]
    beard = inside(-52.0 - y + 0.35 * np.maximum(x - 30.0, 0.0), 10.0) * inside(y + 120.0, 20.0)
    beard = beard * (1.0 - 0.8 * np.exp(-0.5 * ((x - 8.0) / 14.0) ** 2 - 0.5 * ((y - MOUTH_Y) / 9.0) ** 2))
    canvas.reflectance *= (1.0 - looks.stubble * beard * hairs * (places[..., 2] > -90.0)).astype(np.float32)
