"""What is known of a hand before its image is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import HandAnatomy
from posetrack_cli.hand.kinematics import joint_positions


@dataclass(frozen=True, eq=False)
class PredictedHand:
    """A hand where it is expected.

    Attributes:
        pose: (22,).
        joints: (21, 3) mm, camera axes, in the order of ``JOINT_NAMES``.
        scale: of the hand; lengths in settings are of a hand of scale 1.
    """

    pose: FloatArray
    joints: FloatArray
    scale: float

    @classmethod
    def of(cls, anatomy: HandAnatomy, pose: FloatArray) -> PredictedHand:
        """The hand of an anatomy in a pose (22,)."""
        return cls(pose, joint_positions(anatomy, pose[None])[0], anatomy.scale)

    @property
    def wrist(self) -> FloatArray:
        """(3,) the wrist joint, mm."""
        return np.asarray(self.joints[0], dtype=np.float64)

    @property
    def towards_elbow(self) -> FloatArray:
        """(3,) unit vector along the palm, from the knuckles to the wrist."""
        return np.asarray(rotations.matrices_from_quaternions(self.pose[3:7])[:, 1], dtype=np.float64)
