"""Segmentation of the hand in a window around a prediction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.fit.skeleton import FOREARM
from posetrack_cli.hand.observe.arm import Arm, arm_of, is_forearm
from posetrack_cli.hand.observe.observation import IGNORED, Observation, PixelSampler
from posetrack_cli.hand.observe.prediction import PredictedHand, Silhouette, silhouette_of
from posetrack_cli.hand.observe.surfaces import (
    View,
    along,
    behind_others,
    extent_mm,
    jump_mm,
    pixel_mm,
    surface_labels,
    without_pinholes,
)
from posetrack_cli.rendering.port import Window

# Lengths are of a hand of scale 1, mm.
_IN_FRONT_MM, _BEHIND_MM, _ASIDE_MM = 70.0, 70.0, 60.0
"""Distances from the predicted skin, in depth and in the image, up to which pixels may be the hand's."""
_REACH_MM, _MIN_SHARE = 140.0, 0.5
"""A surface is the hand's if this share of its pixels within reach of the joints' centre lies at the
prediction ..."""
_VOTE_ASIDE_MM, _VOTE_MM = 15.0, 45.0
"""... that is, within these distances of it in the image and in depth."""
_MARGIN_MM = 60.0
"""Margin around the window that is searched for the arm."""


class Label(IntEnum):
    """Class of a pixel: no reading, hand, forearm, another surface, or ignored part of the limb."""

    UNREAD = 0
    HAND = 1
    FOREARM = 2
    OTHER = 3
    BEYOND = 4


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Labelled pixels of a window.

    Attributes:
        window: its pixels.
        depth: (h, w) readings, mm, 0 = none.
        labels: (h, w) uint8, of ``Label``.
        wrist: (3,) start of the forearm, on its axis, camera axes, mm.
        arm: (3,) unit vector from the elbow to the wrist, camera axes; None if no forearm is visible.
        reversed: whether the limb continues where fingers are expected, and ends where the forearm is.
        hidden: share of the predicted hand that another hand hides.
    """

    window: Window
    depth: Float32Array
    labels: ImageArray
    wrist: FloatArray
    arm: FloatArray | None
    reversed: bool = False
    hidden: float = 0.0

    def is_labelled(self, label: Label) -> BoolArray:
        """Return the mask (h, w) of a label."""
        mask: BoolArray = self.labels == label
        return mask

    @property
    def observation(self) -> Observation:
        """Return the observation for a likelihood of the hand alone: its depths, others negated."""
        hand = self.is_labelled(Label.HAND)
        image = np.where(hand, self.depth, -self.depth)
        image[self.is_labelled(Label.FOREARM) | self.is_labelled(Label.BEYOND)] = 0.0
        return Observation(self.window, image, int(np.count_nonzero(hand)), hidden=self.hidden)

    def observation_with_inner(self, expected: FloatArray) -> Observation:
        """Return the observation for a likelihood with inner numbers.

        Args:
            expected: (6,) their prior; the forearm's direction is replaced.
        """
        inner = expected.copy()
        if self.arm is None:
            inner[FOREARM] = 0.0
            return replace(self.observation, inner=inner)
        target = self.is_labelled(Label.HAND) | self.is_labelled(Label.FOREARM)
        image = np.where(target, self.depth, -self.depth)
        image[self.is_labelled(Label.BEYOND)] = IGNORED
        inner[:3], count = -self.arm, int(np.count_nonzero(target))
        return Observation(self.window, image, count, inner, self.wrist, self.reversed, self.hidden)


def segment(
    depth: ImageArray,
    sampler: PixelSampler,
    window: Window,
    camera: Camera,
    predicted: PredictedHand,
    *,
    is_followed: bool = True,
) -> Segmentation:
    """Separate the hand from its forearm, other surfaces and missing readings **[ours]**.

    A surface is the hand's if most of it within the hand's reach lies at the prediction; of such a surface,
    the part near the prediction is labelled hand. The forearm is cut at the observed wrist (``arm_of``), with
    the prediction as prior only: a cut at the predicted wrist would let the palm slide along the arm.

    Args:
        depth: (height, width) the frame, mm, 0 = no reading, negative: another hand's.
        sampler: of the camera.
        window: the requested pixels; a margin around them is also used, for the arm.
        camera: its camera.
        predicted: the predicted hand.
        is_followed: whether the prediction is of a tracked hand, not a hypothesis: only a tracked hand may
            have fingers away from the prediction.
    """
    margin = round(_MARGIN_MM / max(float(pixel_mm(predicted.wrist[2], window, camera)), 1e-3))
    margin = min(max(margin, 0), window.width)
    wide = _widened(window, margin)
    tile = sampler.sample(depth, wide)
    free = np.maximum(tile, np.float32(0.0))
    labels, arm, is_reversed = _labels(View.of(free, wide, camera), predicted, is_followed)
    labels[tile < 0.0] = Label.OTHER
    hidden = _hidden_share(tile, wide, camera, predicted)
    inner = np.s_[margin : margin + window.height, margin : margin + window.width]
    return Segmentation(
        window, np.abs(tile[inner]), labels[inner], arm.wrist, arm.direction, is_reversed, hidden
    )


def _hidden_share(tile: Float32Array, window: Window, camera: Camera, predicted: PredictedHand) -> float:
    """Return the share of a predicted hand behind another hand's readings."""
    if not np.any(tile < 0.0):
        return 0.0
    drawn = silhouette_of(predicted.joints, predicted.scale, window, camera)
    return 0.0 if drawn is None else float(drawn.hidden_by(tile)[drawn.mask].mean())


def _widened(window: Window, margin: int) -> Window:
    """Return the window with a margin in tile pixels on every side."""
    return replace(
        window,
        left=window.left - margin * window.step,
        top=window.top - margin * window.step,
        width=window.width + 2 * margin,
        height=window.height + 2 * margin,
    )


_EXIT_WIDTH_MM, _PAST_WRIST_MM = 25.0, 40.0
"""An arm leaving the view is at least this wide, and this far beyond the wrist; for a hand of scale 1."""


def _leaves_towards_fingers(view: View, limb: BoolArray, arm: Arm, scale: float) -> bool:
    """Return whether a limb leaves the view or the image on the fingers' side only."""
    assert arm.direction is not None
    window, camera = view.window, view.camera
    rows, columns = window.rows(), window.columns()
    inside = np.zeros(limb.shape, dtype=np.bool_)
    inner_rows = (rows >= window.step) & (rows < camera.height - window.step)
    inner_columns = (columns >= window.step) & (columns < camera.width - window.step)
    inside[1:-1, 1:-1] = np.outer(inner_rows, inner_columns)[1:-1, 1:-1]
    leaves = limb & ~inside
    along = (view.points[leaves].astype(np.float64) - arm.wrist) @ arm.direction
    width = view.apart[leaves]
    towards_fingers = float(width[along > _PAST_WRIST_MM * scale].sum())
    towards_elbow = float(width[along < 0.0].sum())
    return towards_fingers > _EXIT_WIDTH_MM * scale and towards_elbow == 0.0


def _labels(view: View, predicted: PredictedHand, is_followed: bool) -> tuple[ImageArray, Arm, bool]:
    labels = np.where(view.depth > 0, np.uint8(Label.OTHER), np.uint8(Label.UNREAD))
    silhouette = silhouette_of(predicted.joints, predicted.scale, view.window, view.camera)
    if silhouette is None:
        return labels, Arm(predicted.wrist, predicted.towards_elbow, None), False
    limb, hand = _limb(view, silhouette, predicted, is_followed)
    arm = arm_of(view, limb, hand, silhouette, predicted)
    labels[hand] = Label.HAND
    if arm.direction is not None:
        beyond = limb & (along(view.points, arm.wrist, arm.cut) > 0.0)
        offset = view.points[beyond].astype(np.float64) - predicted.wrist
        near = is_forearm(offset, -arm.direction, predicted.scale)
        labels[beyond] = np.where(near, Label.FOREARM, Label.BEYOND)
    is_reversed = arm.direction is not None and _leaves_towards_fingers(view, limb, arm, predicted.scale)
    return labels, arm, is_reversed


def _limb(
    view: View,
    silhouette: Silhouette,
    predicted: PredictedHand,
    is_followed: bool,
) -> tuple[BoolArray, BoolArray]:
    """Return masks of the surfaces connected to the hand, and of hand and forearm among them.

    A surface is included if most of it within the hand's reach lies at the prediction, or if it is a finger
    of a tracked hand (``_fingers``). The one with most pixels there is always included: a hand that touches a
    body forms one surface with it, and is cut out closely.
    """
    jump = jump_mm(view.apart)
    count, numbers = surface_labels(without_pinholes(view.depth, jump), jump)
    read = view.depth > 0
    at_hand = read & _near_prediction(view, silhouette, predicted, _VOTE_ASIDE_MM, _VOTE_MM, _VOTE_MM)
    near = read & _within_reach(view.points, predicted)
    inside = np.bincount(numbers[at_hand & near], minlength=count)
    inside[0] = 0
    own = inside > _MIN_SHARE * np.bincount(numbers[near], minlength=count)
    merged = np.zeros(count, dtype=np.bool_)
    if inside.any():
        merged[int(np.argmax(inside))] = True
    merged &= ~own
    limb = read & (own | merged)[numbers]
    fingers = np.zeros(count, dtype=np.bool_)
    if is_followed:
        others = np.where(read & ~limb, numbers, 0)
        fingers = _fingers(view, others, near, inside > 0, limb, jump, predicted.scale)
    near_hand = _near_prediction(view, silhouette, predicted, _ASIDE_MM, _IN_FRONT_MM, _BEHIND_MM)
    limb |= fingers[numbers] & read
    return limb, limb & (np.where(merged[numbers], at_hand, near_hand) | fingers[numbers])


_FINGER_MM2, _MIN_NEAR = 3000.0, 0.9
"""Largest area of a finger, for a hand of scale 1, and its smallest share within the hand's reach."""
_MIN_MM2, _MIN_MM, _WIDEST_MM, _GAP_MM = 300.0, 30.0, 26.0, 10.0
"""Smallest area and length of an extended finger, its largest width, and its largest gap to the limb behind
the rim of a nearer finger; for a hand of scale 1."""
_MAX_BEHIND = 0.4
"""Largest share of a finger behind its neighbours: about 0.15 where a thumb hides its base, but most of a
background visible between two fingers."""


def _fingers(
    view: View,
    numbers: IntArray,
    near: BoolArray,
    at_prediction: BoolArray,
    limb: BoolArray,
    jump: Float32Array,
    scale: float,
) -> BoolArray:
    """Return which surfaces (K,) are fingers separate from the limb, even away from the prediction
    **[ours]**.

    A thumb in front of its base, or a missing reading, separates a finger from the hand. A finger that has
    just been stretched is not where the fist was predicted, nor would the next frame predict it. Only fingers
    start at the hand, end within its reach and are this small. A surface away from the prediction must also
    start next to the limb, be finger-shaped, and not lie behind its surroundings.

    Args:
        view: the window.
        numbers: (h, w) of surfaces outside the limb, 0 elsewhere.
        near: (h, w) pixels within the hand's reach.
        at_prediction: (K,) surfaces with a part at the prediction.
        limb: (h, w) the other surfaces connected to the hand.
        jump: (h, w) depth step between surfaces, mm.
        scale: of the hand.
    """
    whole, reached = (
        np.bincount(numbers[part], weights=view.apart[part] ** 2, minlength=len(at_prediction))
        for part in (numbers > 0, near & (numbers > 0))
    )
    small = (whole < scale**2 * _FINGER_MM2) & (reached > _MIN_NEAR * whole)
    fingers: BoolArray = at_prediction & small
    others = small & ~at_prediction & (whole > scale**2 * _MIN_MM2)
    if others.any() and limb.any():
        gap_px = cv2.distanceTransform((~limb).astype(np.uint8), cv2.DIST_L2, 3)
        adjacent = others[numbers] & (gap_px * view.apart < scale * _GAP_MM)
        behind = behind_others(view.depth, jump)
        for k in np.unique(numbers[adjacent]).tolist():
            part = numbers == k
            length = extent_mm(view.points[part].astype(np.float64), float(view.apart[part].mean()))
            is_slim = length > scale * _MIN_MM and whole[k] < scale * _WIDEST_MM * length
            fingers[k] = is_slim and bool(behind[part].mean() < _MAX_BEHIND)
    return fingers


def _near_prediction(
    view: View,
    silhouette: Silhouette,
    predicted: PredictedHand,
    aside: float,
    in_front: float,
    behind: float,
) -> BoolArray:
    """Return the pixels near the predicted hand in image and depth; limits in mm, for a hand of scale 1."""
    scale, beyond = predicted.scale, view.depth - silhouette.depth
    near: BoolArray = silhouette.outside_px * view.apart < scale * aside
    return near & (beyond > -scale * in_front) & (beyond < scale * behind)


def _within_reach(points: Float32Array, predicted: PredictedHand) -> BoolArray:
    """Return the points within the hand's reach, without those behind its wrist."""
    squared = np.zeros(points.shape[:2], dtype=np.float32)
    for axis, middle in enumerate(predicted.joints.mean(axis=0).tolist()):
        squared += (points[..., axis] - np.float32(middle)) ** 2
    beyond_wrist = along(points, predicted.wrist, predicted.towards_elbow) >= 0.0
    return (squared < (predicted.scale * _REACH_MM) ** 2) & ~beyond_wrist
