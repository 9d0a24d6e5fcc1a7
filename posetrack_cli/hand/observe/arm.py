"""Forearm direction and wrist position from widths along the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.hand.model.forearm import SEEN_MM
from posetrack_cli.hand.observe.prediction import PredictedHand, Silhouette
from posetrack_cli.hand.observe.surfaces import View

BIN_MM = 4.0
"""Length of a slice."""
_WRIST_SD_MM = 40.0
"""Standard deviation of the predicted wrist along the arm."""
_MAX_FORESHORTENED = 0.33
"""Arms pointing more towards the camera are sliced at this foreshortening."""


def slice_areas(
    along: FloatArray, areas: FloatArray, extent_mm: FloatArray, first_mm: float, count: int
) -> FloatArray:
    """Return area per length (count,), mm, of slices across an arm: its visible width.

    Each pixel's area is spread over its extent. Otherwise slices about as long as the pixel distance would
    contain one or two rows in turn, and width profiles would align with the rows instead of the hands.

    Args:
        along: (P,) positions of pixels along the arm, mm.
        areas: (P,) their areas, mm^2.
        extent_mm: (P,) their extents along the arm (``extents``), > 0.
        first_mm: start of the first slice; each is ``BIN_MM`` long.
        count: number of slices.
    """
    half = 0.5 * extent_mm
    begin, end = (along - half - first_mm) / BIN_MM, (along + half - first_mm) / BIN_MM
    first = np.floor(begin)
    density = areas / (end - begin)
    total = np.zeros(count)
    for k in range(int(np.ceil((end - begin).max(initial=0.0))) + 1):
        number = first + k
        covered = np.minimum(end, number + 1.0) - np.maximum(begin, number)
        valid = (covered > 0.0) & (number >= 0) & (number < count)
        weights = (density * covered)[valid]
        total += np.bincount(number[valid].astype(np.int64), weights=weights, minlength=count)
    return total / BIN_MM


def extents(apart: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the extent of each pixel along an arm, mm (P,).

    Rows or columns are ``apart`` on an arm across the view, farther apart on a foreshortened one, and closer
    together on one diagonal to them.

    Args:
        apart: (P,) distance of neighbouring pixels on a surface facing the camera, mm.
        axis: (3,) unit vector along the arm, camera axes.
    """
    x, y = np.abs(axis[:2])
    length = max(float(np.hypot(x, y)), _MAX_FORESHORTENED)
    across = max(x, y, np.sqrt(0.5) * _MAX_FORESHORTENED)
    return np.asarray(apart * (across / length**2), dtype=np.float64)


def best_shift(observed: FloatArray, expected: FloatArray, last: int, most: int, stiffness: float) -> float:
    """Return the shift t between an observed and an expected width profile, in slices.

        E(t) = sum over slices k < last + t of |observed_k - expected_(k - t)| + stiffness t^2 / 2

    ``expected`` is used up to ``last``; slices beyond ``last + t`` are not compared. The minimum is refined
    by the parabola through the smallest E and its neighbours.

    Args:
        observed, expected: (K,) widths, mm.
        last: end of the hand at its expected position, a slice.
        most: largest shift, in slices; at most K - ``last``.
        stiffness: of the prior around t = 0.
    """
    padded = np.pad(expected[:last], most)
    errors = np.empty(2 * most + 1)
    for k, shift in enumerate(range(-most, most + 1)):
        compared = last + shift
        moved = padded[most - shift : most - shift + compared]
        errors[k] = np.abs(observed[:compared] - moved).sum() + 0.5 * stiffness * shift**2
    return _vertex(errors) - most


def _vertex(errors: FloatArray) -> float:
    """Return the index of the smallest error, refined by the parabola through it and its neighbours."""
    k = int(np.argmin(errors))
    if k in (0, len(errors) - 1):
        return float(k)
    before, here, after = (float(e) for e in errors[k - 1 : k + 2])
    curvature = before - 2.0 * here + after
    return k + (0.5 * (before - after) / curvature if curvature > 0.0 else 0.0)


# Lengths are of a hand of scale 1.
_ARM_MM = (20.0, 120.0)
"""Part of the forearm, from the wrist, that determines its direction."""
_HALF_WIDTH_MM, _OPENING = 55.0, 0.5
"""Cone in which the forearm is searched: half width at the wrist, and its increase per length."""
_WIDEST_MM, _MIN_MM2 = 125.0, 900.0
"""Largest width of an arm, not a body, and smallest area."""
_SKIN_MM = 25.0
"""Depth of the forearm's axis behind its skin."""
_PASSES = 2
_MAX_BENT = float(np.cos(np.deg2rad(75.0)))
_FINGERS_MM, _BEYOND_MM = 240.0, 80.0
"""Extent of the slices from the wrist towards fingers and elbow."""
_COMPARED_MM = 8.0
"""End of the compared widths beyond the wrist joint, where the drawn hand ends."""
_MAX_SHIFT_MM = 40.0
_AREA_PER_SD_MM2 = 1000.0
"""Area of disagreement equivalent to one standard deviation of the wrist."""


@dataclass(frozen=True, eq=False)
class Arm:
    """A forearm.

    Attributes:
        wrist: (3,) its start, mm.
        cut: (3,) unit normal, towards the elbow, of the plane between hand and forearm: halfway between their
            directions, like the crease of the wrist.
        direction: (3,) unit vector from the elbow to the wrist; None if no forearm is visible.
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
) -> Arm:
    """Find the forearm of a hand.

    Its direction is that of the surface beyond the wrist. The wrist is found by comparing widths across it of
    the observed limb and the predicted hand for every shift (``best_shift``). Fingertips, palm and narrowing
    determine the shift; the forearm, which is not compared, does not.

    Args:
        view: the window.
        limb: (h, w) surfaces of the hand and what is connected to them.
        hand: (h, w) the part near the prediction.
        silhouette: the predicted hand.
        predicted: the predicted hand.
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
    counted = hand[limb] | ((along > 0.0) & _near_axis(offset, towards_elbow, predicted.scale))
    observed = _widths(along[counted], apart[counted], cut, predicted.scale)
    expected = _expected_widths(view, silhouette, cut, predicted)
    shift = _shift_mm(observed, expected, predicted.scale)
    return Arm(predicted.wrist + shift * cut, cut, -towards_elbow)


def _direction(offset: FloatArray, area: FloatArray, predicted: PredictedHand) -> FloatArray | None:
    """Return the unit vector (3,) from the wrist to the centre of the limb beyond it.

    None without a limb there, or if it is too wide for an arm.

    Args:
        offset: (P, 3) the limb's points relative to the wrist, mm.
        area: (P,) their areas, mm^2.
        predicted: the hand.
    """
    scale, direction = predicted.scale, predicted.towards_elbow
    to_axis = np.array([0.0, 0.0, scale * _SKIN_MM])
    for _ in range(_PASSES):
        chosen, length = _in_cone(offset, direction, scale)
        total = float(area[chosen].sum())
        if not scale**2 * _MIN_MM2 <= total <= scale * _WIDEST_MM * length:
            return None
        middle = (area[chosen] / total) @ offset[chosen] + to_axis
        direction = _towards(middle / max(float(np.linalg.norm(middle)), 1e-9), predicted.towards_elbow)
    return direction


def _in_cone(offset: FloatArray, direction: FloatArray, scale: float) -> tuple[BoolArray, float]:
    """Return which points (P, 3) may be the forearm's, and their extent along it, mm."""
    along = offset @ direction
    first, last = _ARM_MM
    in_length = (along > scale * first) & (along < scale * last)
    chosen = in_length & _near_axis(offset, direction, scale)
    return chosen, float(np.ptp(along[chosen])) if chosen.any() else 0.0


def is_forearm(offset: FloatArray, towards_elbow: FloatArray, scale: float) -> BoolArray:
    """Return which points (P, 3) of a limb, from the wrist, are near the forearm's axis and the wrist."""
    near_wrist: BoolArray = offset @ towards_elbow < scale * SEEN_MM
    return near_wrist & _near_axis(offset, towards_elbow, scale)


def _near_axis(offset: FloatArray, direction: FloatArray, scale: float) -> BoolArray:
    """Return which points (P, 3) lie in the cone around the arm's axis, not on a body behind the hand."""
    along = offset @ direction
    squared_aside = np.einsum("ij,ij->i", offset, offset) - along**2
    most = scale * _HALF_WIDTH_MM + _OPENING * np.maximum(along, 0.0)
    within: BoolArray = squared_aside < most**2
    return within


def _towards(direction: FloatArray, palm: FloatArray) -> FloatArray:
    """Limit the angle between a direction and the palm's to the wrist's range."""
    cosine = float(direction @ palm)
    aside = direction - cosine * palm
    length = float(np.linalg.norm(aside))
    if cosine >= _MAX_BENT:
        return direction
    if length < 1e-9:
        return palm
    turned: FloatArray = _MAX_BENT * palm + np.sqrt(1.0 - _MAX_BENT**2) * aside / length
    return turned


def _expected_widths(
    view: View, silhouette: Silhouette, cut: FloatArray, predicted: PredictedHand
) -> FloatArray:
    """Return the widths of the predicted hand in the window."""
    depth = np.where(silhouette.mask, silhouette.depth, np.float32(0.0))
    drawn = View.of(depth, view.window, view.camera)
    points, apart = (part[silhouette.mask].astype(np.float64) for part in (drawn.points, drawn.apart))
    return _widths((points - predicted.wrist) @ cut, apart, cut, predicted.scale)


def _widths(along: FloatArray, apart: FloatArray, cut: FloatArray, scale: float) -> FloatArray:
    before, beyond = _slices(_FINGERS_MM, scale), _slices(_BEYOND_MM, scale)
    return slice_areas(along, apart**2, extents(apart, cut), -before * BIN_MM, before + beyond)


def _shift_mm(observed: FloatArray, expected: FloatArray, scale: float) -> float:
    last = _slices(_FINGERS_MM, scale) + _slices(_COMPARED_MM, scale)
    most = max(0, min(_slices(_MAX_SHIFT_MM, scale), last, len(observed) - last))
    sd = _WRIST_SD_MM * scale / BIN_MM
    stiffness = scale**2 * _AREA_PER_SD_MM2 / BIN_MM / sd**2
    return BIN_MM * best_shift(observed, expected, max(last, 0), most, stiffness)


def _slices(mm: float, scale: float) -> int:
    return round(scale * mm / BIN_MM)
