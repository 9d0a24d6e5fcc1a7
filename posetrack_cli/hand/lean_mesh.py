"""A hand's skin with few triangles: what many poses are drawn with at once.

Weights are only as good as what is drawn: the mesh is made of the smooth skin by collapsing edges where
open and closed hands change least, and then fitted to it, so that the mean distance of both vanishes.
"""

from __future__ import annotations

import functools

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.anatomy import ANGLE_NAMES, POSE_SIZE, HandAnatomy, make_anatomy
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.mesh import hand_mesh
from posetrack_cli.rendering.decimation import Decimation, decimation
from posetrack_cli.rendering.mesh import SkinnedMesh

LEAN_TRIANGLES = 410
# flexion of joint 3 and 2, rad: open, half closed, a fist, hooked, and bent at the knuckles alone
_BENDS = ((0.0, 0.0), (0.8, 0.9), (1.4, 1.6), (0.2, 1.3), (1.3, 0.2))
_THUMB_SHARE = 0.5  # of the fingers' bends in the thumb's


def lean_mesh(anatomy: HandAnatomy, smooth: SkinnedMesh | None = None) -> SkinnedMesh:
    """Return the skin of an average hand in any shape with ``LEAN_TRIANGLES`` triangles.

    All hands have the same triangles and weights, and vertices that are linear in those of the smooth skin.

    Args:
        anatomy: of ``make_anatomy``.
        smooth: its ``medium`` mesh, where that is at hand.
    """
    smooth = smooth or hand_mesh(anatomy, "medium")
    mesh = _average_decimation().of(smooth.vertices)
    return (
        SkinnedMesh(mesh.vertices, mesh.weights, mesh.triangles[:, ::-1].copy()) if anatomy.is_left else mesh
    )


def bent_hands(anatomy: HandAnatomy) -> FloatArray:
    """Bone transforms (K, B, 3, 4) of open to closed hands: the poses in which a simpler skin has to fit."""
    poses = np.zeros((len(_BENDS), POSE_SIZE))
    poses[:, 6] = 1.0
    for pose, (first, second) in zip(poses, _BENDS, strict=True):
        for k, name in enumerate(ANGLE_NAMES):
            if name.endswith("flexion"):
                share = _THUMB_SHARE if name.startswith("thumb") else 1.0
                pose[POSE_SIZE - len(ANGLE_NAMES) + k] = share * (first if _is_first(name) else second)
    return np.asarray(skinning_transforms(anatomy, poses), dtype=np.float64)


def _is_first(name: str) -> bool:
    return "cmc" in name or ("mcp" in name and not name.startswith("thumb"))


@functools.cache
def _average_decimation() -> Decimation:
    """How the lean skin follows the smooth one, found once for the average right hand."""
    average = make_anatomy()
    return decimation(hand_mesh(average, "medium"), LEAN_TRIANGLES, bent_hands(average))
