"""What the synthetic sensor looks at: one skinned mesh of hand and person, and the room behind."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import BONE_COUNT, MIRROR
from posetrack_cli.hand.kinematics import mirrored_poses, skinning_transforms
from posetrack_cli.hand.model import HandModel
from posetrack_cli.rendering.mesh import SkinnedMesh, joined
from posetrack_cli.synthesis.hand import person
from posetrack_cli.synthesis.hand.options import Switches

_MIRRORED_TRANSFORM = np.outer(MIRROR, [*MIRROR, 1.0])  # M T M, entry by entry

# Normals n and offsets c of planes n . p = c, mm: a wall slightly tilted, ceiling, floor.
PLANES = (
    (np.array([0.05, 0.03, 1.0]), 2750.0),
    (np.array([0.0, 1.0, 0.06]), -1050.0),
    (np.array([0.0, 1.0, 0.0]), 1250.0),
)
# Corners of furniture, mm: a cabinet on the left, a seat on the right.
BOXES = (
    (np.array([-1600.0, 250.0, 2150.0]), np.array([-850.0, 1250.0, 2600.0])),
    (np.array([650.0, 560.0, 2000.0]), np.array([1500.0, 1250.0, 2600.0])),
)


class Scene:
    """A hand and as much of its owner as the switches ask for.

    Args:
        hand: bones and skin. A left hand has the mirror image of a right hand's owner.
        switches: ``body`` and ``forearm`` are read.
    """

    def __init__(self, hand: HandModel, switches: Switches) -> None:
        self._anatomy = hand.anatomy
        self._switches = switches
        self.mesh = joined([hand.skin("fine"), *self._person_meshes()])

    def transforms(self, pose: FloatArray, seconds: float) -> Float32Array:
        """camera_T_rest (1, B, 3, 4) of every bone, for a pose (22,) at a time, s."""
        out = np.empty((1, self.mesh.weights.shape[1], 3, 4), dtype=np.float32)
        out[0, :BONE_COUNT] = skinning_transforms(self._anatomy, pose[None])[0]
        first = BONE_COUNT
        for bones in self._person_bones(pose, seconds):
            out[0, first : first + len(bones)] = bones
            first += len(bones)
        return out

    def _person_meshes(self) -> Iterator[SkinnedMesh]:
        scale = self._anatomy.scale
        if self._switches.forearm:
            yield person.forearm_mesh(scale)
        if self._switches.forearm and self._switches.body:
            yield person.upper_arm_mesh(scale)
        if self._switches.body:
            yield person.trunk_mesh()
            yield person.head_mesh()

    def _person_bones(self, pose: FloatArray, seconds: float) -> Iterator[FloatArray]:
        """Transforms in the order of the meshes, which look the same in the mirror x -> -x."""
        left = self._anatomy.is_left
        right_pose = mirrored_poses(pose[None])[0] if left else pose
        for bones in self._right_bones(right_pose, seconds):
            yield bones * _MIRRORED_TRANSFORM if left else bones

    def _right_bones(self, pose: FloatArray, seconds: float) -> Iterator[FloatArray]:
        if self._switches.forearm:
            forearm = person.forearm_bones(pose, self._anatomy.scale)
            yield forearm
            if self._switches.body:
                yield person.upper_arm_bones(forearm[1, :, 3], seconds)
        if self._switches.body:
            yield person.body_bones(seconds)


def room_depth(camera: Camera) -> Float32Array:
    """Return the depth z of the room, (height, width), mm: the nearest of all planes and boxes."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([u, v], axis=-1).astype(np.float64)
    rays = camera.points_from_pixels(pixels, np.ones(u.shape))
    depths = [_plane_depth(rays, *plane) for plane in PLANES] + [_box_depth(rays, *box) for box in BOXES]
    return np.asarray(np.min(depths, axis=0), dtype=np.float32)


def _plane_depth(rays: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """Depth of a plane along rays (..., 3) with z = 1, infinite where it is not met."""
    slope = rays @ normal
    safe = np.where(slope == 0.0, 1.0, slope)
    depth = np.where(slope == 0.0, np.inf, offset / safe)
    return np.where(depth > 0.0, depth, np.inf)


def _box_depth(rays: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Depth of a box along rays with z = 1 by the slab method, infinite where it is missed."""
    with np.errstate(divide="ignore"):
        first, second = low / rays, high / rays
    enters = np.minimum(first, second).max(axis=-1)
    leaves = np.maximum(first, second).min(axis=-1)
    return np.where((enters <= leaves) & (enters > 0.0), enters, np.inf)
