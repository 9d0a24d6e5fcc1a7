"""How well a face model describes faces."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face import BROWS, EYES, MOUTH, NOSTRILS

KINDS: Mapping[str, slice] = {"eyes": EYES, "mouth": MOUTH, "nostrils": NOSTRILS, "brows": BROWS}


def distances_by_kind(differences: FloatArray) -> dict[str, float]:
    """Return the root mean square distance, mm, of each kind of point and of ``all``.

    Args:
        differences: (..., K, 3) mm.
    """
    squares = np.sum(np.square(differences), axis=-1)
    kinds = {name: float(np.sqrt(np.mean(squares[..., points]))) for name, points in KINDS.items()}
    return kinds | {"all": float(np.sqrt(np.mean(squares)))}


def cumulative_contribution(spectrum: FloatArray) -> FloatArray:
    """Return the share, 0 to 1, of a tensor's square that the first 1, 2, ... singular values hold."""
    squares = np.square(spectrum)
    shares: FloatArray = np.cumsum(squares) / np.sum(squares)
    return shares
