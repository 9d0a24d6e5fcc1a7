"""How a face deforms: expressions as displacements of the skin, linear in their strengths."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import EYES, MEAN_SHAPE
from posetrack_cli.synthesis.head.form import (
    AXIS_Z,
    MOUTH_X,
    MOUTH_Y,
)
from posetrack_cli.synthesis.head.identity import Looks
from posetrack_cli.synthesis.head.smooth import Displacements, smooth_step

EXPRESSIONS = (
    "jaw_open",
    "smile_right",
    "smile_left",
    "mouth_sideways",
    "pucker",
    "brows_up",
    "brows_down",
    "blink",
    "gaze",
)
"""Names of the strengths: 0 is neutral and 1 the most; ``BOTH_WAYS`` go from -1 to 1, positive to the
subject's left."""
BOTH_WAYS = ("mouth_sideways", "gaze")

REACH_MM = 26.0
HINGE = np.array([-14.0, AXIS_Z])  # y, z of the jaw's axis, mm
JAW_RAD = float(np.radians(16.4))
GAZE_MM = 3.0
Anchors = list[tuple[float, float, float, float, float]]

# x, y of a place; its displacement in x, y, z at full strength, mm. Sizes as measured on ICT-FaceKit's
# expressions: corners of the mouth 17.5 when the jaw opens, 15.6 in a smile, 18 sideways, 11 in a pucker;
# brows 4.5.
_STILL: Anchors = [
    (0.0, -36.0, 0, 0, 0),
    (0.0, -10.0, 0, 0, 0),
    (-62.0, 5.0, 0, 0, 0),
    (62.0, 5.0, 0, 0, 0),
    (-68.0, -45.0, 0, 0, 0),
    (68.0, -45.0, 0, 0, 0),
]
_SMILE: Anchors = [
    (MOUTH_X, MOUTH_Y, 7.5, 10.0, -9.0),
    (9.0, MOUTH_Y, 1.5, 1.5, -1.5),
    (-MOUTH_X, MOUTH_Y, 0, 0, 0),
    (38.0, -34.0, 0.8, 4.0, 1.5),
    (0.0, -105.0, 0, 0, 0),
]
_SIDEWAYS: Anchors = [
    (MOUTH_X, MOUTH_Y, 11.0, 4.0, -5.0),
    (-MOUTH_X, MOUTH_Y, 15.5, 1.0, 8.5),
    (0.0, MOUTH_Y, 13.5, 0.5, 1.0),
    (0.0, -105.0, 6.0, 0.0, 0.5),
]
_PUCKER: Anchors = [
    (MOUTH_X, MOUTH_Y, -5.0, 2.0, 9.5),
    (-MOUTH_X, MOUTH_Y, 5.0, 2.0, 9.5),
    (0.0, MOUTH_Y, 0.0, 0.5, 7.0),
    (0.0, -105.0, 0.0, 1.0, 1.0),
]
_BROWS_UP: Anchors = [
    (11.7, 25.7, 0.2, 4.5, -0.3),
    (-11.7, 25.7, -0.2, 4.5, -0.3),
    (38.0, 27.0, 0.0, 5.0, -0.5),
    (-38.0, 27.0, 0.0, 5.0, -0.5),
    (0.0, 75.0, 0, 0, 0),
    (31.0, 11.0, 0.0, 1.2, 0.0),
    (-31.0, 11.0, 0.0, 1.2, 0.0),
]
_BROWS_DOWN: Anchors = [
    (11.7, 25.7, -2.2, -2.6, 1.2),
    (-11.7, 25.7, 2.2, -2.6, 1.2),
    (38.0, 27.0, -1.0, -2.0, 0.5),
    (-38.0, 27.0, 1.0, -2.0, 0.5),
    (0.0, 70.0, 0, 0, 0),
]


def displacements(places: FloatArray, below: FloatArray, looks: Looks) -> FloatArray:
    """Return what every expression moves (J, ..., 3), mm at full strength.

    Args:
        places: (..., 3) on the average head, mm.
        below: (...) 1 where the skin moves with the lower jaw's side of the mouth, 0 with the upper.
        looks: of the face; its lids' edges are read.
    """
    xy = places[..., :2]
    front = np.clip((places[..., 2] - AXIS_Z) / 40.0, 0.0, 1.0)[..., None]
    fields = [
        _jaw(places, below),
        _mirrored(_field(_SMILE), xy),
        _field(_SMILE)(xy),
        _field(_SIDEWAYS)(xy),
        _field(_PUCKER)(xy),
        _field(_BROWS_UP)(xy),
        _field(_BROWS_DOWN)(xy),
        _blink(xy, looks),
        _gaze(xy, looks),
    ]
    return np.stack([front * field for field in fields])


def belongs_below(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return which share (...) of a place moves with the lower side of the mouth.

    A step at the lips; beyond the corners of the mouth a slope that widens.
    """
    beyond = np.maximum(np.abs(x) - MOUTH_X, 0.0)
    return smooth_step((MOUTH_Y - y) / np.maximum(1.1 * beyond, 1e-9) * 0.5 + 0.5)


def _field(anchors: Anchors) -> Displacements:
    """The field of anchors, the eyes, nostrils and the places that never move."""
    fixed: Anchors = [(float(x), float(y), 0, 0, 0) for x, y, _ in [*MEAN_SHAPE[EYES], *MEAN_SHAPE[6:8]]]
    named = {(x, y) for x, y, *_ in anchors}
    table = np.array([*anchors, *(a for a in [*_STILL, *fixed] if a[:2] not in named)])
    return Displacements(table[:, :2], table[:, 2:], REACH_MM)


def _mirrored(field: Displacements, xy: FloatArray) -> FloatArray:
    mirrored: FloatArray = field(xy * [-1.0, 1.0]) * [-1.0, 1.0, 1.0]
    return mirrored


def _jaw(places: FloatArray, below: FloatArray) -> FloatArray:
    """The lower face turns about the jaw's axis, the mouth's corners and cheeks follow in part."""
    hung = places[..., 1:] - HINGE
    sine, cosine = np.sin(JAW_RAD), np.cos(JAW_RAD)
    turned = np.stack([np.zeros_like(hung[..., 0]), *_turned(hung, sine, cosine)], axis=-1)
    x, y = places[..., 0], places[..., 1]
    corner = np.exp(-0.5 * ((np.abs(x) - MOUTH_X) / 12.0) ** 2 - 0.5 * ((y - MOUTH_Y) / 14.0) ** 2)
    full = smooth_step((-20.0 - y) / 60.0) * smooth_step((y + 150.0) / 26.0)
    middle = 1.0 - smooth_step((np.abs(x) - 0.55 * MOUTH_X) / (0.45 * MOUTH_X))
    lower = np.where(np.abs(x) < MOUTH_X, 0.62 + 0.38 * middle, 0.62)
    lower = np.where(
        y < MOUTH_Y - 8.0, np.maximum(lower, 0.62 + 0.38 * smooth_step((MOUTH_Y - 8.0 - y) / 25.0)), lower
    )
    upper = 0.62 * corner
    share = full * ((1.0 - below) * upper + below * np.maximum(lower, upper))
    inward = np.stack([-0.16 * np.clip(x, -MOUTH_X, MOUTH_X), np.zeros_like(x), np.zeros_like(x)], axis=-1)
    field: FloatArray = share[..., None] * turned + corner[..., None] * inward
    return field


def _turned(hung: FloatArray, sine: float, cosine: float) -> tuple[FloatArray, FloatArray]:
    """Displacement in y and z of points (..., 2) that hang in y and z before an axis, turned down."""
    y, z = hung[..., 0], hung[..., 1]
    return (cosine - 1.0) * y - sine * z, sine * y + (cosine - 1.0) * z


def _blink(xy: FloatArray, looks: Looks) -> FloatArray:
    """The upper lid comes down to the lower: what the opening shows is pressed together behind its edge."""
    s, above, top, bottom = looks.lids(xy[..., 0], xy[..., 1])
    within = smooth_step((s + 0.12) / 0.12) * smooth_step((1.12 - s) / 0.12)
    opening = np.maximum(top - bottom, 1e-6)
    part = np.clip((above - bottom) / opening, 0.0, 1.0)
    lid = smooth_step((top + 9.0 - above) / 9.0)
    down = np.where(above < top, part, lid) * opening * within * 0.96
    down = np.where(above < bottom, 0.0, down)
    return np.stack([np.zeros_like(down), -down, 0.1 * down], axis=-1)


def _gaze(xy: FloatArray, looks: Looks) -> FloatArray:
    """What the openings show moves to the subject's left, not at all at their edges."""
    s, above, top, bottom = looks.lids(xy[..., 0], xy[..., 1])
    height = np.clip((above - bottom) / np.maximum(top - bottom, 1e-6), 0.0, 1.0)
    inside = np.clip(4.0 * s * (1.0 - s), 0.0, 1.0) * np.minimum(1.0, 6.0 * height * (1.0 - height))
    aside = GAZE_MM * inside * (xy[..., 1] < 12.0)
    return np.stack([aside, np.zeros_like(aside), np.zeros_like(aside)], axis=-1)
