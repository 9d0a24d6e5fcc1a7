"""Anatomy of a hand: bones, joint axes and limits, size and proportions, modes in which people differ."""

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

# What hands are like: the mean hand and the ways in which hands differ, learned from people.
#
# ``population.npz`` is built by ``scripts/build hand-model`` from the skins and joints of hundreds of drawn
# people (`scripts/research/README.md`). A hand is the mean plus modes times coefficients, all of
# them in lengths of a hand of 179 mm from the wrist to the middle finger's tip. Coefficients are in standard
# deviations: among people each is normal, of mean 0 and variance 1, and independent of the others.


SHIPPED = Path(__file__).with_name("population.npz")
HAND_LENGTH_MM = 179.0
"""From the wrist to the tip of the straight middle finger, where its skin ends, at scale 1: the mean of women
and men."""
COEFFICIENTS = 24
"""How many coefficients the hand that is shipped has."""


class RestHand(NamedTuple):
    """A right hand of scale 1 at zero angles, hand coordinates, mm.

    Attributes:
        cage: (C, 3) points of the skin; a smooth surface goes through them.
        bases: (5, 3) where each finger's joint 3 sits.
        segments: (5, 3) lengths from joint 3 to 2, 2 to 1, 1 to the tip.
        radii: (5, 4) of the fingers at the three joints and near the tip.
    """

    cage: FloatArray
    bases: FloatArray
    segments: FloatArray
    radii: FloatArray


@dataclass(frozen=True, eq=False)
class Population:
    """Mean and modes of hands, and the cage that their skins share.

    Attributes:
        mean: (D,) a ``RestHand`` after another, flattened.
        modes: (K, D) what one standard deviation of each coefficient adds.
        weights: (C, 16) skinning weights of the cage.
        triangles: (T, 3) of the cage.
    """

    mean: FloatArray
    modes: FloatArray
    weights: FloatArray
    triangles: IntArray

    def hand(self, coefficients: Sequence[float] = ()) -> RestHand:
        """Return the hand of up to K coefficients; those that are not given are 0."""
        c = np.asarray(coefficients, dtype=np.float64)
        row = self.mean + c @ self.modes[: c.size]
        ends = np.cumsum([3 * len(self.weights), 15, 15])
        cage, bases, segments, radii = np.split(row, ends)
        return RestHand(cage.reshape(-1, 3), bases.reshape(5, 3), segments.reshape(5, 3), radii.reshape(5, 4))


@functools.cache
def population() -> Population:
    """Return the people's hands that are shipped."""
    with SHIPPED.open("rb") as stream:
        arrays = read_npz(stream)
    mean, modes, weights = (arrays[name].astype(np.float64) for name in ("mean", "modes", "weights"))
    return Population(mean, modes, weights, arrays["triangles"].astype(np.int64))


# The hand's bones: names, lengths, rest frames, joint limits, for the right hand.
#
# Hand coordinates: origin at the wrist; with the identity rotation the fingers point up in the image
# (-y), the palm faces the sensor (-z) and the thumb of a right hand points to +x. A left hand is the
# mirror image x -> -x; its angles mean the same anatomical motion.
#
# Angles (hand.md, appendix A.1 of the paper), 15 of them, radians: for the thumb joint 3 (CMC) about x and
# z, joint 2 (MCP) about x; for each finger joint 3 (MCP) about x and z, joint 2 (PIP) about x. About x,
# positive bends towards the palm; about z, positive moves towards the thumb's side. Joint 1 is not free: half
# of joint 2's x angle. In the paper it is the thumb's joint 2 that turns about z, too; a thumb abducts at its
# saddle joint, about an axis of the metacarpal **[ours]**.


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


# What hands differ by: coefficients of the population's modes, and factors on the lengths of a hand.
#
# The average hand becomes another of the population by its coefficients. Factors reshape any hand, one from a
# file too, of which nothing is known but its bones and its skin.


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
MOST_DRAWN, MOST_COEFFICIENT = 2.0, 5.0
"""Standard deviations from the average: of hands that are drawn, and of any that can be meant."""
MOST_PADDING_MM, PADDING_SD_MM = 12.0, 3.0
"""By how much skin may stand out, and what is usual **[ours]**: hands are 4 to 7 mm wider on each side than
their lengths tell in images of a Senz3D (CVAR P1, P4, P7) and a Kinect v2, 2 of a RealSense, 0 to 1.3 among
the synthetic strangers. With 5 for 3 all come out the same; with 2 wider hands are taken for longer ones."""
_DECIMALS = 4
PerFinger = tuple[float, float, float, float, float]
_ONES: PerFinger = (1.0, 1.0, 1.0, 1.0, 1.0)

POPULATION_SD: FloatArray = np.array([0.08, *[0.05] * 5, *[0.07] * 5, 0.06, 0.03, 0.08, 0.15, 0.3])
"""(16,) standard deviations of the factors' logarithms among adults **[ours]**.

The length and the breadth of adult hands vary by some 5 per cent within a sex and by 6 to 8 over both.
Proportions are guessed; where the thumb begins and how the wrist narrows is what hand models differ most in.
"""


@dataclass(frozen=True)
class HandShape:
    """Which hand of the population, and factors on its lengths, or on those of a hand from a file.

    Coefficients 0 and factors 1 are the average hand, or that of the file, itself.

    Attributes:
        scale: on every length.
        finger_lengths: further, on each finger's segments, thumb first.
        finger_widths: further, on each finger's radii, thumb first.
        palm_width: further, on the palm across.
        palm_length: further, on the palm from the wrist to the knuckles.
        palm_thickness: further, on the palm from its back to its front.
        wrist_width: further, on the skin around the wrist across; no bone moves with it.
        thumb_place: further, on the distance of the thumb's base from the wrist along the palm.
        coefficients: of the population's modes, in standard deviations, strongest first; those that are not
            given are 0. Of a hand from a file there are none.
        padding_mm: by how much the skin stands out: hands are wider in the images of a sensor that smears
            edges, or in gloves, than they are. No bone moves with it.
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
        """Factors along the hand's x, y and z."""
        return self.palm_width, self.palm_length, self.palm_thickness

    @property
    def factors(self) -> FloatArray:
        """(16,) in the order of ``SHAPE_NAMES``."""
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
        """The shape of (16,) factors in the order of ``SHAPE_NAMES``."""
        values = [float(factor) for factor in factors]
        lengths, widths = tuple(values[_LENGTHS]), tuple(values[_WIDTHS])
        return cls(values[0], lengths, widths, *values[11:])  # type: ignore[arg-type]


class ShapeSpace(Protocol):
    """Numbers theta that stand for a shape, of which a calibration finds the likeliest.

    Attributes:
        names: of the numbers.
        sd: (S,) standard deviations among hands; theta 0 is the mean.
        low, high: (S,) bounds.
        steps: (S,) differences for derivatives: a change of a millimetre or so.
    """

    names: tuple[str, ...]
    sd: FloatArray
    low: FloatArray
    high: FloatArray
    steps: FloatArray

    def shape(self, theta: FloatArray) -> HandShape:
        """The shape that numbers (S,) stand for."""
        ...

    def theta(self, shape: HandShape) -> FloatArray:
        """The numbers (S,) of a shape."""
        ...


class FactorSpace:
    """Logarithms of the sixteen factors: how a hand from a file may differ from the one that is tracked."""

    names = SHAPE_NAMES
    sd = POPULATION_SD
    low, high = np.log([[0.5, *[0.7] * (SHAPE_SIZE - 2), 0.5], [1.6, *[1.4] * (SHAPE_SIZE - 2), 2.5]])
    steps = np.full(SHAPE_SIZE, 0.01)

    def shape(self, theta: FloatArray) -> HandShape:
        """The shape that numbers (16,) stand for."""
        return HandShape.of_factors(np.exp(theta))

    def theta(self, shape: HandShape) -> FloatArray:
        """The numbers (16,) of a shape."""
        return np.log(shape.factors)


class PopulationSpace:
    """The logarithm of the scale, the population's coefficients, the padding: how images of hands differ.

    Sensors and their filters spread a finger over the pixels beside it. Without the padding, whatever covers
    these would be a larger hand.
    """

    names = ("scale", *(f"coefficient_{k + 1}" for k in range(COEFFICIENTS)), "padding_mm")
    sd = np.array([0.12, *[1.0] * COEFFICIENTS, PADDING_SD_MM])
    high = np.array([np.log(2.2), *[4.0] * COEFFICIENTS, MOST_PADDING_MM])
    low = np.array([np.log(0.45), *[-4.0] * COEFFICIENTS, 0.0])
    steps = np.array([0.01, *[0.25] * COEFFICIENTS, 0.5])

    def shape(self, theta: FloatArray) -> HandShape:
        """The shape that numbers (26,) stand for."""
        coefficients = tuple(float(c) for c in theta[1:-1])
        return HandShape(float(np.exp(theta[0])), coefficients=coefficients, padding_mm=float(theta[-1]))

    def theta(self, shape: HandShape) -> FloatArray:
        """The numbers (26,) of a shape; its factors but the scale are not among them."""
        given = np.zeros(COEFFICIENTS)
        given[: len(shape.coefficients)] = shape.coefficients
        return np.concatenate([[np.log(shape.scale)], given, [shape.padding_mm]])


def shape_space(mesh: str | None) -> ShapeSpace:
    """Return what is unknown of a hand: of a file's its factors, else which of the population it is."""
    return PopulationSpace() if mesh is None else FactorSpace()


def random_shape(rng: np.random.Generator) -> HandShape:
    """A hand of the population, of a scale of .85 to 1.15."""
    scale = 1.0 + 0.15 * rng.uniform(-1.0, 1.0)
    drawn = np.clip(rng.normal(size=COEFFICIENTS), -MOST_DRAWN, MOST_DRAWN)
    return HandShape(scale, coefficients=tuple(float(c) for c in drawn.round(_DECIMALS)))


def shape_between(one: HandAnatomy, other: HandAnatomy) -> HandShape:
    """The factors that take a right hand to another, of either side, that differs by factors alone."""
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
    """The bones of a right hand in a shape, on a side; as ``make_anatomy`` does with the average hand's."""
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
    """The skin of a right hand at zero angles in a shape, on a side.

    Every bone stretches what is bound to it, v' = o' + S (v - o): along itself by the finger's length, across
    by its width, and in the palm by the palm's factors; o and o' are where it begins before and after.
    Linear blend skinning joins them.

    Args:
        mesh: bound to the 16 bones.
        anatomy: of the right hand that it is the skin of.
        side: ``right`` or ``left``.
        shape: factors.
    """
    narrowed = replace(mesh, vertices=_with_wrist(mesh, anatomy, shape.wrist_width))
    stretched = narrowed.posed(_stretches(anatomy, shape)[None])[0]
    skin = SkinnedMesh(shape.scale * stretched, mesh.weights, mesh.triangles)
    return skin.flipped(MIRROR) if side == "left" else skin


def _with_wrist(mesh: SkinnedMesh, anatomy: HandAnatomy, factor: float) -> FloatArray:
    """Vertices with the palm's widths multiplied: fully at the wrist, less towards the knuckles."""
    knuckles = -float(anatomy.base_positions[1:, 1].mean())
    share = mesh.weights[:, 0] * np.clip(1.0 + mesh.vertices[:, 1] / knuckles, 0.0, 1.0)
    vertices = mesh.vertices.copy()
    vertices[:, 0] *= 1.0 + (factor - 1.0) * share
    return vertices


def _stretches(anatomy: HandAnatomy, shape: HandShape) -> FloatArray:
    """The affine maps (16, 3, 4) of the bones, without the scale."""
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
