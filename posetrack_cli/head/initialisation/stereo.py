"""One attempt to find a head in the images that several calibrated cameras took at one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import reprojection_errors, rigid_alignment, triangulate
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.config import StereoInitialisationSettings
from posetrack_cli.head.detection.detector import Detection, FaceDetector
from posetrack_cli.head.detection.fit import relief_of
from posetrack_cli.head.detection.points import FacePoints
from posetrack_cli.head.face.points import EYES, FEATURE_SD, FEATURES, POINT_COUNT, HeadPose
from posetrack_cli.head.face.rig_images import CameraImage, RigImages, is_reference, required
from posetrack_cli.head.initialisation.average_face import MeasuredFace, exchanged_order
from posetrack_cli.head.initialisation.matching import match_points
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.initialisation.single_view import weak_perspective
from posetrack_cli.head.landmarks.faces import Landmarks
from posetrack_cli.recording.base import Frame

CORRELATION, RETURN_MM = 0.5, 4.0
"""A point is matched in another image from this correlation on, if on the way back it is found again within
this distance."""
MATCHED_POINTS = 7
"""So many of the ten must be."""
DEVIATION = 1.1
"""Root mean square distance from an average face, in its standard deviations, at most."""
LEAST_SIZE, MOST_SIZE = 0.7, 1.3
"""Of a face, as factors of the average's."""


@dataclass(frozen=True, eq=False)
class StereoInitialisation:
    """A head that was found.

    Attributes:
        pose: ``camera_T_head`` in the reference camera.
        shape: (K, 3) in the head's frame, mm.
        pixels: (C, K, 2) of the points in every image; NaN for a camera without one.
        matched: (K,) which points were found in more than one image; the others' depth is an average face's.
        score: 0 to 1, mean correlation of the matched points.
        doubt: an order of images that faces found in each by itself fit better, though the head was found in
            the order recorded; empty if none.
    """

    pose: HeadPose
    shape: FloatArray
    pixels: FloatArray
    matched: BoolArray
    score: float
    doubt: tuple[int, ...] = ()

    def is_surer_than(self, other: StereoInitialisation) -> bool:
        """Whether more points were matched than in another order of images, and lie more like a face's."""
        deviations = [
            MeasuredFace(one.pose.points(one.shape), np.ones(POINT_COUNT, dtype=bool)).deviation
            for one in (self, other)
        ]
        return bool(self.matched.sum() > other.matched.sum()) and deviations[0] < deviations[1]


class StereoInitialiser:
    """Finds the face in the images of one frame.

    Args:
        settings: what is good enough.
        cameras: C >= 2, calibrated.
        landmarks: of the reference camera's images; frames that have none are searched by a detector.

    Raises:
        UsageError: a face detector without its model.
    """

    def __init__(
        self,
        settings: StereoInitialisationSettings,
        cameras: Sequence[Camera],
        landmarks: Landmarks | None = None,
    ) -> None:
        self._settings, self._cameras, self._landmarks = settings, tuple(cameras), landmarks
        self._detector = FaceDetector(settings.detection)

    def find(self, frame: Frame, *, is_first: bool) -> StereoInitialisation | InitFailure:
        """Return where the face is in a frame, the first of the run or another, or why none was found."""
        told = self.from_landmarks(frame)
        return self._attempt(frame).find(self._detector) if told is None else told

    def from_landmarks(self, frame: Frame, tracked: FloatArray | None = None) -> StereoInitialisation | None:
        """Return where landmarks tell the largest face, None where they tell none.

        Args:
            frame: of all cameras.
            tracked: (K, 2) pixels of a track in the reference camera: None is returned if it has not slid.
        """
        faces = () if self._landmarks is None else self._landmarks.faces(frame)
        if not faces or self._landmarks is None:
            return None
        if tracked is not None and not self._landmarks.has_slid(tracked, faces[0]):
            return None
        pixels = np.full((len(self._cameras), POINT_COUNT, 2), np.nan)
        pixels[0] = faces[0].pixels
        found = self._attempt(frame).from_clicked(pixels)
        return None if isinstance(found, InitFailure) else found

    def _attempt(self, frame: Frame) -> StereoAttempt:
        return StereoAttempt(RigImages(self._cameras, frame.images), self._settings)


@dataclass(frozen=True, eq=False)
class StereoAttempt:
    """An attempt to find a head in the images of one instant.

    Attributes:
        images: of C >= 2 calibrated cameras.
        settings: what is good enough.
    """

    images: RigImages
    settings: StereoInitialisationSettings = StereoInitialisationSettings()  # noqa: RUF009

    @cached_property
    def views(self) -> tuple[CameraImage | None, ...]:
        """Each camera with its image, None where it has none."""
        return self.images.views

    def find(self, detector: FaceDetector) -> StereoInitialisation | InitFailure:
        """Return the head of a face that a detector finds, or why there is none.

        The face is looked for in the reference camera's image first; where that fails, in the others'.
        """
        cameras = self.images.cameras
        present = [c for c, view in enumerate(self.views) if view is not None]
        if len(present) < 2:
            return InitFailure("images of fewer than two cameras")
        detections: dict[int, Detection] = {}
        failures = [InitFailure(NO_FACE)]
        for camera in sorted(present, key=lambda c: not is_reference(cameras[c])):
            detections[camera] = detector.detect(required(self.views[camera]).image)
            failures.append(InitFailure(NO_FACE, detections[camera].best_score))
            outcomes = [self._from_face(camera, face) for face in detections[camera].faces]
            failures += [one for one in outcomes if isinstance(one, InitFailure)]
            starts = [one for one in outcomes if isinstance(one, StereoInitialisation)]
            if starts:
                return self._checked(starts[0], detections, detector)
        worst = max(failures, key=lambda one: (one.reason != NO_FACE, one.score))
        return self._checked(worst, detections, detector)

    def from_clicked(self, clicked: FloatArray) -> StereoInitialisation | InitFailure:
        """Return the head whose points were clicked.

        Where a point was clicked in several images they are believed; else it is matched as a found one would
        be.

        Args:
            clicked: (C, K, 2) pixels, NaN where none was clicked.
        """
        camera = clicked_camera(clicked)
        if camera is None or self.views[camera] is None:
            return InitFailure("no image of the camera whose points were clicked")
        scale, rotation, _ = weak_perspective(FEATURES, clicked[camera], 1.0 / FEATURE_SD)
        pixels, correlations = self._matched(camera, clicked[camera], scale, FEATURES @ rotation[2])
        given = ~np.isnan(clicked[..., 0])
        pixels[given] = clicked[given]
        correlations[given.sum(axis=0) > 1] = 1.0
        return self.from_pixels(camera, pixels, correlations)

    def from_pixels(
        self, camera: int, pixels: FloatArray, correlations: FloatArray
    ) -> StereoInitialisation | InitFailure:
        """Return the head whose points have pixels (C, K, 2), NaN where not found, if they are a face's.

        Args:
            camera: index of one that has all points.
            pixels: (C, K, 2).
            correlations: (K,) how well the points were matched, for the score.
        """
        views, most_px = self.views, self.settings.reprojection_px
        used = [c for c, view in enumerate(views) if view is not None]
        cameras = [required(views[c]).camera for c in used]
        points, known = triangulate(cameras, pixels[used])
        errors = reprojection_errors(cameras, points, pixels[used])
        known &= np.where(np.isnan(pixels[used, :, 0]), 0.0, errors).max(axis=0) <= most_px
        score, face = float(correlations.mean()), MeasuredFace(points, known)
        if face.known.sum() >= MATCHED_POINTS:
            face = face.without_outliers()
        if face.known.sum() < MATCHED_POINTS:
            reason = f"{face.known.sum()} of {POINT_COUNT} points matched between the images"
            return InitFailure(reason, score)
        reason = self._implausible(face)
        if reason:
            return InitFailure(reason, score)
        known, points = face.known, face.completed(required(views[camera]), pixels[camera])
        pose, shape = pose_and_shape(points)
        pixels = np.where((known | (np.arange(len(views)) == camera)[:, None])[..., None], pixels, np.nan)
        return StereoInitialisation(
            pose, shape, self._everywhere(points, pixels), known, float(correlations[known].mean())
        )

    def _from_face(self, camera: int, face: FacePoints) -> StereoInitialisation | InitFailure:
        relief = relief_of(face.angles)
        return self.from_pixels(camera, *self._matched(camera, face.pixels, face.pixels_per_mm, relief))

    def _matched(
        self, camera: int, pixels: FloatArray, pixels_per_mm: float, relief: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Match the ten points of one camera's image in all others.

        Args:
            camera: index of the one that the points were found in.
            pixels: (K, 2) in its image.
            pixels_per_mm: the face's scale there.
            relief: (K,) mm, how much farther than the head's origin each point of an average face is.

        Returns:
            (C, K, 2) pixels, NaN where a point was not matched, and (K,) each point's best correlation.
        """
        views = self.views
        first = required(views[camera])
        found = np.full((len(views), POINT_COUNT, 2), np.nan)
        found[camera] = pixels
        correlations = np.zeros((len(views), POINT_COUNT))
        for other, second in enumerate(views):
            if other != camera and second is not None:
                matches = match_points(first, second, pixels, relief, pixels_per_mm)
                good = matches.correlations >= CORRELATION
                good &= matches.returns_px <= RETURN_MM * pixels_per_mm
                found[other, good], correlations[other] = matches.pixels[good], matches.correlations
        return found, correlations.max(axis=0)

    def _implausible(self, face: MeasuredFace) -> str:
        """Say what about the known points is not a face's; empty if nothing is."""
        size, deviation = face.size, face.deviation
        if not LEAST_SIZE <= size <= MOST_SIZE:
            return f"points {size:.2f} times as far apart as a face's"
        if deviation > DEVIATION:
            return f"points {deviation:.1f} standard deviations from a face's"
        return ""

    def _everywhere(self, points: FloatArray, pixels: FloatArray) -> FloatArray:
        """Return pixels (C, K, 2) with the projections of points where an image exists and none was found."""
        filled = pixels.copy()
        for own, view in zip(filled, self.views, strict=True):
            if view is not None:
                projected, _ = view.pixels_of(points)
                own[:] = np.where(np.isnan(own), projected, own)
        return filled

    def _checked(
        self,
        outcome: StereoInitialisation | InitFailure,
        detections: dict[int, Detection],
        detector: FaceDetector,
    ) -> StereoInitialisation | InitFailure:
        """Return the outcome, or that images look exchanged if all evidence says so.

        Faces found in each image by itself may fit another order better by chance: on a wide baseline they
        lie off by more than a point's width. So a head must be found in that order, too, and if one was found
        as recorded match in more points and be more like a face; else the outcome stays, with a doubt
        **[ours]**.
        """
        views, cameras = self.views, self.images.cameras
        if any(view is None for view in views) or not any(one.faces for one in detections.values()):
            return outcome
        faces = np.full((len(views), POINT_COUNT, 2), np.nan)
        for camera, view in enumerate(views):
            detection = detections.get(camera) or detector.detect(required(view).image)
            if detection.faces:
                faces[camera] = detection.faces[0].pixels
        order = exchanged_order(cameras, faces)
        if not order:
            return outcome
        other = self._found_in(order, faces)
        if isinstance(outcome, StereoInitialisation):
            if other is None or not other.is_surer_than(outcome):
                return replace(outcome, doubt=order)
        elif other is None:
            return outcome
        names = ", ".join(cameras[c].name for c in order)
        return InitFailure(
            f"images look exchanged: they fit the calibration in the order {names}", outcome.score, order
        )

    def _found_in(self, order: Sequence[int], faces: FloatArray) -> StereoInitialisation | None:
        """Return the head of faces (C, K, 2), one in each image, with the images in another order."""
        images = [self.images.images[c] for c in order]
        attempt = StereoAttempt(RigImages(self.images.cameras, images), self.settings)
        for camera in range(len(order)):
            clicked = np.full_like(faces, np.nan)
            clicked[camera] = faces[order[camera]]
            found = attempt.from_clicked(clicked)
            if isinstance(found, StereoInitialisation):
                return found
        return None


def clicked_camera(pixels: FloatArray) -> int | None:
    """Return the first camera with all of the clicked points (C, K, 2), None if there is none."""
    complete = np.flatnonzero(~np.isnan(pixels[..., 0]).any(axis=1))
    return int(complete[0]) if len(complete) else None


def pose_and_shape(points: FloatArray) -> tuple[HeadPose, FloatArray]:
    """Return the pose and the shape of a head whose ten points are given.

    The rotation lays an average face on the points (weighted least squares); the origin is the mean of the
    eye corners. So R M_k + t are the points.

    Args:
        points: (K, 3) in the reference camera's axes, mm.

    Returns:
        The pose, and the shape (K, 3) in the head's frame, mm.
    """
    rotation, _ = rigid_alignment(FEATURES, points, FEATURE_SD**-2)
    origin = points[EYES].mean(axis=0)
    return HeadPose(origin, quaternions_from_matrices(rotation)), (points - origin) @ rotation
