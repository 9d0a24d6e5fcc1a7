"""How plausible a pose is in itself: joint limits, abduction with flexion, fingers that collide; compiled.

A potential U(x) = sum of w e^2 / 2 over violations e; exp(-U) is a factor of the likelihood, as if anatomy
were observed in every frame.

    joint limits          e = excess, rad
    abduction of a bent finger    e = abduction - that at which it points at the scaphoid, the more so the
                          more it is bent: collateral ligaments are taut then
    relaxed hand          e = angle - relaxed angle, weakly: what nothing shows stays plausible
    resting thumb         or e = angle of a thumb - resting angle, the more so the more probably it rests: one
                          that nothing shows mostly does, and one that is seen may be anywhere
    closing finger        or e = angle of joint 2 - what joint 3 makes it where fingers close, and, weaker,
                          angle of joint 3 - closed angle, the more so the more probably it closes:
                          nothing shows how far the fingers of a hand seen from the back are closed
    straight finger       or e = angle of joint 2 - straight angle, and, weaker, angle of joint 3 - its
                          middle, the more so the more probably it is straight: people bend straight
                          fingers at the knuckle, too
    neighbours            e = difference of two neighbours' joints 2, the less the more their joints 3 differ:
                          where one of two fingers that are bent alike is hidden, the other tells of it
    collision             e = overlap of two fingers' spheres, mm
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
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
"""(15,) 1 / rad^2: standard deviations of 29 degrees for a thumb's flexions and of 20 for its abduction; a
finger's 81 degrees leave it free."""
_RESTING: FloatArray = _D * np.array([14.0, 24.0, 16.0])
_RESTING_WEIGHTS: FloatArray = 1.0 / np.square(_D * np.array([12.0, 12.0, 10.0]))
"""Angles of a thumb that rests, and what differing from them weighs. The thumbs of our hands, laid on the
joints of people 640 to 753, have 14, 18 and 10 degrees (sd 7, 13 and 8); where the back of the hand hides
the tip, these place it best."""
_CLOSED: FloatArray = _D * np.array([76.0, 87.0])
"""Flexion of joints 3 and 2 of a closed finger: between the fist that ``hand synth`` draws (80, 95) and the
closed fingers of strangers who show their palms (66, 79; people 640-650, each with the own mesh). On the way
there joint 2 bends with joint 3 (``Plausibility.coupling``), as people's fingers do on average: where joint 3
is bent by 37, 52, 67 and 82 degrees, joint 2 of CVAR's P1 is by 46, 55, 70 and 74, sd 30, and that of P7, who
points, by 87, 81, 83 and 83."""

_STRAIGHT: FloatArray = _D * np.array([30.0, 5.0])
_STRAIGHT_WEIGHTS: FloatArray = 1.0 / np.square(_D * np.array([40.0, 12.0]))
"""Flexion of joints 3 and 2 of a finger that is straight, bent at the knuckle or not, and what differing
from it weighs. Where joint 3 is bent by 40 to 70 degrees, joint 2 is by less than 15 in .18 of CVAR's P1, .49
of P4, .05 of P7 and .29 of people 640-753, and by more than 60 in .42, .09, .89 and .40. Without this a flat
hand whose fingers are hidden costs ten nats more than a fist."""

ALIKE_WEIGHT = 1.0 / (20.0 * _D) ** 2
"""Of the difference of two neighbours' joints 2, where their joints 3 are bent alike. Where these differ by
less than 15 degrees, those of CVAR's P1 and P4 differ by 22 to 36 (rms; the median is 10 to 23), P7's by 14
to 17 but for the index, who points (92), and those of people 700-753, whose motions bend most fingers alike,
by 5 to 11; where joints 3 differ by more than 25 degrees, P1's, P4's and the people's by 29 to 69."""


_SCAPHOID = 1.0 / 3.0
"""Where the scaphoid's tubercle is, which bent fingers point at: as a share of the way from the wrist's joint
to the thumb's base."""


class Plausibility(NamedTuple):
    """Constants of the potential.

    Attributes:
        low, high: (15,) joint limits, rad.
        relaxed: (15,) rad.
        radii: (5, 5) of the fingers' spheres, mm.
        rest: (15,) weights of the relaxed angles, 1 / rad^2.
        resting: (3,) angles of a thumb that rests, rad.
        resting_weights: (3,) of these, 1 / rad^2.
        closed: (2,) flexion of joints 3 and 2 of a closed finger, rad.
        coupling: how far joint 2 of a finger that closes bends for each radian of joint 3.
        converging: (4,) abduction of a bent finger, rad.
        limit, taut: weights of the limits and of a bent finger's abduction, 1 / rad^2.
        closing_weight, knuckle_weight: of joints 2 and 3 of a finger that closes, 1 / rad^2.
        resting_odds: log odds of a thumb that rests, the heights of both densities included: four of five do.
        closing_odds: log odds of a finger that closes, like ``resting_odds``.
        straight: (2,) flexion of joints 3 and 2 of a straight finger, rad.
        straight_weights: (2,) of these, 1 / rad^2.
        straight_odds: log odds of a straight finger, like ``resting_odds``.
        alike_weight: of neighbours' joints 2 where joints 3 are bent alike, 1 / rad^2.
        alike_sd: how far joints 3 differ, rad, where that counts exp(-1/2) of it.
        overlap: weight of a collision, 1 / mm^2.
        allowed_mm: how far skins may sink into each other.
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
    """Return the constants for a hand: limits of the tables, spheres of its own radii."""
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
    """Abductions (4,), rad, at which the planes that fingers bend in meet at the scaphoid's tubercle.

    Bent fingers converge on it (Kapandji, The Physiology of the Joints, vol. 1): tips that nothing shows are
    nearer to the thumb's side than those of fingers that bend where they point when they are straight. Planes
    of closed ring and little fingers are turned by 18 and 30 degrees of people 642-747, and of CVAR's P7 by
    6 and 11 (joint 2 to tip) to 17 and 26 (joint 3 to 2). This asks 17 and 30; straight fingers fan out by 4
    and 10.
    """
    from_scaphoid = anatomy.base_positions[1:] - _SCAPHOID * anatomy.base_positions[0]
    fan = -anatomy.base_rotations[1:, :, 1]
    aside = [np.arctan2(way[:, 0], -way[:, 1]) for way in (from_scaphoid, fan)]
    out: FloatArray = (-1.0 if anatomy.is_left else 1.0) * (aside[0] - aside[1])
    return out


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
        value += _add_angle(equations, k, about.relaxed[k] - angles[k], about.rest[k])
    for f in range(1, 5):
        bent = (angles[3 * f] - FREE_BEND) / (STIFF_BEND - FREE_BEND)
        share = min(max(bent, 0.0), 1.0)
        if share > 0.0:
            off = about.converging[f - 1] - angles[3 * f + 1]
            value += _add_angle(equations, 3 * f + 1, off, about.taut * share)
    return value


@kernel
def _add_rest(about: Plausibility, angles: FloatArray, equations: NormalEquations) -> float:
    """Pull a thumb to where thumbs rest instead of to the relaxed angles, as far as it probably rests.

    With U_w and U_r = sum of w e^2 / 2 what the relaxed and the resting angles cost, and o the odds, its
    potential is -log((exp(-U_w) + exp(o - U_r)) / (1 + exp(o))), at least 0. As in ``_add_folds``,
    ``_add_limits`` has U_w.
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


@kernel
def _add_folds(about: Plausibility, angles: FloatArray, equations: NormalEquations) -> float:
    """Pull fingers to where closing or straight fingers are instead of to where relaxed ones are.

    With U_r what the relaxed angles, and U_c and U_s = sum of w e^2 / 2 what closing and being straight cost
    a finger, and o their odds, its potential is -log(exp(-U_r) + exp(o_c - U_c) + exp(o_s - U_s)).
    ``_add_limits`` has U_r; the difference is -log(1 + exp(o_c - U_c + U_r) + exp(o_s - U_s + U_r)), whose
    gradient is that of s_c (U_c - U_r) + s_s (U_s - U_r), s the probabilities that it closes or is straight.
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


@kernel
def _add_neighbours(about: Plausibility, angles: FloatArray, equations: NormalEquations) -> float:
    """Pull joints 2 of neighbouring fingers to each other; how much it counts is held as ligaments' is."""
    value = 0.0
    for f in range(1, 4):
        a, b = 3 * f, 3 * f + 3
        apart = (angles[a] - angles[b]) / about.alike_sd
        weight = about.alike_weight * np.exp(-0.5 * apart * apart)
        off = angles[a + 2] - angles[b + 2]
        _add_coupled(equations, a + 2, b + 2, 1.0, off, weight)
        value += 0.5 * weight * off * off
    return value


@kernel
def _add_coupled(
    equations: NormalEquations, a: int, b: int, coupling: float, residual: float, weight: float
) -> None:
    """Pull angle b by a residual, and against it angle a, which it is coupled to."""
    i, j, H, g = 6 + a, 6 + b, equations.matrix, equations.vector
    H[i, i] += weight * coupling * coupling
    H[j, j] += weight
    H[i, j] -= weight * coupling
    H[j, i] -= weight * coupling
    g[i] -= weight * coupling * residual
    g[j] += weight * residual


@kernel
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
    """Push spheres k and m (at p and q) of fingers f < h apart; palm motion moves both alike."""
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


@kernel
def _add_collisions(
    about: Plausibility, posed: Posed, spheres: FloatArray, f: int, h: int, equations: NormalEquations
) -> float:
    """The potential of two fingers' overlaps."""
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


@kernel
def add_anatomy(
    about: Plausibility, pose: FloatArray, posed: Posed, spheres: FloatArray, equations: NormalEquations
) -> float:
    """Add the potential's residuals at a pose (22,) to matrix and vector, and return U.

    Args:
        about: constants.
        pose, posed: the pose and its bones.
        spheres: (5, SPHERES, 3), is written to.
        equations: to add to.
    """
    angles = pose[7:]
    value = _add_limits(about, angles, equations)
    value += _add_rest(about, angles, equations) + _add_folds(about, angles, equations)
    value += _add_neighbours(about, angles, equations)
    place_spheres(posed, spheres)
    for f in range(5):
        for h in range(f + 1, 5 if f == 0 else min(f + 2, 5)):  # the thumb meets all, a finger its neighbour
            value += _add_collisions(about, posed, spheres, f, h, equations)
    return value


@kernel
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
