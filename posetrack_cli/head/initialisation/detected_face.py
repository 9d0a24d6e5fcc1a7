"""The face that was detected in one frame of one camera, and whether it is symmetric (thesis, 4.4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import undistorted_pixels
from posetrack_cli.head.config import MonoInitialisationSettings
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.detection.points import FacePoints
from posetrack_cli.head.face.points import FEATURE_SD, FEATURES, MIRRORED, POINT_COUNT
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.initialisation.single_view import NEAREST_MM, pose_of

EYE_DISTANCE_MM = 63.0
SAME_FACE = 1.0
"""A face that moved farther from one frame to the next, in eye distances, is another one."""
MEAN_FACE_WEIGHTS = (FEATURE_SD.min() / FEATURE_SD) ** 2
"""(K,) how well an average face's points tell where a face is: eyes best."""


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


def detect_face(
    image: ImageArray,
    stamp_ns: int,
    camera: Camera,
    detector: FaceDetector,
    settings: MonoInitialisationSettings,
    choice: int = 0,
    near: FloatArray | None = None,
) -> DetectedFace | InitFailure:
    """Return a face of an image with its points, or why there is none.

    Args:
        image: (height, width) uint8.
        stamp_ns: of the frame.
        camera: that took it.
        detector: of faces.
        settings: which detections count.
        choice: which face, 0 the largest in the image, 1 the next.
        near: (K, 2) pixels of the face in an earlier frame. The face there is taken, whatever the choice: a
            second person who comes nearer meanwhile does not take over.
    """
    detection = detector.detect(image)
    faces = sorted(detection.faces, key=lambda face: -face.pixels_per_mm)
    face = _chosen(faces, choice) if near is None else _same(faces, near)
    if isinstance(face, str):
        return InitFailure(face, detection.best_score)
    deviation = np.rad2deg(slope_deviation(face.pixels, camera))
    if deviation > settings.slope_deg:
        return InitFailure(f"left and right points at slopes that differ by {deviation:.0f} deg", face.score)
    return _detected(stamp_ns, face.pixels, face.responses, camera)


def clicked_face(pixels: FloatArray, stamp_ns: int, camera: Camera) -> DetectedFace:
    """Return the face whose ten points (K, 2) a person clicked; nobody asks whether they are symmetric."""
    return _detected(stamp_ns, pixels, np.ones(POINT_COUNT), camera)


def eye_distance_px(pose: HeadPose, camera: Camera) -> float:
    """Return how many pixels an average face's eyes are apart, as if it looked at the camera."""
    depth = max(float(pose.position[2]), NEAREST_MM)
    return float(EYE_DISTANCE_MM * np.sqrt(camera.fx * camera.fy) / depth)


def _chosen(faces: Sequence[FacePoints], choice: int) -> FacePoints | str:
    if choice < len(faces):
        return faces[choice]
    return f"{len(faces)} face{'s' * (len(faces) > 1)}, not {choice + 1}" if faces else NO_FACE


def _same(faces: Sequence[FacePoints], near: FloatArray) -> FacePoints | str:
    if not faces:
        return NO_FACE
    middle = near.mean(axis=0)
    ways = [np.hypot(*(face.pixels.mean(axis=0) - middle)) / _eye_distance(face) for face in faces]
    nearest = int(np.argmin(ways))
    return faces[nearest] if ways[nearest] <= SAME_FACE else "only faces elsewhere than before"


def _eye_distance(face: FacePoints) -> float:
    return EYE_DISTANCE_MM * face.pixels_per_mm


def _detected(stamp_ns: int, pixels: FloatArray, responses: FloatArray, camera: Camera) -> DetectedFace:
    pose, rms_px = pose_of(pixels, MEAN_FACE_WEIGHTS, camera, FEATURES)
    distance = eye_distance_px(pose, camera)
    return DetectedFace(
        stamp_ns, pixels, responses, float(responses.mean()), distance, pose, rms_px / distance
    )


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
