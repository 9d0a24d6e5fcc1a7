"""Names of the numbers that a dense face adds to results."""

from __future__ import annotations

import re

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
CLOSED = "eyes_closed"
"""1 while both eyes are closed, 0 while they are open."""
_SIDES = ("right", "left")
GAZES = tuple(
    f"{side}_gaze_{part}" for side in _SIDES for part in ("to_left_rad", "up_rad", "sd_rad", "x", "y", "z")
)
"""Per eye: angles in the head's frame with their standard deviation, and the direction in camera axes."""
POINT_SDS = tuple(f"sd_{name}_mm" for name in DENSE_NAMES)
"""Standard deviation of each point, mean over the axes; missing where no image shows the point."""
FACE_NUMBERS = (*MEASURED_ACTIONS, *(f"{name}_sd" for name in MEASURED_ACTIONS), CLOSED, *GAZES, *POINT_SDS)
