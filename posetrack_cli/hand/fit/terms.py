"""Residuals of a depth image and their derivatives; compiled.

With r the rendered pixels and o the observed hand pixels:

    r and o, |dz| < gate     projective point-to-plane: n . (observed - drawn)
    r and o, drawn far in front of the reading     a weak push along z
    r, a reading behind it   pull in the image plane to the nearest hand pixel
    o, not explained         pull of the nearest visible skin vertex to the point

A reading in front of the model that is not the hand's occludes it; a missing reading is no evidence.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, IntArray
from posetrack_cli.compiled import borrowing, inlined
from posetrack_cli.geometry.least_squares import geman_mcclure
from posetrack_cli.hand.fit.normal_equations import RESIDUAL, ROW, NormalEquations, add_row
from posetrack_cli.hand.fit.skeleton import NO_INNER, Posed, Skin, point_row
from posetrack_cli.lanes import padded
from posetrack_cli.rendering.raster import Drawing, View


class Tile(NamedTuple):
    """An observation as the kernels read it.

    Attributes:
        image: (h, w) depth of hand and forearm pixels, mm; negative: other readings; 0: none.
        nearest: (2, h, w) column and row of the nearest hand pixel.
        observed: number of target pixels.
        projection: of points to tile pixels.
        inner: (6,) inner numbers: start of fits, and those of rendered poses (``hand.fit.skeleton``).
        expected: (6,) mean of their prior.
        mm_per_nat: cost D equivalent to one nat of anatomy and prior when poses are compared; 0 to compare by
            the image alone.
    """

    image: FloatArray
    nearest: FloatArray
    observed: int
    projection: View
    inner: FloatArray = NO_INNER
    expected: FloatArray = NO_INNER
    mm_per_nat: float = 0.0


class Terms(NamedTuple):
    """Weights of the terms.

    Attributes:
        sigma_mm: of a point-to-plane residual, and of a pull in the image plane.
        closest_mm: of an unexplained pixel's distance from the skin.
        push: weight of the push along z, 1 / mm^2.
        gate_mm: largest depth difference of corresponding points.
        explained_mm: depth difference beyond which an observed pixel is unexplained.
        surface_tau_mm, silhouette_tau_mm, closest_tau_mm: scales of the robust loss.
        clamp_mm, unread_weight: of the union cost.
        most_unexplained: largest number of unexplained pixels in use, evenly chosen.
    """

    sigma_mm: float = 4.0
    closest_mm: float = 5.0
    push: float = 0.01
    gate_mm: float = 30.0
    explained_mm: float = 12.0
    surface_tau_mm: float = 15.0
    silhouette_tau_mm: float = 15.0
    closest_tau_mm: float = 20.0
    clamp_mm: float = 40.0
    unread_weight: float = 0.2
    most_unexplained: int = 96


_INDEX = np.int32(2**14 - 1)
"""Bits of a float32 that hold an index."""
_TOGETHER = 64
"""Vertices per step of a loop that LLVM has vectorised; it takes the last ones one by one."""

Pull: TypeAlias = tuple[float, float, float, float, float]
"""Direction of the point (3), residual, mm, and weight, 1 / mm^2 (0 for none)."""


class TermBuffers(NamedTuple):
    """Buffers of ``add_terms``.

    Attributes:
        points: (h w, 3) unexplained points.
        vertices: (V,) visible vertices; V is a multiple of ``_TOGETHER``.
        places: (3, V) their positions, one row per coordinate; accurate enough to find the nearest.
        squares: (V,) squared distances from a point.
        row: (16,) of one residual.
    """

    points: FloatArray
    vertices: IntArray
    places: Float32Array
    squares: Float32Array
    row: FloatArray


def empty_buffers(skin: Skin, height: int, width: int) -> TermBuffers:
    """Return the buffers for one image."""
    count = -(-len(skin.mesh.vertices) // _TOGETHER) * _TOGETHER
    points, vertices = np.zeros((height * width, 3)), np.zeros(count, dtype=np.int64)
    places, squares = np.zeros((3, count), np.float32), np.zeros(count, np.float32)
    return TermBuffers(points, vertices, places, squares, padded(np.zeros(ROW)))


@borrowing
def add_terms(
    tile: Tile,
    posed: Posed,
    skin: Skin,
    drawing: Drawing,
    terms: Terms,
    widening: float,
    stride: int,
    buffers: TermBuffers,
    equations: NormalEquations,
) -> float:
    """Add all residuals of a rendered pose; return its union cost D, mm (docs/method.md).

    Args:
        tile: the observation.
        posed, drawing: of the pose.
        skin: the mesh.
        terms: weights.
        widening: factor on the robust scales.
        stride: use one in ``stride`` surface pixels; 2 is a chequerboard. Errors of neighbours are
            correlated, so a step loses little; the cost uses all pixels.
        buffers: overwritten.
        equations: residuals are added to its blocks.
    """
    view, row, (image, inverses) = tile.projection, buffers.row, (tile.image, drawing.inverse)
    fingers, reaches, normals = skin.triangle_fingers, skin.triangle_reaches, drawing.normals
    error, both, missed, unexplained = 0.0, 0, 0.0, 0
    for j in range(image.shape[0]):
        y = (j + 0.5 - view.d) / view.c
        for i in range(image.shape[1]):
            observed, inverse = image[j, i], inverses[j, i]
            if not inverse > 0.0:
                if observed > 0.0:
                    x = (i + 0.5 - view.b) / view.a
                    unexplained = _note(buffers.points, unexplained, x, y, observed)
                continue
            x, z, t = (i + 0.5 - view.b) / view.a, 1.0 / inverse, drawing.triangle[j, i]
            if observed > 0.0:
                both, offset = both + 1, observed - z
                error += min(abs(offset), terms.clamp_mm)
                if abs(offset) > terms.explained_mm:
                    unexplained = _note(buffers.points, unexplained, x, y, observed)
                if (i + j) % stride != 0:
                    continue
                normal = (normals[t, 0], normals[t, 1], normals[t, 2])
                pull = _depth_pull(offset, x, y, normal, widening, terms)
            else:
                share = _missed(observed, z, terms)
                missed += share
                aside = (tile.nearest[0, j, i] - i) / view.a, (tile.nearest[1, j, i] - j) / view.c
                pull = _outline_pull(share if observed < 0.0 else 0.0, aside, x, y, z, widening, terms)
            dx, dy, dz, row[RESIDUAL], weight = pull
            if observed > 0.0:
                weight *= stride
            if weight > 0.0:
                point_row(posed, fingers[t], reaches, t, x * z, y * z, z, dx, dy, dz, row)
                add_row(equations, fingers[t], row, weight)
    _add_closest(posed, skin, drawing, terms, widening, buffers, unexplained, equations)
    return _union(error, both, missed, tile.observed, terms.clamp_mm)


@inlined
def _note(points: FloatArray, count: int, x: float, y: float, z: float) -> int:
    """Append the point (x, y, 1) z to the first ``count``; return the new count."""
    points[count, 0], points[count, 1], points[count, 2] = x * z, y * z, z
    return count + 1


@inlined
def _missed(observed: float, z: float, terms: Terms) -> float:
    """Return the weight of a pixel rendered at depth z without a hand reading: 0 if occluded."""
    if observed == 0.0:
        return terms.unread_weight
    return 1.0 if -observed > z - terms.explained_mm else 0.0


@inlined
def _union(error: float, both: int, missed: float, observed: int, clamp_mm: float) -> float:
    """Return the union cost from error, pixels in both, rendered only, and observed."""
    disagree = missed + (observed - both)
    union = both + disagree
    return (error + clamp_mm * disagree) / union if union > 0.0 else clamp_mm


@inlined
def _depth_pull(
    offset: float, x: float, y: float, normal: tuple[float, float, float], widening: float, terms: Terms
) -> Pull:
    """Return the pull on the ray (x, y, 1) to a reading ``offset`` behind: to its plane, or a push."""
    nx, ny, nz = normal
    if abs(offset) < terms.gate_mm:
        residual = offset * (nx * x + ny * y + nz)
        weight = geman_mcclure((residual / (widening * terms.surface_tau_mm)) ** 2) / terms.sigma_mm**2
        return nx, ny, nz, residual, weight
    return 0.0, 0.0, 1.0, terms.gate_mm, terms.push if offset > 0.0 else 0.0


@inlined
def _outline_pull(
    share: float, aside: tuple[float, float], x: float, y: float, z: float, widening: float, terms: Terms
) -> Pull:
    """Return the pull in the image plane for a hand rendered at (x, y, 1) z outside the observed one."""
    px, py = aside[0] * z, aside[1] * z
    distance = np.sqrt(px * px + py * py)
    if share == 0.0 or distance == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    dx, dy = px / distance, py / distance
    weight = geman_mcclure((distance / (widening * terms.silhouette_tau_mm)) ** 2) / terms.sigma_mm**2
    return dx, dy, -(dx * x + dy * y), distance, share * weight  # orthogonal to the ray


@borrowing
def _add_closest(
    posed: Posed,
    skin: Skin,
    drawing: Drawing,
    terms: Terms,
    widening: float,
    buffers: TermBuffers,
    count: int,
    equations: NormalEquations,
) -> None:
    """Pull the nearest visible vertices to the unexplained points."""
    if count == 0:
        return
    facing = _note_facing(drawing, buffers)
    if facing == 0:
        return
    stride = (count + terms.most_unexplained - 1) // terms.most_unexplained
    row, vertices = buffers.row, drawing.vertices
    for k in range(0, count, stride):
        x, y, z = buffers.points[k, 0], buffers.points[k, 1], buffers.points[k, 2]
        place = np.float32(x), np.float32(y), np.float32(z)
        v = buffers.vertices[_nearest(buffers.places, buffers.squares, facing, *place)]
        px, py, pz = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        dx, dy, dz = x - px, y - py, z - pz
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        if distance < 1e-9:
            continue
        share, row[RESIDUAL] = 1.0 / distance, distance
        scale = widening * terms.closest_tau_mm
        weight = stride * geman_mcclure((distance / scale) ** 2) / terms.closest_mm**2
        dx, dy, dz = share * dx, share * dy, share * dz
        point_row(posed, skin.fingers[v], skin.reaches, v, px, py, pz, dx, dy, dz, row)
        add_row(equations, skin.fingers[v], row, weight)


@inlined
def _note_facing(drawing: Drawing, buffers: TermBuffers) -> int:
    """Write indices and positions of the visible vertices; return their number, rounded up with far ones."""
    count, places = 0, buffers.places
    for v in range(len(drawing.facing)):
        if drawing.facing[v]:
            buffers.vertices[count] = v
            for i in range(3):
                places[i, count] = drawing.vertices[v, i]
            count += 1
    last = (count + _TOGETHER - 1) // _TOGETHER * _TOGETHER
    for m in range(count, last):
        places[0, m] = places[1, m] = places[2, m] = np.inf
    return last


@borrowing
def _nearest(
    places: Float32Array, squares: Float32Array, count: int, x: np.float32, y: np.float32, z: np.float32
) -> int:
    """Return the index of the nearest one of the ``count`` first places (3, V).

    Squares within 2^-9 of each other count as equal: their last bits hold the index, and as non-negative
    floats sort like their bits, the least bits name the nearest. Minima of integers vectorise.
    """
    across, down, along = places[0], places[1], places[2]
    for m in range(count):
        ex, ey, ez = x - across[m], y - down[m], z - along[m]
        squares[m] = ex * ex + ey * ey + ez * ez
    bits, least = squares.view(np.int32), np.int32(2**31 - 1)
    for m in range(count):
        least = min(least, np.int32((bits[m] & ~_INDEX) | m))
    return int(least & _INDEX)


@borrowing
def union_cost(tile: Tile, drawing: Drawing, terms: Terms) -> float:
    """Return the union cost D of a rendered pose, mm."""
    error, both, missed = 0.0, 0, 0.0
    for j in range(tile.image.shape[0]):
        for i in range(tile.image.shape[1]):
            inverse, observed = drawing.inverse[j, i], tile.image[j, i]
            if inverse == 0.0:
                continue
            if observed > 0.0:
                both += 1
                error += min(abs(observed - 1.0 / inverse), terms.clamp_mm)
            else:
                missed += _missed(observed, 1.0 / inverse, terms)
    return _union(error, both, missed, tile.observed, terms.clamp_mm)
