"""A hand's skin as the fits' kernels read it: a mesh, and which finger moves which part of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.hand.anatomy import ARM_BONE
from posetrack_cli.hand.fitting.skeleton import ARM, PALM
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.raster import RestMesh, rest_mesh


class Skin(NamedTuple):
    """A hand's mesh, and what moves it.

    Attributes:
        mesh: the mesh.
        fingers: (V,) finger that moves the vertex most, or PALM, or ARM.
        reaches: (V, 3) skinning weight of its bones from joint 3, 2, 1 outwards.
        triangle_fingers: (T,) the same of a triangle.
        triangle_reaches: (T, 3).
    """

    mesh: RestMesh
    fingers: IntArray
    reaches: FloatArray
    triangle_fingers: IntArray
    triangle_reaches: FloatArray


def skin_of(mesh: SkinnedMesh) -> Skin:
    """Return a mesh bound to the hand's 16 bones, or 17 with a forearm's, as the kernels read it."""
    by_finger = mesh.weights[:, 1:ARM_BONE].reshape(-1, 5, 3)
    outwards = np.cumsum(by_finger[:, :, ::-1], axis=2)[:, :, ::-1]
    fingers, reaches = _strongest(outwards)
    triangle_fingers, triangle_reaches = _strongest(outwards[mesh.triangles].mean(axis=1))
    of_arm: BoolArray = mesh.weights[:, ARM_BONE:].sum(axis=1) > 0.0
    fingers[of_arm], triangle_fingers[of_arm[mesh.triangles[:, 0]]] = ARM, ARM
    return Skin(rest_mesh(mesh), fingers, reaches, triangle_fingers, triangle_reaches)


def _strongest(outwards: FloatArray) -> tuple[IntArray, FloatArray]:
    """Of reaches (M, 5, 3) the finger with the most weight (M,), or PALM, and its reaches (M, 3)."""
    finger = outwards[:, :, 0].argmax(axis=1)
    reach = np.take_along_axis(outwards, finger[:, None, None], axis=1)[:, 0]
    return np.where(reach[:, 0] > 0.0, finger, PALM).astype(np.int64), np.ascontiguousarray(reach)
