"""How the one-camera tracker finds a face: detection, and what is begun with (thesis, 4.4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.mono_config import HeadMonoConfig
from posetrack_cli.head.mono_start.detected import DetectedFace, detect_face
from posetrack_cli.head.mono_start.start import MonoStart, begin
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.projection import project
from posetrack_cli.head.start.start import NoStart
from posetrack_cli.head.templates import TemplateSet, take_templates, tangents
from posetrack_cli.recording.base import Frame


class MonoFinder:
    """Finds a face in images of one camera.

    Args:
        config: parameters.
        camera: of the recording.
        model: of faces.
        choice: which face, 0 the largest.

    Raises:
        UsageError: a face detector without its model.
    """

    def __init__(self, config: HeadMonoConfig, camera: Camera, model: FaceModel, choice: int) -> None:
        self._config, self._camera, self._model, self._choice = config, camera, model, choice
        self._detector = FaceDetector(config.start.detection)

    def detect(self, frame: Frame, near: FloatArray | None) -> DetectedFace | NoStart:
        """Return the face in a frame, the one at pixels (K, 2) ``near`` where they are given."""
        (image,) = frame.images
        if image is None:
            return NoStart("no image")
        return detect_face(
            image, frame.stamp_ns, self._camera, self._detector, self._config.start, self._choice, near
        )

    def begin(self, detected: Sequence[DetectedFace]) -> MonoStart | NoStart:
        """Return the head that was detected in some frames."""
        return begin(detected, self._camera, self._model, self._config)

    def templates(self, frame: Frame, found: DetectedFace, start: MonoStart) -> TemplateSet:
        """Return the templates of a frame with a face, the last of those begun with."""
        shape = self._shape(start)
        return take_templates(frame.images, (self._camera,), start.views[-1].pose, shape, found.pixels[None])

    def reference(self, first: TemplateSet, start: MonoStart) -> TemplateSet:
        """Return the templates of the first frame, whose head lies otherwise than thought in that frame."""
        pose = start.views[0].pose
        projection = project((self._camera,), pose.points(self._shape(start)))
        return replace(first, tangents=tangents(projection, pose), facing=pose.facing)

    def _shape(self, start: MonoStart) -> FloatArray:
        return self._model.of_person(start.person.identity, start.person.offsets).mean
