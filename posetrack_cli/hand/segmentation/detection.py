"""Hands in a whole depth image, without any prediction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import DetectionSettings
from posetrack_cli.hand.observation import PixelSampler
from posetrack_cli.hand.segmentation.arm import BIN_MM, slice_areas
from posetrack_cli.hand.segmentation.palms import Surfaces, palm_pixels, surfaces_of
from posetrack_cli.hand.segmentation.region import Exit, Region, region_around
from posetrack_cli.rendering.window import Window

_FINGER_MM = 30.0
"""What is narrower where it leads out of a hand's reach is a finger, not the arm."""


@dataclass(frozen=True, eq=False)
class Detection:
    """A surface that may be a hand.

    Attributes:
        window: the pixels that the mask is of: the whole image in steps.
        mask: (h, w) the hand's pixels, without the forearm.
        palm: (3,) middle of the palm on the surface that is seen, camera axes, mm.
        palm_radius_mm: of the largest disc around it.
        wrist: (3,) where the forearm begins, mm; None where no forearm is seen.
        arm: (3,) unit vector from the elbow to the wrist, camera axes; None where no forearm is seen.
        extent_mm: how far the hand reaches from the palm.
        score: 0 to 1: how much it is like a hand at the end of an arm.
    """

    window: Window
    mask: BoolArray
    palm: FloatArray
    palm_radius_mm: float
    wrist: FloatArray | None
    arm: FloatArray | None
    extent_mm: float
    score: float

    @property
    def arm_in_image(self) -> FloatArray | None:
        """(2,) unit vector from the elbow to the wrist in the image, x right and y down; None without one.

        None also for an arm that points at the camera.
        """
        if self.arm is None:
            return None
        length = float(np.hypot(self.arm[0], self.arm[1]))
        return self.arm[:2] / length if length > _FORESHORTENED else None


_FORESHORTENED = 0.2


def detect(
    depth: ImageArray, camera: Camera, settings: DetectionSettings, sampler: PixelSampler | None = None
) -> list[Detection]:
    """Find hands, the nearest first.

    A hand is the end of an arm: a surface as wide as a palm, within whose reach it goes on at one place at
    most, which is as wide as an arm (after the extremities of Plagemann et al. 2010, told by width instead of
    geodesic distance) **[ours]**. No direction is preferred and no body expected.

    Args:
        depth: (height, width) mm, 0 = no reading.
        camera: its camera; lens distortion is taken out.
        settings: sizes and depths.
        sampler: of the camera, kept by callers that look at many images.
    """
    window = coarse_window(depth, camera, settings)
    tile = (sampler or PixelSampler(camera)).sample(depth, window)
    tile[tile > settings.farthest_mm + settings.reach_mm] = 0.0
    surfaces = surfaces_of(tile, window, camera, settings.steepest)
    found = [_best_of(surfaces, int(row), int(column), settings) for row, column in palm_pixels(surfaces, settings)]
    likely = sorted((d for d in found if d.score >= settings.least_score), key=lambda d: -d.score)
    kept: list[Detection] = []
    for detection in likely:
        if all(_apart(detection, other, settings) for other in kept):
            kept.append(detection)
    return sorted(kept[: settings.most_hands], key=lambda d: float(d.palm[2]))


def coarse_window(depth: ImageArray, camera: Camera, settings: DetectionSettings) -> Window:
    """The whole image in whole steps of pixels, some 3.5 mm on what is nearest in it, or fewer pixels."""
    few = depth[::_SPARSE, ::_SPARSE]
    in_range = few[(few >= settings.nearest_mm) & (few <= settings.farthest_mm)]
    near = float(np.percentile(in_range, _NEAREST_PERCENT)) if in_range.size else settings.farthest_mm
    least = -(-min(camera.width, camera.height) // _MOST_ACROSS)
    step = max(least, round(_APART_MM * np.sqrt(camera.fx * camera.fy) / near))
    return Window(0, 0, step, -(-camera.width // step), -(-camera.height // step))


def _best_of(surfaces: Surfaces, row: int, column: int, settings: DetectionSettings) -> Detection:
    """The hand at a place, or a little farther out on the same limb, whichever is more like one."""
    here = _detection(surfaces, row, column, settings)
    if here.detection.score == 0.0:
        return here.detection
    outwards = _farther_out(surfaces, here)
    if outwards is None:
        return here.detection
    there = _detection(surfaces, *outwards, settings)
    return max(here.detection, there.detection, key=lambda d: d.score)


@dataclass(frozen=True, eq=False)
class _Candidate:
    region: Region
    detection: Detection


def _detection(surfaces: Surfaces, row: int, column: int, settings: DetectionSettings) -> _Candidate:
    region = region_around(surfaces, row, column, settings.reach_mm)
    arm = _arm_exit(region)
    score = _score(region, settings)
    if arm is None or score == 0.0:
        mask, wrist, direction = region.mask, None, None
    else:
        direction = (region.palm - arm.middle) / np.linalg.norm(region.palm - arm.middle)
        mask, wrist = _without_arm(region, surfaces, direction)
    whole = np.zeros(surfaces.depth.shape, dtype=np.bool_)
    whole[region.rows, region.columns] = mask
    extent = _extent(region, mask)
    detection = Detection(
        surfaces.window, whole, region.palm, region.radius_mm, wrist, direction, extent, score
    )
    return _Candidate(region, detection)


def _arm_exit(region: Region) -> Exit | None:
    """The widest way out, if it is no finger."""
    widest = max(region.exits, key=lambda e: e.width_mm, default=None)
    return widest if widest is not None and widest.width_mm >= _FINGER_MM else None


def _score(region: Region, settings: DetectionSettings) -> float:
    """0 to 1: as wide and as large as a hand, with one arm; less without one, nothing with a body's width."""
    low, high = settings.palm_radius_mm
    wide = _plateau(region.radius_mm, 0.8 * low, 1.3 * low, 0.8 * high, 1.1 * high)
    large = _plateau(region.area_mm2, *_AREAS_MM2)
    widths = [e.width_mm for e in region.exits]
    arms = [w for w in widths if w >= _FINGER_MM]
    if not arms:
        limb = _NO_ARM
    elif len(arms) > 1:
        limb = _MORE_ARMS ** (len(arms) - 1)
    else:
        limb = _plateau(arms[0], 0.0, _FINGER_MM, settings.arm_mm, 1.5 * settings.arm_mm)
    fingers = _LONG_FINGER ** (len(widths) - len(arms))
    before = _plateau(region.behind, -1.0, 0.0, 0.3, 0.8)
    return wide * large * limb * fingers * before * (0.9 + 0.1 * min(1.0, region.radius_mm / high))


_APART_MM, _NEAREST_PERCENT, _SPARSE = 3.5, 10.0, 4
_MOST_ACROSS = 240
_AREAS_MM2 = (800.0, 2500.0, 28000.0, 45000.0)
_NO_ARM, _MORE_ARMS, _LONG_FINGER = 0.6, 0.15, 0.8


def _plateau(value: float, low: float, first: float, last: float, high: float) -> float:
    """1 from ``first`` to ``last``, falling linearly to 0 at ``low`` and ``high``."""
    return float(np.interp(value, [low, first, last, high], [0.0, 1.0, 1.0, 0.0]))


def _farther_out(surfaces: Surfaces, candidate: _Candidate) -> tuple[int, int] | None:
    """Where the palm is if a region reaches farther from the arm than a hand does from its palm."""
    region, arm = candidate.region, candidate.detection.arm
    if arm is None:
        return None
    outwards = (region.points - region.palm) @ arm
    beyond = np.where(region.mask, outwards, -np.inf)
    end = float(np.percentile(outwards[region.mask], 99.0))
    if end <= _LONGEST_FROM_PALM_MM:
        return None
    there = region.mask & (beyond > end - _LONGEST_FROM_PALM_MM) & (beyond < end - _SHORTEST_FROM_PALM_MM)
    radius = np.where(there, surfaces.radius[region.rows, region.columns], 0.0)
    if not radius.any():
        return None
    row, column = np.unravel_index(int(np.argmax(radius)), radius.shape)
    return region.rows.start + int(row), region.columns.start + int(column)


_SHORTEST_FROM_PALM_MM, _LONGEST_FROM_PALM_MM = 60.0, 130.0


def _without_arm(
    region: Region, surfaces: Surfaces, direction: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Cut the forearm off at the wrist: the narrowest place about where a palm ends.

    Returns:
        The rest of the region's mask, and the wrist (3,), mm.
    """
    towards_elbow = ((region.points - region.palm) @ -direction).astype(np.float64)
    areas = surfaces.pixel_mm[region.rows, region.columns][region.mask] ** 2
    first, last = _WRIST_FROM_PALM_MM
    widths = slice_areas(towards_elbow[region.mask], areas, first, round((last - first) / BIN_MM))
    middles = first + BIN_MM * (np.arange(len(widths)) + 0.5)
    cost = widths + _OFF_USUAL * (middles - _USUAL_WRIST_MM) ** 2
    wrist = float(middles[int(np.argmin(cost))])
    return region.mask & (towards_elbow < wrist), region.palm - wrist * direction


_WRIST_FROM_PALM_MM, _USUAL_WRIST_MM, _OFF_USUAL = (20.0, 100.0), 52.0, 0.01


def _extent(region: Region, mask: BoolArray) -> float:
    offset = region.points[mask] - region.palm
    return float(np.sqrt(np.max(np.einsum("ij,ij->i", offset, offset), initial=0.0)))


def _apart(first: Detection, second: Detection, settings: DetectionSettings) -> bool:
    """Whether two detections are of two hands."""
    far = float(np.linalg.norm(first.palm - second.palm)) > settings.apart_mm
    shared = np.count_nonzero(first.mask & second.mask)
    least = min(np.count_nonzero(first.mask), np.count_nonzero(second.mask))
    return far and shared < 0.2 * least
