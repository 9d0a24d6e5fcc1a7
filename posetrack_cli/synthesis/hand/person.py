"""Person behind a right hand: forearm, upper arm, trunk and head.

The person faces the sensor, so the right shoulder is on the left of the image. Camera axes, mm.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.geometry import rotations
from posetrack_cli.rendering.mesh import SkinnedMesh

FOREARM_MM = 255.0
MOST_WRIST_BEND = np.deg2rad(60.0)
WRIST_OFFSET_MM = 3.0
"""Start of the forearm behind the wrist joint in hand coordinates, inside the hand's wrist cap."""

ELBOW_MM = np.array([-60.0, 195.0, 890.0])
"""Elbow position for the wrist at ``ELBOW_FOR_WRIST_MM``."""
ELBOW_FOR_WRIST_MM = np.array([0.0, 55.0, 650.0])
ELBOW_FOLLOWS = 0.5
"""Share of the wrist's displacement that the elbow follows."""

TRUNK_MM = np.array([115.0, 0.0, 1065.0])
HEAD_MM = np.array([115.0, -125.0, 1030.0])
SHOULDER_MM = np.array([-65.0, 95.0, 1050.0])
SWAY_MM, SWAY_HZ = 6.0, 0.31

# Rings of neck, shoulders and trunk: height y, half width, half depth, mm.
_TRUNK_RINGS = np.array(
    [
        (-30.0, 45.0, 45.0),
        (20.0, 58.0, 55.0),
        (42.0, 105.0, 72.0),
        (65.0, 165.0, 88.0),
        (110.0, 200.0, 102.0),
        (220.0, 195.0, 115.0),
        (420.0, 170.0, 112.0),
        (620.0, 185.0, 115.0),
        (900.0, 180.0, 110.0),
    ]
)

SIDES = 24
ROUNDING = 5  # rings of a rounded end


def forearm_mesh(scale: float) -> SkinnedMesh:
    """Return a mesh with two bones, wrist and elbow; the near end has the wrist's width and thickness."""
    return limb((29.0 * scale, 18.5 * scale), (43.0 * scale, 41.0 * scale), (0.6, 42.0 * scale, 37.0 * scale))


def upper_arm_mesh(scale: float) -> SkinnedMesh:
    """Return a mesh with two bones, elbow and shoulder."""
    return limb((45.0 * scale, 43.0 * scale), (62.0, 58.0))


def trunk_mesh() -> SkinnedMesh:
    """Return a mesh with one bone: neck, shoulders and trunk down to below the image."""
    return stacked(_TRUNK_RINGS)


def head_mesh() -> SkinnedMesh:
    """Return a mesh with one bone."""
    return ellipsoid((76.0, 112.0, 95.0))


def forearm_bones(pose: FloatArray, scale: float) -> FloatArray:
    """Return transforms (2, 3, 4) of the forearm's ends for a hand pose (22,).

    A straight wrist puts the forearm along the hand's +y; the elbow position bends it. With b the angle
    between the two, the wrist bends by m tanh(b / m), m = 60 degrees.
    """
    hand = rotations.matrices_from_quaternions(pose[3:7])
    start = pose[:3] + hand[:, 1] * WRIST_OFFSET_MM * scale
    direction = _bent(hand[:, 1], _elbow_for(pose[:3]) - start)
    frame = _frame(direction, hand[:, 0])
    elbow = start + FOREARM_MM * scale * direction
    return np.stack([_transform(frame, start), _transform(frame, elbow)])


def upper_arm_bones(elbow: FloatArray, seconds: float) -> FloatArray:
    """Return transforms (2, 3, 4) of the upper arm's ends."""
    shoulder = SHOULDER_MM + body_sway(seconds)
    frame = _frame((shoulder - elbow) / np.linalg.norm(shoulder - elbow), np.array([1.0, 0.0, 0.0]))
    return np.stack([_transform(frame, elbow), _transform(frame, shoulder)])


def body_bones(seconds: float) -> FloatArray:
    """Return transforms (2, 3, 4) of trunk and head, with a slight sway."""
    sway = body_sway(seconds)
    return np.stack([_transform(np.eye(3), TRUNK_MM + sway), _transform(np.eye(3), HEAD_MM + 1.5 * sway)])


def body_sway(seconds: float) -> FloatArray:
    """Return the displacement of the trunk, mm."""
    phase = 2.0 * np.pi * SWAY_HZ * seconds
    return SWAY_MM * np.array([np.sin(phase), 0.0, 0.7 * np.sin(0.62 * phase + 1.0)])


def _elbow_for(wrist: FloatArray) -> FloatArray:
    elbow: FloatArray = ELBOW_MM + ELBOW_FOLLOWS * (wrist - ELBOW_FOR_WRIST_MM)
    return elbow


def _bent(straight: FloatArray, towards: FloatArray) -> FloatArray:
    """Rotate a unit vector towards another vector, within the wrist's range."""
    axis = np.cross(straight, towards)
    sine, cosine = float(np.linalg.norm(axis)), float(straight @ towards)
    if sine < 1e-9 * abs(cosine):
        return straight
    bend = MOST_WRIST_BEND * np.tanh(np.arctan2(sine, cosine) / MOST_WRIST_BEND)
    return rotations.rotate(rotations.exponential(axis / sine * bend), straight)


def _frame(along: FloatArray, across: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) with y axis ``along`` and x axis as close as possible to ``across``."""
    x = across - (across @ along) * along
    x /= np.linalg.norm(x)
    return np.stack([x, along, np.cross(x, along)], axis=1)


def _transform(rotation: FloatArray, position: FloatArray) -> FloatArray:
    return np.hstack([rotation, position[:, None]])


def stacked(rings: FloatArray, shares: FloatArray | None = None) -> SkinnedMesh:
    """Return the closed mesh through elliptic rings around the y axis.

    Args:
        rings: (R, 3) height y, half width along x, half depth along z of each ring, mm, y not decreasing.
            Flat fans close the first and the last ring.
        shares: (R,) weight of bone 1 on each ring, the rest is bone 0's; None for one bone.
    """
    angles = np.arange(SIDES) * (2.0 * np.pi / SIDES)
    y, a, b = (rings[:, k, None] for k in range(3))
    around = np.stack([a * np.cos(angles), y + 0.0 * angles, b * np.sin(angles)], axis=-1).reshape(-1, 3)
    poles = np.array([[0.0, rings[0, 0], 0.0], [0.0, rings[-1, 0], 0.0]])
    vertices = np.vstack([around, poles])
    return SkinnedMesh(vertices, _weights(shares, len(rings)), _triangles(len(rings)))


def ellipsoid(half_axes: tuple[float, float, float]) -> SkinnedMesh:
    """Return an ellipsoid around the origin with half axes along x, y, z, mm."""
    x, y, z = half_axes
    t = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * ROUNDING + 5)[1:-1]
    return stacked(np.stack([y * np.sin(t), x * np.cos(t), z * np.cos(t)], axis=1))


def limb(
    near: tuple[float, float], far: tuple[float, float], belly: tuple[float, float, float] | None = None
) -> SkinnedMesh:
    """Return a tapered capsule stretched by two bones; each end is rigid, at its bone's origin.

    Bone 0 moves the near end, bone 1 the far end, in direction of bone 0's +y.

    Args:
        near, far: half width (x) and half depth (z) of the ends, mm.
        belly: position (0 to 1), half width and half depth of an additional ring in between.
    """
    t = np.linspace(0.0, 0.5 * np.pi, ROUNDING + 1)[1:]
    cap = np.stack([np.cos(t), np.sin(t), np.sin(t)], axis=1)
    first = cap * np.array([-min(near), *near])
    last = (cap * np.array([min(far), *far]))[::-1]
    if belly is None:
        return stacked(np.vstack([first, last]), np.repeat([0.0, 1.0], ROUNDING))
    middle = np.array([[0.0, *belly[1:]]])
    shares = np.r_[np.zeros(ROUNDING), belly[0], np.ones(ROUNDING)]
    return stacked(np.vstack([first, middle, last]), shares)


def _weights(shares: FloatArray | None, rings: int) -> FloatArray:
    """Return (V, B) weights of the rings' vertices, then the two poles."""
    if shares is None:
        return np.ones((rings * SIDES + 2, 1))
    of_vertex = np.r_[np.repeat(shares, SIDES), shares[0], shares[-1]]
    return np.stack([1.0 - of_vertex, of_vertex], axis=1)


def _triangles(rings: int) -> IntArray:
    """Return triangles between the rings and fans at the poles, counter-clockwise from outside."""
    k = np.arange(SIDES)
    m = (k + 1) % SIDES
    first, last = rings * SIDES, rings * SIDES + 1
    top = (rings - 1) * SIDES
    parts = [np.stack([np.full(SIDES, first), k, m], axis=1)]
    for r in range(rings - 1):
        low, high = r * SIDES, (r + 1) * SIDES
        parts.append(np.stack([low + k, high + k, high + m], axis=1))
        parts.append(np.stack([low + k, high + m, low + m], axis=1))
    parts.append(np.stack([np.full(SIDES, last), top + m, top + k], axis=1))
    return np.concatenate(parts)
