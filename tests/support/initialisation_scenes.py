"""Cameras, heads before them and detectors that say what a test wants, for the tests of mono starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.detection.detector import Detection
from posetrack_cli.head.detection.finders import FaceGuess
from posetrack_cli.head.detection.points import FacePoints
from posetrack_cli.head.face.points import FEATURES, HeadPose

PLAIN = Camera(640, 480, 900.0, 900.0, 320.0, 240.0, name="plain")
BENT = Camera(640, 480, 600.0, 610.0, 330.0, 230.0, (-0.3, 0.1, 0.001, -0.002, 0.0), name="bent")
FISHEYE = Camera(640, 480, 300.0, 300.0, 320.0, 240.0, (0.05, -0.01, 0.002, 0.0), "equidistant", "fisheye")
BLANK = np.zeros((480, 640), np.uint8)


def head(roll=0.0, pitch=0.0, yaw=0.0, x=0.0, y=0.0, z=700.0):
    """A head turned by degrees, mm before the camera."""
    angles = np.deg2rad([roll, pitch, yaw])
    return HeadPose(np.array([x, y, z]), head_quaternion_from_roll_pitch_yaw(angles))


def pixels_of(pose, camera=PLAIN, shape=FEATURES):
    pixels, visible = pixels_from_points(camera, pose.points(shape))
    assert visible.all()
    return pixels


def found(pose, camera=PLAIN, response=0.8, shape=FEATURES):
    """What the detector would say of a head if it erred nowhere."""
    scale = camera.fx / pose.position[2]
    pixels = pixels_of(pose, camera, shape)
    guess = FaceGuess(pixels[:4].mean(axis=0), 63.0 * scale, 0.0, 0.9)
    return FacePoints(pixels, np.full(10, response), scale, np.zeros(3), guess)


@dataclass
class Says:
    """A detector that says the same of every image."""

    faces: tuple
    best_score: float = 0.9

    def detect(self, image, *, wanted=1, roll=None):
        return Detection(tuple(self.faces), self.best_score)

    def detect_quickly(self, image, index, *, wanted=1):
        return self.detect(image)

    def detect_near(self, image, pixels):
        return self.detect(image)
