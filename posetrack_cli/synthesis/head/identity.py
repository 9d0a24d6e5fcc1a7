"""Who is seen: proportions and looks of a head, drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, MIRRORED, SHAPE_SD
from posetrack_cli.synthesis.head.form import LidPlaces, Relief, along_and_above, lower_edge, upper_edge
from posetrack_cli.synthesis.head.smooth import smooth_step

LIKENESS_MM = 35.0
"""[ours] Distance over which neighbouring points of a face deviate alike."""
ASYMMETRY = 0.15
"""[ours] Share of the deviation that the two halves of a face do not have in common."""
MOST_DEVIATION = 2.0
"""Deviations are drawn within so many standard deviations, all together: no face is a freak."""

# angle from the front, deg: the hairline's height, mm, relative to its height in the middle
_ANGLES = np.radians([0.0, 20.0, 38.0, 52.0, 62.0, 72.0, 82.0, 92.0, 105.0, 120.0, 180.0])
_DROP = np.array([0.0, 1.0, 4.0, 12.0, 38.0, 62.0, 92.0, 84.0, 96.0, 150.0, 165.0])


@dataclass(frozen=True)
class Looks:
    """What a face looks like where no feature point says so; lengths mm, tones are reflectances 0 to 1.

    Attributes:
        skin, hair, lips, iris: tones.
        brow_thickness: of the brow at its inner end.
        brow_arch: how far the brow rises above the line between its ends.
        brow_density: opacity 0 to 1.
        upper_lid, lower_lid: greatest distance of a lid's edge from the line between the eye's corners.
        upper_lip, lower_lip: thickness in the middle.
        hairline: height of the hair's edge above the eyes.
        hair_volume: how far the hair stands off.
        stubble: darkness 0 to 1 of the beard's shadow.
        freckles: number of spots.
        wrinkles: depth 0 to 1 of the lines of the skin.
        texture_seed: of everything else that is random about the skin.
    """

    skin: float = 0.62
    hair: float = 0.16
    lips: float = 0.40
    iris: float = 0.16
    brow_thickness: float = 8.0
    brow_arch: float = 4.0
    brow_density: float = 0.8
    upper_lid: float = 5.6
    lower_lid: float = 3.8
    upper_lip: float = 7.0
    lower_lip: float = 9.0
    hairline: float = 74.0
    hair_volume: float = 7.0
    stubble: float = 0.1
    freckles: int = 60
    wrinkles: float = 0.5
    texture_seed: int = 0

    def lids(self, x: FloatArray, y: FloatArray) -> LidPlaces:
        """Return where places (...), mm, of the average head lie at the lids of this face."""
        s, above = along_and_above(x, y)
        return LidPlaces(s, above, upper_edge(s, self.upper_lid), lower_edge(s, self.lower_lid))


@dataclass(frozen=True, eq=False)
class Identity:
    """A person.

    Attributes:
        points: (K, 3) the ten feature points of the neutral face, mm, head's frame.
        relief: of the face between them.
        looks: of the skin.
    """

    points: FloatArray = field(default_factory=MEAN_SHAPE.copy)
    relief: Relief = field(default_factory=Relief)
    looks: Looks = field(default_factory=Looks)


def identity_of_seed(seed: int) -> Identity:
    """Return the person of a seed; the same seed is the same person in every recording."""
    shape, looks = np.random.default_rng([seed, 0x68656164]).spawn(2)
    return Identity(random_points(shape), _random_relief(shape), _random_looks(looks))


def random_points(rng: np.random.Generator) -> FloatArray:
    """Draw the ten points (K, 3) of a neutral face, mm, with the origin at the mean of the eye corners.

    Deviations from ``MEAN_SHAPE`` are Gaussian with the standard deviations ``SHAPE_SD``, measured on
    ICT-FaceKit's identities. How they hang together is **[ours]**: exp(-d^2 / (2 l^2)) between points at
    distance d, and nearly the same on both sides.
    """
    while True:
        common, apart = (_smooth_deviation(rng) for _ in range(2))
        common = _symmetric(common)
        deviation = np.sqrt(1.0 - ASYMMETRY**2) * common + ASYMMETRY * apart
        if float(np.sqrt(np.mean(deviation**2))) < MOST_DEVIATION:
            break
    points: FloatArray = MEAN_SHAPE + SHAPE_SD * deviation
    centred: FloatArray = points - points[EYES].mean(axis=0)
    return centred


def _smooth_deviation(rng: np.random.Generator) -> FloatArray:
    """(K, 3) of unit variance, alike where points are close together."""
    apart = np.linalg.norm(MEAN_SHAPE[:, None] - MEAN_SHAPE[None], axis=-1)
    covariance = np.exp(-0.5 * (apart / LIKENESS_MM) ** 2) + 1e-9 * np.eye(len(MEAN_SHAPE))
    deviation: FloatArray = np.linalg.cholesky(covariance) @ rng.standard_normal(MEAN_SHAPE.shape)
    return deviation


def _symmetric(deviation: FloatArray) -> FloatArray:
    """The right half's deviation, and its mirror image on the left."""
    mirrored = deviation[list(MIRRORED)] * [-1.0, 1.0, 1.0]
    right = MEAN_SHAPE[:, 0] < 0.0
    both: FloatArray = np.where(right[:, None], deviation, mirrored)
    return both


def _random_relief(rng: np.random.Generator) -> Relief:
    return Relief(
        nose=rng.uniform(0.8, 1.15),
        nose_width=rng.uniform(0.9, 1.2),
        lips=rng.uniform(0.7, 1.25),
        bones=rng.uniform(0.8, 1.2),
    )


def _random_looks(rng: np.random.Generator) -> Looks:
    skin = rng.uniform(0.42, 0.70)
    return Looks(
        skin=skin,
        hair=rng.uniform(0.07, 0.26),
        lips=skin * rng.uniform(0.55, 0.72),
        iris=rng.uniform(0.06, 0.22),
        brow_thickness=rng.uniform(6.5, 9.5),
        brow_arch=rng.uniform(2.0, 5.5),
        brow_density=rng.uniform(0.65, 0.9),
        upper_lid=rng.uniform(4.8, 6.2),
        lower_lid=rng.uniform(3.3, 4.3),
        upper_lip=rng.uniform(5.0, 8.0),
        lower_lip=rng.uniform(7.0, 10.0),
        hairline=rng.uniform(66.0, 80.0),
        hair_volume=rng.uniform(3.0, 12.0),
        stubble=max(0.0, rng.uniform(-0.5, 0.45)),
        freckles=int(rng.integers(10, 160)),
        wrinkles=rng.uniform(0.2, 0.9),
        texture_seed=int(rng.integers(2**31)),
    )


def hair_share(places: FloatArray, looks: Looks, *, soft_mm: float = 8.0) -> FloatArray:
    """Return how much hair (...) grows at places (..., 3) of the average head: 0 none, 1 full."""
    angle = np.abs(np.arctan2(places[..., 0], (places[..., 2] + 82.0)))
    line = looks.hairline - np.interp(angle, _ANGLES, _DROP)
    return smooth_step((places[..., 1] - line) / soft_mm)
