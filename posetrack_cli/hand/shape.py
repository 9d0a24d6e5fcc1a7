"""What hands differ by: coefficients of the population's modes, and factors on the lengths of a hand.

The average hand becomes another of the population by its coefficients. Factors reshape any hand, one from a
file too, of which nothing is known but its bones and its skin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.anatomy import BONE_COUNT, FINGERS, MIRROR, HandAnatomy
from posetrack_cli.hand.population import COEFFICIENTS
from posetrack_cli.rendering.mesh import SkinnedMesh

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
