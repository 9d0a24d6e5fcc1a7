"""Pose and shape of a head from its points in a few frames of one camera (thesis, 4.4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, undistorted_pixels
from posetrack_cli.head.adjustment.adjuster import Adjusted, Adjuster, PersonParameters, PointView
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.detection.points import FacePoints
from posetrack_cli.head.face.points import FEATURE_SD, FEATURES, MIRRORED, POINT_COUNT, HeadPose
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import TemplateSet, take_templates, tangents
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.initialisation.single_view import NEAREST_MM, pose_of
from posetrack_cli.head.landmarks.faces import Landmarks, ToldFace
from posetrack_cli.recording.base import Frame

Face = TypeVar("Face", FacePoints, ToldFace)
EYE_DISTANCE_MM = 63.0
SAME_FACE = 1.0
"""A face that moved farther from one frame to the next, in eye distances, is another one."""
MEAN_FACE_WEIGHTS = (FEATURE_SD.min() / FEATURE_SD) ** 2
"""(K,) how well an average face's points tell where a face is: eyes best."""
SLOPE_DEG = 4.0
"""The lines between left and right points differ by no more in slope (standard deviation)."""
MOST_RESIDUAL = 0.12
"""Points lie so near an average face's, and once adjusted the person's: root mean square, eye distances."""
DISTANCES_MM = (100.0, 5000.0)
"""Between them lie heads that a camera sees well; others come of a wrong focal length or of no head."""
CLICKED = np.ones(POINT_COUNT)
"""(K,) responses of points that a person clicked."""


@dataclass(frozen=True, eq=False)
class DetectedFace:
    """The ten points of one face in one frame.

    Attributes:
        stamp_ns: of the frame.
        pixels: (K, 2) as recorded.
        responses: (K,) 0 to 1, how much each place looks like its point; 1 where a person clicked.
        score: 0 to 1, their mean.
        eye_distance: pixels between the eyes' centres, as if the face looked at the camera.
        pose: rough, of an average face.
        misfit: weighted root mean square of how far the points lie from the average face's, eye distances.
    """

    stamp_ns: int
    pixels: FloatArray
    responses: FloatArray
    score: float
    eye_distance: float
    pose: HeadPose
    misfit: float


def face_at(
    pixels: FloatArray, stamp_ns: int, camera: Camera, responses: FloatArray = CLICKED
) -> DetectedFace:
    """Return the face whose ten points (K, 2) were detected or, without responses (K,), clicked."""
    pose, rms_px = pose_of(pixels, MEAN_FACE_WEIGHTS, camera, FEATURES)
    distance = eye_distance_px(pose, camera)
    score = float(responses.mean())
    return DetectedFace(stamp_ns, pixels, responses, score, distance, pose, rms_px / distance)


def eye_distance_px(pose: HeadPose, camera: Camera) -> float:
    """Return how many pixels an average face's eyes are apart, as if it looked at the camera."""
    depth = max(float(pose.position[2]), NEAREST_MM)
    return float(EYE_DISTANCE_MM * np.sqrt(camera.fx * camera.fy) / depth)


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


class MonoInitialiser:
    """Finds a face in images of one camera.

    Args:
        config: of the whole run; where it never adjusts a person, the mean one stays.
        adjuster: of views of the camera that takes the images.
        detector: of faces.
        choice: which face, 0 the largest in the image, 1 the next.
        landmarks: of the same images; frames that have none are searched by the detector.
    """

    def __init__(
        self,
        config: HeadMonoConfig,
        adjuster: Adjuster,
        detector: FaceDetector,
        choice: int = 0,
        landmarks: Landmarks | None = None,
    ) -> None:
        self._config, self._adjuster = config, adjuster
        self._camera, self._model = adjuster.camera, adjuster.model
        self._detector, self._choice, self._landmarks = detector, choice, landmarks

    def detect(self, frame: Frame, near: FloatArray | None = None) -> DetectedFace | InitFailure:
        """Return a face in a frame with its points, or why there is none.

        Args:
            frame: of one image.
            near: (K, 2) pixels of the face in an earlier frame. The face there is taken, whatever the choice:
                a second person who comes nearer meanwhile does not take over.
        """
        (image,) = frame.images
        if image is None:
            return InitFailure("no image")
        told = self.told(frame, near)
        if told is not None:
            return face_at(self._placed(image, told), frame.stamp_ns, self._camera, told.responses)
        roll = None if near is None else _roll(near)
        detection = self._detector.detect(image, wanted=self._choice + 1 if near is None else 1, roll=roll)
        faces = sorted(detection.faces, key=lambda face: -face.pixels_per_mm)
        face = self._chosen(faces) if near is None else _same(faces, near)
        if isinstance(face, str):
            return InitFailure(face, detection.best_score)
        deviation = np.rad2deg(slope_deviation(face.pixels, self._camera))
        if deviation > SLOPE_DEG:
            reason = f"left and right points at slopes that differ by {deviation:.0f} deg"
            return InitFailure(reason, face.score)
        return face_at(face.pixels, frame.stamp_ns, self._camera, face.responses)

    def told(self, frame: Frame, near: FloatArray | None = None) -> ToldFace | None:
        """Return the face that landmarks tell of a frame, chosen as a detected one; None for none."""
        faces = () if self._landmarks is None else self._landmarks.faces(frame)
        face = self._chosen(faces) if near is None else _same(faces, near)
        return None if isinstance(face, str) else face

    def _placed(self, image: ImageArray, told: ToldFace) -> FloatArray:
        """Where a track of a face that landmarks tell begins, (K, 2)."""
        seen = self._detector.points_at(image, told.pixels)
        return told.pixels if seen is None or self._landmarks is None else self._landmarks.placed(seen, told)

    def has_slid(self, pixels: FloatArray, told: ToldFace) -> bool:
        """Whether tracked points (K, 2) have left where landmarks tell them."""
        return self._landmarks is not None and self._landmarks.has_slid(pixels, told)

    def _chosen(self, faces: Sequence[Face]) -> Face | str:
        if self._choice < len(faces):
            return faces[self._choice]
        return f"{len(faces)} face{'s' * (len(faces) > 1)}, not {self._choice + 1}" if faces else NO_FACE

    def initialise(self, detected: Sequence[DetectedFace]) -> MonoInitialisation | InitFailure:
        """Return the head whose points were found in one frame or more, or why they are no head's.

        The adjustment begins with the mean person and with the pose that each frame's points alone give an
        average face **[ours]**; the thesis's begins with a face in the middle of the image that looks at the
        camera. Points are compared with a face's before it, too: constant offsets would make any points a
        face's.

        Args:
            detected: of one face, in the order of time.
        """
        if not detected:
            return InitFailure(NO_FACE)
        settings = self._config.adjustment
        score = float(np.mean([face.score for face in detected]))
        misfit = float(np.median([face.misfit for face in detected]))
        if misfit > MOST_RESIDUAL:
            return InitFailure(_unlike(misfit), score)
        adjusted = self._adjuster.adjust(
            [self._view(face) for face in detected],
            PersonParameters(self._model.identity_mean, np.zeros((POINT_COUNT, 3))),
            iterations=settings.start_iterations,
            hold_person=settings.when == "never",
            wide=True,
        )
        residual = _residual(adjusted, detected)
        reason = _implausible([view.pose for view in adjusted.views], residual)
        if reason:
            return InitFailure(reason, score)
        return MonoInitialisation(
            adjusted.views, adjusted.person, detected[0].pixels, residual, score, adjusted
        )

    def templates(self, frame: Frame, found: DetectedFace, start: MonoInitialisation) -> TemplateSet:
        """Return the templates of a frame with a face, the last of those that the head was found in."""
        images = RigImages((self._camera,), frame.images)
        return take_templates(images, start.views[-1].pose, self._shape(start), found.pixels[None])

    def reference(self, first: TemplateSet, start: MonoInitialisation) -> TemplateSet:
        """Return the templates of the first frame, at the pose that the adjustment came to."""
        pose = start.views[0].pose
        projection = project((self._camera,), pose.points(self._shape(start)))
        return replace(first, tangents=tangents(projection, pose), facing=pose.facing)

    def _shape(self, start: MonoInitialisation) -> FloatArray:
        return self._model.of_person(start.person.identity, start.person.offsets).mean

    def _view(self, face: DetectedFace) -> PointView:
        """Return a frame as the adjustment takes it: points count by their noise beside tracked ones'."""
        noise = np.full(POINT_COUNT, self._config.start.pixel_sd)
        if self._landmarks is not None:
            told = self._landmarks.noise_px / self._config.adjustment.pixel_sd.values
            noise = np.maximum(noise, told)
        weights = np.minimum(noise**-2, 1.0) * (face.responses > 0.0)
        return PointView(face.stamp_ns, face.pixels, weights, face.pose, self._model.deformation_mean)


def _roll(pixels: FloatArray) -> float:
    """Rad, clockwise, of the line through the eyes of a face with points (K, 2)."""
    across = pixels[2:4].mean(axis=0) - pixels[:2].mean(axis=0)
    return float(np.arctan2(across[1], across[0]))


def _same(faces: Sequence[Face], near: FloatArray) -> Face | str:
    if not faces:
        return NO_FACE
    middle = near.mean(axis=0)
    ways = [
        np.hypot(*(face.pixels.mean(axis=0) - middle)) / (EYE_DISTANCE_MM * face.pixels_per_mm)
        for face in faces
    ]
    nearest = int(np.argmin(ways))
    return faces[nearest] if ways[nearest] <= SAME_FACE else "only faces elsewhere than before"


RIGHT = tuple(k for k, other in enumerate(MIRRORED) if k < other)
LEFT = tuple(MIRRORED[k] for k in RIGHT)


def slope_deviation(pixels: FloatArray, camera: Camera) -> float:
    """Return the standard deviation, rad, of the slopes of the K/2 segments from right to left points.

    The segments of a symmetric face are parallel in space, and so, but for perspective, in the image: a turn
    of the head does not matter. Slopes are angles to their mean direction **[ours]**, so that roll does not
    either, and are weighted by the squares of the segments' lengths **[ours]**: an error of a pixel turns
    the nostrils' segment five times as far as that of the eyes' outer corners.

    Args:
        pixels: (K, 2) as recorded.
        camera: that saw them; its lens bends the segments.
    """
    flat = undistorted_pixels(camera, pixels)
    segments = flat[list(LEFT)] - flat[list(RIGHT)]
    lengths = np.linalg.norm(segments, axis=1)
    along = segments.sum(axis=0) / max(float(np.linalg.norm(segments.sum(axis=0))), 1e-12)
    across = segments @ along
    angles = np.arctan2(segments[:, 1] * along[0] - segments[:, 0] * along[1], across)
    weights = lengths**2 / np.sum(lengths**2)
    return float(np.sqrt(weights @ (angles - weights @ angles) ** 2))


def _residual(adjusted: Adjusted, detected: Sequence[DetectedFace]) -> float:
    distances = np.array([face.eye_distance for face in detected])
    return float(np.sqrt(np.nanmean((adjusted.residuals / distances[:, None]) ** 2)))


def _implausible(poses: Sequence[HeadPose], residual: float) -> str:
    """Say what about adjusted poses is not a head's before a camera; empty if nothing is."""
    nearest, farthest = DISTANCES_MM
    for pose in poses:
        distance = float(pose.position[2])
        if not nearest <= distance <= farthest:
            return f"a face {distance / 1000.0:.2g} m before the camera"
        if pose.facing @ pose.position >= 0.0:
            return "a face that looks away from the camera"
    if not residual <= MOST_RESIDUAL:
        return _unlike(residual)
    return ""


def _unlike(distance: float) -> str:
    if not np.isfinite(distance):
        return "points that no face before this camera has"
    return f"points {distance:.2f} eye distances from a face's"
