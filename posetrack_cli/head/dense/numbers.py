"""Names of the numbers that a dense face adds to results."""

from __future__ import annotations

import re
from collections.abc import Sequence

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.dense.expressions import BLEND_SHAPES
from posetrack_cli.head.dense.lengths import LENGTH_NAMES
from posetrack_cli.head.dense.points import DENSE_NAMES

_MM = tuple(f"action_{name}_mm" for name in LENGTH_NAMES)
"""Lip gap, mouth width and lid openings as they are; jaw and brows relative to the face at rest."""
_OPEN = ("action_right_lid_open", "action_left_lid_open")
"""Lid openings as shares of the person's open eye."""
STRENGTH_NAMES = tuple(
    "action_" + re.sub("[A-Z]", lambda letter: "_" + letter.group().lower(), name) for name in BLEND_SHAPES
)
"""Names of the strengths of expressions, such as ``action_mouth_smile_left``."""
MEASURED_ACTIONS = (*_MM, *_OPEN, *STRENGTH_NAMES)
MEASURED_SHARES = tuple(name for name in (*_OPEN, *STRENGTH_NAMES) if name != "action_jaw_open")
"""Shares and strengths that the ten points do not have."""
CLOSED = "eyes_closed"
"""1 while both eyes are closed, 0 while they are open."""
CLOSED_BELOW = 0.5
"""Opening of the lids, as a share of the usual one, below which true eyes are closed."""
SIDES = ("right", "left")
GAZES = tuple(
    f"{side}_gaze_{part}" for side in SIDES for part in ("to_left_rad", "up_rad", "sd_rad", "x", "y", "z")
)
"""Per eye: angles in the head's frame with their standard deviation, and the direction in camera axes."""
TRUE_NUMBERS = (
    "action_right_lid_mm",
    "action_left_lid_mm",
    *_OPEN,
    CLOSED,
    *(name for name in GAZES if not name.endswith("_sd_rad")),
)
"""Numbers that synthetic recordings have as ground truth."""
_PARTS = ("x_mm", "y_mm", "z_mm", "sd_mm", "u_px", "v_px", "sd_px")
DENSE_NUMBERS = tuple(f"{name}_{part}" for name in DENSE_NAMES for part in _PARTS)
"""Each point in the head's frame and in the reference camera's image, with standard deviations of each
coordinate; missing where no image shows it."""
FACE_NUMBERS = (
    *MEASURED_ACTIONS,
    *(f"{name}_sd" for name in MEASURED_ACTIONS),
    CLOSED,
    *GAZES,
    *DENSE_NUMBERS,
)


def dense_points(number_names: Sequence[str], numbers: FloatArray) -> FloatArray | None:
    """Return the dense points (..., D, 7) in the parts' order, from numbers (..., M); None without them."""
    if DENSE_NUMBERS[0] not in number_names:
        return None
    start = number_names.index(DENSE_NUMBERS[0])
    found: FloatArray = numbers[..., start : start + len(DENSE_NUMBERS)]
    return found.reshape(*found.shape[:-1], len(DENSE_NAMES), len(_PARTS))
