"""Two cameras and an average face before them, for the tests of starts."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import canonical
from posetrack_cli.head.face.points import FEATURES, HeadPose
from posetrack_cli.head.face.rig_images import CameraImage

LEFT = Camera(640, 480, 900.0, 900.0, 320.0, 240.0, name="left")


def right_camera(toe_in: float, baseline: float = 120.0) -> Camera:
    """A camera to the right of the left one, turned in by an angle, rad."""
    rotation = Rotation.from_rotvec([0.0, toe_in, 0.0]).as_matrix()
    transform = np.column_stack([rotation, -rotation @ [baseline, 0.0, 0.0]])
    rows = tuple(tuple(float(value) for value in row) for row in transform)
    return Camera(640, 480, 950.0, 950.0, 310.0, 250.0, name="right", camera_T_reference=rows)


def turned_head(yaw: float = 0.2, pitch: float = 0.1, distance: float = 700.0) -> HeadPose:
    """A head that looks at the left camera but for some yaw and pitch."""
    rotation = Rotation.from_euler("YX", [yaw, pitch]) * Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    return HeadPose(np.array([10.0, -20.0, distance]), canonical(rotation.as_quat()))


def face_pixels(cameras: tuple[Camera, ...], pose: HeadPose, shape: np.ndarray = FEATURES) -> np.ndarray:
    """Where each camera sees the points of a shape, (C, K, 2)."""
    blank = np.zeros((480, 640), np.uint8)
    return np.array([CameraImage(camera, blank).pixels_of(pose.points(shape))[0] for camera in cameras])
