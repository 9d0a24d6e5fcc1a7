"""A small depth rasteriser for one skinned mesh in one pose; compiled.

It draws what ``rendering.tiled`` draws, without a device and with the triangle behind every pixel, which
the derivatives need.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.hand.fitting.skeleton import PALM
from posetrack_cli.rendering.mesh import SkinnedMesh

NEAR_MM = 50.0
NOTHING = -1  # the triangle of a pixel on which nothing is drawn


class Skin(NamedTuple):
    """A mesh as the kernels read it.

    Attributes:
        vertices: (V, 3) at rest, mm.
        bones: (V, k) bones of a vertex, heaviest first.
        weights: (V, k).
        triangles: (T, 3).
        fingers: (V,) finger that moves the vertex most, or PALM.
        reaches: (V, 3) skinning weight of its bones from joint 3, 2, 1 outwards.
        triangle_fingers: (T,) the same of a triangle.
        triangle_reaches: (T, 3).
    """

    vertices: FloatArray
    bones: np.ndarray[tuple[int, int], np.dtype[np.int64]]
    weights: FloatArray
    triangles: np.ndarray[tuple[int, int], np.dtype[np.int64]]
    fingers: np.ndarray[tuple[int], np.dtype[np.int64]]
    reaches: FloatArray
    triangle_fingers: np.ndarray[tuple[int], np.dtype[np.int64]]
    triangle_reaches: FloatArray


class View(NamedTuple):
    """What a tile shows: a point falls on tile x = a X/Z + b, y = c Y/Z + d; pixel (0, 0) spans 0..1."""

    a: float
    b: float
    c: float
    d: float


class Drawing(NamedTuple):
    """What ``draw`` writes.

    Attributes:
        vertices: (V, 3) posed, camera coordinates, mm.
        screen: (V, 3) tile x, y and 1 / z.
        inverse: (h, w) 1 / z, 0 where nothing is drawn.
        triangle: (h, w) the nearest triangle, or NOTHING.
        normals: (T, 3) unit normals of the triangles, towards the camera; of those that face it.
        facing: (V,) whether a vertex belongs to a triangle that faces the camera.
    """

    vertices: FloatArray
    screen: FloatArray
    inverse: FloatArray
    triangle: np.ndarray[tuple[int, int], np.dtype[np.int64]]
    normals: FloatArray
    facing: np.ndarray[tuple[int], np.dtype[np.bool_]]


def skin_of(mesh: SkinnedMesh) -> Skin:
    """Return a mesh bound to the hand's 16 bones as the kernels read it."""
    most = int((mesh.weights > 0).sum(axis=1).max())
    order = np.argsort(-mesh.weights, axis=1, kind="stable")[:, :most]
    by_finger = mesh.weights[:, 1:].reshape(-1, 5, 3)
    outwards = np.cumsum(by_finger[:, :, ::-1], axis=2)[:, :, ::-1]
    fingers, reaches = _strongest(outwards)
    triangle_fingers, triangle_reaches = _strongest(outwards[mesh.triangles].mean(axis=1))
    return Skin(
        np.ascontiguousarray(mesh.vertices),
        np.ascontiguousarray(order),
        np.take_along_axis(mesh.weights, order, axis=1),
        np.ascontiguousarray(mesh.triangles),
        fingers,
        reaches,
        triangle_fingers,
        triangle_reaches,
    )


def _strongest(outwards: FloatArray) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], FloatArray]:
    """Of reaches (M, 5, 3) the finger with the most weight (M,), or PALM, and its reaches (M, 3)."""
    finger = outwards[:, :, 0].argmax(axis=1)
    reach = np.take_along_axis(outwards, finger[:, None, None], axis=1)[:, 0]
    return np.where(reach[:, 0] > 0.0, finger, PALM).astype(np.int64), np.ascontiguousarray(reach)


def empty_drawing(skin: Skin, height: int, width: int) -> Drawing:
    """Return room for one drawing."""
    count = len(skin.vertices)
    return Drawing(
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        np.zeros((height, width)),
        np.full((height, width), NOTHING, dtype=np.int64),
        np.zeros((len(skin.triangles), 3)),
        np.zeros(count, dtype=np.bool_),
    )


@kernel
def _place(skin: Skin, bones: FloatArray, view: View, out: Drawing) -> bool:
    """Pose and project the vertices; False if one is too near to be drawn."""
    for v in range(len(skin.vertices)):
        x, y, z = skin.vertices[v, 0], skin.vertices[v, 1], skin.vertices[v, 2]
        px, py, pz = 0.0, 0.0, 0.0
        for k in range(skin.weights.shape[1]):
            w = skin.weights[v, k]
            if w == 0.0:
                break
            T = bones[skin.bones[v, k]]
            px += w * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3])
            py += w * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3])
            pz += w * (T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3])
        if pz < NEAR_MM:
            return False
        out.vertices[v, 0], out.vertices[v, 1], out.vertices[v, 2] = px, py, pz
        inverse = 1.0 / pz
        out.screen[v, 0] = view.a * px * inverse + view.b
        out.screen[v, 1] = view.c * py * inverse + view.d
        out.screen[v, 2] = inverse
    return True


@kernel
def _fill(out: Drawing, t: int, a: FloatArray, b: FloatArray, c: FloatArray, area: float) -> None:
    """Draw one triangle that faces the camera; 1 / z is linear in the image."""
    height, width = out.inverse.shape
    left = max(0, int(np.ceil(min(a[0], b[0], c[0]) - 0.5)))
    right = min(width - 1, int(np.floor(max(a[0], b[0], c[0]) - 0.5)))
    top = max(0, int(np.ceil(min(a[1], b[1], c[1]) - 0.5)))
    bottom = min(height - 1, int(np.floor(max(a[1], b[1], c[1]) - 0.5)))
    # barycentric coordinates of b and c are linear in x and y
    share = 1.0 / area
    bx, by = (c[1] - a[1]) * share, (a[0] - c[0]) * share
    cx, cy = (a[1] - b[1]) * share, (b[0] - a[0]) * share
    zb, zc = b[2] - a[2], c[2] - a[2]
    for j in range(top, bottom + 1):
        y = j + 0.5 - a[1]
        for i in range(left, right + 1):
            x = i + 0.5 - a[0]
            beta, gamma = bx * x + by * y, cx * x + cy * y
            if beta < 0.0 or gamma < 0.0 or beta + gamma > 1.0:
                continue
            inverse = a[2] + beta * zb + gamma * zc
            if inverse > out.inverse[j, i]:
                out.inverse[j, i] = inverse
                out.triangle[j, i] = t


@kernel
def _normal(out: Drawing, t: int, p: FloatArray, q: FloatArray, r: FloatArray) -> None:
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = np.sqrt(x * x + y * y + z * z) + 1e-30
    out.normals[t, 0], out.normals[t, 1], out.normals[t, 2] = x / length, y / length, z / length


@kernel
def draw(skin: Skin, bones: FloatArray, view: View, out: Drawing) -> bool:
    """Draw the mesh posed by bones (16, 3, 4); False, and nothing drawn, if it is too near the camera."""
    out.inverse[:] = 0.0
    out.triangle[:] = NOTHING
    out.facing[:] = False
    if not _place(skin, bones, view, out):
        return False
    for t in range(len(skin.triangles)):
        ia, ib, ic = skin.triangles[t, 0], skin.triangles[t, 1], skin.triangles[t, 2]
        a, b, c = out.screen[ia], out.screen[ib], out.screen[ic]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area < 0.0:  # counter-clockwise from outside; y runs downwards
            out.facing[ia] = out.facing[ib] = out.facing[ic] = True
            _normal(out, t, out.vertices[ia], out.vertices[ib], out.vertices[ic])
            _fill(out, t, a, b, c, area)
    return True
