"""The forearm behind a hand: which way it goes, and where the hand ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import SegmentationSettings
from posetrack_cli.hand.segmentation.prediction import PredictedHand
from posetrack_cli.hand.segmentation.silhouette import Silhouette
from posetrack_cli.hand.segmentation.surfaces import pixel_mm, points_of
from posetrack_cli.rendering.window import Window

BIN_MM = 4.0
"""Length of the slices of an arm."""
_ARM_MM = (20.0, 120.0)
"""The part of the forearm, from the wrist, that tells its direction."""
_HALF_WIDTH_MM, _OPENING = 55.0, 0.5
"""Looked at in a cone: so far from its axis at the wrist, and so much farther per length."""
_WIDEST_MM = 125.0
_LEAST_ARM_MM2 = 900.0
_SKIN_MM = 25.0
"""The forearm's skin lies so far before its axis."""
_PASSES = 2
_MOST_BENT = np.cos(np.deg2rad(75.0))
_FINGERS_MM, _BEYOND_MM = 240.0, 80.0
"""Slices reach so far to the fingers and to the elbow from the wrist, mm, of a hand of scale 1."""
_SHIFT_MM = 40.0
"""So far along the arm a wrist may lie from where it is predicted."""


@dataclass(frozen=True, eq=False)
class Arm:
    """A forearm.

    Attributes:
        wrist: (3,) where it begins, mm.
        cut: (3,) unit normal, towards the elbow, of the plane that parts hand and forearm there: midway
            between palm and forearm, as the wrist's crease is.
        direction: (3,) unit vector from the elbow to the wrist; None where no forearm is seen.
    """

    wrist: FloatArray
    cut: FloatArray
    direction: FloatArray | None


def arm_of(
    points: Float32Array,
    areas: Float32Array,
    limb: BoolArray,
    beside: BoolArray,
    silhouette: Silhouette,
    window: Window,
    camera: Camera,
    predicted: PredictedHand,
    settings: SegmentationSettings,
) -> Arm:
    """Find the forearm of a hand.

    Its direction is that of the surface which goes on from the hand beyond the wrist. Along it, widths of the
    observed limb and of the predicted hand are compared for every shift t of the wrist:

        E(t) = sum over slices s < t of |w_observed(s) - w_predicted(s - t)| ds + (t / wrist_sd)^2 A / 2

    A is an area that is worth one standard deviation. The smallest E is the wrist: fingertips, palm and the
    narrowing behind it all say where the hand is, the forearm, which is not compared, says nothing.

    Args:
        points: (h, w, 3) of the window, mm.
        areas: (h, w) that each pixel covers, mm^2.
        limb: (h, w) the surfaces of the hand, and whatever they go on to.
        beside: (h, w) the pixels beside the prediction.
        silhouette: the predicted hand.
        window: whose pixels.
        camera: its camera.
        predicted: the hand as expected.
        settings: ``wrist_sd_mm``.
    """
    offset = points[limb] - predicted.wrist
    area = areas[limb].astype(np.float64)
    towards_elbow = _direction(offset, area, predicted)
    if towards_elbow is None:
        return Arm(predicted.wrist, predicted.towards_elbow, None)
    cut = predicted.towards_elbow + towards_elbow
    cut /= np.linalg.norm(cut)
    end = settings.forearm_mm * predicted.scale
    along = offset @ cut
    counted = beside[limb] | (along > 0.0)
    observed = _widths(along[counted], area[counted], predicted.scale)
    drawn = points_of(np.where(silhouette.mask, silhouette.depth, 0.0), window, camera)[silhouette.mask]
    expected = _widths(
        (drawn - predicted.wrist) @ cut,
        pixel_mm(silhouette.depth[silhouette.mask], window, camera) ** 2,
        predicted.scale,
    )
    shift = _best_shift(observed, expected, end, settings.wrist_sd_mm * predicted.scale, predicted.scale)
    return Arm(predicted.wrist + shift * cut, cut, -towards_elbow)


def _direction(offset: FloatArray, area: FloatArray, predicted: PredictedHand) -> FloatArray | None:
    """Unit vector (3,) from wrist to elbow: to the middle of what the limb is beyond the wrist.

    None where there is no limb beyond it, or one that is no arm but a body.
    """
    first, last = (predicted.scale * mm for mm in _ARM_MM)
    palm = direction = predicted.towards_elbow
    to_skin = np.array([0.0, 0.0, predicted.scale * _SKIN_MM])
    for _ in range(_PASSES):
        along = offset @ direction
        aside = offset - along[:, None] * direction
        most = predicted.scale * _HALF_WIDTH_MM + _OPENING * np.maximum(along, 0.0)
        chosen = (along > first) & (along < last) & (np.einsum("ij,ij->i", aside, aside) < most**2)
        total = float(area[chosen].sum())
        if total < _LEAST_ARM_MM2 * predicted.scale**2:
            return None
        if total > predicted.scale * _WIDEST_MM * float(np.ptp(along[chosen])):
            return None
        middle = (area[chosen] / total) @ offset[chosen] + to_skin
        direction = _towards(middle / max(float(np.linalg.norm(middle)), 1e-9), palm)
    return direction


def _towards(direction: FloatArray, palm: FloatArray) -> FloatArray:
    """A direction, turned back towards the palm's where a wrist could not bend so far."""
    cosine = float(direction @ palm)
    if cosine >= _MOST_BENT:
        return direction
    aside = direction - cosine * palm
    length = float(np.linalg.norm(aside))
    if length < 1e-9:
        return palm
    turned: FloatArray = _MOST_BENT * palm + np.sqrt(1.0 - _MOST_BENT**2) * aside / length
    return turned


def slice_areas(along: FloatArray, areas: FloatArray, first_mm: float, count: int) -> FloatArray:
    """Area per length (count,), mm, that is the width seen, of slices across an arm.

    Args:
        along: (P,) where pixels lie along the arm, mm.
        areas: (P,) what each covers, mm^2.
        first_mm: where the first slice begins; each is ``BIN_MM`` long.
        count: how many slices.
    """
    number = np.floor((along - first_mm) / BIN_MM).astype(np.int64)
    valid = (number >= 0) & (number < count)
    return np.bincount(number[valid], weights=areas[valid], minlength=count) / BIN_MM


def _widths(along: FloatArray, areas: FloatArray, scale: float) -> FloatArray:
    count = round(scale * (_FINGERS_MM + _BEYOND_MM) / BIN_MM)
    return slice_areas(along, areas, -round(scale * _FINGERS_MM / BIN_MM) * BIN_MM, count)


def _best_shift(observed: FloatArray, expected: FloatArray, end: float, sd: float, scale: float) -> float:
    """The shift t, mm, of smallest E(t); between slices by a parabola through the smallest three."""
    wrist = round(scale * _FINGERS_MM / BIN_MM)
    last = wrist + round(end / BIN_MM)  # the hand's slices are those before this one
    most = round(scale * _SHIFT_MM / BIN_MM)
    shifts = np.arange(-most, most + 1)
    errors = np.empty(len(shifts))
    padded = np.pad(expected[:last], most)
    for k, shift in enumerate(shifts):
        moved = (
            padded[most - shift : most - shift + last + shift]
            if shift <= 0
            else padded[most - shift : most + last]
        )
        errors[k] = BIN_MM * np.abs(observed[: last + shift] - moved[: last + shift]).sum()
    errors += 0.5 * _AREA_PER_SD_MM2 * scale**2 * (BIN_MM * shifts / sd) ** 2
    return BIN_MM * float(shifts[0] + _vertex(errors))


_AREA_PER_SD_MM2 = 1000.0


def _vertex(errors: FloatArray) -> float:
    """Index of the smallest error, refined by the parabola through it and its neighbours."""
    k = int(np.argmin(errors))
    if k in (0, len(errors) - 1):
        return float(k)
    before, here, after = errors[k - 1 : k + 2]
    curvature = before - 2.0 * here + after
    return k + (0.5 * (before - after) / curvature if curvature > 0 else 0.0)
