"""Where joints lie in a hand: between what a rig says and what anatomy says, as far as either is known.

A rig's joints are where its mesh turns well; rigs differ by 5 to 20 mm at wrist, knuckles and thumb. Anatomy
puts the knuckle where the first phalanx is 1.6 times as long as the second or farther back, divides fingers
as Buryanov and Kotiuk 2010 measured, and lets the thumb begin at the trapezium.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from research.hand_model.template import SEGMENTS, THUMB_BASE

ANATOMY_SHARE = (1.0, 0.5)
"""Mean and standard deviation of how far joints lie on the way from the rig's place to anatomy's."""
ALONG_SD, BESIDE_SD = np.array([2.0, 1.2, 1.2]), np.array([2.0, 0.8, 0.8])
"""mm, of the joints 3, 2 and 1, further: along the finger, and out of the palm's plane."""
THUMB_BASE_SD, WRIST_SD = (3.0, 2.0, 3.0), (3.0, 2.0, 2.0)
"""mm: along the palm, out of its plane, across it."""
_KNUCKLE = 1.6
"""First phalanx in terms of the second where a rig bends at the webs."""
_PALM_MM = 90.0
"""From the wrist to the middle knuckle of the hand that ``THUMB_BASE`` is of."""


def anatomical_joints(joints: FloatArray, rng: np.random.Generator | None) -> FloatArray:
    """Return a hand's 21 joints (21, 3) as they may lie in its skin, mm; without a generator, as on average.

    Tips stay: rigs have them where the skin ends, to a millimetre or two. The build puts them where the
    skin that was laid on it ends.
    """
    up, out, side = _palm_axes(joints)
    mean, sd = ANATOMY_SHARE
    share = mean + (sd * rng.normal() if rng else 0.0)
    result = joints.copy()
    axes = np.stack([up, out, side])
    if rng:
        result[0] += rng.normal(0.0, WRIST_SD) @ axes
    for finger in range(5):
        chain = joints[1 + 4 * finger : 5 + 4 * finger]
        ours = _thumb(chain, joints, axes) if finger == 0 else _finger(chain, finger)
        placed = chain[:3] + share * (ours - chain[:3])
        if rng:
            for k in range(3):
                placed[k] += rng.normal(0.0, ALONG_SD[k]) * _unit(chain[k + 1] - chain[k])
                placed[k] += rng.normal(0.0, BESIDE_SD[k]) * out
            if finger == 0:
                placed[0] += rng.normal(0.0, THUMB_BASE_SD) @ axes
        result[1 + 4 * finger : 4 + 4 * finger] = placed
    return result


def _palm_axes(joints: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Towards the fingers, out of a right hand's palm, and towards the thumb."""
    up = _unit(joints[9] - joints[0])
    out = np.cross(joints[5] - joints[0], joints[17] - joints[0])
    out = _unit(out - up * (out @ up))
    side = np.cross(out, up)
    return up, out, side * np.sign(side @ (joints[5] - joints[17]))


def _finger(chain: FloatArray, finger: int) -> FloatArray:
    """Joints 3, 2, 1 of a finger (3, 3): the knuckle moved back, the rest divided as the tables do."""
    first, second = np.linalg.norm(np.diff(chain[:3], axis=0), axis=1)
    knuckle = chain[0] + max(_KNUCKLE * second - first, 0.0) * (chain[0] - chain[1]) / first
    whole = np.vstack([knuckle, chain[1:]])
    length = float(np.linalg.norm(np.diff(whole, axis=0), axis=1).sum())
    shares = np.cumsum(SEGMENTS[finger])[:2] / SEGMENTS[finger].sum()
    return np.vstack([knuckle, _along(whole, shares * length)])


def _thumb(chain: FloatArray, joints: FloatArray, axes: FloatArray) -> FloatArray:
    """Joints 3, 2, 1 of the thumb (3, 3): its base at the trapezium, the rest divided as the tables do."""
    size = float(np.linalg.norm(joints[9] - joints[0])) / _PALM_MM
    x, y, z = THUMB_BASE * size
    base = joints[0] + np.array([-y, -z, x]) @ axes
    outer = chain[1:]
    length = float(np.linalg.norm(np.diff(outer, axis=0), axis=1).sum())
    share = SEGMENTS[0, 1] / SEGMENTS[0, 1:].sum()
    return np.vstack([base, chain[1], _along(outer, np.array([share * length]))])


def _along(points: FloatArray, distances: FloatArray) -> FloatArray:
    """Points at distances from the start of a chain (N, 3)."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    k = np.clip(np.searchsorted(starts, distances, side="right") - 1, 0, len(lengths) - 1)
    share = (distances - starts[k]) / lengths[k]
    return np.asarray(points[k] + share[:, None] * (points[k + 1] - points[k]))


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v))
