"""A head's pose ``camera_T_head``, how small changes of it are counted, and how its face deforms.

The camera is the recording's reference camera (x right, y down, z forward). A tangent vector has six entries:
translation in camera axes, mm, then a rotation vector w in camera axes, rad, about the head's origin:
t' = t + d[:3], R' = exp(w) R. For a head that looks at the camera w is (pitch, yaw, roll) to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rotations import (
    canonical,
    conjugate,
    exponential,
    logarithm,
    matrices_from_quaternions,
    multiply,
)

POSE_SIZE = 6


@dataclass(frozen=True, eq=False)
class HeadPose:
    """Where one head is, or, with n before each shape, where it is in n frames.

    Attributes:
        position: (3,) of the head's origin in the reference camera's axes, mm.
        quaternion: (4,) x y z w, w >= 0, rotation of ``camera_T_head``.
    """

    position: FloatArray
    quaternion: FloatArray

    @classmethod
    def stacked(cls, poses: Sequence[HeadPose]) -> HeadPose:
        """Return the poses of some frames as one."""
        return cls(np.array([one.position for one in poses]), np.array([one.quaternion for one in poses]))

    def of_frame(self, index: int) -> HeadPose:
        """Return the pose in one of several frames."""
        return HeadPose(self.position[index], self.quaternion[index])

    @cached_property
    def rotation(self) -> FloatArray:
        """The (3, 3) rotation matrix R."""
        return matrices_from_quaternions(self.quaternion)

    @cached_property
    def facing(self) -> FloatArray:
        """(3,) unit vector out of the face, in camera axes."""
        return self.rotation[:, 2]

    def points(self, shape: FloatArray) -> FloatArray:
        """Return R m + t, (..., 3) mm in camera axes, of points m (..., 3) in the frame of one head."""
        points: FloatArray = shape @ self.rotation.T + self.position
        return points

    def moved(self, tangent: FloatArray) -> HeadPose:
        """Return the pose after a tangent vector (6,)."""
        turned = multiply(exponential(tangent[..., 3:]), self.quaternion)
        return HeadPose(self.position + tangent[..., :3], canonical(turned))

    def difference(self, other: HeadPose) -> FloatArray:
        """Return the tangent vector (6,) that takes this pose to the other."""
        turn = logarithm(multiply(other.quaternion, conjugate(self.quaternion)))
        return np.concatenate([other.position - self.position, turn], axis=-1)


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Mean shape and deformation directions of one face.

    Attributes:
        mean: (K, 3) neutral shape in the head's frame, mm.
        basis: (K, 3, B) orthonormal directions of deformation; B = 0 is a rigid face.
        deviations: (B,) mu, standard deviation of each coefficient, mm, descending.
    """

    mean: FloatArray
    basis: FloatArray
    deviations: FloatArray

    @property
    def size(self) -> int:
        """B, the number of deformation coefficients."""
        return len(self.deviations)

    def shapes(self, coefficients: FloatArray) -> FloatArray:
        """Return the shapes (..., K, 3), mm, of deformation coefficients (..., B), mm."""
        moved = coefficients @ self.basis.reshape(self.mean.size, -1).T
        return self.mean + moved.reshape(*moved.shape[:-1], *self.mean.shape)


def rigid_model(mean: FloatArray) -> ShapeModel:
    """Return the model of a face (K, 3) that does not deform."""
    return ShapeModel(mean, np.zeros((*mean.shape, 0)), np.zeros(0))
