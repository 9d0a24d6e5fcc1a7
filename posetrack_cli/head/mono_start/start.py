"""Pose and shape of a head from its points in a few frames of one camera (thesis, 4.4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.adjustment.adjust import adjust
from posetrack_cli.head.adjustment.views import Adjusted, Person, PointView
from posetrack_cli.head.face import POINT_COUNT
from posetrack_cli.head.mono_config import HeadMonoConfig
from posetrack_cli.head.mono_start.detected import DetectedFace
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.start.start import NO_FACE, NoStart

DISTANCES_MM = (100.0, 5000.0)
"""Between them lie heads that a camera sees well; others come of a wrong focal length or of no head."""


@dataclass(frozen=True, eq=False)
class MonoStart:
    """A head that was found.

    Attributes:
        views: the frames, adjusted, in the order given.
        person: identity and offsets.
        pixels: (K, 2) of the points in the first frame, as detected.
        residual: root mean square of how far the adjusted points lie from the detected, eye distances.
        score: 0 to 1, mean of the detections'.
        adjusted: all that the adjustment came to.
    """

    views: tuple[PointView, ...]
    person: Person
    pixels: FloatArray
    residual: float
    score: float
    adjusted: Adjusted


def begin(
    detected: Sequence[DetectedFace], camera: Camera, model: FaceModel, settings: HeadMonoConfig
) -> MonoStart | NoStart:
    """Return the head whose points were found in one frame or more, or why they are no head's.

    The adjustment begins with the mean person and with the pose that each frame's points alone give an
    average face **[ours]**; the thesis's begins with a face in the middle of the image that looks at the
    camera. Points are compared with a face's before it, too: constant offsets would make any points a face's.

    Args:
        detected: of one face, in the order of time.
        camera: that sees it.
        model: of faces.
        settings: of the whole run; where they never adjust a person, the mean one stays.
    """
    if not detected:
        return NoStart(NO_FACE)
    score = float(np.mean([face.score for face in detected]))
    misfit = float(np.median([face.misfit for face in detected]))
    if misfit > settings.start.residual:
        return NoStart(_unlike(misfit), score)
    adjusted = adjust(
        [_view(face, model, settings.start.pixel_sd) for face in detected],
        Person(model.identity_mean, np.zeros((POINT_COUNT, 3))),
        model,
        camera,
        settings.adjustment,
        iterations=settings.adjustment.start_iterations,
        hold_person=settings.adjustment.when == "never",
        wide=True,
    )
    residual = _residual(adjusted, detected)
    reason = _implausible([view.pose for view in adjusted.views], residual, settings.start.residual)
    if reason:
        return NoStart(reason, score)
    return MonoStart(adjusted.views, adjusted.person, detected[0].pixels, residual, score, adjusted)


def _view(face: DetectedFace, model: FaceModel, pixel_sd: float) -> PointView:
    """Return a frame as the adjustment takes it: detected points count less than tracked ones."""
    weights = np.full(POINT_COUNT, min(pixel_sd**-2, 1.0))
    return PointView(face.stamp_ns, face.pixels, weights, face.pose, model.deformation_mean)


def _residual(adjusted: Adjusted, detected: Sequence[DetectedFace]) -> float:
    distances = np.array([face.eye_distance for face in detected])
    return float(np.sqrt(np.nanmean((adjusted.residuals / distances[:, None]) ** 2)))


def _implausible(poses: Sequence[HeadPose], residual: float, most: float) -> str:
    """Say what about adjusted poses is not a head's before a camera; empty if nothing is."""
    nearest, farthest = DISTANCES_MM
    for pose in poses:
        distance = float(pose.position[2])
        if not nearest <= distance <= farthest:
            return f"a face {distance / 1000.0:.2g} m before the camera"
        if pose.facing @ pose.position >= 0.0:
            return "a face that looks away from the camera"
    if not residual <= most:
        return _unlike(residual)
    return ""


def _unlike(distance: float) -> str:
    if not np.isfinite(distance):
        return "points that no face before this camera has"
    return f"points {distance:.2f} eye distances from a face's"
