"""Rasteriser: interpolates attributes of triangles to pixels, with a depth buffer."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from posetrack_cli.arrays import FloatArray, IntArray


@njit(cache=True)
def _fill(pixels, depths, values, triangles, corners, kinds, out, kind_of, buffer):  # type: ignore[no-untyped-def]
    height, width = buffer.shape
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = (
            pixels[a, 0],
            pixels[a, 1],
            pixels[b, 0],
            pixels[b, 1],
            pixels[c, 0],
            pixels[c, 1],
        )
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area >= -1e-12:
            continue
        left, right = max(0, math.ceil(min(ax, bx, cx))), min(width - 1, math.floor(max(ax, bx, cx)))
        top, bottom = max(0, math.ceil(min(ay, by, cy))), min(height - 1, math.floor(max(ay, by, cy)))
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                u = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) / area
                v = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) / area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                z = u * depths[a] + v * depths[b] + w * depths[c]
                if z >= buffer[y, x]:
                    continue
                buffer[y, x] = z
                kind_of[y, x] = kinds[t]
                for k in range(values.shape[1]):
                    out[y, x, k] = u * values[a, k] + v * values[b, k] + w * values[c, k]
                for k in range(2):
                    out[y, x, values.shape[1] + k] = (
                        u * corners[t, 0, k] + v * corners[t, 1, k] + w * corners[t, 2, k]
                    )


def rasterise(
    pixels: FloatArray,
    depths: FloatArray,
    values: FloatArray,
    triangles: IntArray,
    corners: FloatArray,
    kinds: IntArray,
    size: tuple[int, int],
) -> tuple[FloatArray, IntArray]:
    """Draw triangles that face the camera.

    Args:
        pixels: (V, 2) of the vertices.
        depths: (V,) of the vertices; smaller ones are in front.
        values: (V, A) attributes of vertices.
        triangles: (T, 3) vertices, counter-clockwise in the image if they face the camera.
        corners: (T, 3, 2) texture coordinates.
        kinds: (T,) kinds, 0 or more.
        size: height and width of the image.

    Returns:
        (H, W, A + 2) attributes and texture coordinates, and (H, W) kinds, -1 where nothing is drawn.
    """
    out = np.zeros((*size, values.shape[1] + 2))
    kind_of, buffer = np.full(size, -1), np.full(size, np.inf)
    _fill(pixels, depths, values, triangles, corners, kinds, out, kind_of, buffer)
    return out, kind_of


def vertex_normals(vertices: FloatArray, triangles: IntArray) -> FloatArray:
    """Return (V, 3) unit normals, means over the triangles of each vertex."""
    a, b, c = (vertices[triangles[:, one]] for one in range(3))
    across = np.cross(b - a, c - a)
    total = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(across[:, axis], 3), len(vertices)) for axis in range(3)],
        axis=1,
    )
    normals: FloatArray = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    return normals
