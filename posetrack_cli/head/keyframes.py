"""Templates of several face directions: which to compare a frame with, and when to keep another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.templates import TemplateSet


def chosen(sets: Sequence[TemplateSet], facing: FloatArray) -> tuple[TemplateSet, ...]:
    """Return the reference, and the keyframe whose direction is nearest to ``facing`` if it is nearer."""
    nearest = min(sets, key=lambda one: angle_deg(one.facing, facing))
    return (sets[0],) if nearest is sets[0] else (sets[0], nearest)


def is_new(sets: Sequence[TemplateSet], facing: FloatArray, apart_deg: float) -> bool:
    """Whether a direction is farther than that from those of all templates."""
    return all(angle_deg(one.facing, facing) > apart_deg for one in sets)


def angle_deg(a: FloatArray, b: FloatArray) -> float:
    """Return the angle, degrees, between unit vectors (3,)."""
    return float(np.degrees(np.arccos(np.clip(a @ b, -1.0, 1.0))))
