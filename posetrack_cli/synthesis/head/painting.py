"""A head's texture: skin, eyes, brows, lips, nostrils, mouth and hair."""

from __future__ import annotations

import functools

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.synthesis.head.canvas import Canvas
from posetrack_cli.synthesis.head.identity import Looks
from posetrack_cli.synthesis.head.paint_eyes import paint_brows, paint_eyes
from posetrack_cli.synthesis.head.paint_hair import paint_hair
from posetrack_cli.synthesis.head.paint_mouth import paint_lips, paint_nostrils, paint_pocket
from posetrack_cli.synthesis.head.paint_skin import paint_skin, shade_folds


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
