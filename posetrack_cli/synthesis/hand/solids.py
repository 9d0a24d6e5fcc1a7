"""Closed meshes of stacked elliptic rings: arms, trunk and head."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.rendering.mesh import SkinnedMesh

SIDES = 24
ROUNDING = 5  # rings of a rounded end


def stacked(rings: FloatArray, shares: FloatArray | None = None) -> SkinnedMesh:
    """Return the closed mesh through elliptic rings around the y axis.

    Args:
        rings: (R, 3) height y, half width along x, half depth along z of each ring, mm, y not falling.
            The first and the last are closed by flat fans.
        shares: (R,) weight of bone 1 on each ring, the rest is bone 0's; None for one bone.
    """
    angles = np.arange(SIDES) * (2.0 * np.pi / SIDES)
    y, a, b = (rings[:, k, None] for k in range(3))
    around = np.stack([a * np.cos(angles), y + 0.0 * angles, b * np.sin(angles)], axis=-1).reshape(-1, 3)
    poles = np.array([[0.0, rings[0, 0], 0.0], [0.0, rings[-1, 0], 0.0]])
    vertices = np.vstack([around, poles])
    return SkinnedMesh(vertices, _weights(shares, len(rings)), _triangles(len(rings)))


def ellipsoid(half_axes: tuple[float, float, float]) -> SkinnedMesh:
    """Return an ellipsoid around the origin, half axes along x, y, z, mm."""
    x, y, z = half_axes
    t = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * ROUNDING + 5)[1:-1]
    return stacked(np.stack([y * np.sin(t), x * np.cos(t), z * np.cos(t)], axis=1))


def limb(
    near: tuple[float, float], far: tuple[float, float], belly: tuple[float, float, float] | None = None
) -> SkinnedMesh:
    """Return a tapered capsule that its two bones stretch: each end is rigid and at its bone's origin.

    Bone 0 carries the near end, bone 1 the far end, which lies towards bone 0's +y.

    Args:
        near, far: half width (x) and half depth (z) of the ends, mm.
        belly: share of the way, half width and half depth of one more ring between.
    """
    t = np.linspace(0.0, 0.5 * np.pi, ROUNDING + 1)[1:]
    cap = np.stack([np.cos(t), np.sin(t), np.sin(t)], axis=1)
    first = cap * np.array([-min(near), *near])
    last = (cap * np.array([min(far), *far]))[::-1]
    if belly is None:
        return stacked(np.vstack([first, last]), np.repeat([0.0, 1.0], ROUNDING))
    middle = np.array([[0.0, *belly[1:]]])
    shares = np.r_[np.zeros(ROUNDING), belly[0], np.ones(ROUNDING)]
    return stacked(np.vstack([first, middle, last]), shares)


def _weights(shares: FloatArray | None, rings: int) -> FloatArray:
    """(V, B) weights: the rings' vertices, then the two poles."""
    if shares is None:
        return np.ones((rings * SIDES + 2, 1))
    of_vertex = np.r_[np.repeat(shares, SIDES), shares[0], shares[-1]]
    return np.stack([1.0 - of_vertex, of_vertex], axis=1)


def _triangles(rings: int) -> IntArray:
    """Triangles between the rings, and fans at the poles, counter-clockwise seen from outside."""
    k = np.arange(SIDES)
    m = (k + 1) % SIDES
    first, last = rings * SIDES, rings * SIDES + 1
    top = (rings - 1) * SIDES
    parts = [np.stack([np.full(SIDES, first), k, m], axis=1)]
    for r in range(rings - 1):
        low, high = r * SIDES, (r + 1) * SIDES
        parts.append(np.stack([low + k, high + k, high + m], axis=1))
        parts.append(np.stack([low + k, high + m, low + m], axis=1))
    parts.append(np.stack([np.full(SIDES, last), top + m, top + k], axis=1))
    return np.concatenate(parts)
