"""The points of one camera's image found in another's, along epipolar lines (thesis, 3.2.1).

A point's pixel and a depth give a place in space, and so a pixel in the other image; the image around the
first, warped as a plane at that depth would be seen, is correlated with the other image there. First one
depth is looked for that all points share, up to the relief of an average face; then each point's own near it
**[ours]**.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import in_camera_axes
from posetrack_cli.head.detection.points import find_peak
from posetrack_cli.head.face.rig_images import CameraImage

# The face's depth follows from its size in the image, for heads of these sizes.
NEAREST, FARTHEST = 0.65, 1.5
# Steps along the epipolar line, pixels.
STEP_PX = 0.5
MOST_STEPS = 600
# A point's own depth is looked for so far before and behind the shared one; nearer is likelier.
OWN_DEPTH_MM = 55.0
OWN_DEPTH_SD_MM = 30.0
# Faces differ so much in relief: the shared depth may differ by this from point to point.
RELIEF_MM = 8.0
# Half the side of what is compared, mm on the face, and its limits in pixels.
HALF_SIDE_MM = 6.0
HALF_SIDES_PX = (6, 24)
# A calibration is right to about a pixel: so far from the epipolar line the peak may lie.
OFF_LINE_SD_PX = 0.8
# On the way back a point is looked for so far around, in half sides.
RETURN_REACH = 1.0


@dataclass(frozen=True, eq=False)
class Matches:
    """Points of one image in another.

    Attributes:
        pixels: (K, 2).
        correlations: (K,) of each point's surroundings in both images.
        returns_px: (K,) how far from where it began each point comes out on the way back, pixels.
    """

    pixels: FloatArray
    correlations: FloatArray
    returns_px: FloatArray


def match_points(
    first: CameraImage, second: CameraImage, pixels: FloatArray, relief: FloatArray, pixels_per_mm: float
) -> Matches:
    """Find points of the first view's image in the second's.

    Args:
        first, second: two calibrated views.
        pixels: (K, 2) in the first image.
        relief: (K,) mm, how much farther than the head's origin each point of an average face is.
        pixels_per_mm: scale of the face in the first image.
    """
    about = np.sqrt(first.camera.fx * first.camera.fy) / pixels_per_mm
    depths = _depths(first, second, pixels.mean(axis=0), (NEAREST * about, FARTHEST * about))
    half = int(np.clip(round(HALF_SIDE_MM * pixels_per_mm), *HALF_SIDES_PX))
    traces = [
        _trace(first, second, pixel, depths + own, half) for pixel, own in zip(pixels, relief, strict=True)
    ]
    shared = depths[int(np.argmax(_shared_scores(depths, traces)))]
    found = [_own_match(trace, depths, shared) for trace in traces]
    places = np.array([place for place, _ in found])
    returned = [
        _returned(second, first, place, pixel, shared + own, half)
        for place, pixel, own in zip(places, pixels, relief, strict=True)
    ]
    return Matches(places, np.array([score for _, score in found]), np.array(returned))


@dataclass(frozen=True, eq=False)
class _Trace:
    """Correlations of one point over a piece of the second image, and where each depth is in it.

    Attributes:
        response: (height, width), 0 where negative or outside.
        corner: (2,) pixel of the second image that the map's first pixel is.
        places: (D, 2) pixels of the map for each depth.
        scores: (D,) the responses there.
    """

    response: Float32Array
    corner: FloatArray
    places: FloatArray
    scores: FloatArray


def _depths(
    first: CameraImage, second: CameraImage, pixel: FloatArray, limits: tuple[float, float]
) -> FloatArray:
    """Return depths whose inverses are evenly spaced, STEP_PX apart in the second image."""
    ends, _ = second.pixels_of(first.points_at(np.stack([pixel, pixel]), np.array(limits)))
    count = int(np.clip(np.hypot(*(ends[1] - ends[0])) / STEP_PX, 20, MOST_STEPS))
    depths: FloatArray = 1.0 / np.linspace(1.0 / limits[0], 1.0 / limits[1], count)
    return depths


def _trace(
    first: CameraImage, second: CameraImage, pixel: FloatArray, depths: FloatArray, half: int
) -> _Trace:
    places, visible = second.pixels_of(first.points_at(np.broadcast_to(pixel, (len(depths), 2)), depths))
    template = _template(first, second, pixel, float(np.median(depths)), half)
    response, corner = _response(second.image, template, places[visible])
    local = places - corner
    scores = np.where(visible, _look_up(response, local), 0.0)
    return _Trace(response, corner, local, scores)


def _template(
    source: CameraImage, target: CameraImage, pixel: FloatArray, depth: float, half: int
) -> ImageArray:
    """Return a pixel's surroundings as the target would see them, were they a plane facing the source."""
    around = pixel + np.array([[0.0, 0.0], [half, 0.0], [0.0, half]])
    seen, _ = target.pixels_of(source.points_at(around, np.full(3, depth)))
    source_from_target = np.linalg.inv((seen[1:] - seen[0]).T / half)
    transform = np.column_stack([source_from_target, pixel - source_from_target @ np.full(2, float(half))])
    size = (2 * half + 1, 2 * half + 1)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(source.image, transform, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def _response(image: ImageArray, template: ImageArray, places: FloatArray) -> tuple[Float32Array, FloatArray]:
    """Correlate a template with the piece of an image that covers places (n, 2) and three pixels around.

    Returns:
        The map, and the pixel of the image that its first pixel is. A map of one zero if the piece is empty.
    """
    half = template.shape[0] // 2
    size = np.array(image.shape[::-1])
    inside = places[np.all((places >= half) & (places < size - half), axis=1)]
    if not len(inside):
        return np.zeros((1, 1), np.float32), np.zeros(2)
    least = np.maximum(np.floor(inside.min(axis=0)).astype(int) - 3, half)
    most = np.minimum(np.ceil(inside.max(axis=0)).astype(int) + 3, size - half - 1)
    part = image[least[1] - half : most[1] + half + 1, least[0] - half : most[0] + half + 1]
    correlation = cv2.matchTemplate(part, template, cv2.TM_CCOEFF_NORMED)
    return np.clip(np.nan_to_num(correlation), 0.0, 1.0), least.astype(float)


def _look_up(response: Float32Array, places: FloatArray) -> FloatArray:
    """Return the map's values (n,) at places (n, 2), bilinear; 0 outside."""
    x, y = (np.ascontiguousarray(column, np.float32)[:, None] for column in places.T)
    values = cv2.remap(response, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    looked_up: FloatArray = values[:, 0].astype(float)
    return looked_up


def _shared_scores(depths: FloatArray, traces: Sequence[_Trace]) -> FloatArray:
    """Return for each depth (D,) the sum over points of the best score within the relief's uncertainty."""
    first = np.searchsorted(depths, depths - RELIEF_MM)
    last = np.searchsorted(depths, depths + RELIEF_MM, side="right")
    total = np.zeros(len(depths))
    for trace in traces:
        total += [trace.scores[i:j].max() for i, j in zip(first, last, strict=True)]
    return total


def _own_match(trace: _Trace, depths: FloatArray, shared: float) -> tuple[FloatArray, float]:
    """Return the pixel (2,) in the second image and the correlation of one point's best depth."""
    off = depths - shared
    prior = np.where(np.abs(off) <= OWN_DEPTH_MM, np.exp(-0.5 * (off / OWN_DEPTH_SD_MM) ** 2), 0.0)
    best = int(np.argmax(trace.scores * prior))
    place, _ = find_peak(trace.response, trace.places[best], (OFF_LINE_SD_PX, OFF_LINE_SD_PX))
    return place + trace.corner, float(_look_up(trace.response, place[None])[0])


def _returned(
    source: CameraImage, target: CameraImage, pixel: FloatArray, began: FloatArray, depth: float, half: int
) -> float:
    """Return how far from where it began a point is found in the target, looked for around there."""
    source_depth = float(in_camera_axes(source.camera, target.points_at(began, np.array(depth)))[2])
    template = _template(source, target, pixel, source_depth, half)
    reach = RETURN_REACH * half
    response, corner = _response(target.image, template, began + np.array([[-reach, -reach], [reach, reach]]))
    row, column = np.unravel_index(int(np.argmax(response)), response.shape)
    return float(np.hypot(*(np.array([column, row]) + corner - began)))
