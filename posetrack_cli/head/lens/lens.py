"""A camera with estimated focal length, and the resulting errors of poses **[ours]**.

With another focal length, e = d log f, a face at the ray x, y has the distance (1 + e) z, and its rotation
about y and x changes by x e and y e: the part of its angles that comes from its place in the image. The part
that comes from the image of the face itself changes less, by ``GAIN`` times its angle (measured). Both are
added, because faces turn to the side to which they move. Another principal point c turns a head by c / f.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.adjustment.adjuster import angles_of
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.subject import RIGHT_DEG

GAIN = 0.1
"""Relative change of yaw and pitch with log f, for a face in the middle of the image."""


@dataclass(frozen=True, eq=False)
class EstimatedLens:
    """An uncalibrated camera.

    Attributes:
        camera: with the estimated focal length.
        focal_sd: standard deviation of its logarithm.
        centre_sd_px: (2,) standard deviations of the principal point along x and y, pixels.
        ray: (2,) usual x/z, y/z of the head.
        angles: (2,) its usual yaw and pitch, rad.
    """

    camera: Camera
    focal_sd: float
    centre_sd_px: FloatArray
    ray: FloatArray
    angles: FloatArray

    def variance(self, pose: HeadPose) -> FloatArray:
        """Return the (6,) variances of a pose, mm^2 in camera axes and rad^2 about the head's axes."""
        depth, aside = float(pose.position[2]), np.square(self.centre_sd_px / self.camera.fx)
        turns = np.append((np.square(self._turn(_ray(pose), pose)) + aside)[::-1], 0.0)
        about_head = np.square(pose.rotation.T) @ turns
        return np.concatenate([depth**2 * aside, [(depth * self.focal_sd) ** 2], about_head])

    def share_right(self, pose: HeadPose) -> float:
        """Return the probability that the camera causes less than the allowed error of rotation.

        A constant rotation of the head does not count. One of the camera, by c / f, differs from it by c / f
        times the angle by which the head is turned.
        """
        away = np.abs(angles_of(pose.facing) - self.angles)
        by_centre = self.centre_sd_px / self.camera.fx * float(np.hypot(*away))
        sd = float(np.linalg.norm([self._turn(_ray(pose) - self.ray, pose), by_centre]))
        return math.erf(math.radians(RIGHT_DEG) / (math.sqrt(2.0) * max(sd, 1e-9)))

    def _turn(self, ray: FloatArray, pose: HeadPose) -> FloatArray:
        """Return the standard deviations (2,) of yaw and pitch, rad."""
        away = np.abs(angles_of(pose.facing) - self.angles)
        turns: FloatArray = self.focal_sd * (np.abs(ray) + GAIN * away)
        return turns

    def record(self) -> dict[str, str]:
        """Return the entries of the run record."""
        focal = self.camera.fx
        return {
            "intrinsics": "estimated",
            "focal_px": f"{focal:.1f}",
            "focal_sd_px": f"{focal * self.focal_sd:.1f}",
            "principal_point_px": f"{self.camera.cx:.1f} {self.camera.cy:.1f}",
            "principal_point_sd_px": "{:.1f} {:.1f}".format(*self.centre_sd_px),
        }


def _ray(pose: HeadPose) -> FloatArray:
    ray: FloatArray = pose.position[:2] / max(float(pose.position[2]), 1.0)
    return ray
