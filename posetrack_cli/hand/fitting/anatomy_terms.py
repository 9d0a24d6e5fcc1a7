"""How plausible a hand's pose is in itself: joint limits, abduction with flexion, fingers that collide; compiled.

A potential U(x) = sum of w e^2 / 2 over violations e; exp(-U) is a factor of the likelihood, as if anatomy
were observed in every frame.

    joint limits          e = excess, rad
    abduction of a bent finger    e = abduction times the bend's share (taut collateral ligaments)
    relaxed hand          e = angle - relaxed angle, weakly: what nothing shows stays plausible
    collision             e = overlap of two fingers' spheres, mm
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.hand.anatomy import ANGLE_LIMITS, HandAnatomy
from posetrack_cli.hand.fitting.normal_equations import NormalEquations
from posetrack_cli.hand.fitting.skeleton import Posed, Skeleton, point_row, pose_bones

SPHERES = 5  # a finger: at joint 2, between, at joint 1, between, near the tip
FREE_BEND, STIFF_BEND = np.deg2rad(5.0), np.deg2rad(40.0)
_D = np.pi / 180.0
RELAXED: FloatArray = _D * np.array([5, 10, 0, 15, 2, 20, 15, 0, 22, 17, -2, 23, 20, -5, 24], dtype=np.float64)
"""(15,) angles of a relaxed hand, rad."""


class Plausibility(NamedTuple):
    """Constants of the potential.

    Attributes:
        low, high: (15,) joint limits, rad.
        relaxed: (15,) rad.
        radii: (5, 5) of the fingers' spheres, mm.
        limit, taut, rest: weights, 1 / rad^2.
        overlap: weight of a collision, 1 / mm^2.
        allowed_mm: so far skins may sink into each other.
    """

    low: FloatArray
    high: FloatArray
    relaxed: FloatArray
    radii: FloatArray
    limit: float = 400.0
    taut: float = 5.0
    rest: float = 0.5
    overlap: float = 0.2
    allowed_mm: float = 3.0


def plausibility_of(anatomy: HandAnatomy) -> Plausibility:
    """Return the constants for a hand: limits of the tables, spheres of its own radii."""
    r = anatomy.radii
    radii = np.stack([r[:, 1], 0.5 * (r[:, 1] + r[:, 2]), r[:, 2], 0.5 * (r[:, 2] + r[:, 3]), r[:, 3]], axis=1)
    low, high = (np.ascontiguousarray(side) for side in ANGLE_LIMITS.T)
    return Plausibility(low, high, RELAXED, radii)


@kernel
def _add_angle(equations: NormalEquations, k: int, residual: float, weight: float) -> float:
    """Pull angle k by a residual, and return the potential."""
    equations.matrix[6 + k, 6 + k] += weight
    equations.vector[6 + k] += weight * residual
    return 0.5 * weight * residual * residual


@kernel
def _add_limits(about: Plausibility, angles: FloatArray, equations: NormalEquations) -> float:
    value = 0.0
    for k in range(15):
        if angles[k] < about.low[k]:
            value += _add_angle(equations, k, about.low[k] - angles[k], about.limit)
        elif angles[k] > about.high[k]:
            value += _add_angle(equations, k, about.high[k] - angles[k], about.limit)
        value += _add_angle(equations, k, about.relaxed[k] - angles[k], about.rest)
    for f in range(1, 5):
        bent = (angles[3 * f] - FREE_BEND) / (STIFF_BEND - FREE_BEND)
        share = min(max(bent, 0.0), 1.0)
        if share > 0.0:
            value += _add_angle(equations, 3 * f + 1, -angles[3 * f + 1], about.taut * share)
    return value


@kernel
def _sphere(posed: Posed, f: int, k: int, out: FloatArray) -> int:
    """Write the centre of a finger's sphere; return the bone 1 or 2 that carries it."""
    joint2, joint1, tip = posed.centres[f, 1], posed.centres[f, 2], posed.tips[f]
    for i in range(3):
        if k == 0:
            out[i] = joint2[i]
        elif k == 1:
            out[i] = 0.5 * (joint2[i] + joint1[i])
        elif k == 2:
            out[i] = joint1[i]
        elif k == 3:
            out[i] = 0.6 * joint1[i] + 0.4 * tip[i]
        else:
            out[i] = 0.3 * joint1[i] + 0.7 * tip[i]
    return 1 if k < 2 else 2


@kernel
def _add_overlap(
    posed: Posed, f: int, h: int, k: int, m: int, about: Plausibility, equations: NormalEquations
) -> float:
    """Push sphere k of finger f and sphere m of finger h apart where they overlap."""
    p, q, d = np.empty(3), np.empty(3), np.empty(3)
    bone, other = _sphere(posed, f, k, p), _sphere(posed, h, m, q)
    distance = 1e-9
    for i in range(3):
        d[i] = p[i] - q[i]
    distance += np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    overlap = about.radii[f, k] + about.radii[h, m] - about.allowed_mm - distance
    if overlap <= 0.0:
        return 0.0
    for i in range(3):
        d[i] /= distance
    ones, row, against = np.ones(3), np.empty(9), np.empty(9)
    ones[2] = 1.0 if bone == 2 else 0.0
    point_row(posed, f, ones, p, d, row)
    ones[2] = 1.0 if other == 2 else 0.0
    point_row(posed, h, ones, q, d, against)
    H, g, w = equations.matrix, equations.vector, about.overlap
    first, second = 6 + 3 * f, 6 + 3 * h
    for i in range(3):  # palm motion moves both alike
        g[first + i] += w * row[6 + i] * overlap
        g[second + i] -= w * against[6 + i] * overlap
        for j in range(3):
            if j >= i:
                H[first + i, first + j] += w * row[6 + i] * row[6 + j]
                H[second + i, second + j] += w * against[6 + i] * against[6 + j]
            H[min(first, second) + i, max(first, second) + j] -= w * (
                row[6 + i] * against[6 + j] if first < second else against[6 + i] * row[6 + j]
            )
    return 0.5 * w * overlap * overlap


@kernel
def add_anatomy(about: Plausibility, pose: FloatArray, posed: Posed, equations: NormalEquations) -> float:
    """Add the potential's residuals at a pose (22,) to the upper triangle, and return U."""
    value = _add_limits(about, pose[7:], equations)
    for f in range(5):
        others = range(1, 5) if f == 0 else range(f + 1, min(f + 2, 5))
        for h in others:
            for k in range(SPHERES):
                for m in range(SPHERES):
                    value += _add_overlap(posed, f, h, k, m, about, equations)
    return value


@kernel
def potentials(
    about: Plausibility,
    skeleton: Skeleton,
    poses: FloatArray,
    posed: Posed,
    equations: NormalEquations,
    out: FloatArray,
) -> None:
    """Write U (N,) of poses (N, 22)."""
    for n in range(len(poses)):
        pose_bones(skeleton, poses[n], posed)
        out[n] = add_anatomy(about, poses[n], posed, equations)
