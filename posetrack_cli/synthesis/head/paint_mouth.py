"""Lips, nostrils, and what is seen between parted lips."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import MEAN_SHAPE
from posetrack_cli.synthesis.head.canvas import Box, Canvas, blob, inside
from posetrack_cli.synthesis.head.form import MOUTH_X, MOUTH_Y
from posetrack_cli.synthesis.head.identity import Looks
from posetrack_cli.synthesis.head.noise_fields import smooth_field

MOUTH: Box = (-36.0, 36.0, -88.0, -52.0)
NOSE: Box = (-20.0, 20.0, -54.0, -34.0)
NOSTRIL = (float(MEAN_SHAPE[7, 0]), float(MEAN_SHAPE[7, 1]))
NOSTRIL_MM = (3.3, 1.9)
TOOTH_MM = 8.0


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
