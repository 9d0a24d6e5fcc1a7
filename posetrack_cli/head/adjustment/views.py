"""What is adjusted: frames in which a person was seen, and what is thought of the person."""

from __future__ import annotations

from dataclasses import dataclass

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.pose import HeadPose


@dataclass(frozen=True, eq=False)
class PointView:
    """One frame with its feature points.

    Attributes:
        stamp_ns: of the frame.
        pixels: (K, 2) m^, where the points are on the image, as recorded (with the lens's distortion).
        weights: (K,) 0 to 1, how far each is believed; 0 leaves it out.
        pose: p, start or result of an adjustment.
        deformation: (A,) a, likewise.
    """

    stamp_ns: int
    pixels: FloatArray
    weights: FloatArray
    pose: HeadPose
    deformation: FloatArray


@dataclass(frozen=True, eq=False)
class Person:
    """What does not change from frame to frame.

    Attributes:
        identity: (S,) s.
        offsets: (K, 3) mm in the head's frame: how far each image feature lies from the model's point,
            constant **[ours]**; the corner that a camera sees is not the vertex that the model has.
    """

    identity: FloatArray
    offsets: FloatArray


@dataclass(frozen=True, eq=False)
class Adjusted:
    """What an adjustment came to.

    Attributes:
        views: with adjusted poses and deformations, in the order given.
        person: adjusted.
        cost: F with priors, half a sum of squares, at the end.
        residuals: (n, K) length of each point's error, pixels; NaN where its weight is 0.
        iterations: steps taken in all.
        identity_deviations: (S,) posterior standard deviations of s, from the Hessian at the end with poses,
            deformations and offsets eliminated; those of the model's people where the person was held, NaN
            where nobody asked for them.
    """

    views: tuple[PointView, ...]
    person: Person
    cost: float
    residuals: FloatArray
    iterations: int
    identity_deviations: FloatArray
