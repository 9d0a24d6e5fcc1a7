"""Compiled depth rasteriser for one skinned mesh in one pose.

It is the counterpart of ``rendering.gl.device`` without a device, and also returns the triangle at every
pixel, which is needed for derivatives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.compiled import borrowing, inlined
from posetrack_cli.lanes import Lanes, emitted, padded
from posetrack_cli.rendering.mesh import SkinnedMesh

NEAR_MM = 50.0
NOTHING = -1  # triangle index of an empty pixel
_ROW = 8
"""Pixels of a row that are computed at once; few triangles are wider."""


class RestMesh(NamedTuple):
    """Skinned mesh in the form used by the kernels.

    Attributes:
        vertices: (V, 3) at rest, mm.
        bones: (V, k) bones of each vertex, heaviest first.
        weights: (V, k).
        triangles: (T, 3).
    """

    vertices: FloatArray
    bones: IntArray
    weights: FloatArray
    triangles: IntArray


class View(NamedTuple):
    """Projection to a tile: x = a X/Z + b, y = c Y/Z + d; pixel (0, 0) spans 0..1."""

    a: float
    b: float
    c: float
    d: float


class Drawing(NamedTuple):
    """Output buffers of ``draw``.

    Attributes:
        vertices: (V, 3) posed, camera coordinates, mm.
        screen: (V, 3) tile x, y and 1 / z.
        inverse: (h, w) 1 / z, 0 where empty.
        triangle: (h, w) nearest triangle, or NOTHING.
        normals: (T, 3) unit normals of the triangles that face the camera, towards it.
        facing: (V,) whether a vertex belongs to a triangle that faces the camera.
        columns: (B + 1, 4, 4) buffer: columns of the bones, and one point.
    """

    vertices: FloatArray
    screen: FloatArray
    inverse: FloatArray
    triangle: IntArray
    normals: FloatArray
    facing: BoolArray
    columns: FloatArray


def rest_mesh(mesh: SkinnedMesh) -> RestMesh:
    """Return a mesh in the form used by the kernels."""
    most = int((mesh.weights > 0).sum(axis=1).max())
    order = np.argsort(-mesh.weights, axis=1, kind="stable")[:, :most]
    return RestMesh(
        np.ascontiguousarray(mesh.vertices),
        np.ascontiguousarray(order),
        np.take_along_axis(mesh.weights, order, axis=1),
        np.ascontiguousarray(mesh.triangles),
    )


def empty_drawing(mesh: RestMesh, height: int, width: int) -> Drawing:
    """Return empty output buffers."""
    count = len(mesh.vertices)
    return Drawing(
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        padded(np.zeros((height, width))),
        padded(np.full((height, width), NOTHING, dtype=np.int64)),
        np.zeros((len(mesh.triangles), 3)),
        np.zeros(count, dtype=np.bool_),
        padded(np.zeros((int(mesh.bones.max()) + 2, 4, 4))),
    )


@emitted
def _move_point(columns: Lanes, bone: Lanes, to: Lanes, x: Lanes, y: Lanes, z: Lanes, weight: Lanes) -> None:
    """Write a point moved by a bone, times a weight, to a block of the bones' columns."""
    columns.store(to * 16, _moved(columns, bone * 16, x, y, z) * weight)


@emitted
def _add_moved(columns: Lanes, bone: Lanes, to: Lanes, x: Lanes, y: Lanes, z: Lanes, weight: Lanes) -> None:
    """Add a point moved by a bone, times a weight."""
    moved = _moved(columns, bone * 16, x, y, z) * weight
    columns.store(to * 16, columns.load(to * 16, 4) + moved)


def _moved(columns: Lanes, at: Lanes, x: Lanes, y: Lanes, z: Lanes) -> Lanes:
    a, b, c, d = (columns.load(at + 4 * k, 4) for k in range(4))
    return a * x + b * y + c * z + d


@borrowing
def _place(mesh: RestMesh, bones: FloatArray, view: View, out: Drawing) -> bool:
    """Pose and project the vertices; return False if one is too near."""
    vertices, indices, weights, columns = mesh.vertices, mesh.bones, mesh.weights, out.columns
    last = len(columns) - 1
    for b in range(last):
        for i in range(3):
            for j in range(4):
                columns[b, j, i] = bones[b, i, j]
    for v in range(len(vertices)):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        _move_point(columns, indices[v, 0], last, x, y, z, weights[v, 0])
        for k in range(1, weights.shape[1]):
            if weights[v, k] == 0.0:
                break
            _add_moved(columns, indices[v, k], last, x, y, z, weights[v, k])
        px, py, pz = columns[last, 0, 0], columns[last, 0, 1], columns[last, 0, 2]
        if not pz >= NEAR_MM:  # also true for NaN
            return False
        out.vertices[v, 0], out.vertices[v, 1], out.vertices[v, 2] = px, py, pz
        inverse = 1.0 / pz
        out.screen[v, 0] = view.a * px * inverse + view.b
        out.screen[v, 1] = view.c * py * inverse + view.d
        out.screen[v, 2] = inverse
    return True


@emitted
def _raise_row(
    inverses: Lanes,
    at: Lanes,
    first: Lanes,
    last: Lanes,
    y: Lanes,
    ax: Lanes,
    az: Lanes,
    bx: Lanes,
    by: Lanes,
    cx: Lanes,
    cy: Lanes,
    uz: Lanes,
    vz: Lanes,
) -> Lanes:
    """Write 1 / z of a triangle where it is nearer, to pixels from column ``first`` on; return bits of these.

    Args:
        inverses, at: image, and index of the first pixel.
        first, last: columns.
        y: of the row, from vertex a.
        ax, az: column and 1 / z of vertex a.
        bx, by, cx, cy: derivatives of the barycentric coordinates of b and c.
        uz, vz: 1 / z of b and c beyond that of a.
    """
    column = first.converted("double").counted(_ROW)
    x = column + 0.5 - ax
    beta, gamma = bx * x + by * y, cx * x + cy * y
    inside = (1.0 - (beta + gamma)).least(beta.least(gamma))
    inverse, before = az + beta * uz + gamma * vz, inverses.load(at, _ROW)
    nearer = (inside >= 0.0) & (column <= last.converted("double")) & (inverse > before)
    inverses.store(at, inverse.where(nearer, before))
    return nearer.bits


@emitted
def _write_row(triangles: Lanes, at: Lanes, nearer: Lanes, triangle: Lanes) -> None:
    """Write a triangle's index to the pixels of a row whose bits are set."""
    before = triangles.load(at, _ROW)
    triangles.store(at, (before.constant(0) + triangle).where(nearer.unpacked(_ROW), before))


@inlined
def _fill(out: Drawing, t: int, a: int, b: int, c: int, area: float, with_faces: bool) -> None:
    """Rasterise one front-facing triangle a, b, c; 1 / z is linear in the image."""
    height, width = out.inverse.shape
    screen = out.screen
    ax, ay, az = screen[a, 0], screen[a, 1], screen[a, 2]
    ux, uy, uz = screen[b, 0] - ax, screen[b, 1] - ay, screen[b, 2] - az
    vx, vy, vz = screen[c, 0] - ax, screen[c, 1] - ay, screen[c, 2] - az
    left = max(0, int(np.ceil(ax + min(0.0, ux, vx) - 0.5)))
    right = min(width - 1, int(np.floor(ax + max(0.0, ux, vx) - 0.5)))
    top = max(0, int(np.ceil(ay + min(0.0, uy, vy) - 0.5)))
    bottom = min(height - 1, int(np.floor(ay + max(0.0, uy, vy) - 0.5)))
    share = 1.0 / area  # barycentric coordinates of b and c are linear in x and y
    bx, by, cx, cy = vy * share, -vx * share, -uy * share, ux * share
    for i in range(left, right + 1, _ROW):
        for j in range(top, bottom + 1):
            at, y = j * width + i, j + 0.5 - ay
            nearer = _raise_row(out.inverse, at, i, right, y, ax, az, bx, by, cx, cy, uz, vz)
            if with_faces:
                _write_row(out.triangle, at, nearer, t)


@inlined
def _write_normal(out: Drawing, t: int, a: int, b: int, c: int) -> None:
    p = out.vertices
    ux, uy, uz = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1], p[b, 2] - p[a, 2]
    vx, vy, vz = p[c, 0] - p[a, 0], p[c, 1] - p[a, 1], p[c, 2] - p[a, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    share = 1.0 / (np.sqrt(x * x + y * y + z * z) + 1e-30)
    out.normals[t, 0], out.normals[t, 1], out.normals[t, 2] = x * share, y * share, z * share


@borrowing
def draw(mesh: RestMesh, bones: FloatArray, view: View, out: Drawing) -> bool:
    """Render the mesh posed by bones (B, 3, 4); return False, with empty buffers, if it is too near."""
    return _draw(mesh, bones, view, True, out)


@borrowing
def draw_depth(mesh: RestMesh, bones: FloatArray, view: View, out: Drawing) -> bool:
    """Render like ``draw``, but without triangles, normals and facing vertices."""
    return _draw(mesh, bones, view, False, out)


@inlined
def _draw(mesh: RestMesh, bones: FloatArray, view: View, with_faces: bool, out: Drawing) -> bool:
    out.inverse[:] = 0.0
    if with_faces:
        out.triangle[:] = NOTHING
        out.facing[:] = False
    if not _place(mesh, bones, view, out):
        return False
    triangles, screen = mesh.triangles, out.screen
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy = screen[b, 0] - screen[a, 0], screen[b, 1] - screen[a, 1]
        vx, vy = screen[c, 0] - screen[a, 0], screen[c, 1] - screen[a, 1]
        area = ux * vy - uy * vx
        if area < 0.0:  # counter-clockwise from outside; y runs downwards
            if with_faces:
                out.facing[a] = out.facing[b] = out.facing[c] = True
                _write_normal(out, t, a, b, c)
            _fill(out, t, a, b, c, area, with_faces)
    return True
