"""Anatomical plausibility of a pose: joint limits, abduction with flexion, finger collisions; compiled.

A potential U(x) = sum of w e^2 / 2 over violations e; exp(-U) is a factor of the likelihood, as if anatomy
were observed in every frame.

    joint limits       e = excess, rad
    bent finger        e = abduction - that of the scaphoid's direction, more strongly the more it is bent:
                       the collateral ligaments are taut then
    relaxed hand       e = angle - relaxed angle, weakly, for hidden joints
    resting thumb      or e = angle of a thumb - resting angle, weighted by the probability that it rests:
                       most hidden thumbs do, visible ones may be anywhere
    closing finger     or e = angle of joint 2 - that coupled to joint 3 in closing fingers, and, more weakly,
                       angle of joint 3 - closed angle, weighted by the probability that it closes: from the
                       back of the hand, closing is hidden
    straight finger    or e = angle of joint 2 - straight angle, and, more weakly, angle of joint 3 - its
                       mean, weighted by the probability that it is straight: straight fingers also bend at
                       the knuckle
    neighbours         e = difference of two neighbours' joints 2, less the more their joints 3 differ: a
                       visible finger is evidence for a hidden one bent alike
    collision          e = overlap of two fingers' spheres, mm
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import borrowing, kernel
from posetrack_cli.hand.fit.normal_equations import ROW, THUMB_PART, THUMB_PLACE, NormalEquations
from posetrack_cli.hand.fit.skeleton import THUMB_ROW, Posed, Skeleton, point_row, pose_bones
from posetrack_cli.hand.model.anatomy import ANGLE_LIMITS, HandAnatomy

SPHERES = 5  # a finger: at joint 2, between, at joint 1, between, near the tip
FREE_BEND, STIFF_BEND = np.deg2rad(5.0), np.deg2rad(40.0)
_D = np.pi / 180.0
RELAXED: FloatArray = _D * np.array(
    [15, 22, 5, 15, 2, 20, 15, 0, 22, 17, -2, 23, 20, -5, 24], dtype=np.float64
)
"""(15,) angles of a relaxed hand, rad."""
_REST: FloatArray = np.array([4.0, 4.0, 8.0, *[0.5] * 12])
"""(15,) 1 / rad^2: standard deviations of 29 degrees for a thumb's flexions and 20 for its abduction; a
finger's 81 degrees leave it free."""
_RESTING: FloatArray = _D * np.array([14.0, 24.0, 16.0])
_RESTING_WEIGHTS: FloatArray = 1.0 / np.square(_D * np.array([12.0, 12.0, 10.0]))
"""Angles of a resting thumb and their weights, tuned around the means of people 640 to 753 (14, 18 and
10 degrees, sd 7, 13 and 8)."""
_CLOSED: FloatArray = _D * np.array([76.0, 87.0])
"""Flexion of joints 3 and 2 of a closed finger, between the synthetic fist (80, 95) and closed fingers seen
from the palm (66, 79). While closing, joint 2 follows joint 3 (``Plausibility.coupling``)."""

_STRAIGHT: FloatArray = _D * np.array([30.0, 5.0])
_STRAIGHT_WEIGHTS: FloatArray = 1.0 / np.square(_D * np.array([40.0, 12.0]))
"""Flexion of joints 3 and 2 of a straight finger, whether bent at the knuckle or not, and their weights.
Without this mode a flat hand with hidden fingers costs ten nats more than a fist."""

ALIKE_WEIGHT = 1.0 / (20.0 * _D) ** 2
"""Weight of the difference of two neighbours' joints 2 at equal joints 3, in 1 / rad^2."""


_SCAPHOID = 1.0 / 3.0
"""Position of the scaphoid's tubercle, which bent fingers point at, as a share of the way from the wrist
joint to the thumb's base."""


class Plausibility(NamedTuple):
    """Constants of the potential.

    Attributes:
        low, high: (15,) joint limits, rad.
        relaxed: (15,) rad.
        radii: (5, 5) of the fingers' spheres, mm.
        rest: (15,) weights of the relaxed angles, 1 / rad^2.
        resting: (3,) angles of a resting thumb, rad.
        resting_weights: (3,) of these, 1 / rad^2.
        closed: (2,) flexion of joints 3 and 2 of a closed finger, rad.
        coupling: flexion of a closing finger's joint 2 per radian of joint 3.
        converging: (4,) abduction of a bent finger, rad.
        limit, taut: weights of the limits and of a bent finger's abduction, 1 / rad^2.
        closing_weight, knuckle_weight: of joints 2 and 3 of a closing finger, 1 / rad^2.
        resting_odds: log odds of a resting thumb, including the heights of both densities: four of five rest.
        closing_odds: log odds of a closing finger, like ``resting_odds``.
        straight: (2,) flexion of joints 3 and 2 of a straight finger, rad.
        straight_weights: (2,) of these, 1 / rad^2.
        straight_odds: log odds of a straight finger, like ``resting_odds``.
        alike_weight: of neighbours' joints 2 at equal joints 3, 1 / rad^2.
        alike_sd: difference of joints 3, rad, at which that weight falls to exp(-1/2).
        overlap: weight of a collision, 1 / mm^2.
        allowed_mm: overlap of skins without penalty.
    """

    low: FloatArray
    high: FloatArray
    relaxed: FloatArray
    radii: FloatArray
    rest: FloatArray
    resting: FloatArray
    resting_weights: FloatArray
    closed: FloatArray
    straight: FloatArray
    straight_weights: FloatArray
    converging: FloatArray
    coupling: float = 0.5
    limit: float = 400.0
    taut: float = 12.0
    closing_weight: float = 6.0
    knuckle_weight: float = 2.0
    resting_odds: float = 3.8
    closing_odds: float = 2.2
    straight_odds: float = 1.0
    alike_weight: float = ALIKE_WEIGHT
    alike_sd: float = 0.3
    overlap: float = 0.2
    allowed_mm: float = 3.0


def plausibility_of(anatomy: HandAnatomy) -> Plausibility:
    """Return the constants of a hand: limits from the tables, spheres from its radii."""
    r = anatomy.radii
    radii = np.stack(
        [r[:, 1], 0.5 * (r[:, 1] + r[:, 2]), r[:, 2], 0.5 * (r[:, 2] + r[:, 3]), r[:, 3]], axis=1
    )
    low, high = (np.ascontiguousarray(side) for side in ANGLE_LIMITS.T)
    return Plausibility(
        low,
        high,
        RELAXED,
        radii,
        _REST,
        _RESTING,
        _RESTING_WEIGHTS,
        _CLOSED,
        _STRAIGHT,
        _STRAIGHT_WEIGHTS,
        _converging(anatomy),
    )


def _converging(anatomy: HandAnatomy) -> FloatArray:
    """Return abductions (4,), rad, at which the fingers' bending planes meet at the scaphoid's tubercle.

    Bent fingers converge on it (Kapandji, The Physiology of the Joints, vol. 1): their tips are closer to the
    thumb than if they bent in the direction of the straight fingers.
    """
    from_scaphoid = anatomy.base_positions[1:] - _SCAPHOID * anatomy.base_positions[0]
    fan = -anatomy.base_rotations[1:, :, 1]
    aside = [np.arctan2(way[:, 0], -way[:, 1]) for way in (from_scaphoid, fan)]
    out: FloatArray = (-1.0 if anatomy.is_left else 1.0) * (aside[0] - aside[1])
    return out


@borrowing
def _add_angle(equations: NormalEquations, k: int, residual: float, weight: float) -> float:
    """Add a residual of angle k; return its potential."""
    equations.matrix[6 + k, 6 + k] += weight
    equations.vector[6 + k] += weight * residual
    return 0.5 * weight * residual * residual


@borrowing
def _add_limits(about: Plausibility, angles: FloatArray, equations: NormalEquations) -> float:
    value = 0.0
    for k in range(15):
        if angles[k] < about.low[k]:
            value += _add_angle(equations, k, about.low[k] - angles[k], about.limit)
        elif angles[k] > about.high[k]:
            value += _add_angle(equations, k, about.high[k] - angles[k], about.limit)
        value += _add_angle(equations, k, about.relaxed[k] - angles[k], about.rest[k])
    for f in range(1, 5):
        bent = (angles[3 * f] - FREE_BEND) / (STIFF_BEND - FREE_BEND)
        share = min(max(bent, 0.0), 1.0)
        if share > 0.0:
            off = about.converging[f - 1] - angles[3 * f + 1]
            value += _add_angle(equations, 3 * f + 1, off, about.taut * share)
    return value


@borrowing
def _add_rest(about: Plausibility, angles: FloatArray, equations: NormalEquations) -> float:
    """Replace a thumb's relaxed prior by the resting one, with the probability that it rests.

    With U_w and U_r = sum of w e^2 / 2 for the relaxed and the resting angles, and o the log odds, the
    potential is -log((exp(-U_w) + exp(o - U_r)) / (1 + exp(o))), at least 0. ``_add_limits`` has already
    added U_w.
    """
    log_odds = about.resting_odds
    for k in range(3):
        anywhere, off = about.relaxed[k] - angles[k], about.resting[k] - angles[k]
        log_odds += 0.5 * (about.rest[k] * anywhere * anywhere - about.resting_weights[k] * off * off)
    most = max(0.0, log_odds)
    whole = np.exp(-most) + np.exp(log_odds - most)
    rests = np.exp(log_odds - most) / whole
    for k in range(3):
        _add_angle(equations, k, about.relaxed[k] - angles[k], -rests * about.rest[k])
        _add_angle(equations, k, about.resting[k] - angles[k], rests * about.resting_weights[k])
    return float(np.log(1.0 + np.exp(about.resting_odds)) - most - np.log(whole))


@borrowing
def _add_folds(about: Plausibility, angles: FloatArray, equations: NormalEquations) -> float:
    """Replace fingers' relaxed prior by a mixture with closing and straight fingers.

    With U_r, U_c and U_s = sum of w e^2 / 2 for relaxed, closing and straight fingers, and o their log odds,
    the potential is -log(exp(-U_r) + exp(o_c - U_c) + exp(o_s - U_s)). ``_add_limits`` has already added U_r;
    the difference is -log(1 + exp(o_c - U_c + U_r) + exp(o_s - U_s + U_r)), whose gradient is that of s_c
    (U_c - U_r) + s_s (U_s - U_r), with s the probabilities that it closes or is straight.
    """
    value = 0.0
    for f in range(1, 5):
        a, b = 3 * f, 3 * f + 2
        at_rest = 0.0
        for i in (a, b):
            off = about.relaxed[i] - angles[i]
            at_rest += 0.5 * about.rest[i] * off * off
        short = about.closed[0] - angles[a]
        bent = about.closed[1] - about.coupling * short - angles[b]
        closing = about.closing_odds + at_rest
        closing -= 0.5 * (about.closing_weight * bent * bent + about.knuckle_weight * short * short)
        knuckle, middle = about.straight[0] - angles[a], about.straight[1] - angles[b]
        straight = about.straight_odds + at_rest
        straight -= 0.5 * (
            about.straight_weights[0] * knuckle * knuckle + about.straight_weights[1] * middle * middle
        )
        most = max(0.0, closing, straight)
        whole = np.exp(-most) + np.exp(closing - most) + np.exp(straight - most)
        closes, is_straight = np.exp(closing - most) / whole, np.exp(straight - most) / whole
        for i in (a, b):
            _add_angle(equations, i, about.relaxed[i] - angles[i], -(closes + is_straight) * about.rest[i])
        _add_angle(equations, a, short, closes * about.knuckle_weight)
        _add_coupled(equations, a, b, about.coupling, bent, closes * about.closing_weight)
        _add_angle(equations, a, knuckle, is_straight * about.straight_weights[0])
        _add_angle(equations, b, middle, is_straight * about.straight_weights[1])
        value -= most + np.log(whole)
    return value


@borrowing
def _add_neighbours(about: Plausibility, angles: FloatArray, equations: NormalEquations) -> float:
    """Pull joints 2 of neighbouring fingers together; the weight is treated as constant, as in ``taut``."""
    value = 0.0
    for f in range(1, 4):
        a, b = 3 * f, 3 * f + 3
        apart = (angles[a] - angles[b]) / about.alike_sd
        weight = about.alike_weight * np.exp(-0.5 * apart * apart)
        off = angles[a + 2] - angles[b + 2]
        _add_coupled(equations, a + 2, b + 2, 1.0, off, weight)
        value += 0.5 * weight * off * off
    return value


@borrowing
def _add_coupled(
    equations: NormalEquations, a: int, b: int, coupling: float, residual: float, weight: float
) -> None:
    """Add a residual of angle b coupled to angle a."""
    i, j, H, g = 6 + a, 6 + b, equations.matrix, equations.vector
    H[i, i] += weight * coupling * coupling
    H[j, j] += weight
    H[i, j] -= weight * coupling
    H[j, i] -= weight * coupling
    g[i] -= weight * coupling * residual
    g[j] += weight * residual


@borrowing
def place_spheres(posed: Posed, out: FloatArray) -> None:
    """Write the centres (5, SPHERES, 3) of the fingers' spheres, camera coordinates, mm."""
    for f in range(5):
        for i in range(3):
            joint2, joint1, tip = posed.centres[f, 1, i], posed.centres[f, 2, i], posed.tips[f, i]
            out[f, 0, i] = joint2
            out[f, 1, i] = 0.5 * (joint2 + joint1)
            out[f, 2, i] = joint1
            out[f, 3, i] = 0.6 * joint1 + 0.4 * tip
            out[f, 4, i] = 0.3 * joint1 + 0.7 * tip


@kernel
def _add_overlap(
    posed: Posed,
    pair: tuple[int, int, int, int],
    p: FloatArray,
    q: FloatArray,
    overlap: float,
    weight: float,
    equations: NormalEquations,
) -> None:
    """Push spheres k and m (at p and q) of fingers f < h apart; the palm moves both alike."""
    f, h, k, m = pair
    dx, dy, dz = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    share = 1.0 / (np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-9)
    dx, dy, dz = share * dx, share * dy, share * dz
    reaches, row, against = np.ones((2, 3)), np.empty(ROW), np.empty(ROW)
    reaches[0, 2], reaches[1, 2] = 1.0 if k > 1 else 0.0, 1.0 if m > 1 else 0.0
    point_row(posed, f, reaches, 0, p[0], p[1], p[2], dx, dy, dz, row)
    point_row(posed, h, reaches, 1, q[0], q[1], q[2], dx, dy, dz, against)
    H, g, first, second = equations.matrix, equations.vector, 6 + 3 * f, 6 + 3 * h
    for i in range(3):
        g[first + i] += weight * row[6 + i] * overlap
        g[second + i] -= weight * against[6 + i] * overlap
        for j in range(3):
            H[first + i, first + j] += weight * row[6 + i] * row[6 + j]
            H[second + i, second + j] += weight * against[6 + i] * against[6 + j]
            H[first + i, second + j] -= weight * row[6 + i] * against[6 + j]
            H[second + j, first + i] -= weight * row[6 + i] * against[6 + j]
    if f != THUMB_ROW:
        return
    for i in range(2):
        at, moved = THUMB_PLACE + i, weight * row[THUMB_PART + i]
        g[at] += moved * overlap
        for j in range(3):
            H[at, first + j] += moved * row[6 + j]
            H[first + j, at] += moved * row[6 + j]
            H[at, second + j] -= moved * against[6 + j]
            H[second + j, at] -= moved * against[6 + j]
        for j in range(2):
            H[at, THUMB_PLACE + j] += moved * row[THUMB_PART + j]


@borrowing
def _add_collisions(
    about: Plausibility, posed: Posed, spheres: FloatArray, f: int, h: int, equations: NormalEquations
) -> float:
    """Add the overlaps of two fingers; return their potential."""
    value = 0.0
    for k in range(SPHERES):
        x, y, z = spheres[f, k, 0], spheres[f, k, 1], spheres[f, k, 2]
        for m in range(SPHERES):
            ex, ey, ez = x - spheres[h, m, 0], y - spheres[h, m, 1], z - spheres[h, m, 2]
            allowed = about.radii[f, k] + about.radii[h, m] - about.allowed_mm
            square = ex * ex + ey * ey + ez * ez
            if square < allowed * allowed:
                overlap = allowed - np.sqrt(square)
                value += 0.5 * about.overlap * overlap * overlap
                pair = (f, h, k, m)
                _add_overlap(posed, pair, spheres[f, k], spheres[h, m], overlap, about.overlap, equations)
    return value


@borrowing
def add_anatomy(
    about: Plausibility, pose: FloatArray, posed: Posed, spheres: FloatArray, equations: NormalEquations
) -> float:
    """Add the potential's residuals at a pose (22,) to matrix and vector; return U.

    Args:
        about: constants.
        pose, posed: the pose and its bones.
        spheres: (5, SPHERES, 3), overwritten.
        equations: to add to.
    """
    angles = pose[7:]
    value = _add_limits(about, angles, equations)
    value += _add_rest(about, angles, equations) + _add_folds(about, angles, equations)
    value += _add_neighbours(about, angles, equations)
    place_spheres(posed, spheres)
    for f in range(5):
        for h in range(f + 1, 5 if f == 0 else min(f + 2, 5)):  # the thumb reaches all fingers
            value += _add_collisions(about, posed, spheres, f, h, equations)
    return value


@borrowing
def potentials(
    about: Plausibility,
    skeleton: Skeleton,
    poses: FloatArray,
    inner: FloatArray,
    first: int,
    stride: int,
    posed: Posed,
    spheres: FloatArray,
    equations: NormalEquations,
    out: FloatArray,
) -> None:
    """Write U (N,) of every ``stride``-th of poses (N, 22) with inner numbers (6,)."""
    for n in range(first, len(poses), stride):
        pose_bones(skeleton, poses[n], inner, posed)
        out[n] = add_anatomy(about, poses[n], posed, spheres, equations)
