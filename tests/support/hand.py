"""Hands in any pose within the joint limits, and the camera that most tests look through."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import ANGLE_LIMITS, ANGLE_NAMES

KINECT = Camera(512, 424, 365.0, 365.0, 255.5, 211.5)
REST = np.concatenate([np.zeros(6), [1.0], np.zeros(15)])
BONE_LENGTHS_MM = {
    # Buryanov and Kotiuk 2010, as hand.md prints them: metacarpal, proximal, middle, distal, soft tip
    "thumb": (46.2, 31.6, np.nan, 21.7, 5.7),
    "index": (68.1, 39.8, 22.4, 15.8, 3.8),
    "middle": (64.6, 44.6, 26.3, 17.4, 4.0),
    "ring": (58.0, 41.4, 25.7, 17.3, 4.0),
    "little": (53.7, 32.6, 18.1, 16.0, 3.7),
}


def posed_from(position: FloatArray, rotation_vector: FloatArray, angles: FloatArray) -> FloatArray:
    """A pose (22,) of a rotation vector, rad."""
    return np.concatenate([position, rotations.exponential(rotation_vector), angles])


def bent(**angles: float) -> FloatArray:
    """The rest pose (22,) with some angles, rad, by name."""
    pose = REST.copy()
    for name, value in angles.items():
        pose[7 + ANGLE_NAMES.index(name)] = value
    return pose


def random_poses(count: int, seed: int = 0) -> FloatArray:
    """Poses (N, 22): any rotation, angles all over their limits, about 650 mm away."""
    rng = np.random.default_rng(seed)
    poses = np.empty((count, 22))
    poses[:, :3] = [0.0, 50.0, 650.0] + 60.0 * rng.standard_normal((count, 3))
    poses[:, 3:7] = rotations.canonical(rng.standard_normal((count, 4)))
    poses[:, 7:] = rng.uniform(ANGLE_LIMITS[:, 0], ANGLE_LIMITS[:, 1], (count, 15))
    return poses


_units = st.floats(-1.0, 1.0, allow_subnormal=False)


def pose_strategy() -> st.SearchStrategy[FloatArray]:
    """Poses (22,) within the limits, their corners and the rest pose among them."""
    low, high = ANGLE_LIMITS.T
    return st.builds(
        lambda p, r, a: posed_from(700.0 * p, np.pi * r, low + (high - low) * 0.5 * (a + 1.0)),
        arrays(np.float64, 3, elements=_units),
        arrays(np.float64, 3, elements=_units),
        arrays(np.float64, 15, elements=_units),
    )


def enclosed_volume(vertices: FloatArray, triangles: FloatArray) -> float:
    """Signed volume of a closed mesh, mm^3; positive if its faces are counter-clockwise from outside."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0)
