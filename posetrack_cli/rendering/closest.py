"""The points of triangles that are nearest to given points."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray

CANDIDATES = 32
"""Triangles a point is held against: those with the nearest middles."""


def closest_points(points: FloatArray, corners: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the nearest triangle (P,) of each point, and where on it, as barycentric coordinates (P, 3).

    The nearest of the ``CANDIDATES`` triangles whose middles are nearest: exact for points near a surface
    of triangles that are not much longer than wide.

    Args:
        points: (P, 3).
        corners: (T, 3, 3) of the triangles.
    """
    from scipy.spatial import KDTree

    count = min(CANDIDATES, len(corners))
    _, near = KDTree(corners.mean(axis=1)).query(points, k=range(1, count + 1))
    candidates = corners[near]  # (P, K, 3, 3)
    shares = np.stack([_within(points, candidates), *(_on_edge(points, candidates, k) for k in range(3))])
    distances = ((np.einsum("opkc,pkcx->opkx", shares, candidates) - points[:, None]) ** 2).sum(axis=-1)
    distances[0][(shares[0] < 0.0).any(axis=-1)] = np.inf
    best = distances.transpose(1, 2, 0).reshape(len(points), -1).argmin(axis=1)
    place, option, rows = best // 4, best % 4, np.arange(len(points))
    return near[rows, place], shares[option, rows, place]


def _within(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Barycentric coordinates (P, K, 3) of the points' projections on the planes of triangles (P, K, 3, 3).

    With sides a and b: s = ((p.a)(b.b) - (p.b)(a.b)) / |a x b|^2, t likewise.
    """
    a, b = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    p = points[:, None] - corners[..., 0, :]
    aa, bb, ab = ((x * y).sum(axis=-1) for x, y in ((a, a), (b, b), (a, b)))
    pa, pb = (p * a).sum(axis=-1), (p * b).sum(axis=-1)
    area2 = np.maximum(aa * bb - ab * ab, np.finfo(np.float64).tiny)
    s, t = (pa * bb - pb * ab) / area2, (pb * aa - pa * ab) / area2
    return np.stack([1.0 - s - t, s, t], axis=-1)


def _on_edge(points: FloatArray, corners: FloatArray, first: int) -> FloatArray:
    """The same of the nearest points on the edges from one corner to the next."""
    second = (first + 1) % 3
    start = corners[..., first, :]
    along = corners[..., second, :] - start
    length2 = np.maximum((along**2).sum(axis=-1), np.finfo(np.float64).tiny)
    share = np.clip(((points[:, None] - start) * along).sum(axis=-1) / length2, 0.0, 1.0)
    out = np.zeros((*share.shape, 3))
    out[..., first], out[..., second] = 1.0 - share, share
    return out
