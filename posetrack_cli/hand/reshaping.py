"""The shape's factors applied to a hand that is not the average one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.anatomy import BONE_COUNT, MIRROR, HandAnatomy
from posetrack_cli.hand.shape import HandShape
from posetrack_cli.rendering.mesh import SkinnedMesh


def reshaped_anatomy(anatomy: HandAnatomy, side: str, shape: HandShape) -> HandAnatomy:
    """The bones of a right hand in a shape, on a side; as ``make_anatomy`` does with the average hand's."""
    scale = shape.scale
    positions = anatomy.base_positions * shape.palm
    positions[0, 1] *= shape.thumb_place
    turns = anatomy.base_rotations
    if side == "left":
        positions, turns = positions * MIRROR, MIRROR[:, None] * turns * MIRROR
    return HandAnatomy(
        side,
        scale * positions,
        turns,
        scale * anatomy.segments * np.asarray(shape.finger_lengths)[:, None],
        scale * anatomy.radii * np.asarray(shape.finger_widths)[:, None],
        scale * anatomy.scale,
        shape.palm,
        shape.wrist_width,
    )


def reshaped_skin(mesh: SkinnedMesh, anatomy: HandAnatomy, side: str, shape: HandShape) -> SkinnedMesh:
    """The skin of a right hand at zero angles in a shape, on a side.

    Every bone stretches what is bound to it, v' = o' + S (v - o): along itself by the finger's length, across
    by its width, and in the palm by the palm's factors; o and o' are where it begins before and after.
    Linear blend skinning joins them.

    Args:
        mesh: bound to the 16 bones.
        anatomy: of the right hand that it is the skin of.
        side: ``right`` or ``left``.
        shape: factors.
    """
    narrowed = replace(mesh, vertices=_with_wrist(mesh, anatomy, shape.wrist_width))
    stretched = narrowed.posed(_stretches(anatomy, shape)[None])[0]
    skin = SkinnedMesh(shape.scale * stretched, mesh.weights, mesh.triangles)
    return skin.flipped(MIRROR) if side == "left" else skin


def _with_wrist(mesh: SkinnedMesh, anatomy: HandAnatomy, factor: float) -> FloatArray:
    """Vertices with the palm's widths multiplied: fully at the wrist, less towards the knuckles."""
    knuckles = -float(anatomy.base_positions[1:, 1].mean())
    share = mesh.weights[:, 0] * np.clip(1.0 + mesh.vertices[:, 1] / knuckles, 0.0, 1.0)
    vertices = mesh.vertices.copy()
    vertices[:, 0] *= 1.0 + (factor - 1.0) * share
    return vertices


def _stretches(anatomy: HandAnatomy, shape: HandShape) -> FloatArray:
    """The affine maps (16, 3, 4) of the bones, without the scale."""
    after = reshaped_anatomy(anatomy, "right", replace(shape, scale=1.0)).rest_origins
    maps = np.zeros((BONE_COUNT, 3, 4))
    maps[0, :, :3] = np.diag(shape.palm)
    for finger, (length, width) in enumerate(zip(shape.finger_lengths, shape.finger_widths, strict=True)):
        frame = anatomy.base_rotations[finger]
        stretch = frame @ np.diag([width, length, width]) @ frame.T
        for bone in range(3):
            at = maps[1 + 3 * finger + bone]
            at[:, :3] = stretch
            at[:, 3] = after[finger, bone] - stretch @ anatomy.rest_origins[finger, bone]
    return maps
