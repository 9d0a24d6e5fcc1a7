"""Persons and their expressions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, MIRRORED, SHAPE_SD
from posetrack_cli.synthesis.head.form import (
    AXIS_Z,
    EYE_MIDDLE,
    MOUTH_X,
    MOUTH_Y,
    POCKET_MM,
    Displacements,
    LidPlaces,
    Relief,
    SkinGrid,
    Sway,
    along_and_above,
    forward,
    lower_edge,
    on_smooth_head,
    pulse,
    random_sway,
    smooth_step,
    upper_edge,
)
from posetrack_cli.synthesis.head.options import TWO_MOTIONS, HeadSynthOptions

# Identity: proportions and looks of a head, drawn from a seed

LIKENESS_MM = 35.0
"""[ours] Correlation length of the landmarks' deviations."""
ASYMMETRY = 0.15
"""[ours] Share of the deviation that is not symmetric."""
MOST_DEVIATION = 2.0
"""Maximum RMS deviation in standard deviations, which excludes extreme faces."""

# Angle from the front, deg, and drop of the hairline, mm, relative to its height in the middle
_ANGLES = np.radians([0.0, 20.0, 38.0, 52.0, 62.0, 72.0, 82.0, 92.0, 105.0, 120.0, 180.0])
_DROP = np.array([0.0, 1.0, 4.0, 12.0, 38.0, 62.0, 92.0, 84.0, 96.0, 150.0, 165.0])


@dataclass(frozen=True)
class Looks:
    """Appearance of a face where no landmark determines it; lengths in mm, tones as reflectance 0 to 1.

    Attributes:
        skin, hair, lips, iris: tones.
        brow_thickness: thickness of the brow at its inner end.
        brow_arch: height of the brow above the line between its ends.
        brow_density: opacity 0 to 1.
        upper_lid, lower_lid: maximum distance of a lid's edge from the line between the eye corners.
        upper_lip, lower_lip: thickness in the middle.
        hairline: height of the hairline above the eyes.
        hair_volume: thickness of the hair.
        stubble: darkness of the beard's shadow, 0 to 1.
        freckles: number of spots.
        wrinkles: depth of wrinkles, 0 to 1.
        texture_seed: seed of all other random structure of the skin.
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
        """Return eye coordinates and lid edges of this face at places (...), mm, of the average head."""
        s, above = along_and_above(x, y)
        return LidPlaces(s, above, upper_edge(s, self.upper_lid), lower_edge(s, self.lower_lid))


@dataclass(frozen=True, eq=False)
class Identity:
    """A person.

    Attributes:
        points: (K, 3) ten landmarks of the neutral face, mm, head's frame.
        relief: relief of the face between them.
        looks: appearance of the skin.
    """

    points: FloatArray = field(default_factory=MEAN_SHAPE.copy)
    relief: Relief = field(default_factory=Relief)
    looks: Looks = field(default_factory=Looks)


def identity_of_seed(seed: int) -> Identity:
    """Return the person of a seed, the same in every recording."""
    shape, looks = np.random.default_rng([seed, 0x68656164]).spawn(2)
    return Identity(random_points(shape), _random_relief(shape), _random_looks(looks))


def random_points(rng: np.random.Generator) -> FloatArray:
    """Draw the ten landmarks (K, 3) of a neutral face, mm, with the origin at the mean of the eye corners.

    Deviations from ``MEAN_SHAPE`` are Gaussian with the standard deviations ``SHAPE_SD``, measured on
    ICT-FaceKit's identities. Their correlation is **[ours]**: exp(-d^2 / (2 l^2)) between points at
    distance d, and nearly symmetric.
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
    """Return deviations (K, 3) of unit variance, correlated between close points."""
    apart = np.linalg.norm(MEAN_SHAPE[:, None] - MEAN_SHAPE[None], axis=-1)
    covariance = np.exp(-0.5 * (apart / LIKENESS_MM) ** 2) + 1e-9 * np.eye(len(MEAN_SHAPE))
    deviation: FloatArray = np.linalg.cholesky(covariance) @ rng.standard_normal(MEAN_SHAPE.shape)
    return deviation


def _symmetric(deviation: FloatArray) -> FloatArray:
    """Return the right half's deviation, mirrored to the left."""
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
    """Return the hair density (...) at places (..., 3) of the average head: 0 none, 1 full."""
    angle = np.abs(np.arctan2(places[..., 0], (places[..., 2] + 82.0)))
    line = looks.hairline - np.interp(angle, _ANGLES, _DROP)
    return smooth_step((places[..., 1] - line) / soft_mm)


# Schedule of expressions: that of the thesis's experiment 3.4, or that of model building.
#
# Free script: after a neutral start the face deforms during the first two thirds of the recording, then only
# the head moves. Model building: first the mouth becomes wide and narrow, then the face long and short (brows
# and jaw together), each slowly and several times. Blinks continue throughout.

NEUTRAL_S, NEUTRAL_PART = 2.0, 0.15
"""Duration of the neutral start, at most this fraction of the recording."""
DEFORMING_PART = 2.0 / 3.0
RISE_S, HOLD_S, FALL_S, REST_S = (0.25, 0.6), (0.2, 1.0), (0.25, 0.6), (0.0, 0.4)
BLINK_EVERY_S, BLINK_S = (2.5, 6.0), (0.06, 0.02, 0.10)
TARGET_MM, TARGET_HZ = (220.0, 120.0, 100.0), (0.1, 0.4)
"""Range of the motion of what the eyes look at, around the reference camera, for a head at 700 mm."""
# Simultaneous expressions, with minimum and maximum strength
_FACES: tuple[dict[str, tuple[float, float]], ...] = (
    {"jaw_open": (0.4, 0.9)},
    {"jaw_open": (0.3, 0.6), "brows_up": (0.5, 1.0)},
    {"smile_right": (0.5, 0.9), "smile_left": (0.5, 0.9)},
    {"smile_right": (0.4, 0.8), "smile_left": (0.4, 0.8), "jaw_open": (0.1, 0.3)},
    {"smile_left": (0.5, 0.9)},
    {"smile_right": (0.5, 0.9)},
    {"mouth_sideways": (0.5, 0.9)},
    {"mouth_sideways": (-0.9, -0.5)},
    {"pucker": (0.5, 1.0)},
    {"brows_up": (0.6, 1.0)},
    {"brows_down": (0.6, 1.0), "pucker": (0.0, 0.4)},
)

# Motions for building face models (thesis, 4.2 and figure 4.4)
STILL_S, STILL_PART = 4.5, 0.3
"""Duration of the neutral start, in which a tracker treats the face as rigid; at most this fraction."""
SWEEP_S, LEAST_SWEEPS = 3.0, 2
"""[ours] Approximate duration of one sweep of a motion, and minimum number of sweeps."""
HOLD_PART = 0.1
"""Fraction of a sweep in which either end of the range is held."""
STRENGTH = (0.8, 1.0)
# Simultaneous expressions at either end of the range
_WIDTH = (("smile_right", "smile_left"), ("pucker",))
_LENGTH = (("jaw_open", "brows_up"), ("brows_down",))


@dataclass(frozen=True)
class Episode:
    """One expression: name, maximum strength, start, and durations of rise, hold and fall, s."""

    name: str
    strength: float
    start: float
    rise: float
    hold: float
    fall: float

    @property
    def end(self) -> float:
        """End, s."""
        return self.start + self.rise + self.hold + self.fall


@dataclass(frozen=True, eq=False)
class ExpressionScript:
    """All expressions of a recording.

    Attributes:
        episodes: in any order; strengths with the same name add up.
        target: motion of the point that the eyes look at, mm in reference axes; None if they look ahead.
    """

    episodes: tuple[Episode, ...]
    target: Sway | None

    def strengths(self, times: FloatArray) -> FloatArray:
        """Return strengths (T, J) of ``EXPRESSIONS`` at times (T,), s."""
        values = np.zeros((len(times), len(EXPRESSIONS)))
        for one in self.episodes:
            shape = pulse(times, one.start, one.rise, one.hold, one.fall)
            values[:, EXPRESSIONS.index(one.name)] += one.strength * shape
        return values


def make_script(options: HeadSynthOptions, rng: np.random.Generator) -> ExpressionScript:
    """Draw the expressions of a recording; without expressions the face is completely still."""
    if not options.expressions:
        return ExpressionScript((), None)
    deforming, blinking, looking = rng.spawn(3)
    duration_s = options.duration_s
    drawn = two_motions if options.script == TWO_MOTIONS else _deformations
    episodes = [*drawn(duration_s, deforming), *_blinks(duration_s, blinking)]
    target = random_sway(np.array(TARGET_MM) * options.distance_mm / 700.0, TARGET_HZ, looking)
    return ExpressionScript(tuple(episodes), target)


def deforming_interval(options: HeadSynthOptions) -> tuple[float, float] | None:
    """Return the interval in which a face deforms, s; None for never."""
    if not options.expressions:
        return None
    of_script = motions_interval if options.script == TWO_MOTIONS else _free_interval
    return of_script(options.duration_s)


def _free_interval(duration_s: float) -> tuple[float, float]:
    return min(NEUTRAL_S, NEUTRAL_PART * duration_s), DEFORMING_PART * duration_s


def _deformations(duration_s: float, rng: np.random.Generator) -> list[Episode]:
    time, end = _free_interval(duration_s)
    order: list[int] = []
    episodes: list[Episode] = []
    while True:
        order = order or rng.permutation(len(_FACES)).tolist()
        rise, hold, fall = (float(rng.uniform(*limits)) for limits in (RISE_S, HOLD_S, FALL_S))
        if time + rise + hold + fall > end:
            return episodes
        for name, limits in _FACES[order.pop()].items():
            episodes.append(Episode(name, float(rng.uniform(*limits)), time, rise, hold, fall))
        time += rise + hold + fall + float(rng.uniform(*REST_S))


def _blinks(duration_s: float, rng: np.random.Generator) -> list[Episode]:
    time, episodes = float(rng.uniform(*BLINK_EVERY_S)), []
    while time < duration_s:
        episodes.append(Episode("blink", 1.0, time, *BLINK_S))
        time += float(rng.uniform(*BLINK_EVERY_S))
    return episodes


def two_motions(duration_s: float, rng: np.random.Generator) -> tuple[Episode, ...]:
    """Return the expressions of a recording for model building, of this duration."""
    start, end = motions_interval(duration_s)
    half = 0.5 * (end - start)
    return (*_sweeps(_WIDTH, start, half, rng), *_sweeps(_LENGTH, start + half, half, rng))


def motions_interval(duration_s: float) -> tuple[float, float]:
    """Return the interval in which the face moves, s."""
    return min(STILL_S, STILL_PART * duration_s), duration_s


def _sweeps(
    motion: tuple[tuple[str, ...], ...], start: float, length: float, rng: np.random.Generator
) -> Iterator[Episode]:
    """Yield one motion: each sweep goes to one end and back, then to the other and back."""
    count = max(LEAST_SWEEPS, round(length / SWEEP_S))
    time, part = start, length / (count * len(motion))
    hold = HOLD_PART * part
    way = 0.5 * (part - hold)
    for _ in range(count):
        for together in motion:
            strength = float(rng.uniform(*STRENGTH))
            for name in together:
                yield Episode(name, strength, time, way, hold, way)
            time += part


# Deformation: expressions as displacements of the skin, linear in their strengths

EXPRESSIONS = (
    "jaw_open",
    "smile_right",
    "smile_left",
    "mouth_sideways",
    "pucker",
    "brows_up",
    "brows_down",
    "blink",
)
"""Names of the strengths, 0 (neutral) to 1, or -1 to 1 for ``BOTH_WAYS``, positive to the subject's left.

A blink does not deform the skin: lids are painted (``synthesis.head.eyes``).
"""
BOTH_WAYS = ("mouth_sideways",)

MOTION_REACH_MM = 26.0
HINGE = np.array([-14.0, AXIS_Z])  # y, z of the jaw axis, mm
JAW_RAD = float(np.radians(16.4))
Anchors = list[tuple[float, float, float, float, float]]

# x, y of a place; its displacement in x, y, z at full strength, mm. Magnitudes as measured on ICT-FaceKit's
# expressions: mouth corners 17.5 with open jaw, 15.6 in a smile, 18 sideways, 11 in a pucker; brows 4.5.
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


def displacements(places: FloatArray, below: FloatArray) -> FloatArray:
    """Return the displacements of every expression except blinks (J - 1, ..., 3), mm at full strength.

    Args:
        places: (..., 3) on the average head, mm.
        below: (...) 1 where the skin moves with the lower side of the mouth, 0 with the upper.
    """
    xy = places[..., :2]
    front = np.clip((places[..., 2] - AXIS_Z) / 40.0, 0.0, 1.0)[..., None]
    front = front * (1.0 - on_eyeball(places))
    fields = [
        _jaw(places, below),
        _mirrored(_field(_SMILE), xy),
        _field(_SMILE)(xy),
        _field(_SIDEWAYS)(xy),
        _field(_PUCKER)(xy),
        _field(_BROWS_UP)(xy),
        _field(_BROWS_DOWN)(xy),
    ]
    return np.stack([front * field for field in fields])


def belongs_below(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the share (...) of a place that moves with the lower side of the mouth.

    A step at the lips; beyond the corners of the mouth a slope that widens.
    """
    beyond = np.maximum(np.abs(x) - MOUTH_X, 0.0)
    return smooth_step((MOUTH_Y - y) / np.maximum(1.1 * beyond, 1e-9) * 0.5 + 0.5)


def _field(anchors: Anchors) -> Displacements:
    """Return the field of the anchors, with eyes, nostrils and other fixed places held still."""
    fixed: Anchors = [(float(x), float(y), 0, 0, 0) for x, y, _ in [*MEAN_SHAPE[EYES], *MEAN_SHAPE[6:8]]]
    named = {(x, y) for x, y, *_ in anchors}
    table = np.array([*anchors, *(a for a in [*_STILL, *fixed] if a[:2] not in named)])
    return Displacements(table[:, :2], table[:, 2:], MOTION_REACH_MM)


def _mirrored(field: Displacements, xy: FloatArray) -> FloatArray:
    mirrored: FloatArray = field(xy * [-1.0, 1.0]) * [-1.0, 1.0, 1.0]
    return mirrored


def _jaw(places: FloatArray, below: FloatArray) -> FloatArray:
    """Return the rotation of the lower face about the jaw axis; mouth corners and cheeks follow partly."""
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
    """Return the displacement in y and z of points (..., 2), relative to an axis, rotated downwards."""
    y, z = hung[..., 0], hung[..., 1]
    return (cosine - 1.0) * y - sine * z, sine * y + (cosine - 1.0) * z


# Renderable head: neutral skin, displacements by expressions, and the ten true landmarks

REACH_MM = 30.0
BALL_MM = 12.0
ON_BALL_MM = (7.5, 11.0)
"""Distance from the middle of the opening up to which skin lies on the eyeball, and where it has left it."""
EAR_MIDDLE = np.array([72.0, -16.0, -88.0])
EAR_MM = np.array([7.0, 31.0, 17.0])


@dataclass(frozen=True, eq=False)
class Person:
    """Head that deforms linearly: skin = neutral + sum_j strength_j moved_j.

    Attributes:
        surface: the neutral face without hair.
        neutral: (R, C, 3) vertices of ``form``, mm, head's frame.
        moved: (J - 1, R, C, 3) displacement by each of ``EXPRESSIONS`` but the blink at full strength, mm.
        points: (K, 3) landmarks of the neutral face, on the skin.
        points_moved: (J - 1, K, 3) their displacements.
        ears: right and left, vertex grids, mm.
    """

    surface: FaceSurface
    neutral: FloatArray
    moved: FloatArray
    points: FloatArray
    points_moved: FloatArray
    ears: tuple[FloatArray, FloatArray]

    def skin(self, strengths: FloatArray) -> FloatArray:
        """Return vertices (R, C, 3), mm, for strengths (J,)."""
        skin: FloatArray = self.neutral + np.tensordot(strengths[:-1], self.moved, axes=1)
        return skin

    def shape(self, strengths: FloatArray) -> FloatArray:
        """Return landmarks (..., K, 3), mm, for strengths (..., J)."""
        shape: FloatArray = self.points + np.tensordot(strengths[..., :-1], self.points_moved, axes=1)
        return shape


def make_person(identity: Identity, grid: SkinGrid) -> Person:
    """Return the head of an identity."""
    surface = FaceSurface(identity)
    depth = np.zeros(grid.places.shape)
    depth[grid.inside, :, 2] = _pocket_depth(grid)
    vertices = surface(grid.places, depth) + _hair(grid, identity)
    faced = _with_face(grid.places, identity) - depth
    ten = _with_face(_ten_places(), identity)
    return Person(
        surface,
        vertices,
        displacements(faced, _below(grid)),
        surface(_ten_places()),
        displacements(ten, belongs_below(ten[:, 0], ten[:, 1])),
        (surface.warped(ear_vertices(-1.0)), surface.warped(ear_vertices(1.0))),
    )


class FaceSurface:
    """Skin of a person's neutral face; around the pupils it lies on the eyeballs.

    Attributes:
        eyeballs: (2, 3) centres of the right and left eyeball, mm in the head's frame.
    """

    def __init__(self, identity: Identity) -> None:
        self._identity = identity
        self._warp = _Proportions(_with_face(_ten_places(), identity), identity.points)
        pupils = np.array([[side * EYE_MIDDLE[0], EYE_MIDDLE[1]] for side in (-1.0, 1.0)])
        flat = on_smooth_head(pupils[:, 0], pupils[:, 1])
        self.eyeballs: FloatArray = self.warped(_with_face(flat, identity)) - [0.0, 0.0, BALL_MM]

    def __call__(self, places: FloatArray, depth: FloatArray | float = 0.0) -> FloatArray:
        """Return the skin (..., 3), mm, at places (..., 3) of the smooth average head, less a depth."""
        skin = self.warped(_with_face(places, self._identity) - depth)
        for eyeball in self.eyeballs:
            off = skin[..., :2] - eyeball[:2]
            ball = eyeball[2] + np.sqrt(np.maximum(BALL_MM**2 - np.square(off).sum(axis=-1), 0.0))
            share = on_eyeball(places) * (np.sign(places[..., 0]) == np.sign(eyeball[0]))[..., None]
            skin[..., 2] += share[..., 0] * (ball - skin[..., 2])
        return skin

    def warped(self, places: FloatArray) -> FloatArray:
        """Return places (..., 3) of an average head in this person's proportions."""
        return self._warp(places)


def on_eyeball(places: FloatArray) -> FloatArray:
    """Return the share (..., 1) of the skin that lies on an eyeball, at places of the average head."""
    near, far = ON_BALL_MM
    away = np.hypot(np.abs(places[..., 0]) - EYE_MIDDLE[0], places[..., 1] - EYE_MIDDLE[1])
    return ((places[..., 2] > AXIS_Z) * smooth_step((far - away) / (far - near)))[..., None]


def _ten_places() -> FloatArray:
    """Return the landmarks (K, 3) on the smooth average head."""
    return on_smooth_head(MEAN_SHAPE[:, 0], MEAN_SHAPE[:, 1])


def _with_face(places: FloatArray, identity: Identity) -> FloatArray:
    """Add the face's relief, which fades towards the sides, to places (..., 3) of the smooth head."""
    faced = places.copy()
    facing = np.clip((places[..., 2] + 70.0) / 40.0, 0.0, 1.0)
    faced[..., 2] += facing * forward(places[..., 0], places[..., 1], identity.relief)
    return faced


class _Proportions:
    """Warp of the average head to given landmarks: scaling, then a smooth displacement."""

    def __init__(self, ten: FloatArray, wanted: FloatArray) -> None:
        self._factors = np.ones(3)
        for axis in (0, 1):
            self._factors[axis] = np.sum(ten[:, axis] * wanted[:, axis]) / np.sum(ten[:, axis] ** 2)
        self._factors[2] = np.sqrt(self._factors[0] * self._factors[1])
        self._bend = Displacements(ten, wanted - ten * self._factors, REACH_MM)

    def __call__(self, places: FloatArray) -> FloatArray:
        moved: FloatArray = places * self._factors + self._bend(places)
        return moved


def _pocket_depth(grid: SkinGrid) -> FloatArray:
    """Return the depth (rows inside, C), mm, of the pocket behind the lips; 0 at the mouth corners."""
    x = grid.places[grid.inside, :, 0]
    front = grid.places[grid.inside, :, 2] > 0.0
    across = np.sqrt(np.clip(1.0 - (x / MOUTH_X) ** 2, 0.0, 1.0)) * front
    depth: FloatArray = POCKET_MM * np.sin(np.pi * grid.pocket[grid.inside])[:, None] ** 0.6 * across
    return depth


def _below(grid: SkinGrid) -> FloatArray:
    """Return the share (R, C) of each vertex that moves with the lower jaw."""
    x, y = grid.places[..., 0], grid.places[..., 1]
    share = belongs_below(x, y)
    between = (np.abs(x) < MOUTH_X - 1e-9) & (np.abs(y - MOUTH_Y) < 1e-9) & (grid.places[..., 2] > 0.0)
    rows = np.broadcast_to(smooth_step((grid.pocket - 0.35) / 0.3)[:, None], share.shape)
    return np.where(between, rows, share)


def _hair(grid: SkinGrid, identity: Identity) -> FloatArray:
    """Return the displacement (R, C, 3) by the hair, away from the head's centre."""
    share = hair_share(grid.places, identity.looks, soft_mm=30.0)
    outward = grid.places - np.array([0.0, 20.0, -80.0])
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    displacement: FloatArray = identity.looks.hair_volume * share[..., None] * outward
    return displacement


def ear_vertices(side: float) -> FloatArray:
    """Return the grid (13, 25, 3) of an ear, mm, head's frame; side 1 is the subject's left, -1 right."""
    across = np.linspace(-np.pi, np.pi, 25)[None, :]
    down = np.linspace(0.5 * np.pi, -0.5 * np.pi, 13)[:, None]
    y, z = np.broadcast_arrays(np.sin(down), np.cos(down) * np.cos(across))
    x = np.cos(down) * np.sin(across)
    rim = 1.0 - 0.75 * np.exp(-0.5 * ((np.hypot(y, 1.3 * z)) / 0.45) ** 2)  # hollow in the middle
    ear = np.stack([x * rim, y, z - 0.2 * y], axis=-1) * EAR_MM
    ear[..., 0] += 0.3 * np.maximum(-ear[..., 2], 0.0)
    placed: FloatArray = (ear + EAR_MIDDLE) * [side, 1.0, 1.0]
    return placed
