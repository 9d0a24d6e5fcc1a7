"""Hand detection in a whole depth image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import DetectionSettings
from posetrack_cli.hand.observe.arm import BIN_MM, extents, slice_areas
from posetrack_cli.hand.observe.observation import PixelSampler
from posetrack_cli.hand.observe.region import (
    Region,
    Surfaces,
    arm_exit,
    likeness,
    palm_pixels,
    region_around,
    surfaces_of,
    thin_mask,
)
from posetrack_cli.rendering.port import Window

_APART_MM, _MAX_ACROSS = 3.5, 240
"""Smallest distance of pixels on the nearest surface, and largest number of pixels along the shorter side."""
_NEAREST_PERCENT, _SPARSE = 10.0, 4
_MAX_SHARED = 0.2
_REACH_MM = 170.0
"""Distance from the palm beyond which a hand does not reach; only the arm continues."""
_TWO_PALMS_MM = 110.0
_MAX_HANDS, _MIN_SCORE = 4, 0.4
"""Largest number of detections, and smallest score."""
_AS_LIKELY = 0.85
_STEPS_OUTWARDS = 3
_SURE, _SAME_PALM_MM = 0.9, 60.0
_REACH_OF_RADIUS = 3.4
"""Reach of a large hand, in palm radii."""
_SHORTEST_FROM_PALM_MM, _LONGEST_FROM_PALM_MM = 60.0, 130.0
"""Distance from the palm's centre to the end of a fist, and of an extended hand."""
_WRIST_FROM_PALM_MM, _USUAL_WRIST_MM = (20.0, 100.0), 52.0
_OFF_USUAL = 0.01
"""Penalty on the squared deviation from the usual wrist position, mm of arm width per mm^2."""


@dataclass(frozen=True, eq=False)
class Detection:
    """A surface that may be a hand.

    Attributes:
        window: pixels of the mask: the whole image at a coarse step.
        mask: (h, w) the hand's pixels, without the forearm.
        palm: (3,) centre of the palm on the visible surface, camera axes, mm.
        palm_radius_mm: of the largest disc around it.
        wrist: (3,) start of the forearm on the visible surface, mm; None if not visible.
        arm: (3,) unit vector from the elbow to the wrist, camera axes; None if no forearm is visible.
        extent_mm: reach of the hand from the palm.
        score: 0 to 1, similarity to a hand at the end of an arm.
        fingers_mm2: area of the mask that is as thin as fingers; for an elbow only its rim.
    """

    window: Window
    mask: BoolArray
    palm: FloatArray
    palm_radius_mm: float
    wrist: FloatArray | None
    arm: FloatArray | None
    extent_mm: float
    score: float
    fingers_mm2: float

    def enlarged(self, factor: float) -> Detection:
        """Return the detection with all lengths scaled; finger areas still refer to a hand of usual size."""
        return replace(
            self,
            palm=factor * self.palm,
            palm_radius_mm=factor * self.palm_radius_mm,
            wrist=None if self.wrist is None else factor * self.wrist,
            extent_mm=factor * self.extent_mm,
        )


def detect(
    depth: ImageArray, camera: Camera, settings: DetectionSettings, sampler: PixelSampler | None = None
) -> list[Detection]:
    """Detect hands, the nearest first.

    A hand is the end of an arm: a surface as wide as a palm which continues beyond its reach in at most one
    place, as wide as an arm (after the extremities of Plagemann et al. 2010, with width instead of geodesic
    distance) **[ours]**. Neither a direction nor a visible body is assumed.

    Args:
        depth: (height, width) mm, 0 = no reading, negative: of a hand that is already known.
        camera: its camera; lens distortion is removed.
        settings: the depth range.
        sampler: of the camera, for callers with many images.
    """
    window = coarse_window(depth, camera, settings)
    tile = (sampler or PixelSampler(camera)).sample(depth, window)
    tile[(tile > settings.farthest_mm + _REACH_MM) | (tile < 0.0)] = 0.0
    surfaces = surfaces_of(tile, window, camera)
    found: list[_Candidate] = []
    known: dict[tuple[int, int], _Candidate] = {}  # several places of an arm have one outer end
    for row, column in palm_pixels(surfaces, settings).tolist():
        if not any(_is_on_palm(surfaces, (row, column), candidate) for candidate in found):
            found.append(_move_outwards(surfaces, (row, column), known))
    likely = [candidate for candidate in found if candidate.score >= _MIN_SCORE]
    kept: list[Detection] = []
    for candidate in sorted(likely, key=_rank, reverse=True):
        palm = candidate.region.palm
        if any(np.linalg.norm(palm - other.palm) <= _TWO_PALMS_MM for other in kept):
            continue
        detection = _detection(surfaces, candidate)
        if all(_are_distinct(detection, other) for other in kept):
            kept.append(detection)
        if len(kept) == _MAX_HANDS:
            break
    return sorted(kept, key=lambda d: float(d.palm[2]))


def coarse_window(depth: ImageArray, camera: Camera, settings: DetectionSettings) -> Window:
    """Return the whole image at a step that suits a hand at the depth of the nearest surfaces."""
    few = depth[::_SPARSE, ::_SPARSE]
    in_range = few[(few >= settings.nearest_mm) & (few <= settings.farthest_mm)]
    near = float(np.percentile(in_range, _NEAREST_PERCENT)) if in_range.size else settings.farthest_mm
    least = -(-min(camera.width, camera.height) // _MAX_ACROSS)
    step = max(least, round(_APART_MM * float(np.sqrt(camera.fx * camera.fy)) / near))
    return Window(0, 0, step, -(-camera.width // step), -(-camera.height // step))


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A possible palm and its score."""

    region: Region
    score: float
    arm: FloatArray | None  # from elbow to wrist


def _is_on_palm(surfaces: Surfaces, place: tuple[int, int], candidate: _Candidate) -> bool:
    """Return whether a place is on the palm of a certain candidate."""
    if candidate.score < _SURE:
        return False
    return float(np.linalg.norm(surfaces.points[*place] - candidate.region.palm)) < _SAME_PALM_MM


def _rank(candidate: _Candidate) -> float:
    """Return the sort key for places on one limb: score, width, and closeness to the camera."""
    region = candidate.region
    return candidate.score * region.radius_mm / max(float(region.palm[2]), 1.0)


def _move_outwards(
    surfaces: Surfaces, place: tuple[int, int], known: dict[tuple[int, int], _Candidate]
) -> _Candidate:
    """Return the candidate at a place, or one farther out on the limb of about the same score."""

    def at(place: tuple[int, int]) -> _Candidate:
        if place not in known:
            known[place] = _candidate(surfaces, *place)
        return known[place]

    here = at(place)
    for _ in range(_STEPS_OUTWARDS):
        outwards = None if here.score == 0.0 else _farther_out(surfaces, here)
        if outwards is None:
            break
        outer = at(outwards)
        if outer.score < _AS_LIKELY * here.score:
            break
        here = outer
    return here


def _candidate(surfaces: Surfaces, row: int, column: int) -> _Candidate:
    reach = max(_REACH_MM, _REACH_OF_RADIUS * float(surfaces.radius[row, column]))
    region = region_around(surfaces, row, column, reach)
    leaving = arm_exit(region)
    if leaving is None:
        return _Candidate(region, likeness(region), None)
    arm = region.palm - leaving.middle
    return _Candidate(region, likeness(region), arm / max(float(np.linalg.norm(arm)), 1e-9))


def _farther_out(surfaces: Surfaces, candidate: _Candidate) -> tuple[int, int] | None:
    """Return the palm's place if the region extends farther from the arm than a hand from its palm."""
    region, arm = candidate.region, candidate.arm
    if arm is None:
        return None
    rows, columns = np.nonzero(region.mask)
    outwards = (region.points[rows, columns] - region.palm) @ arm
    end = float(np.percentile(outwards, 99.0))
    if end <= _LONGEST_FROM_PALM_MM:
        return None
    from_end = end - outwards
    band = (from_end > _SHORTEST_FROM_PALM_MM) & (from_end < _LONGEST_FROM_PALM_MM)
    rows, columns = rows[band] + region.rows.start, columns[band] + region.columns.start
    radius = surfaces.radius[rows, columns]
    if not radius.any():
        return None
    widest = int(np.argmax(radius))
    return int(rows[widest]), int(columns[widest])


def _detection(surfaces: Surfaces, candidate: _Candidate) -> Detection:
    region = candidate.region
    hand, wrist = region.mask, None
    if candidate.arm is not None:
        hand, wrist = _without_arm(region, surfaces, candidate.arm)
    mask = np.zeros(surfaces.depth.shape, dtype=np.bool_)
    mask[region.rows, region.columns] = hand
    extent = float(np.linalg.norm(region.points[hand] - region.palm, axis=1).max(initial=0.0))
    apart = float(np.median(surfaces.pixel_mm[region.rows, region.columns][hand])) if hand.any() else 1.0
    return Detection(
        surfaces.window,
        mask,
        region.palm,
        region.radius_mm,
        wrist,
        candidate.arm,
        extent,
        candidate.score,
        float(np.count_nonzero(thin_mask(hand, apart))) * apart**2,
    )


def _without_arm(region: Region, surfaces: Surfaces, arm: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Cut the forearm at the wrist: the narrowest place near the usual wrist position.

    Returns:
        The rest of the region's mask, and the wrist (3,), mm.
    """
    along = (region.palm - region.points) @ arm
    apart = surfaces.pixel_mm[region.rows, region.columns][region.mask].astype(np.float64)
    first, last = _WRIST_FROM_PALM_MM
    count = round((last - first) / BIN_MM)
    widths = slice_areas(along[region.mask], apart**2, extents(apart, arm), first, count)
    middles = first + BIN_MM * (np.arange(len(widths)) + 0.5)
    wrist = float(middles[int(np.argmin(widths + _OFF_USUAL * (middles - _USUAL_WRIST_MM) ** 2))])
    return region.mask & (along < wrist), region.palm - wrist * arm


def _are_distinct(first: Detection, second: Detection) -> bool:
    """Return whether two detections whose palms are far apart are different hands."""
    shared = int(np.count_nonzero(first.mask & second.mask))
    return shared < _MAX_SHARED * min(int(np.count_nonzero(d.mask)) for d in (first, second))
