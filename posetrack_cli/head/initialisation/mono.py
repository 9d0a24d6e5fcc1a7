"""Pose and identity of a head from its points in a few frames of one camera (thesis, 4.4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, undistorted_pixels
from posetrack_cli.head.adjustment.adjuster import Adjusted, Adjuster, PersonParameters, PointView
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.detection.detector import Detection, FaceDetector
from posetrack_cli.head.detection.points import FacePoints, mean_response
from posetrack_cli.head.face.points import FEATURE_SD, FEATURES, MIRRORED, POINT_COUNT, HeadPose
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import TemplateSet, take_templates, tangents
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.initialisation.single_view import NEAREST_MM, pose_of
from posetrack_cli.head.landmarks.faces import LandmarkFace, Landmarks
from posetrack_cli.recording.base import Frame

Face = TypeVar("Face", FacePoints, LandmarkFace)
EYE_DISTANCE_MM = 63.0
SAME_FACE = 1.0
"""Farthest motion of a face between two frames, in eye distances."""
MEAN_FACE_WEIGHTS = (FEATURE_SD.min() / FEATURE_SD) ** 2
"""(K,) weights of the points in fits of an average face: eyes vary least."""
SLOPE_DEG = 4.0
"""Maximum standard deviation of the slopes of lines between left and right points."""
TURNED_SLOPE_DEG = 10.0
"""The same for a face with hidden points: the lines left are foreshortened."""
MOST_RESIDUAL = 0.12
"""Maximum RMS distance of the points from the average and the adjusted face, eye distances."""
DISTANCES_MM = (100.0, 5000.0)
"""Plausible distances of a head; others indicate a wrong focal length or a false detection."""
ALL_SEEN = np.ones(POINT_COUNT, dtype=bool)
CLICKED = np.ones(POINT_COUNT)
"""(K,) responses of clicked points."""


@dataclass(frozen=True, eq=False)
class DetectedFace:
    """The ten points of a face in one frame.

    Attributes:
        stamp_ns: of the frame.
        pixels: (K, 2) in the image, with lens distortion.
        responses: (K,) 0 to 1, similarity of each place to its point; 1 for clicked, 0 for hidden points.
        score: 0 to 1, mean of those not hidden.
        eye_distance: pixels, as if the face looked at the camera.
        pose: rough, of an average face.
        misfit: weighted RMS distance of the points from the average face, eye distances.
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
    """Return the face with detected or, without responses (K,), clicked points (K, 2)."""
    pose, rms_px = pose_of(pixels, MEAN_FACE_WEIGHTS * (responses > 0.0), camera, FEATURES)
    distance = eye_distance_px(pose, camera)
    score = mean_response(responses)
    return DetectedFace(stamp_ns, pixels, responses, score, distance, pose, rms_px / distance)


def eye_distance_px(pose: HeadPose, camera: Camera) -> float:
    """Return the eye distance, pixels, of an average face that looks at the camera."""
    depth = max(float(pose.position[2]), NEAREST_MM)
    return float(EYE_DISTANCE_MM * np.sqrt(camera.fx * camera.fy) / depth)


@dataclass(frozen=True, eq=False)
class MonoInitialisation:
    """Initialisation of a person from several frames.

    Attributes:
        views: adjusted frames, in the order given.
        person: identity and offsets.
        pixels: (K, 2) detected points of the first frame.
        residual: RMS distance of the adjusted from the detected points, eye distances.
        score: 0 to 1, mean of the detections.
        adjusted: full result of the adjustment.
    """

    views: tuple[PointView, ...]
    person: PersonParameters
    pixels: FloatArray
    residual: float
    score: float
    adjusted: Adjusted


class MonoInitialiser:
    """Detects faces in images of one camera and initialises people from them.

    Args:
        config: of the run; without adjustments the person remains the mean.
        adjuster: for views of the camera.
        detector: of faces.
        choice: face to use, 0 is the largest in the image.
        landmarks: of the same images; frames without landmarks use the detector.
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

    def detect(
        self, frame: Frame, near: FloatArray | None = None, *, thoroughly: bool = False
    ) -> DetectedFace | InitFailure:
        """Return a face in a frame with its points, or the reason why there is none.

        Args:
            frame: with one image.
            near: (K, 2) pixels of the face in an earlier frame. The face there is used, whatever the choice,
                so that another person who approaches does not take over.
            thoroughly: search the whole image in all ways, not in one of them or near the earlier face.
        """
        (image,) = frame.images
        if image is None:
            return InitFailure("no image")
        landmark_face = self.landmark_face(frame, near)
        if landmark_face is not None:
            pixels = self._start_pixels(image, landmark_face)
            return face_at(pixels, frame.stamp_ns, self._camera, landmark_face.responses)
        detection = self._detections(image, frame.index, near, thoroughly)
        face = self._chosen(detection.faces) if near is None else _same(detection.faces, near)
        if isinstance(face, str):
            return InitFailure(face, detection.best_score)
        deviation = np.rad2deg(slope_deviation(face.pixels, self._camera, face.responses > 0.0))
        if deviation > (SLOPE_DEG if face.responses.all() else TURNED_SLOPE_DEG):
            reason = f"slopes between left and right points differ by {deviation:.0f} deg"
            return InitFailure(reason, face.score)
        return face_at(face.pixels, frame.stamp_ns, self._camera, face.responses)

    def _detections(
        self, image: ImageArray, index: int, near: FloatArray | None, thoroughly: bool
    ) -> Detection:
        wanted = self._choice + 1
        if near is None:
            detect = self._detector
            return (
                detect.detect(image, wanted=wanted)
                if thoroughly
                else detect.detect_quickly(image, index, wanted=wanted)
            )
        found = self._detector.detect(image, roll=_roll(near)) if thoroughly else None
        return found if found is not None and found.faces else self._detector.detect_near(image, near)

    def landmark_face(self, frame: Frame, near: FloatArray | None = None) -> LandmarkFace | None:
        """Return the face from landmarks, chosen like a detected one; None without landmarks."""
        faces = () if self._landmarks is None else self._landmarks.faces(frame)
        face = self._chosen(faces) if near is None else _same(faces, near)
        return None if isinstance(face, str) else face

    def _start_pixels(self, image: ImageArray, face: LandmarkFace) -> FloatArray:
        """Return the pixels (K, 2) at which a face from landmarks is tracked."""
        seen = self._detector.points_at(image, face.pixels)
        if seen is None or self._landmarks is None:
            return face.pixels
        return self._landmarks.start_pixels(seen, face)

    def has_slid(self, pixels: FloatArray, face: LandmarkFace) -> bool:
        """Whether tracked points (K, 2) have left their landmarks."""
        return self._landmarks is not None and self._landmarks.has_slid(pixels, face)

    def _chosen(self, faces: Sequence[Face]) -> Face | str:
        if self._choice < len(faces):
            return faces[self._choice]
        return f"{len(faces)} face{'s' * (len(faces) > 1)}, not {self._choice + 1}" if faces else NO_FACE

    def initialise(self, detected: Sequence[DetectedFace]) -> MonoInitialisation | InitFailure:
        """Adjust a person to the detected points of one or more frames, or return why that fails.

        The adjustment starts with the mean person and the pose of each frame's own points **[ours]**; the
        thesis starts with a face in the image centre that looks at the camera. The points must resemble a
        face before the adjustment as well, because constant offsets could fit any points.

        Args:
            detected: faces of one person, in the order of time.
        """
        if not detected:
            return InitFailure(NO_FACE)
        settings = self._config.adjustment
        score = float(np.mean([face.score for face in detected]))
        misfit = float(np.median([face.misfit for face in detected]))
        # before the adjustment, whose offsets could fit any points
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
        """Return the templates of the last frame of an initialisation."""
        images = RigImages((self._camera,), frame.images)
        seen = take_templates(images, start.views[-1].pose, self._shape(start), found.pixels[None])
        return replace(seen, seen=seen.seen & (found.responses > 0.0))

    def reference(self, first: TemplateSet, start: MonoInitialisation) -> TemplateSet:
        """Return the templates of the first frame at its adjusted pose."""
        pose = start.views[0].pose
        projection = project((self._camera,), pose.points(self._shape(start)))
        return replace(first, tangents=tangents(projection, pose), facing=pose.facing)

    def _shape(self, start: MonoInitialisation) -> FloatArray:
        return self._model.of_person(start.person.identity, start.person.offsets).mean

    def _view(self, face: DetectedFace) -> PointView:
        """Return a frame for the adjustment, with weights from the noise relative to tracked points."""
        noise = np.full(POINT_COUNT, self._config.start.pixel_sd)
        if self._landmarks is not None:
            noise = np.maximum(noise, self._landmarks.noise_px / self._config.adjustment.pixel_sd.values)
        weights = np.minimum(noise**-2, 1.0) * (face.responses > 0.0)
        return PointView(face.stamp_ns, face.pixels, weights, face.pose, self._model.deformation_mean)


def _roll(pixels: FloatArray) -> float:
    """Return the roll, rad, clockwise, of a face with points (K, 2)."""
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
    return faces[nearest] if ways[nearest] <= SAME_FACE else "no face near the last position"


RIGHT = tuple(k for k, other in enumerate(MIRRORED) if k < other)
LEFT = tuple(MIRRORED[k] for k in RIGHT)


def slope_deviation(pixels: FloatArray, camera: Camera, seen: BoolArray = ALL_SEEN) -> float:
    """Return the standard deviation, rad, of the slopes of the K/2 segments from right to left points.

    The segments of a symmetric face are parallel in space and, up to perspective, in the image, whatever the
    yaw and pitch. Slopes are measured against their mean direction **[ours]**, which makes them independent
    of roll, and weighted by squared length **[ours]**: a pixel error turns the nostrils' segment five times
    as far as that of the outer eye corners.

    Args:
        pixels: (K, 2) with lens distortion.
        camera: of the image.
        seen: (K,) which points are not hidden.
    """
    both = seen[list(LEFT)] & seen[list(RIGHT)]
    if not both.any():
        return 0.0
    flat = undistorted_pixels(camera, pixels)
    segments = (flat[list(LEFT)] - flat[list(RIGHT)])[both]
    lengths = np.linalg.norm(segments, axis=1)
    along = segments.sum(axis=0) / max(float(np.linalg.norm(segments.sum(axis=0))), 1e-12)
    across = segments @ along
    angles = np.arctan2(segments[:, 1] * along[0] - segments[:, 0] * along[1], across)
    # the variance of a segment's angle is inversely proportional to its squared length
    weights = lengths**2 / np.sum(lengths**2)
    return float(np.sqrt(weights @ (angles - weights @ angles) ** 2))


def _residual(adjusted: Adjusted, detected: Sequence[DetectedFace]) -> float:
    distances = np.array([face.eye_distance for face in detected])
    return float(np.sqrt(np.nanmean((adjusted.residuals / distances[:, None]) ** 2)))


def _implausible(poses: Sequence[HeadPose], residual: float) -> str:
    """Return why adjusted poses or residuals are implausible; empty if they are not."""
    nearest, farthest = DISTANCES_MM
    for pose in poses:
        distance = float(pose.position[2])
        if not nearest <= distance <= farthest:
            return f"face at an implausible distance of {distance / 1000.0:.2g} m"
        if pose.facing @ pose.position >= 0.0:
            return "face looks away from the camera"
    if not residual <= MOST_RESIDUAL:
        return _unlike(residual)
    return ""


def _unlike(distance: float) -> str:
    if not np.isfinite(distance):
        return "points do not match any face"
    return f"points deviate from a face by {distance:.2f} eye distances"
