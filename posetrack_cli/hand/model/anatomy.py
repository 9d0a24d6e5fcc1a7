"""Anatomy of a hand: bones, joint axes and limits, size, proportions, and the population's shape modes."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.npz import read_npz
from posetrack_cli.rendering.mesh import SkinnedMesh

# Population: mean and modes of hands
#
# ``population.npz`` is built by ``scripts/build hand-model`` from skins and joints of hundreds of synthetic
# people (`scripts/research/README.md`). A hand is the mean plus modes times coefficients, at a length of
# 179 mm from the wrist to the middle finger's tip. Coefficients are independent standard normal variables.

SHIPPED = Path(__file__).with_name("population.npz")
HAND_LENGTH_MM = 179.0
"""From the wrist to the skin at the tip of the straight middle finger, at scale 1: the mean adult."""
COEFFICIENTS = 24
"""Number of coefficients of the shipped hand."""


class RestHand(NamedTuple):
    """A right hand of scale 1 at zero angles, hand coordinates, mm.

    Attributes:
        cage: (C, 3) control points of the skin, on its smooth surface.
        bases: (5, 3) position of each finger's joint 3.
        segments: (5, 3) lengths from joint 3 to 2, 2 to 1, 1 to the tip.
        radii: (5, 4) of the fingers at the three joints and near the tip.
    """

    cage: FloatArray
    bases: FloatArray
    segments: FloatArray
    radii: FloatArray


@dataclass(frozen=True, eq=False)
class Population:
    """Mean and modes of hands, and the cage shared by their skins.

    Attributes:
        mean: (D,) flattened ``RestHand``.
        modes: (K, D) change per standard deviation of each coefficient.
        weights: (C, 16) skinning weights of the cage.
        triangles: (T, 3) of the cage.
    """

    mean: FloatArray
    modes: FloatArray
    weights: FloatArray
    triangles: IntArray

    def hand(self, coefficients: Sequence[float] = ()) -> RestHand:
        """Return the hand for up to K coefficients; missing ones are 0."""
        c = np.asarray(coefficients, dtype=np.float64)
        row = self.mean + c @ self.modes[: c.size]
        ends = np.cumsum([3 * len(self.weights), 15, 15])
        cage, bases, segments, radii = np.split(row, ends)
        return RestHand(cage.reshape(-1, 3), bases.reshape(5, 3), segments.reshape(5, 3), radii.reshape(5, 4))


@functools.cache
def population() -> Population:
    """Return the shipped population."""
    with SHIPPED.open("rb") as stream:
        arrays = read_npz(stream)
    mean, modes, weights = (arrays[name].astype(np.float64) for name in ("mean", "modes", "weights"))
    return Population(mean, modes, weights, arrays["triangles"].astype(np.int64))


# Bones of the right hand: names, lengths, rest frames, joint limits
#
# Hand coordinates: origin at the wrist; with the identity rotation the fingers point up in the image
# (-y), the palm faces the sensor (-z) and the thumb of a right hand points to +x. A left hand is the
# mirror image x -> -x; its angles mean the same anatomical motion.
#
# 15 angles (appendix A.1 of the paper), radians: for the thumb joint 3 (CMC) about x and z, joint 2 (MCP)
# about x; for each finger joint 3 (MCP) about x and z, joint 2 (PIP) about x. About x, positive bends towards
# the palm; about z, positive moves towards the thumb's side. Joint 1 turns about x by half of joint 2. In the
# paper the thumb's joint 2 also turns about z; ours abducts at its saddle joint, about an axis of the
# metacarpal **[ours]**.

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
ARM_BONE = 16  # the forearm, if drawn
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
"""(15, 2) lower and upper joint limits, rad; generous."""

_FINGER_FAN = _D * np.array([5.0, 0.0, -5.0, -11.0])
"""Fan of the straight fingers at zero angles, rad."""
_THUMB_DIRECTION = np.array([0.72, -0.60, -0.35])
_THUMB_BENDS_TOWARDS = np.array([-0.65, -0.15, -0.75])
MIRROR: FloatArray = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class HandAnatomy:
    """Sizes and rest frames of one hand.

    Attributes:
        side: ``right`` or ``left``.
        base_positions: (5, 3) position of each finger's joint 3, hand coordinates, mm.
        base_rotations: (5, 3, 3) hand_R_finger at zero angles.
        segments: (5, 3) lengths from joint 3 to 2, 2 to 1, 1 to the tip, mm.
        radii: (5, 4) finger radii, mm.
        scale: of all lengths, relative to the population's hand of these coefficients.
        palm: further factors on the palm's width (x), length (y) and thickness (z).
        wrist: further factor on the width of the skin around the wrist.
        coefficients: of the population's modes, which determine the average hand's skin.
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
        """Return whether this is a left hand."""
        return self.side == "left"

    @cached_property
    def rest_origins(self) -> FloatArray:
        """Return joints 3, 2, 1 of the fingers (5, 3, 3) at zero angles, hand coordinates, mm."""
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
        palm: further factors on the palm's width, length and thickness: positions of the fingers' bases in x,
            y and z, and width and thickness of the skin between them and the wrist.
        wrist: further factor on the width of the skin around the wrist.
        thumb_place: further factor on the distance of the thumb's base from the wrist along the palm.
        coefficients: of the population's modes, in standard deviations; none for the average hand.
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
    """Return hand_R_thumb: -y along the metacarpal; positive rotation about x sweeps it across the palm."""
    y = -_THUMB_DIRECTION / np.linalg.norm(_THUMB_DIRECTION)
    x = np.cross(-y, _THUMB_BENDS_TOWARDS)
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], axis=1)


# Shape: coefficients of the population's modes, and factors on lengths, which also apply to hands from files

SHAPE_NAMES: tuple[str, ...] = (
    "scale",
    *(f"{finger}_length" for finger in FINGERS),
    *(f"{finger}_width" for finger in FINGERS),
    "palm_width",
    "palm_length",
    "palm_thickness",
    "wrist_width",
    "thumb_place",
)
SHAPE_SIZE = len(SHAPE_NAMES)
_LENGTHS, _WIDTHS = slice(1, 6), slice(6, 11)
MAX_DRAWN, MOST_COEFFICIENT = 2.0, 5.0
"""Largest coefficients, in standard deviations: of random hands, and of any valid hand."""
MOST_PADDING_MM, PADDING_SD_MM = 12.0, 3.0
"""Limit and standard deviation of the skin's extra thickness **[ours]**: images of a Senz3D and a Kinect v2
widen hands by 4 to 7 mm per side, a RealSense by 2."""
_DECIMALS = 4
PerFinger = tuple[float, float, float, float, float]
_ONES: PerFinger = (1.0, 1.0, 1.0, 1.0, 1.0)

POPULATION_SD: FloatArray = np.array([0.08, *[0.05] * 5, *[0.07] * 5, 0.06, 0.03, 0.08, 0.15, 0.3])
"""(16,) standard deviations of the log factors among adults **[ours]**.

Hand length and breadth vary by about 5 per cent within a sex and 6 to 8 overall. Proportions are estimates;
hand models differ most in the thumb's base and the wrist.
"""


@dataclass(frozen=True)
class HandShape:
    """A hand of the population, with factors on its lengths or on those of a hand from a file.

    Coefficients 0 and factors 1 give the average hand, or the file's own.

    Attributes:
        scale: on every length.
        finger_lengths: on each finger's segments, thumb first.
        finger_widths: on each finger's radii, thumb first.
        palm_width: across the palm.
        palm_length: on the palm from the wrist to the knuckles.
        palm_thickness: on the palm from back to front.
        wrist_width: on the skin across the wrist; it moves no bone.
        thumb_place: on the distance of the thumb's base from the wrist along the palm.
        coefficients: of the population's modes, in standard deviations, strongest first; missing ones are 0.
            None for a hand from a file.
        padding_mm: extra thickness of the skin, for sensors that smear edges or for gloves. It moves no bone.
    """

    scale: float = 1.0
    finger_lengths: PerFinger = _ONES
    finger_widths: PerFinger = _ONES
    palm_width: float = 1.0
    palm_length: float = 1.0
    palm_thickness: float = 1.0
    wrist_width: float = 1.0
    thumb_place: float = 1.0
    coefficients: tuple[float, ...] = ()
    padding_mm: float = 0.0

    @property
    def palm(self) -> tuple[float, float, float]:
        """Return factors along the hand's x, y and z."""
        return self.palm_width, self.palm_length, self.palm_thickness

    @property
    def factors(self) -> FloatArray:
        """Return the factors (16,) in the order of ``SHAPE_NAMES``."""
        return np.array(
            [
                self.scale,
                *self.finger_lengths,
                *self.finger_widths,
                *self.palm,
                self.wrist_width,
                self.thumb_place,
            ]
        )

    @classmethod
    def of_factors(cls, factors: FloatArray) -> HandShape:
        """Return the shape for factors (16,) in the order of ``SHAPE_NAMES``."""
        values = [float(factor) for factor in factors]
        lengths, widths = tuple(values[_LENGTHS]), tuple(values[_WIDTHS])
        return cls(values[0], lengths, widths, *values[11:])  # type: ignore[arg-type]


class ShapeSpace(Protocol):
    """Parameters theta of a shape, estimated by a calibration.

    Attributes:
        names: of the parameters.
        sd: (S,) standard deviations among hands; theta 0 is the mean.
        low, high: (S,) bounds.
        steps: (S,) finite-difference steps: a change of about a millimetre.
    """

    names: tuple[str, ...]
    sd: FloatArray
    low: FloatArray
    high: FloatArray
    steps: FloatArray

    def shape(self, theta: FloatArray) -> HandShape:
        """Return the shape for parameters (S,)."""
        ...

    def theta(self, shape: HandShape) -> FloatArray:
        """Return the parameters (S,) of a shape."""
        ...


class FactorSpace:
    """Logarithms of the sixteen factors, for a hand from a file."""

    names = SHAPE_NAMES
    sd = POPULATION_SD
    low, high = np.log([[0.5, *[0.7] * (SHAPE_SIZE - 2), 0.5], [1.6, *[1.4] * (SHAPE_SIZE - 2), 2.5]])
    steps = np.full(SHAPE_SIZE, 0.01)

    def shape(self, theta: FloatArray) -> HandShape:
        """Return the shape for parameters (16,)."""
        return HandShape.of_factors(np.exp(theta))

    def theta(self, shape: HandShape) -> FloatArray:
        """Return the parameters (16,) of a shape."""
        return np.log(shape.factors)


class PopulationSpace:
    """Log scale, the population's coefficients, and the padding.

    Sensors and their filters spread fingers over neighbouring pixels; without the padding only a larger hand
    would cover these.
    """

    names = ("scale", *(f"coefficient_{k + 1}" for k in range(COEFFICIENTS)), "padding_mm")
    sd = np.array([0.12, *[1.0] * COEFFICIENTS, PADDING_SD_MM])
    high = np.array([np.log(2.2), *[4.0] * COEFFICIENTS, MOST_PADDING_MM])
    low = np.array([np.log(0.45), *[-4.0] * COEFFICIENTS, 0.0])
    steps = np.array([0.01, *[0.25] * COEFFICIENTS, 0.5])

    def shape(self, theta: FloatArray) -> HandShape:
        """Return the shape for parameters (26,)."""
        coefficients = tuple(float(c) for c in theta[1:-1])
        return HandShape(float(np.exp(theta[0])), coefficients=coefficients, padding_mm=float(theta[-1]))

    def theta(self, shape: HandShape) -> FloatArray:
        """Return the parameters (26,) of a shape; factors other than the scale are not included."""
        given = np.zeros(COEFFICIENTS)
        given[: len(shape.coefficients)] = shape.coefficients
        return np.concatenate([[np.log(shape.scale)], given, [shape.padding_mm]])


def shape_space(mesh: str | None) -> ShapeSpace:
    """Return the shape parameters of a hand: factors for one from a file, else the population's."""
    return PopulationSpace() if mesh is None else FactorSpace()


def random_shape(rng: np.random.Generator) -> HandShape:
    """Return a random hand of the population with a scale of .85 to 1.15."""
    scale = 1.0 + 0.15 * rng.uniform(-1.0, 1.0)
    drawn = np.clip(rng.normal(size=COEFFICIENTS), -MAX_DRAWN, MAX_DRAWN)
    return HandShape(scale, coefficients=tuple(float(c) for c in drawn.round(_DECIMALS)))


def shape_between(one: HandAnatomy, other: HandAnatomy) -> HandShape:
    """Return the factors from a right hand to another of either side, which differs by factors only."""
    lengths, widths = (
        tuple(float(factor) for factor in after[:, 0] / before[:, 0] * (one.scale / other.scale))
        for before, after in ((one.segments, other.segments), (one.radii, other.radii))
    )
    reach = other.base_positions[0, 1] / one.base_positions[0, 1] * (one.scale / other.scale)
    return HandShape(
        other.scale / one.scale,
        lengths,  # type: ignore[arg-type]
        widths,  # type: ignore[arg-type]
        *other.palm,
        other.wrist,
        float(reach / other.palm[1]),
    )


def reshaped_anatomy(anatomy: HandAnatomy, side: str, shape: HandShape) -> HandAnatomy:
    """Return a right hand's bones with a shape and side, as ``make_anatomy`` does for the average hand."""
    scale = shape.scale
    positions = anatomy.base_positions * shape.palm
    positions[0, 1] *= shape.thumb_place
    turns = anatomy.base_rotations
    if side == "left":
        positions, turns = positions * MIRROR, MIRROR[:, None] * turns * MIRROR
    return HandAnatomy(
        side,
        scale * positions,
        turns,
        scale * anatomy.segments * np.asarray(shape.finger_lengths)[:, None],
        scale * anatomy.radii * np.asarray(shape.finger_widths)[:, None],
        scale * anatomy.scale,
        shape.palm,
        shape.wrist_width,
    )


def reshaped_skin(mesh: SkinnedMesh, anatomy: HandAnatomy, side: str, shape: HandShape) -> SkinnedMesh:
    """Return a right hand's skin at zero angles with a shape and side.

    Every bone stretches its vertices, v' = o' + S (v - o): along itself by the finger's length, across by its
    width, and in the palm by the palm's factors; o and o' are its origin before and after. Linear blend
    skinning joins the bones.

    Args:
        mesh: bound to the 16 bones.
        anatomy: of the mesh's right hand.
        side: ``right`` or ``left``.
        shape: factors.
    """
    narrowed = replace(mesh, vertices=_with_wrist(mesh, anatomy, shape.wrist_width))
    stretched = narrowed.posed(_stretches(anatomy, shape)[None])[0]
    skin = SkinnedMesh(shape.scale * stretched, mesh.weights, mesh.triangles)
    return skin.flipped(MIRROR) if side == "left" else skin


def _with_wrist(mesh: SkinnedMesh, anatomy: HandAnatomy, factor: float) -> FloatArray:
    """Scale the palm's width: fully at the wrist, less towards the knuckles."""
    knuckles = -float(anatomy.base_positions[1:, 1].mean())
    share = mesh.weights[:, 0] * np.clip(1.0 + mesh.vertices[:, 1] / knuckles, 0.0, 1.0)
    vertices = mesh.vertices.copy()
    vertices[:, 0] *= 1.0 + (factor - 1.0) * share
    return vertices


def _stretches(anatomy: HandAnatomy, shape: HandShape) -> FloatArray:
    """Return the affine maps (16, 3, 4) of the bones, without the scale."""
    after = reshaped_anatomy(anatomy, "right", replace(shape, scale=1.0)).rest_origins
    maps = np.zeros((BONE_COUNT, 3, 4))
    maps[0, :, :3] = np.diag(shape.palm)
    for finger, (length, width) in enumerate(zip(shape.finger_lengths, shape.finger_widths, strict=True)):
        frame = anatomy.base_rotations[finger]
        stretch = frame @ np.diag([width, length, width]) @ frame.T
        for bone in range(3):
            at = maps[1 + 3 * finger + bone]
            at[:, :3] = stretch
            at[:, 3] = after[finger, bone] - stretch @ anatomy.rest_origins[finger, bone]
    return maps
