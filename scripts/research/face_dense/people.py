"""Random faces: identity, expression, gaze."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from research.face_dense.mesh import LANDMARKS, FaceKit

SPEECH = (
    "jawOpen",
    "mouthFunnel",
    "mouthPucker",
    "mouthClose",
    "mouthShrugUpper",
    "mouthShrugLower",
    "mouthRollUpper",
    "mouthRollLower",
    "mouthLeft",
    "mouthRight",
    "jawLeft",
    "jawRight",
    "jawForward",
)
PAIRS = (
    "mouthSmile",
    "mouthFrown",
    "mouthStretch",
    "mouthUpperUp",
    "mouthLowerDown",
    "mouthPress",
    "mouthDimple",
    "noseSneer",
    "cheekPuff",
    "cheekSquint",
)
BROWS = ("browDown", "browInnerUp", "browOuterUp")
LIDS = ([37, 38, 40, 41], [43, 44, 46, 47])
BALL_MM = 12.0
"""Radius of an eyeball."""
LOOK_FULL_RAD = (0.55, 0.45)
"""Gaze, to the side and up, at which the lids have moved by the full expression ``eyeLook...``."""


@dataclass(frozen=True, eq=False)
class Face:
    """One face in the head's frame, mm.

    Attributes:
        vertices: (V, 3).
        landmarks: (68, 3).
        eyes: (2, 3) centres of the right and left eyeball, ``BALL_MM`` behind its front: the model's spheres
            are larger than eyes, and not tied to the lids.
        gazes: (2, 3) unit vectors.
    """

    vertices: FloatArray
    landmarks: FloatArray
    eyes: FloatArray
    gazes: FloatArray


def random_identity(kit: FaceKit, rng: np.random.Generator) -> FloatArray:
    """Return a neutral face (V, 3), its origin between the eyes."""
    weights = rng.standard_normal(len(kit.identities)).astype(np.float32)
    face = kit.neutral + np.tensordot(weights, kit.identities, axes=1)
    centred: FloatArray = face - face[LANDMARKS[[36, 39, 42, 45]]].mean(axis=0)
    return centred


def random_pupils(rng: np.random.Generator) -> float:
    """Return how far a person's pupils are above the middle of the lids when they look ahead, mm."""
    return float(rng.normal(0.5, 0.4))


def random_face(kit: FaceKit, identity: FloatArray, pupils_mm: float, rng: np.random.Generator) -> Face:
    """Return a face with a random expression and gaze, given a neutral face and ``random_pupils``."""
    gazes = random_gazes(rng)
    side, up = np.arctan2(gazes[:, 0], gazes[:, 2]).mean(), np.arcsin(gazes[0, 1])
    weights = random_expression(rng) | _looking(side, up)
    moved = sum((weight * kit.expressions[name] for name, weight in weights.items()), np.zeros_like(identity))
    vertices = identity + moved
    centres = np.empty((2, 3))
    for index, ball in enumerate(kit.eyeballs):
        vertices[ball] = identity[ball]
        centres[index] = _sphere_centre(identity[ball])
        centres[index, 1] = identity[LANDMARKS[LIDS[index]], 1].mean() + pupils_mm
        centres[index, 2] = identity[ball, 2].max() - BALL_MM
    return Face(vertices, vertices[LANDMARKS], centres, gazes)


def random_gazes(rng: np.random.Generator) -> FloatArray:
    """Return directions (2, 3) of the right and left eye in the head's axes."""
    side, up = rng.normal(0.0, 0.22), rng.normal(0.0, 0.15)
    gazes = []
    for squint in (0.03, -0.03):
        x, y = np.clip([side + rng.uniform(0.0, 1.0) * squint, up], -0.6, 0.6)
        gazes.append([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)])
    return np.array(gazes)


def random_expression(rng: np.random.Generator) -> dict[str, float]:
    """Return weights by name: speech and grimaces, blinks, brows, each at rest in a part of the faces."""
    weights: dict[str, float] = {}
    if rng.random() < 0.8:
        for name in rng.choice(SPEECH, rng.integers(1, 5), replace=False):
            weights[name] = rng.uniform(0.0, 1.0)
        if rng.random() < 0.6:
            weights["jawOpen"] = rng.uniform(0.0, 1.0) ** 1.3 * 1.2
        if rng.random() < 0.5:
            weights["mouthClose"] = 0.0
        for name in rng.choice(PAIRS, rng.integers(0, 4), replace=False):
            _pair(weights, name, rng.uniform(0.0, 1.1), rng)
    if rng.random() < 0.6:
        for name in rng.choice(BROWS, rng.integers(1, 3), replace=False):
            _pair(weights, name, rng.uniform(0.0, 1.3), rng)
    kind = rng.random()
    blink = rng.uniform(0.85, 1.1) if kind < 0.25 else rng.uniform(0.0, 0.9) if kind < 0.55 else 0.0
    _pair(weights, "eyeBlink", blink, rng, alike=0.9)
    if kind > 0.8:
        _pair(weights, "eyeWide" if rng.random() < 0.5 else "eyeSquint", rng.uniform(0.0, 1.0), rng)
    return weights


def _pair(
    weights: dict[str, float], name: str, weight: float, rng: np.random.Generator, alike: float = 0.7
) -> None:
    """Set an expression on both sides, equally in a share ``alike`` of the faces."""
    other = weight if rng.random() < alike else weight * rng.uniform(0.0, 1.0)
    first, second = ("_L", "_R") if rng.random() < 0.5 else ("_R", "_L")
    weights[name + first], weights[name + second] = weight, other


def _looking(side: float, up: float) -> dict[str, float]:
    """Return the lids' weights for a gaze to the subject's left and up, rad."""
    to_side, vertical = abs(side) / LOOK_FULL_RAD[0], abs(up) / LOOK_FULL_RAD[1]
    out, into = ("L", "R") if side > 0.0 else ("R", "L")
    level = "Up" if up > 0.0 else "Down"
    return {
        f"eyeLookOut_{out}": to_side,
        f"eyeLookIn_{into}": to_side,
        f"eyeLook{level}_L": vertical,
        f"eyeLook{level}_R": vertical,
    }


def _sphere_centre(points: FloatArray) -> FloatArray:
    """Return the centre of the sphere through points (N, 3), by least squares."""
    system = np.column_stack([2.0 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(system, np.square(points).sum(axis=1), rcond=None)[0]
    centre: FloatArray = solution[:3]
    return centre
