"""What pulls a pose towards a depth image: residuals of pixels and their derivatives; compiled.

With r the pixels on which the model is drawn and o the hand's observed pixels (hand-findings.md):

    r and o, |dz| < gate     projective point-to-plane: n . (observed - drawn)
    r and o, drawn far in front of the reading     a weak push along z
    r, a reading behind it   pull in the image plane to the nearest hand pixel
    o, not explained         the nearest point of the skin that faces the camera is pulled there

A reading that is no hand's and in front of the model hides it; where there is none, nothing is said.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.hand.fitting.normal_equations import ROW, NormalEquations, add_row
from posetrack_cli.hand.fitting.raster import Drawing, Skin, View
from posetrack_cli.hand.fitting.skeleton import Posed, point_row


class Tile(NamedTuple):
    """What was observed, as the kernels read it.

    Attributes:
        image: (h, w) depth of the hand's pixels, mm; negative: other readings; 0: none, or not to count.
        nearest: (2, h, w) column and row of the nearest hand pixel.
        observed: number of the hand's pixels.
        projection: how points fall on it.
    """

    image: FloatArray
    nearest: FloatArray
    observed: int
    projection: View


class Terms(NamedTuple):
    """Weights of the terms.

    Attributes:
        sigma_mm: of a point-to-plane residual, and of a pull in the image plane.
        closest_mm: of an unexplained pixel's distance from the skin.
        push: weight of the push along z, 1 / mm^2.
        gate_mm: up to here a depth difference is one of corresponding points.
        explained_mm: beyond it an observed pixel looks for another part of the skin.
        surface_tau_mm, silhouette_tau_mm, closest_tau_mm: scales of the robust factor.
        clamp_mm, unread_weight: of the union cost.
        most_unexplained: so many unexplained pixels are used, evenly chosen.
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


class Scratch(NamedTuple):
    """Room for ``add_terms``: unexplained points (h w, 3), vertices that face the camera (V,)."""

    points: FloatArray
    vertices: IntArray


def empty_scratch(skin: Skin, height: int, width: int) -> Scratch:
    """Return room for one image."""
    return Scratch(np.zeros((height * width, 3)), np.zeros(len(skin.vertices), dtype=np.int64))


@inlined
def _robust(e: float, tau: float) -> float:
    """The factor 1 / (1 + (e / tau)^2)^2 of Geman and McClure."""
    s = 1.0 + (e / tau) * (e / tau)
    return 1.0 / (s * s)


@kernel
def add_terms(
    tile: Tile,
    posed: Posed,
    skin: Skin,
    drawing: Drawing,
    terms: Terms,
    widening: float,
    scratch: Scratch,
    equations: NormalEquations,
) -> float:
    """Add all residuals of a drawn pose, and return its union cost D, mm (hand.md, observation model).

    Args:
        tile: the observation.
        posed, drawing: of the pose.
        skin: the mesh.
        terms: weights.
        widening: factor on the robust scales.
        scratch: room.
        equations: residuals are added to its blocks.
    """
    height, width = tile.image.shape
    view = tile.projection
    row = np.empty(ROW)
    fingers, reaches, normals = skin.triangle_fingers, skin.triangle_reaches, drawing.normals
    inverse_variance = 1.0 / (terms.sigma_mm * terms.sigma_mm)
    error, both, missed, unexplained = 0.0, 0, 0.0, 0
    for j in range(height):
        y = (j + 0.5 - view.d) / view.c
        for i in range(width):
            observed, inverse = tile.image[j, i], drawing.inverse[j, i]
            x = (i + 0.5 - view.b) / view.a
            if inverse == 0.0:
                if observed > 0.0:
                    _note(scratch.points, unexplained, x, y, observed)
                    unexplained += 1
                continue
            z = 1.0 / inverse
            t = drawing.triangle[j, i]
            if observed > 0.0:
                dz = observed - z
                both += 1
                error += min(abs(dz), terms.clamp_mm)
                if abs(dz) < terms.gate_mm:
                    dx, dy, nz = normals[t, 0], normals[t, 1], normals[t, 2]
                    row[9] = dz * (dx * x + dy * y + nz)
                    weight = inverse_variance * _robust(row[9], widening * terms.surface_tau_mm)
                    point_row(posed, fingers[t], reaches, t, x * z, y * z, z, dx, dy, nz, row)
                    add_row(equations, fingers[t], row, weight)
                elif dz > 0.0:
                    row[9] = terms.gate_mm
                    point_row(posed, fingers[t], reaches, t, x * z, y * z, z, 0.0, 0.0, 1.0, row)
                    add_row(equations, fingers[t], row, terms.push)
                if abs(dz) > terms.explained_mm:
                    _note(scratch.points, unexplained, x, y, observed)
                    unexplained += 1
            elif observed == 0.0:
                missed += terms.unread_weight
            elif -observed > z - terms.explained_mm:
                missed += 1.0
                dx = (tile.nearest[0, j, i] - i) / view.a * z
                dy = (tile.nearest[1, j, i] - j) / view.c * z
                distance = np.sqrt(dx * dx + dy * dy)
                if distance > 0.0:
                    row[9], dx, dy = distance, dx / distance, dy / distance
                    weight = inverse_variance * _robust(distance, widening * terms.silhouette_tau_mm)
                    nz = -(dx * x + dy * y)
                    point_row(posed, fingers[t], reaches, t, x * z, y * z, z, dx, dy, nz, row)
                    add_row(equations, fingers[t], row, weight)
    _add_closest(posed, skin, drawing, terms, widening, scratch, unexplained, equations)
    disagree = missed + (tile.observed - both)
    union = both + disagree
    if union <= 0.0:
        return terms.clamp_mm
    return (error + terms.clamp_mm * disagree) / union


@inlined
def _note(points: FloatArray, k: int, x: float, y: float, z: float) -> None:
    points[k, 0], points[k, 1], points[k, 2] = x * z, y * z, z


@kernel
def _add_closest(
    posed: Posed,
    skin: Skin,
    drawing: Drawing,
    terms: Terms,
    widening: float,
    scratch: Scratch,
    count: int,
    equations: NormalEquations,
) -> None:
    """Pull the nearest vertices that face the camera to the unexplained points."""
    facing = 0
    for v in range(len(drawing.facing)):
        if drawing.facing[v]:
            scratch.vertices[facing] = v
            facing += 1
    if facing == 0 or count == 0:
        return
    stride = (count + terms.most_unexplained - 1) // terms.most_unexplained
    row, vertices = np.empty(ROW), drawing.vertices
    for k in range(0, count, stride):
        x, y, z = scratch.points[k, 0], scratch.points[k, 1], scratch.points[k, 2]
        best, nearest = 1e30, 0
        for m in range(facing):
            v = scratch.vertices[m]
            ex, ey, ez = x - vertices[v, 0], y - vertices[v, 1], z - vertices[v, 2]
            square = ex * ex + ey * ey + ez * ez
            if square < best:
                best, nearest = square, v
        distance = np.sqrt(best)
        if distance < 1e-9:
            continue
        px, py, pz = vertices[nearest, 0], vertices[nearest, 1], vertices[nearest, 2]
        weight = stride / (terms.closest_mm * terms.closest_mm)
        weight *= _robust(distance, widening * terms.closest_tau_mm)
        finger, share = skin.fingers[nearest], 1.0 / distance
        row[9] = distance
        point_row(
            posed,
            finger,
            skin.reaches,
            nearest,
            px,
            py,
            pz,
            share * (x - px),
            share * (y - py),
            share * (z - pz),
            row,
        )
        add_row(equations, finger, row, weight)


@kernel
def union_cost(tile: Tile, drawing: Drawing, terms: Terms) -> float:
    """The union cost D of a drawn pose, mm."""
    height, width = tile.image.shape
    error, both, missed = 0.0, 0, 0.0
    for j in range(height):
        for i in range(width):
            inverse = drawing.inverse[j, i]
            if inverse == 0.0:
                continue
            observed = tile.image[j, i]
            if observed > 0.0:
                both += 1
                error += min(abs(observed - 1.0 / inverse), terms.clamp_mm)
            elif observed == 0.0:
                missed += terms.unread_weight
            elif -observed > 1.0 / inverse - terms.explained_mm:
                missed += 1.0
    disagree = missed + (tile.observed - both)
    union = both + disagree
    if union <= 0.0:
        return terms.clamp_mm
    return (error + terms.clamp_mm * disagree) / union
