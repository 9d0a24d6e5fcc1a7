"""Texture of the head."""

from __future__ import annotations

import functools
from collections.abc import Callable
from functools import cached_property, partial

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.head.face.points import MEAN_SHAPE
from posetrack_cli.synthesis.head.form import (
    BOTTOM,
    MOUTH_X,
    MOUTH_Y,
    POCKET_BAND,
    TEXTURE_SIZE,
    TOP,
    LidPlaces,
    angle_of,
    half_width,
    height,
    layered_field,
    smooth_field,
    smooth_head,
    smooth_step,
    texel_angles,
    texel_levels,
)
from posetrack_cli.synthesis.head.person import Looks, hair_share

# Canvas and brushes

MARGIN_MM = 2.0
Box = tuple[float, float, float, float]
"""Minimum and maximum x, minimum and maximum y, mm, of the average head."""


class Canvas:
    """Reflectance and gloss of a head's skin.

    Attributes:
        reflectance, gloss: (rows, columns) float32, 0 to 1.
        texel_mm: approximate size of a texel.
    """

    def __init__(self, reflectance: float, size: tuple[int, int] = TEXTURE_SIZE) -> None:
        self.reflectance: Float32Array = np.full(size, reflectance, dtype=np.float32)
        self.gloss: Float32Array = np.zeros(size, dtype=np.float32)
        self._levels, self._pocket = texel_levels(size[0])
        self._angles = texel_angles(size[1])
        self.texel_mm = (TOP - BOTTOM + POCKET_BAND) / size[0]

    @cached_property
    def places(self) -> FloatArray:
        """(rows, columns, 3) position of every texel on the smooth average head, mm."""
        return smooth_head(self._angles[None, :], self._levels[:, None])

    @property
    def pocket(self) -> FloatArray:
        """(rows,) position in the pocket behind the lips, 0 above and 1 below it."""
        return self._pocket

    def paint(self, box: Box, tone: float, cover: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
        """Blend in a tone with opacity cover(x, y), 0 to 1."""
        self.change(box, lambda x, y, old: old + cover(x, y) * (tone - old))

    def shade(self, box: Box, factor: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
        """Multiply the reflectance by factor(x, y)."""
        self.change(box, lambda x, y, old: old * factor(x, y))

    def polish(self, box: Box, gloss: float, cover: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
        """Blend in a gloss with opacity cover(x, y)."""
        window = self.window(box)
        x, y = self.seen(window)
        part = self.gloss[window]
        part += cover(x, y) * (gloss - part)

    def change(
        self, box: Box, new: Callable[[FloatArray, FloatArray, Float32Array], FloatArray | Float32Array]
    ) -> None:
        """Replace the reflectance in a box by new(x, y, old)."""
        window = self.window(box)
        x, y = self.seen(window)
        self.reflectance[window] = new(x, y, self.reflectance[window])

    def texture(self) -> ImageArray:
        """Return the canvas (rows, columns, 2) as an 8-bit texture."""
        both = np.stack([self.reflectance, self.gloss], axis=-1)
        codes: ImageArray = np.rint(np.clip(both, 0.0, 1.0) * 255.0).astype(np.uint8)
        return codes

    def window(self, box: Box) -> tuple[slice, slice]:
        """Return the texels that a frontal box may cover."""
        low_x, high_x, low_y, high_y = box
        levels = np.linspace(low_y, high_y, 9)
        columns = self._columns(low_x, levels, min), self._columns(high_x, levels, max)
        heights = height(self._levels)
        rows = np.flatnonzero((heights <= high_y + MARGIN_MM) & (heights >= low_y - MARGIN_MM))
        return slice(rows[0], rows[-1] + 1), slice(max(columns[0] - 2, 0), columns[1] + 3)

    def _columns(self, x: float, levels: FloatArray, pick: Callable[..., float]) -> int:
        angle = float(pick(angle_of(np.full(len(levels), x), levels).tolist()))
        return int((angle / np.pi + 1.0) / 2.0 * len(self._angles))

    def seen(self, window: tuple[slice, slice]) -> tuple[FloatArray, FloatArray]:
        """Return x and y, mm, (rows, columns) of a window's texels in frontal view."""
        levels, angles = self._levels[window[0]], self._angles[window[1]]
        x = half_width(levels)[:, None] * np.sin(angles)[None, :]
        return x, np.broadcast_to(height(levels)[:, None], x.shape)


def blob(
    x: FloatArray, y: FloatArray, middle: tuple[float, float], spread: tuple[float, float]
) -> FloatArray:
    """Return a Gaussian blob (...) of height 1."""
    spot: FloatArray = np.exp(
        -0.5 * ((x - middle[0]) / spread[0]) ** 2 - 0.5 * ((y - middle[1]) / spread[1]) ** 2
    )
    return spot


def inside(distance: FloatArray, soft: float) -> FloatArray:
    """Return 1 for positive, 0 for negative signed distances (...), mm, with a transition of ``soft`` mm."""
    return smooth_step(distance / soft + 0.5)


# Skin: tone, blotches, pores, freckles, wrinkles, stubble, shading of folds

FACE: Box = (-66.0, 66.0, -118.0, 75.0)
GLOSS = 0.07
BLOTCHES, PORES = 0.05, 0.04
# Darkened areas: depth; x (both sides) and y of the centre; spreads, mm
_SHADES = (
    (0.30, 30.0, 8.5, 13.0, 6.5),  # under the brows
    (0.22, 16.5, 4.0, 4.5, 9.0),  # sides of the nasal root
    (0.12, 33.0, -10.0, 11.0, 5.0),  # under the eyes
    (0.22, 0.0, -50.5, 8.0, 3.0),  # under the nose
    (0.26, 15.0, -41.5, 1.8, 4.0),  # behind the wings
    (0.24, 0.0, -85.0, 14.0, 3.4),  # under the lower lip
    (0.10, 0.0, -57.0, 2.0, 5.0),  # philtrum
)


def paint_skin(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint the whole canvas with skin, glossiest on forehead and nose."""
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
    """Darken areas with less light: under brows, nose and lip, next to the mouth, on the neck."""
    for depth, side, up, across, down in _SHADES:
        canvas.shade(
            FACE, partial(_shaded, depth=depth, middle=(side, up), spread=(across, down), mirrored=True)
        )
    canvas.shade(FACE, lambda x, y: 1.0 - 0.22 * looks.wrinkles * _fold(x, y))
    neck = np.clip((-108.0 - canvas.places[:, :1, 1]) / 30.0, 0.0, 1.0)
    canvas.reflectance *= (1.0 - 0.35 * neck).astype(np.float32)


def _pores(size: tuple[int, int], texel: float, rng: np.random.Generator) -> Float32Array:
    """Return fine structure at 0.7 and 1.6 mm, with more dark than bright spots."""
    fine = smooth_field(size, 0.7 / texel, rng) + 1.2 * smooth_field(size, 1.6 / texel, rng)
    return np.asarray(0.75 * fine - 0.07 * (fine * fine - 1.0), dtype=np.float32)


def _shining(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the opacity of greasy skin, on the forehead and along the nose."""
    return 0.7 * np.maximum(blob(x, y, (0.0, 45.0), (30.0, 14.0)), blob(x, y, (0.0, -25.0), (6.0, 18.0)))


def _shaded(
    x: FloatArray,
    y: FloatArray,
    depth: float,
    middle: tuple[float, float],
    spread: tuple[float, float],
    mirrored: bool = False,
) -> FloatArray:
    """Return the light factor in a soft spot, on both sides of the face if ``mirrored``."""
    return 1.0 - depth * blob(np.abs(x) if mirrored else x, y, middle, spread)


def _fold(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the opacity of the nasolabial folds."""
    along = np.clip((-43.0 - y) / 27.0, 0.0, 1.0)
    middle = 16.0 + 17.0 * along**0.8
    width = 1.3 + 1.5 * along
    ends = inside(-43.0 - y, 6.0) * inside(y + 76.0, 10.0)
    line: FloatArray = ends * np.exp(-0.5 * ((np.abs(x) - middle) / width) ** 2)
    return line


def _paint_freckle(canvas: Canvas, rng: np.random.Generator) -> None:
    """Paint a small spot at a random place; some are as large and dark as moles."""
    x, y = rng.uniform(-60.0, 60.0), rng.uniform(-110.0, 62.0)
    size = 0.35 + 0.5 * rng.random() ** 3
    depth = rng.uniform(0.12, 0.35) if size < 0.7 else 0.5
    box = (x - 4.0 * size, x + 4.0 * size, y - 4.0 * size, y + 4.0 * size)
    canvas.shade(box, partial(_shaded, depth=depth, middle=(x, y), spread=(size, size)))


def _paint_lines(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint wrinkles on the forehead and next to the eyes."""
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
    """Return the light factor of a wavy line across the forehead."""
    off = y - height - bend * (x / 35.0) ** 2 - 0.6 * np.sin(x / 5.0 + wave)
    left: FloatArray = 1.0 - 0.16 * depth * np.exp(-0.5 * (off / 0.7) ** 2 - (x / reach) ** 4)
    return left


def _crows_foot(x: FloatArray, y: FloatArray, slope: float, start: float, depth: float) -> FloatArray:
    """Return the light factor of a line that runs outwards from an eye."""
    along = np.abs(x) - start
    ends = inside(along, 1.5) * inside(9.0 - along, 5.0)
    left: FloatArray = 1.0 - 0.14 * depth * ends * np.exp(-0.5 * ((y - slope * along) / 0.6) ** 2)
    return left


def _paint_stubble(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint a beard's shadow of single hairs."""
    if looks.stubble <= 0.0:
        return
    size = canvas.reflectance.shape
    hairs = np.clip(0.5 + 0.5 * smooth_field(size, 0.6 / canvas.texel_mm, rng), 0.0, 1.3)
    places = canvas.places
    x, y = np.abs(places[..., 0]), places[..., 1]
    beard = inside(-52.0 - y + 0.35 * np.maximum(x - 30.0, 0.0), 10.0) * inside(y + 120.0, 20.0)
    beard = beard * (1.0 - 0.8 * np.exp(-0.5 * ((x - 8.0) / 14.0) ** 2 - 0.5 * ((y - MOUTH_Y) / 9.0) ** 2))
    canvas.reflectance *= (1.0 - looks.stubble * beard * hairs * (places[..., 2] > -90.0)).astype(np.float32)


# Lids, brows, mouth, nostrils, hair

EYES: tuple[Box, Box] = ((-54.0, -12.0, -14.0, 18.0), (12.0, 54.0, -14.0, 18.0))
BROW_INNER = (float(MEAN_SHAPE[9, 0]), float(MEAN_SHAPE[9, 1]))
BROW_OUTER_X = 54.0
BROWS: tuple[Box, Box] = ((-60.0, -8.0, 8.0, 40.0), (8.0, 60.0, 8.0, 40.0))

MOUTH: Box = (-36.0, 36.0, -88.0, -52.0)
NOSE: Box = (-20.0, 20.0, -54.0, -34.0)
NOSTRIL = (float(MEAN_SHAPE[7, 0]), float(MEAN_SHAPE[7, 1]))
NOSTRIL_MM = (3.3, 1.9)
TOOTH_MM = 8.0


@functools.lru_cache(maxsize=2)  # for repeated recordings of a person
def head_texture(looks: Looks) -> ImageArray:
    """Return the texture (rows, columns, 2) uint8 of a head, reflectance and gloss; read-only.

    It has no eyes: ``eyes.EyePainter`` adds them.
    """
    skin, hair, brows, mouth = np.random.default_rng(looks.texture_seed).spawn(4)
    canvas = Canvas(looks.skin)
    paint_skin(canvas, looks, skin)
    shade_folds(canvas, looks)
    paint_lips(canvas, looks, mouth)
    paint_nostrils(canvas)
    paint_brows(canvas, looks, brows)
    for box in EYES:
        canvas.change(box, lambda x, y, old: _lids(looks.lids(x, y), old, looks.wrinkles))
    paint_hair(canvas, looks, hair)
    paint_pocket(canvas, mouth)
    texture = canvas.texture()
    texture.setflags(write=False)
    return texture


def paint_brows(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint both brows; the upper corner of the inner end is a landmark."""
    texel = canvas.texel_mm
    size = canvas.reflectance.shape
    strands = 0.6 * smooth_field(size, (1.0 / texel, 2.5 / texel), rng) + 0.4 * smooth_field(
        size, 0.8 / texel, rng
    )
    for box in BROWS:
        cover = partial(_brow, strands=strands[canvas.window(box)], looks=looks)
        canvas.paint(box, looks.hair * 0.75, cover)


def _brow(x: FloatArray, y: FloatArray, strands: FloatArray, looks: Looks) -> FloatArray:
    """Return the opacity of a brow: a band with a corner above its inner end, thinner outwards."""
    along = np.clip((np.abs(x) - BROW_INNER[0]) / (BROW_OUTER_X - BROW_INNER[0]), 0.0, 1.0)
    top = BROW_INNER[1] + looks.brow_arch * np.sin(np.pi * np.clip(along * 0.85, 0.0, 1.0)) - 4.0 * along**3
    thick = looks.brow_thickness * (1.0 - 0.15 * along - 0.6 * along**3)
    edges = inside(top - y, 1.6) * inside(y - top + thick, 2.2)
    ends = inside(np.abs(x) - BROW_INNER[0], 1.4) * inside(BROW_OUTER_X - np.abs(x), 9.0)
    hairs = np.clip(0.85 + 0.28 * strands, 0.0, 1.0)
    opacity: FloatArray = looks.brow_density * edges * ends * hairs
    return opacity


def _lids(at: LidPlaces, old: Float32Array, wrinkles: float) -> FloatArray:
    """Return the crease above the upper lid and the shade of the lower lid."""
    s, above, top, bottom = at
    ends = inside(s + 0.02, 0.12) * inside(1.10 - s, 0.2)
    crease = ends * np.exp(-0.5 * ((above - top - 3.4 + 1.0 * (2 * s - 1) ** 2) / 0.75) ** 2)
    bag = ends * np.exp(-0.5 * ((above - bottom + 3.0) / 0.9) ** 2)
    return old * (1.0 - 0.42 * crease) * (1.0 - 0.12 * wrinkles * bag)


def paint_lips(canvas: Canvas, looks: Looks, rng: np.random.Generator) -> None:
    """Paint the lips with fine vertical lines, the dark line between them, and the corners of the mouth."""
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
    """Paint the nostrils dark around their landmarks, fading towards the wings."""
    canvas.shade(
        NOSE, lambda x, y: 1.0 - 0.3 * blob(np.abs(x), y, (NOSTRIL[0] + 1.5, NOSTRIL[1] + 0.4), (5.0, 2.6))
    )
    canvas.paint(NOSE, 0.05, _nostril)
    canvas.polish(NOSE, 0.0, _nostril)


def paint_pocket(canvas: Canvas, rng: np.random.Generator) -> None:
    """Paint the texture behind the lips: teeth of both jaws on a dark background."""
    rows = np.flatnonzero((canvas.pocket > 0.0) & (canvas.pocket < 1.0))
    x = canvas.places[rows[0], :, 0]
    columns = np.flatnonzero((np.abs(x) < MOUTH_X) & (canvas.places[rows[0], :, 2] > 0.0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    shown = _teeth(x[None, columns], canvas.pocket[rows][:, None])
    canvas.reflectance[window] = shown * (1.0 + 0.05 * smooth_field(shown.shape, 4.0, rng))
    canvas.gloss[window] = 0.0


def _teeth(x: FloatArray, pocket: FloatArray) -> FloatArray:
    """Return the reflectance behind the lips: gums, a row of teeth on either side, darkness in between."""
    depth = np.minimum(pocket, 1.0 - pocket)
    gap = np.abs((np.abs(x) / TOOTH_MM + 0.5) % 1.0 - 0.5) * TOOTH_MM
    tooth = inside(gap - 0.25, 0.5) * inside(depth - 0.05, 0.03) * inside(0.30 - depth, 0.04)
    tooth = tooth * inside(19.0 - np.abs(x), 4.0) * np.where(pocket < 0.5, 0.72, 0.5)
    gums = 0.20 * (1.0 - np.clip(4.0 * depth, 0.0, 1.0)) + 0.03
    return np.maximum(gums, tooth)


def _lips(x: FloatArray, y: FloatArray, looks: Looks) -> FloatArray:
    """Return the opacity of both lips: a bow above, an arc below."""
    across = np.clip(np.abs(x) / (MOUTH_X + 0.5), 0.0, 1.0)
    bow = 1.0 - across**1.7 - 0.16 * np.exp(-0.5 * (x / 3.4) ** 2)
    top, bottom = MOUTH_Y + looks.upper_lip * bow, MOUTH_Y - looks.lower_lip * (1.0 - across**2.4)
    lips: FloatArray = inside(top - y, 1.3) * inside(y - bottom, 2.2) * inside(MOUTH_X + 1.0 - np.abs(x), 2.5)
    return lips


def _line(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the opacity of the line between the lips, which ends in the corners."""
    up = y - MOUTH_Y
    width = 0.75 + 0.35 * np.clip(np.abs(x) / MOUTH_X, 0.0, 1.0) ** 3
    line = np.exp(-0.5 * (up / width) ** 2) * inside(MOUTH_X + 0.3 - np.abs(x), 1.4)
    corner = 0.75 * np.exp(-0.5 * ((np.abs(x) - MOUTH_X + 0.8) / 1.5) ** 2 - 0.5 * (up / 1.6) ** 2)
    opacity: FloatArray = np.clip(np.maximum(0.9 * line, corner), 0.0, 1.0)
    return opacity


def _nostril(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the opacity of the openings: ellipses, higher towards the outside."""
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
