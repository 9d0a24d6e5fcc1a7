"""Topics of cameras in converted recordings and in results."""

from __future__ import annotations

from posetrack_cli.geometry.camera import Camera

CAMERA_PREFIX = "/camera"
IMAGE, CALIBRATION = "image", "calibration"
PLACES_TOPIC = "/tf_static"
"""Poses of the other cameras."""


def camera_topic(camera: Camera, what: str, cameras: int) -> str:
    """Return a camera's topic for images, calibration or annotations, given the number of cameras."""
    return f"{CAMERA_PREFIX}/{what}" if cameras == 1 else f"{CAMERA_PREFIX}/{camera.name.strip('/')}/{what}"
