"""Initialisation of a head from simultaneous images of several calibrated cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import reprojection_errors, rigid_alignment, triangulate
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.config import StereoInitialisationSettings
from posetrack_cli.head.detection.detector import Detection, FaceDetector
from posetrack_cli.head.detection.fit import relief_of
from posetrack_cli.head.detection.points import FacePoints
from posetrack_cli.head.face.points import EYES, FEATURE_SD, FEATURES, POINT_COUNT, HeadPose
from posetrack_cli.head.face.rig_images import CameraImage, RigImages, is_reference, required
from posetrack_cli.head.initialisation.average_face import MeasuredFace, swapped_order
from posetrack_cli.head.initialisation.matching import match_points
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.initialisation.single_view import weak_perspective
from posetrack_cli.head.landmarks.faces import Landmarks
from posetrack_cli.recording.base import Frame

CORRELATION, RETURN_MM = 0.5, 4.0
"""Minimum correlation and maximum forward-backward error of a match."""
MATCHED_POINTS = 7
"""Minimum number of matched points."""
DEVIATION = 1.1
"""Maximum RMS distance from an average face, in its standard deviations."""
LEAST_SIZE, MOST_SIZE = 0.7, 1.3
"""Limits of a face's size relative to the average."""


@dataclass(frozen=True, eq=False)
class StereoInitialisation:
    """A head found in one frame.

    Attributes:
        pose: ``camera_T_head`` in the reference camera.
        shape: (K, 3) in the head's frame, mm.
        pixels: (C, K, 2) of the points in every image; NaN for a camera without one.
        matched: (K,) points found in more than one image; the others have an average face's depth.
        score: 0 to 1, mean correlation of the matched points.
        reprojection_px: largest reprojection error of each point, averaged over the matched points.
    """

    pose: HeadPose
    shape: FloatArray
    pixels: FloatArray
    matched: BoolArray
    score: float
    reprojection_px: float = 0.0

    def is_better_than(self, other: StereoInitialisation) -> bool:
        """Whether the points fit the cameras clearly better than in another image order.

        More of them match, they resemble a face more closely, and they reproject at least as well.
        """
        deviations = [
            MeasuredFace(one.pose.points(one.shape), np.ones(POINT_COUNT, dtype=bool)).deviation
            for one in (self, other)
        ]
        closer = deviations[0] < deviations[1] and self.reprojection_px <= other.reprojection_px
        return bool(self.matched.sum() > other.matched.sum()) and closer


class StereoInitialiser:
    """Finds the face in the images of one frame.

    Args:
        settings: of the initialisation.
        cameras: C >= 2, calibrated.
        landmarks: of the reference camera's images; frames without landmarks use the detector.

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

    def find(
        self, frame: Frame, *, is_first: bool, is_known: bool = False
    ) -> StereoInitialisation | InitFailure:
        """Return the head in a frame, or the reason why there is none.

        Args:
            frame: of all cameras.
            is_first: whether it is searched thoroughly.
            is_known: whether the face was found before; its cameras are then searched in turn.
        """
        found = self.from_landmarks(frame)
        if found is not None:
            return found
        index = None if is_first else frame.index
        return self._attempt(frame).find(self._detector, index, in_turn=is_known)

    def from_landmarks(self, frame: Frame, tracked: FloatArray | None = None) -> StereoInitialisation | None:
        """Return the head from the landmarks of the largest face, None without landmarks.

        Args:
            frame: of all cameras.
            tracked: (K, 2) pixels of a track in the reference camera; returns None if it has not slid.
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
    """One attempt to find a head in simultaneous images.

    Attributes:
        images: of C >= 2 calibrated cameras.
        settings: of the initialisation.
    """

    images: RigImages
    settings: StereoInitialisationSettings = StereoInitialisationSettings()  # noqa: RUF009

    @cached_property
    def views(self) -> tuple[CameraImage | None, ...]:
        """Each camera with its image, None where it has none."""
        return self.images.views

    def find(
        self, detector: FaceDetector, index: int | None = None, *, in_turn: bool = False
    ) -> StereoInitialisation | InitFailure:
        """Detect a face and return its head, or the reason why there is none.

        The reference camera's image is searched first, then the others'.

        Args:
            detector: of faces.
            index: of the frame, for a quick search; by default the images are searched thoroughly.
            in_turn: a quick search looks at one camera's image per frame.
        """
        cameras = self.images.cameras
        present = [c for c, view in enumerate(self.views) if view is not None]
        if len(present) < 2:
            return InitFailure("fewer than two cameras have an image")
        # stable sort with the reference camera first
        order = sorted(present, key=lambda c: not is_reference(cameras[c]))
        in_turn = in_turn and index is not None
        if in_turn and index is not None:
            order, index = [order[index % len(order)]], index // len(order)
        detect = detector.detect if index is None else partial(detector.detect_quickly, index=index)
        detections: dict[int, Detection] = {}
        failures = [InitFailure(NO_FACE)]
        for camera in order:
            detections[camera] = detect(required(self.views[camera]).image)
            failures.append(InitFailure(NO_FACE, detections[camera].best_score))
            outcomes = [self._from_face(camera, face) for face in detections[camera].faces]
            failures += [one for one in outcomes if isinstance(one, InitFailure)]
            starts = [one for one in outcomes if isinstance(one, StereoInitialisation)]
            if starts:
                return starts[0] if in_turn else self._check_order(starts[0], detections, detect)
        worst = max(failures, key=lambda one: (one.reason != NO_FACE, one.score))
        return worst if in_turn else self._check_order(worst, detections, detect)

    def from_clicked(self, clicked: FloatArray) -> StereoInitialisation | InitFailure:
        """Return the head from clicked points.

        Points clicked in several images are used as they are; others are matched like detected ones.

        Args:
            clicked: (C, K, 2) pixels, NaN where no point was clicked.
        """
        camera = complete_camera(clicked)
        if camera is None or self.views[camera] is None:
            return InitFailure("the camera with clicked points has no image")
        scale, rotation, _ = weak_perspective(FEATURES, clicked[camera], 1.0 / FEATURE_SD)
        pixels, correlations = self._matched(camera, clicked[camera], scale, FEATURES @ rotation[2])
        given = ~np.isnan(clicked[..., 0])
        pixels[given] = clicked[given]
        correlations[given.sum(axis=0) > 1] = 1.0  # clicked in several images, so not matched
        return self.from_pixels(camera, pixels, correlations)

    def from_pixels(
        self, camera: int, pixels: FloatArray, correlations: FloatArray
    ) -> StereoInitialisation | InitFailure:
        """Triangulate points at pixels (C, K, 2), NaN if not found; check that they form a face.

        Args:
            camera: index of a camera with all points.
            pixels: (C, K, 2).
            correlations: (K,) of the matches, for the score.
        """
        views, most_px = self.views, self.settings.reprojection_px
        used = [c for c, view in enumerate(views) if view is not None]
        cameras = [required(views[c]).camera for c in used]
        points, known, errors = _consistent_points(cameras, pixels[used], most_px)
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
            pose,
            shape,
            self._filled(points, pixels),
            known,
            float(correlations[known].mean()),
            float(errors[known].mean()),
        )

    def _from_face(self, camera: int, face: FacePoints) -> StereoInitialisation | InitFailure:
        relief = relief_of(face.angles)
        return self.from_pixels(camera, *self._matched(camera, face.pixels, face.pixels_per_mm, relief))

    def _matched(
        self, camera: int, pixels: FloatArray, pixels_per_mm: float, relief: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Match the ten points of one camera's image in all others.

        Args:
            camera: index of the camera with the points.
            pixels: (K, 2) in its image.
            pixels_per_mm: scale of the face there.
            relief: (K,) mm, depth of each point of an average face relative to the head's origin.

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
        """Return why the known points are not a face's; empty if they are."""
        size, deviation = face.size, face.deviation
        if not LEAST_SIZE <= size <= MOST_SIZE:
            return f"implausible size: {size:.2f} times an average face"
        if deviation > DEVIATION:
            return f"points deviate from a face by {deviation:.1f} standard deviations"
        return ""

    def _filled(self, points: FloatArray, pixels: FloatArray) -> FloatArray:
        """Return pixels (C, K, 2) with missing ones replaced by projections where an image exists."""
        filled = pixels.copy()
        for own, view in zip(filled, self.views, strict=True):
            if view is not None:
                projected, _ = view.pixels_of(points)
                own[:] = np.where(np.isnan(own), projected, own)
        return filled

    def _check_order(
        self,
        outcome: StereoInitialisation | InitFailure,
        detections: dict[int, Detection],
        detect: Callable[[ImageArray], Detection],
    ) -> StereoInitialisation | InitFailure:
        """Return the outcome, or a failure if the images are clearly swapped.

        Separately detected faces may fit another order by chance, since on a wide baseline they are off by
        more than a point's width. Points that match between the images reproject to within a pixel in the
        right order. A head must therefore also be found in the other order and, if one was found as recorded,
        fit the cameras better **[ours]**.
        """
        views, cameras = self.views, self.images.cameras
        if any(view is None for view in views) or not any(one.faces for one in detections.values()):
            return outcome
        faces = np.full((len(views), POINT_COUNT, 2), np.nan)
        for camera, view in enumerate(views):
            detection = detections.get(camera) or detect(required(view).image)
            if detection.faces:
                faces[camera] = detection.faces[0].pixels
        order = swapped_order(cameras, faces)
        if not order:
            return outcome
        other = self._find_in_order(order, faces)
        if isinstance(outcome, StereoInitialisation):
            if other is None or not other.is_better_than(outcome):
                return outcome
        elif other is None:
            return outcome
        names = ", ".join(cameras[c].name for c in order)
        return InitFailure(
            f"images seem swapped: they fit the calibration in the order {names}", outcome.score, order
        )

    def _find_in_order(self, order: Sequence[int], faces: FloatArray) -> StereoInitialisation | None:
        """Return the head of faces (C, K, 2), one per image, with the images reordered."""
        images = [self.images.images[c] for c in order]
        attempt = StereoAttempt(RigImages(self.images.cameras, images), self.settings)
        for camera in range(len(order)):
            clicked = np.full_like(faces, np.nan)
            clicked[camera] = faces[order[camera]]
            found = attempt.from_clicked(clicked)
            if isinstance(found, StereoInitialisation):
                return found
        return None


def _consistent_points(
    cameras: Sequence[Camera], pixels: FloatArray, most_px: float
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Triangulate points from the cameras that agree.

    With three or more cameras, a point that one of them contradicts is triangulated without it.

    Args:
        cameras: of the pixels.
        pixels: (C, K, 2), NaN if not found.
        most_px: maximum reprojection error.

    Returns:
        (K, 3) points, mm, (K,) whether their cameras agree, and (K,) their largest reprojection errors.
    """
    seen = np.isfinite(pixels[..., 0])
    while True:
        points, known = triangulate(cameras, pixels, seen)
        errors = np.where(seen, reprojection_errors(cameras, points, pixels), 0.0)
        largest = errors.max(axis=0)
        wrong = known & (largest > most_px) & (seen.sum(axis=0) > 2)
        if not wrong.any():
            return points, known & (largest <= most_px), largest
        seen[errors[:, wrong].argmax(axis=0), np.flatnonzero(wrong)] = False


def complete_camera(pixels: FloatArray) -> int | None:
    """Return the first camera with all clicked points (C, K, 2), None if there is none."""
    complete = np.flatnonzero(~np.isnan(pixels[..., 0]).any(axis=1))
    return int(complete[0]) if len(complete) else None


def pose_and_shape(points: FloatArray) -> tuple[HeadPose, FloatArray]:
    """Return pose and shape of a head with given points, so that R M_k + t are the points.

    The rotation aligns an average face with the points (weighted least squares); the origin is the mean of
    the eye corners.

    Args:
        points: (K, 3) in the reference camera's axes, mm.

    Returns:
        The pose, and the shape (K, 3) in the head's frame, mm.
    """
    rotation, _ = rigid_alignment(FEATURES, points, FEATURE_SD**-2)
    origin = points[EYES].mean(axis=0)
    return HeadPose(origin, quaternions_from_matrices(rotation)), (points - origin) @ rotation
