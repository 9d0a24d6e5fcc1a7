"""The hand's bones: names, lengths, rest frames, joint limits, for the right hand.

Hand coordinates: origin at the wrist; with the identity rotation the fingers point up in the image
(-y), the palm faces the sensor (-z) and the thumb of a right hand points to +x. A left hand is the
mirror image x -> -x; its angles mean the same anatomical motion.

Angles (hand.md, appendix A.1 of the paper), 15 of them, radians: for the thumb joint 3 (CMC) about x and
z, joint 2 (MCP) about x; for each finger joint 3 (MCP) about x and z, joint 2 (PIP) about x. About x,
positive bends towards the palm; about z, positive moves towards the thumb's side. Joint 1 is not free: half
of joint 2's x angle. In the paper it is the thumb's joint 2 that turns about z, too; a thumb abducts at its
saddle joint, about an axis of the metacarpal **[ours]**.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.population import population

FINGERS = ("thumb", "index", "middle", "ring", "little")
_FINGER_ANGLES = ("mcp_flexion", "mcp_abduction", "pip_flexion")
ANGLE_NAMES: tuple[str, ...] = (
    "thumb_cmc_flexion",
    "thumb_mcp_flexion",
    "thumb_cmc_abduction",
    *(f"{finger}_{angle}" for finger in FINGERS[1:] for angle in _FINGER_ANGLES),
)
JOINT_NAMES: tuple[str, ...] = (
    "wrist",
    "thumb_cmc",
    "thumb_mcp",
    "thumb_ip",
    "thumb_tip",
    *(f"{finger}_{joint}" for finger in FINGERS[1:] for joint in ("mcp", "pip", "dip", "tip")),
)
JOINT_PARENTS: tuple[int, ...] = (-1, *(0 if k == 0 else 4 * f + k for f in range(5) for k in range(4)))
BONE_COUNT = 16  # the palm, then three per finger
ARM_BONE = 16  # a forearm's, where one is drawn behind the hand
POSE_SIZE = 22
TANGENT_SIZE = 21
ANGLES = slice(7, 22)  # of a pose
TANGENT_ANGLES = slice(6, 21)  # of a tangent vector

_D = np.pi / 180.0
ANGLE_LIMITS: FloatArray = _D * np.array(
    [
        (-45.0, 74.0),  # thumb CMC flexion
        (0.0, 74.0),  # thumb MCP flexion
        (-35.0, 35.0),  # thumb CMC abduction
        *((-15.0, 90.0), (-19.0, 28.0), (0.0, 108.0)),  # index
        *((-15.0, 90.0), (-28.0, 17.0), (0.0, 108.0)),  # middle
        *((-15.0, 90.0), (-17.0, 17.0), (0.0, 108.0)),  # ring
        *((-15.0, 90.0), (-39.0, 28.0), (0.0, 108.0)),  # little
    ]
)
"""(15, 2) lower and upper joint limits, rad (generous; hand.md, facts for the models)."""

_FINGER_FAN = _D * np.array([5.0, 0.0, -5.0, -11.0])
"""How the straight fingers fan out at zero angles, rad."""
_THUMB_DIRECTION = np.array([0.72, -0.60, -0.35])
_THUMB_BENDS_TOWARDS = np.array([-0.65, -0.15, -0.75])
MIRROR: FloatArray = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class HandAnatomy:
    """Sizes and rest frames of one hand.

    Attributes:
        side: ``right`` or ``left``.
        base_positions: (5, 3) where each finger's joint 3 sits in hand coordinates, mm.
        base_rotations: (5, 3, 3) hand_R_finger at zero angles.
        segments: (5, 3) lengths from joint 3 to 2, 2 to 1, 1 to the tip, mm.
        radii: (5, 4) finger radii, mm.
        scale: all lengths relative to the population's hand of these coefficients.
        palm: further factors on the palm's width (x), length (y) and thickness (z).
        wrist: further factor on the width of the skin around the wrist.
        coefficients: of the population's modes; what the skin of the average hand is made with.
    """

    side: str
    base_positions: FloatArray
    base_rotations: FloatArray
    segments: FloatArray
    radii: FloatArray
    scale: float
    palm: tuple[float, float, float] = (1.0, 1.0, 1.0)
    wrist: float = 1.0
    coefficients: tuple[float, ...] = ()

    @property
    def is_left(self) -> bool:
        """Whether this is a left hand."""
        return self.side == "left"

    @cached_property
    def rest_origins(self) -> FloatArray:
        """(5, 3, 3) where the fingers' joints 3, 2, 1 sit at zero angles, hand coordinates, mm."""
        along = np.concatenate([np.zeros((5, 1)), np.cumsum(self.segments, axis=1)[:, :2]], axis=1)
        return self.base_positions[:, None] - along[..., None] * self.base_rotations[:, None, :, 1]


def make_anatomy(
    side: str = "right",
    scale: float = 1.0,
    finger_lengths: tuple[float, ...] = (1.0,) * 5,
    finger_widths: tuple[float, ...] = (1.0,) * 5,
    palm: tuple[float, float, float] = (1.0, 1.0, 1.0),
    wrist: float = 1.0,
    thumb_place: float = 1.0,
    coefficients: tuple[float, ...] = (),
) -> HandAnatomy:
    """Return the average adult hand, or another of the population, scaled.

    Args:
        side: ``right`` or ``left``.
        scale: factor on every length.
        finger_lengths: further factor on each finger's segments, thumb first.
        finger_widths: further factor on each finger's radii, thumb first.
        palm: further factors on the palm's width, length and thickness: where the fingers' bases lie in
            x, y and z, and how wide and thick the skin between them and the wrist is.
        wrist: further factor on the width of the skin around the wrist.
        thumb_place: further factor on the distance of the thumb's base from the wrist along the palm.
        coefficients: of the population's modes, in standard deviations; none is the average hand.
    """
    hand, rotations = population().hand(coefficients), rest_rotations()
    positions = hand.bases * np.asarray(palm)
    positions[0, 1] *= thumb_place
    if side == "left":
        positions = positions * MIRROR
        rotations = MIRROR[:, None] * rotations * MIRROR
    segments = hand.segments * np.asarray(finger_lengths)[:, None]
    radii = hand.radii * np.asarray(finger_widths)[:, None]
    return HandAnatomy(
        side, scale * positions, rotations, scale * segments, scale * radii, scale, palm, wrist, coefficients
    )


def rest_rotations() -> FloatArray:
    """Return hand_R_finger (5, 3, 3) of a right hand at zero angles."""
    fingers = np.zeros((4, 3, 3))
    cos, sin = np.cos(_FINGER_FAN), np.sin(_FINGER_FAN)
    fingers[:, 0, 0], fingers[:, 0, 1], fingers[:, 1, 0], fingers[:, 1, 1] = cos, -sin, sin, cos
    fingers[:, 2, 2] = 1.0
    return np.concatenate([_thumb_rotation()[None], fingers])


def _thumb_rotation() -> FloatArray:
    """hand_R_thumb: -y along the metacarpal, positive rotation about x sweeps it across the palm."""
    y = -_THUMB_DIRECTION / np.linalg.norm(_THUMB_DIRECTION)
    x = np.cross(-y, _THUMB_BENDS_TOWARDS)
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], axis=1)
