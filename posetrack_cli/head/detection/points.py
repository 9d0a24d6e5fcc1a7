"""Localisation of the ten points of one face in an image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.head.detection.appearance import Appearance
from posetrack_cli.head.detection.finders import NO_EYES, FaceGuess
from posetrack_cli.head.detection.fit import JOINT_POSE_SIZE as JOINT_POSE
from posetrack_cli.head.detection.fit import VISIBLE, fit_face, fit_jointly, projected, visible_shares
from posetrack_cli.head.detection.responses import FacePatch, cut_patch, response_maps
from posetrack_cli.head.face.points import EYES, NOSTRILS, POINT_COUNT

# Search radius, in standard deviations of the prior.
REACH = 2.5
# The prior shifts a peak by a pixel or two; farther uphill is another peak.
STEPS_UPHILL = 2


def find_peak(
    response: Float32Array, expected: FloatArray, sd: tuple[float, float]
) -> tuple[FloatArray, float]:
    """Return the peak of a response selected by a Gaussian prior, and the response there.

    The prior selects a pixel; the response alone is climbed from there, so that the prior causes no bias.

    Args:
        response: (height, width), not negative.
        expected: (2,) pixels, mean of the prior.
        sd: its standard deviations in x and y, pixels.

    Returns:
        (2,) pixels, with subpixel refinement by a parabola, and the response at the nearest pixel; the
            expected
        place and 0 if it lies outside the map.
    """
    columns = _near(expected[0], sd[0], response.shape[1])
    rows = _near(expected[1], sd[1], response.shape[0])
    if not len(columns) or not len(rows):
        return expected.astype(float), 0.0
    prior_x = np.exp(-0.5 * ((columns - expected[0]) / sd[0]) ** 2)
    prior_y = np.exp(-0.5 * ((rows - expected[1]) / sd[1]) ** 2)
    values = response[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] * prior_x * prior_y[:, None]
    row, column = np.unravel_index(int(np.argmax(values)), values.shape)
    x, y = _uphill(response, int(columns[column]), int(rows[row]))
    shift_x = _vertex(response[y, x - 1 : x + 2])
    shift_y = _vertex(response[y - 1 : y + 2, x])
    return np.array([x + shift_x, y + shift_y]), float(response[y, x])


def _uphill(response: Float32Array, x: int, y: int) -> tuple[int, int]:
    """Climb the response by a few pixels."""
    height, width = response.shape
    for _ in range(STEPS_UPHILL):
        row, column = divmod(int(np.argmax(response[y - 1 : y + 2, x - 1 : x + 2])), 3)
        x, y = int(np.clip(x + column - 1, 1, width - 2)), int(np.clip(y + row - 1, 1, height - 2))
    return x, y


def _near(expected: float, sd: float, size: int) -> IntArray:
    first = max(int(np.ceil(expected - REACH * sd)), 1)
    last = min(int(np.floor(expected + REACH * sd)), size - 2)
    near: IntArray = np.arange(first, last + 1)
    return near


def _vertex(three: Float32Array) -> float:
    """Return the maximum, -0.5 to 0.5, of a parabola through three neighbouring values."""
    before, at, after = (float(value) for value in three)
    curvature = before - 2.0 * at + after
    if curvature >= 0.0:
        return 0.0
    return float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5))


# Standard deviations of a point about the fitted mean face, pixels of the patch.
POINT_SD = (3.5, 3.0)
# The same for the nose base, and for the nostrils relative to it.
NOSE_SD = (5.0, 4.0)
NOSTRIL_SD = (2.0, 2.0)
EYE_DISTANCE_MM = 63.0
TURNED_RAD = np.radians(30.0)
"""Yaw from which points may be hidden."""


@dataclass(frozen=True, eq=False)
class FacePoints:
    """The ten points of a face in one image.

    Attributes:
        pixels: (K, 2) in the order of ``face.POINT_NAMES``.
        responses: (K,) 0 to 1, similarity of each place to its point; 0 for a hidden point.
        pixels_per_mm: scale of the face in the image.
        angles: (3,) approximate roll, yaw, pitch, rad: rotations about the camera's z, y and x axis of a head
            that looked at the camera, pitch first.
        guess: detection of the face.
        misfit_px: RMS distance of the points from the nearest likely face, pixels of the patch; 0 without an
            appearance model.
    """

    pixels: FloatArray
    responses: FloatArray
    pixels_per_mm: float
    angles: FloatArray
    guess: FaceGuess
    misfit_px: float = 0.0

    @property
    def score(self) -> float:
        """Mean response of the points that are not hidden, 0 to 1."""
        return mean_response(self.responses)

    @property
    def as_guess(self) -> FaceGuess:
        """The detection, with the place, size and roll of the points."""
        middle, distance = self.pixels[EYES].mean(axis=0), EYE_DISTANCE_MM * self.pixels_per_mm
        return replace(
            self.guess, middle=middle, eye_distance=distance, roll=float(self.angles[0]), eyes=NO_EYES
        )


def mean_response(responses: FloatArray) -> float:
    """Return the mean of the responses above 0; 0 without any."""
    seen = responses > 0.0
    return float(responses[seen].mean()) if seen.any() else 0.0


def find_points(image: ImageArray, guess: FaceGuess, appearance: Appearance | None = None) -> FacePoints:
    """Locate the ten points of a face in a (height, width) uint8 image.

    A mean face is fitted to response maps around the face, which are then made upright and fitted again. From
    there the points are located jointly with the appearance model, or each at the strongest corner nearby,
    which varies slightly between faces but tracks well.

    Args:
        image: grey.
        guess: approximate place of the face.
        appearance: appearance model; without it, the strongest corners are used.
    """
    first = cut_patch(image, guess.middle, guess.eye_distance / EYE_DISTANCE_MM, guess.roll)
    eyes = (first.from_image(guess.eyes[0]), first.from_image(guess.eyes[1]))
    rough = fit_face(response_maps(first.grey), eyes, yaw=guess.yaw)
    yaw = guess.yaw or (float(rough[4]) if abs(rough[4]) > TURNED_RAD else 0.0)
    pixels_per_mm, roll = rough[2] / first.scale, first.roll + rough[3]
    upright = cut_patch(image, first.to_image(rough[:2]), pixels_per_mm, roll)
    maps = response_maps(upright.grey)
    pose = fit_face(maps, NO_EYES, _carried_over(rough, first, upright), yaw)
    expected = projected(pose[None])[0]
    visible = visible_shares(pose[4:5])[0, :POINT_COUNT] if yaw else VISIBLE
    misfit = 0.0
    if appearance is None:
        pixels, responses = _strongest(maps, expected)
    else:
        places = fit_jointly(upright.grey, expected[:POINT_COUNT], pose[:JOINT_POSE], appearance, visible)
        pixels, responses, pose = places.pixels, places.probabilities, places.pose
        misfit = places.misfit_px
    responses = np.where(visible > 0.0, responses, 0.0)
    angles = np.array([upright.roll + pose[3], pose[4], pose[5]])
    scale = float(pose[2] / upright.scale)
    return FacePoints(upright.to_image(pixels), responses, scale, angles, guess, misfit)


def _carried_over(pose: FloatArray, before: FacePatch, after: FacePatch) -> FloatArray:
    """Convert a pose (8,) from one patch to another."""
    middle = after.from_image(before.to_image(pose[:2]))
    scale, roll = pose[2] * after.scale / before.scale, pose[3] + before.roll - after.roll
    return np.array([*middle, scale, roll, *pose[4:]])


def _strongest(maps: Float32Array, expected: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the strongest places (K, 2) near expected ones (K + 1, 2), and their responses (K,)."""
    nose, _ = find_peak(maps[-1], expected[-1], NOSE_SD)
    expected = expected.copy()
    expected[NOSTRILS] += nose - expected[-1]
    spreads = [
        NOSTRIL_SD if k in range(*NOSTRILS.indices(POINT_COUNT)) else POINT_SD for k in range(POINT_COUNT)
    ]
    peaks = [find_peak(one, place, sd) for one, place, sd in zip(maps, expected, spreads, strict=False)]
    return np.array([pixel for pixel, _ in peaks]), np.array([response for _, response in peaks])
