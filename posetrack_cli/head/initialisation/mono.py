"""Pose and shape of a head from its points in a few frames of one camera (thesis, 4.4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.adjustment.adjust import adjust
from posetrack_cli.head.adjustment.views import Adjusted, PersonParameters, PointView
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.face.points import POINT_COUNT
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.face.projection import project
from posetrack_cli.head.face.templates import TemplateSet, take_templates, tangents
from posetrack_cli.head.initialisation.detected_face import DetectedFace, detect_face
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.recording.base import Frame

DISTANCES_MM = (100.0, 5000.0)
"""Between them lie heads that a camera sees well; others come of a wrong focal length or of no head."""


@dataclass(frozen=True, eq=False)
class MonoInitialisation:
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
    person: PersonParameters
    pixels: FloatArray
    residual: float
    score: float
    adjusted: Adjusted


def initialise(
    detected: Sequence[DetectedFace], camera: Camera, model: FaceModel, settings: HeadMonoConfig
) -> MonoInitialisation | InitFailure:
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
        return InitFailure(NO_FACE)
    score = float(np.mean([face.score for face in detected]))
    misfit = float(np.median([face.misfit for face in detected]))
    if misfit > settings.start.residual:
        return InitFailure(_unlike(misfit), score)
    adjusted = adjust(
        [_view(face, model, settings.start.pixel_sd) for face in detected],
        PersonParameters(model.identity_mean, np.zeros((POINT_COUNT, 3))),
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
        return InitFailure(reason, score)
    return MonoInitialisation(adjusted.views, adjusted.person, detected[0].pixels, residual, score, adjusted)


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


class MonoInitialiser:
    """Finds a face in images of one camera.

    Args:
        config: parameters.
        camera: that takes the images.
        model: of faces.
        detector: of faces.
        choice: which face, 0 the largest.
    """

    def __init__(
        self, config: HeadMonoConfig, camera: Camera, model: FaceModel, detector: FaceDetector, choice: int
    ) -> None:
        self._config, self._camera, self._model = config, camera, model
        self._detector, self._choice = detector, choice

    def detect(self, frame: Frame, near: FloatArray | None) -> DetectedFace | InitFailure:
        """Return the face in a frame, the one at pixels (K, 2) ``near`` where they are given."""
        (image,) = frame.images
        if image is None:
            return InitFailure("no image")
        return detect_face(
            image, frame.stamp_ns, self._camera, self._detector, self._config.start, self._choice, near
        )

    def initialise(self, detected: Sequence[DetectedFace]) -> MonoInitialisation | InitFailure:
        """Return the head that was detected in some frames."""
        return initialise(detected, self._camera, self._model, self._config)

    def templates(self, frame: Frame, found: DetectedFace, start: MonoInitialisation) -> TemplateSet:
        """Return the templates of a frame with a face, the last of those that the head was found in."""
        shape = self._shape(start)
        return take_templates(frame.images, (self._camera,), start.views[-1].pose, shape, found.pixels[None])

    def reference(self, first: TemplateSet, start: MonoInitialisation) -> TemplateSet:
        """Return the templates of the first frame, at the pose that the adjustment came to."""
        pose = start.views[0].pose
        projection = project((self._camera,), pose.points(self._shape(start)))
        return replace(first, tangents=tangents(projection, pose), facing=pose.facing)

    def _shape(self, start: MonoInitialisation) -> FloatArray:
        return self._model.of_person(start.person.identity, start.person.offsets).mean
