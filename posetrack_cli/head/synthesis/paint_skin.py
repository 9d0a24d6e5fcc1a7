"""Skin: tone, blotches, pores, freckles, lines, a beard's shadow, and the shade in a face's folds."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.head.synthesis.canvas import Box, Canvas, blob, inside
from posetrack_cli.head.synthesis.form import MOUTH_Y
from posetrack_cli.head.synthesis.identity import Looks
from posetrack_cli.head.synthesis.noise_fields import layered_field, smooth_field

FACE: Box = (-66.0, 66.0, -118.0, 75.0)
GLOSS = 0.07
BLOTCHES, PORES = 0.05, 0.045
# depth; x (both sides) and y of the middle; spreads, mm: less light comes there
_SHADES = (
    (0.30, 30.0, 8.5, 13.0, 6.5),  # under the brows
    (0.22, 16.5, 4.0, 4.5, 9.0),  # beside the nose's root
    (0.12, 33.0, -10.0, 11.0, 5.0),  # under the eyes
    (0.38, 0.0, -50.0, 9.0, 2.6),  # under the nose
    (0.20, 15.5, -42.0, 2.2, 4.5),  # behind the wings
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
    for middle, spread in (((0.0, 45.0), (30.0, 14.0)), ((0.0, -25.0), (6.0, 18.0))):
        canvas.polish(FACE, 2.0 * GLOSS, lambda x, y, m=middle, s=spread: 0.7 * blob(x, y, m, s))  # type: ignore[misc]
    _freckles(canvas, looks, rng)
    _lines(canvas, looks, rng)
    _stubble(canvas, looks, rng)


def shade_folds(canvas: Canvas, looks: Looks) -> None:
    """Darken where less light comes: under brows, nose and lip, beside the mouth, on the neck."""
    for depth, side, up, across, down in _SHADES:
        canvas.shade(FACE, lambda x, y, v=(depth, side, up, across, down): 1.0 - _pair(x, y, *v))  # type: ignore[misc]
    canvas.shade(FACE, lambda x, y: 1.0 - 0.22 * looks.wrinkles * _fold(x, y))
    neck = np.clip((-108.0 - canvas.places[:, :1, 1]) / 30.0, 0.0, 1.0)
    canvas.reflectance *= (1.0 - 0.35 * neck).astype(np.float32)


def _pores(size: tuple[int, int], texel: float, rng: np.random.Generator) -> Float32Array:
    """Fine structure at 0.7 and 1.6 mm, with darker than brighter spots."""
    fine = smooth_field(size, 0.7 / texel, rng) + 1.2 * smooth_field(size, 1.6 / texel, rng)
    dark: Float32Array = np.float32(0.75) * fine - np.float32(0.12) * (fine * fine - 1.0)
    return dark


def _pair(
    x: FloatArray, y: FloatArray, depth: float, side: float, up: float, across: float, down: float
) -> FloatArray:
    spot: FloatArray = depth * np.exp(
        -0.5 * ((np.abs(x) - side) / across) ** 2 - 0.5 * ((y - up) / down) ** 2
    )
    return spot


def _fold(x: FloatArray, y: FloatArray) -> FloatArray:
    """The folds from the wings of the nose to beside the mouth."""
    along = np.clip((-43.0 - y) / 27.0, 0.0, 1.0)
    middle = 16.0 + 17.0 * along**0.8
    width = 1.3 + 1.5 * along
    ends = inside(-43.0 - y, 6.0) * inside(y + 76.0, 10.0)
    line: FloatArray = ends * np.exp(-0.5 * ((np.abs(x) - middle) / width) ** 2)
    return line


def _freckles(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Spots, few of them big: moles."""
    for _ in range(looks.freckles):
        x, y = rng.uniform(-60.0, 60.0), rng.uniform(-110.0, 62.0)
        size = 0.35 + 0.5 * rng.random() ** 3
        depth = rng.uniform(0.12, 0.35) if size < 0.7 else 0.5
        box = (x - 4 * size, x + 4 * size, y - 4 * size, y + 4 * size)
        canvas.shade(box, lambda a, b, v=(x, y, size, depth): 1.0 - v[3] * blob(a, b, v[:2], (v[2], v[2])))  # type: ignore[misc]


def _lines(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Lines across the forehead and beside the eyes."""
    for k in range(3):
        y0, bend = 38.0 + 8.5 * k + rng.uniform(-1.5, 1.5), rng.uniform(-2.0, 3.0)
        wave, reach = rng.uniform(0.0, 6.0), rng.uniform(20.0, 38.0)
        canvas.shade(
            (-55.0, 55.0, y0 - 8.0, y0 + 8.0),
            lambda x, y, v=(y0, bend, wave, reach): (  # type: ignore[misc]
                1.0
                - 0.16
                * looks.wrinkles
                * np.exp(
                    -0.5 * ((y - v[0] - v[1] * (x / 35.0) ** 2 - 0.6 * np.sin(x / 5.0 + v[2])) / 0.7) ** 2
                )
                * np.exp(-((x / v[3]) ** 4))
            ),
        )
    for side in (-1.0, 1.0):
        for k in range(3):
            slope, start = (k - 1.0) * 0.35 + rng.uniform(-0.08, 0.08), 48.5 + rng.uniform(0.0, 1.5)
            canvas.shade(
                (min(44 * side, 66 * side), max(44 * side, 66 * side), -14.0, 14.0),
                lambda x, y, v=(slope, start): (  # type: ignore[misc]
                    1.0
                    - 0.14
                    * looks.wrinkles
                    * np.exp(-0.5 * ((y - v[0] * (np.abs(x) - v[1])) / 0.6) ** 2)
                    * inside(np.abs(x) - v[1], 1.5)
                    * inside(v[1] + 9.0 - np.abs(x), 5.0)
                ),
            )


def _stubble(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
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
