"""Hair: strands that run from the hairline over the skull."""

from __future__ import annotations

import numpy as np

from posetrack_cli.synthesis.head.canvas import Canvas
from posetrack_cli.synthesis.head.hair import hair_share
from posetrack_cli.synthesis.head.identity import Looks
from posetrack_cli.synthesis.head.noise_fields import smooth_field


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
