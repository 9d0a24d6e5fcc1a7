"""The forearm behind a hand: which way it goes, and where the hand ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.hand.config import SegmentationSettings
from posetrack_cli.hand.segmentation.prediction import PredictedHand
from posetrack_cli.hand.segmentation.silhouette import Silhouette
from posetrack_cli.hand.segmentation.slices import BIN_MM, best_shift, extents, slice_areas
from posetrack_cli.hand.segmentation.view import View

# Lengths are of a hand of scale 1.
_ARM_MM = (20.0, 120.0)
"""The part of the forearm, from the wrist, that tells its direction."""
_HALF_WIDTH_MM, _OPENING = 55.0, 0.5
"""It is looked for in a cone: so far from the axis at the wrist, and so much farther per length."""
_WIDEST_MM, _LEAST_MM2 = 125.0, 900.0
"""What is wider is a body; what is less is nothing."""
_SKIN_MM = 25.0
"""The forearm's skin lies so far before its axis."""
_PASSES = 2
_MOST_BENT = float(np.cos(np.deg2rad(75.0)))
_FINGERS_MM, _BEYOND_MM = 240.0, 80.0
"""Slices reach so far to the fingers and to the elbow from the wrist."""
_COMPARED_MM = 8.0
"""The drawn hand ends so far beyond its wrist joint; widths are compared up to there."""
_MOST_SHIFT_MM = 40.0
_AREA_PER_SD_MM2 = 1000.0
"""Area of disagreement that is worth one standard deviation of the wrist's place."""


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
    view: View,
    limb: BoolArray,
    hand: BoolArray,
    silhouette: Silhouette,
    predicted: PredictedHand,
    settings: SegmentationSettings,
) -> Arm:
    """Find the forearm of a hand.

    Its direction is that of the surface that goes on from the hand beyond the wrist. Across it, widths of the
    observed limb and of the predicted hand are compared for every shift of the wrist (``best_shift``):
    fingertips, palm and the narrowing behind it all say where the hand is, and the forearm, which is not
    compared, says nothing.

    Args:
        view: the window.
        limb: (h, w) the surfaces of the hand, and whatever they go on to.
        hand: (h, w) what of them lies beside the prediction.
        silhouette: the predicted hand.
        predicted: the hand as expected.
        settings: ``wrist_sd_mm``.
    """
    offset = view.points[limb].astype(np.float64) - predicted.wrist
    apart = view.apart[limb].astype(np.float64)
    area = apart**2
    towards_elbow = _direction(offset, area, predicted)
    if towards_elbow is None:
        return Arm(predicted.wrist, predicted.towards_elbow, None)
    cut = predicted.towards_elbow + towards_elbow
    cut /= np.linalg.norm(cut)
    along = offset @ cut
    counted = hand[limb] | ((along > 0.0) & _beside_axis(offset, towards_elbow, predicted.scale))
    observed = _widths(along[counted], apart[counted], cut, predicted.scale)
    expected = _expected_widths(view, silhouette, cut, predicted)
    shift = _shift_mm(observed, expected, settings, predicted.scale)
    return Arm(predicted.wrist + shift * cut, cut, -towards_elbow)


def _direction(offset: FloatArray, area: FloatArray, predicted: PredictedHand) -> FloatArray | None:
    """Unit vector (3,) from wrist to elbow: to the middle of what the limb is beyond the wrist.

    None where there is no limb beyond it, or one that is no arm but a body.

    Args:
        offset: (P, 3) the limb's points from the wrist, mm.
        area: (P,) what each covers, mm^2.
        predicted: the hand.
    """
    scale, direction = predicted.scale, predicted.towards_elbow
    to_axis = np.array([0.0, 0.0, scale * _SKIN_MM])
    for _ in range(_PASSES):
        chosen, length = _in_cone(offset, direction, scale)
        total = float(area[chosen].sum())
        if not scale**2 * _LEAST_MM2 <= total <= scale * _WIDEST_MM * length:
            return None
        middle = (area[chosen] / total) @ offset[chosen] + to_axis
        direction = _towards(middle / max(float(np.linalg.norm(middle)), 1e-9), predicted.towards_elbow)
    return direction


def _in_cone(offset: FloatArray, direction: FloatArray, scale: float) -> tuple[BoolArray, float]:
    """Which points (P, 3) may be the forearm's, and over what length they go along it, mm."""
    along = offset @ direction
    first, last = _ARM_MM
    in_length = (along > scale * first) & (along < scale * last)
    chosen = in_length & _beside_axis(offset, direction, scale)
    return chosen, float(np.ptp(along[chosen])) if chosen.any() else 0.0


def _beside_axis(offset: FloatArray, direction: FloatArray, scale: float) -> BoolArray:
    """Which points (P, 3) lie in the cone, and are not the body's that a hand lies before."""
    along = offset @ direction
    squared_aside = np.einsum("ij,ij->i", offset, offset) - along**2
    most = scale * _HALF_WIDTH_MM + _OPENING * np.maximum(along, 0.0)
    within: BoolArray = squared_aside < most**2
    return within


def _towards(direction: FloatArray, palm: FloatArray) -> FloatArray:
    """A direction, turned back towards the palm's where a wrist could not bend so far."""
    cosine = float(direction @ palm)
    aside = direction - cosine * palm
    length = float(np.linalg.norm(aside))
    if cosine >= _MOST_BENT:
        return direction
    if length < 1e-9:
        return palm
    turned: FloatArray = _MOST_BENT * palm + np.sqrt(1.0 - _MOST_BENT**2) * aside / length
    return turned


def _expected_widths(
    view: View, silhouette: Silhouette, cut: FloatArray, predicted: PredictedHand
) -> FloatArray:
    """Widths of the predicted hand, as the window sees it."""
    depth = np.where(silhouette.mask, silhouette.depth, np.float32(0.0))
    drawn = View.of(depth, view.window, view.camera)
    points, apart = (part[silhouette.mask].astype(np.float64) for part in (drawn.points, drawn.apart))
    return _widths((points - predicted.wrist) @ cut, apart, cut, predicted.scale)


def _widths(along: FloatArray, apart: FloatArray, cut: FloatArray, scale: float) -> FloatArray:
    before, beyond = _slices(_FINGERS_MM, scale), _slices(_BEYOND_MM, scale)
    return slice_areas(along, apart**2, extents(apart, cut), -before * BIN_MM, before + beyond)


def _shift_mm(
    observed: FloatArray, expected: FloatArray, settings: SegmentationSettings, scale: float
) -> float:
    last = _slices(_FINGERS_MM, scale) + _slices(_COMPARED_MM, scale)
    most = max(0, min(_slices(_MOST_SHIFT_MM, scale), last, len(observed) - last))
    sd = settings.wrist_sd_mm * scale / BIN_MM
    stiffness = scale**2 * _AREA_PER_SD_MM2 / BIN_MM / sd**2
    return BIN_MM * best_shift(observed, expected, max(last, 0), most, stiffness)


def _slices(mm: float, scale: float) -> int:
    return round(scale * mm / BIN_MM)
