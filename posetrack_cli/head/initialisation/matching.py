"""Stereo matching of feature points along epipolar lines (thesis, 3.2.1).

A pixel and a depth determine a pixel in the other image. The patch around the first, warped as a plane at
that depth, is correlated with the other image there. A depth common to all points, up to the relief of an
average face, is found first; each point's own depth near it follows **[ours]**.
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

# Depth range for a face of known image size, for heads of these relative sizes.
NEAREST, FARTHEST = 0.65, 1.5
# Steps along the epipolar line, pixels.
STEP_PX = 0.5
MOST_STEPS = 600
# Search range of a point's own depth about the shared one, and the standard deviation of its prior.
OWN_DEPTH_MM = 55.0
OWN_DEPTH_SD_MM = 30.0
# Relief differs between faces: the shared depth may vary by this from point to point.
RELIEF_MM = 8.0
# Half the side of a compared patch, mm on the face, and its limits in pixels.
HALF_SIDE_MM = 6.0
HALF_SIDES_PX = (6, 24)
# Distance of a peak from the epipolar line: calibrations are accurate to about a pixel.
OFF_LINE_SD_PX = 0.8
# Search radius of the backward match, in half sides.
RETURN_REACH = 1.0


@dataclass(frozen=True, eq=False)
class Matches:
    """Points of one image matched in another.

    Attributes:
        pixels: (K, 2).
        correlations: (K,) of each point's patches.
        returns_px: (K,) forward-backward error of each point, pixels.
    """

    pixels: FloatArray
    correlations: FloatArray
    returns_px: FloatArray


def match_points(
    first: CameraImage, second: CameraImage, pixels: FloatArray, relief: FloatArray, pixels_per_mm: float
) -> Matches:
    """Match points of the first view's image in the second's.

    Args:
        first, second: two calibrated views.
        pixels: (K, 2) in the first image.
        relief: (K,) mm, depth of each point of an average face relative to the head's origin.
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
    """Correlations of one point in a region of the second image, and the pixel for each depth.

    Attributes:
        response: (height, width), 0 where negative or outside.
        corner: (2,) pixel of the second image at the map's origin.
        places: (D, 2) pixels of the map for each depth.
        scores: (D,) responses there.
    """

    response: Float32Array
    corner: FloatArray
    places: FloatArray
    scores: FloatArray


def _depths(
    first: CameraImage, second: CameraImage, pixel: FloatArray, limits: tuple[float, float]
) -> FloatArray:
    """Return depths with evenly spaced inverses, STEP_PX apart in the second image."""
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
    """Return the patch around a pixel as seen by the target, assuming a fronto-parallel plane."""
    around = pixel + np.array([[0.0, 0.0], [half, 0.0], [0.0, half]])
    seen, _ = target.pixels_of(source.points_at(around, np.full(3, depth)))
    source_from_target = np.linalg.inv((seen[1:] - seen[0]).T / half)
    transform = np.column_stack([source_from_target, pixel - source_from_target @ np.full(2, float(half))])
    size = (2 * half + 1, 2 * half + 1)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(source.image, transform, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def _response(image: ImageArray, template: ImageArray, places: FloatArray) -> tuple[Float32Array, FloatArray]:
    """Correlate a template with the image region of places (n, 2), with a margin of three pixels.

    Returns:
        The map, and the pixel of the image at its origin; a single 0 for an empty region.
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
    """Return for each depth (D,) the sum over points of the best score within the relief's tolerance."""
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
    """Return the forward-backward error of a point."""
    source_depth = float(in_camera_axes(source.camera, target.points_at(began, np.array(depth)))[2])
    template = _template(source, target, pixel, source_depth, half)
    reach = RETURN_REACH * half
    response, corner = _response(target.image, template, began + np.array([[-reach, -reach], [reach, reach]]))
    row, column = np.unravel_index(int(np.argmax(response)), response.shape)
    return float(np.hypot(*(np.array([column, row]) + corner - began)))
