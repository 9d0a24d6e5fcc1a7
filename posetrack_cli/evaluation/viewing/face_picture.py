"""Picture of a face model: identities in rows, deformations in columns (thesis, figure 4.6)."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.evaluation.viewing.drawing import SKIN, TEXT, Captions, Colour
from posetrack_cli.head.face.points import LINES, POINT_NAMES
from posetrack_cli.head.multilinear.face_model import FaceModel

IDENTITY_AXES, DEFORMATION_AXES = 2, 3
"""Maximum numbers of axes to draw."""
DEVIATIONS = 2.0
PIXELS_PER_MM = 1.6
_FRONT_MM, _SIDE_MM, _HEIGHT_MM = 116.0, 84.0, 148.0
_FRONT_X_MM, _SIDE_Z_MM, _TOP_MM = -58.0, -24.0, 44.0
_RIGHT = [POINT_NAMES.index(f"right_{name}") for name in ("eye_outer", "eye_inner", "brow_inner", "nostril")]
_RIGHT.append(POINT_NAMES.index("right_mouth_corner"))
# Indices into _RIGHT: the eye, and the profile from brow over nose to mouth.
_SIDE_LINES = ((0, 1), (2, 3), (3, 4))
_GROUND: Colour = (24, 24, 24)
_MEAN: Colour = (95, 95, 95)
_BITS = 4
Numbered = tuple[str, FloatArray]


def face_model_picture(model: FaceModel) -> ImageArray:
    """Draw faces (height, width, 3) from the front and the right, over the mean face in grey.

    The first row is the mean identity, the others are ``DEVIATIONS`` standard deviations along the axes that
    change the face most; likewise the columns for deformations.
    """
    neutral = model.shapes(model.identity_mean, model.deformation_mean)
    identities = _along(model.identity_mean, model.identity_deviations, _identity_reach(model), "s")
    deformations = _along(
        model.deformation_mean, model.deformation_deviations, _deformation_reach(model), "a"
    )
    rows = [
        np.hstack([_cell(model.shapes(s, a), neutral, f"{of_s}  {of_a}") for of_a, a in deformations])
        for of_s, s in identities
    ]
    return np.vstack(rows)


def _identity_reach(model: FaceModel) -> FloatArray:
    """Return the displacement (S,) of the points by one standard deviation, mm, at the mean deformation."""
    moved = np.einsum("kisa,a->kis", model.core, model.deformation_mean) * model.identity_deviations
    reach: FloatArray = np.linalg.norm(moved, axis=(0, 1))
    return reach


def _deformation_reach(model: FaceModel) -> FloatArray:
    moved = np.einsum("kisa,s->kia", model.core, model.identity_mean) * model.deformation_deviations
    reach: FloatArray = np.linalg.norm(moved, axis=(0, 1))
    return reach


def _along(mean: FloatArray, deviations: FloatArray, reach: FloatArray, name: str) -> Sequence[Numbered]:
    """Return the mean and both directions along the axes with the largest displacement, with captions."""
    shown = [(f"{name} mean", mean)]
    most = IDENTITY_AXES if name == "s" else DEFORMATION_AXES
    for axis in np.argsort(-reach, kind="stable")[:most].tolist():
        for sign in (1.0, -1.0):
            moved = mean.copy()
            moved[axis] += sign * DEVIATIONS * deviations[axis]
            shown.append((f"{name}{axis + 1} {sign * DEVIATIONS:+g} sd", moved))
    return shown


def _cell(shape: FloatArray, neutral: FloatArray, text: str) -> ImageArray:
    """Draw a face from the front and the right, with a caption."""
    width, height = (round(PIXELS_PER_MM * mm) for mm in (_FRONT_MM + _SIDE_MM, _HEIGHT_MM))
    picture = np.full((height, width, 3), _GROUND, np.uint8)
    for points, colour in ((neutral, _MEAN), (shape, SKIN)):
        _draw(picture, points[:, [0, 1]] - [_FRONT_X_MM, 0.0], LINES, colour)
        _draw(picture, points[_RIGHT][:, [2, 1]] + [_FRONT_MM - _SIDE_Z_MM, 0.0], _SIDE_LINES, colour)
    named = Captions([[text]], width).below(picture, [([text], TEXT)])
    return np.pad(named, ((0, 3), (0, 3), (0, 0)))


def _draw(picture: ImageArray, places: FloatArray, lines: Sequence[tuple[int, int]], colour: Colour) -> None:
    """Draw points (P, 2), mm to the right and above the origin of the mean face, and lines."""
    pixels = PIXELS_PER_MM * (places * [1.0, -1.0] + [0.0, _TOP_MM])
    fixed = [(int(x), int(y)) for x, y in np.rint(pixels * (1 << _BITS))]
    for start, end in lines:
        cv2.line(picture, fixed[start], fixed[end], colour, 2, cv2.LINE_AA, _BITS)
    for place in fixed:
        cv2.circle(picture, place, 4 << _BITS, colour, -1, cv2.LINE_AA, _BITS)
