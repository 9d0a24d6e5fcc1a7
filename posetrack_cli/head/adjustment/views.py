"""What is adjusted: frames in which a person was seen, and which of them are kept.

Those that are adjusted together show the face in different directions (thesis, 4.3.2). They are few, and
change. For an adjustment over a whole recording an album keeps the frames of every direction that the face
was seen in whose points looked most like themselves **[ours]**.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.face.scaling import scaled_pixels


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

    def seen_larger(self, ratio: float) -> PointView:
        """Return the frame as an image shows it that is so many times as large."""
        return replace(self, pixels=scaled_pixels(self.pixels, ratio))


@dataclass(frozen=True, eq=False)
class PersonParameters:
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
    person: PersonParameters
    cost: float
    residuals: FloatArray
    iterations: int
    identity_deviations: FloatArray


CELL_DEG = 5.0
"""Directions are told apart in cells of so many degrees of yaw and pitch."""
PER_CELL = 2
"""Frames kept of a cell: one view's error must not count for a direction alone."""


@dataclass(frozen=True, eq=False)
class Album:
    """The frames kept.

    Attributes:
        pages: by cell, frames with their scores, the best first.
    """

    pages: Mapping[tuple[int, int], tuple[tuple[float, PointView], ...]] = field(default_factory=dict)

    @property
    def views(self) -> tuple[PointView, ...]:
        """All frames, in the order of their time."""
        kept = (view for page in self.pages.values() for _, view in page)
        return tuple(sorted(kept, key=lambda view: view.stamp_ns))

    def sample(self, count: int) -> tuple[PointView, ...]:
        """Return ``count`` frames evenly spread over the kept ones, all if there are no more."""
        views = self.views
        if len(views) <= count:
            return views
        return tuple(views[i] for i in np.linspace(0, len(views) - 1, count).astype(int))

    def seen_larger(self, ratio: float) -> Album:
        """Return the same frames as images show them that are so many times as large."""
        return Album(
            {
                cell: tuple((score, view.seen_larger(ratio)) for score, view in page)
                for cell, page in self.pages.items()
            }
        )

    def with_view(self, view: PointView, score: float) -> Album:
        """Return the album with a frame, if none better shows that direction."""
        cell = _cell(view.pose.facing)
        page = sorted((*self.pages.get(cell, ()), (score, view)), key=lambda one: -one[0])
        return Album({**self.pages, cell: tuple(page[:PER_CELL])})


def _cell(facing: FloatArray) -> tuple[int, int]:
    """The cell of a direction (3,): yaw and pitch from the camera's axis."""
    yaw, pitch = np.degrees(angles_of(facing))
    return round(yaw / CELL_DEG), round(pitch / CELL_DEG)


def angles_of(facing: FloatArray) -> FloatArray:
    """Return yaw and pitch (..., 2), rad, of directions (..., 3) from the camera's axis."""
    yaw = np.arctan2(facing[..., 0], -facing[..., 2])
    return np.stack([yaw, np.arcsin(np.clip(facing[..., 1], -1.0, 1.0))], axis=-1)


def choose_views(
    views: Sequence[PointView], new: PointView, count: int, *, by_angles: bool = False
) -> tuple[PointView, ...]:
    """Return the frames for the next adjustment; the new one is the last.

    While there are fewer than ``count`` it is added. Then it replaces one: that without which the directions
    of the others and the new one vary most, ``spread``, or their angles, yaw and pitch. Of equal ones
    the oldest in order goes.

    Args:
        views: frames of the last adjustment.
        new: the present frame.
        count: n, at least 1.
        by_angles: as printed (4.3.2), not by directions.
    """
    kept = list(views)
    while len(kept) >= count:
        facing = matrices_from_quaternions(np.array([view.pose.quaternion for view in (*kept, new)]))[..., 2]
        spreads = angle_variances_without(facing) if by_angles else spreads_without(facing)
        del kept[int(np.argmax(spreads[:-1]))]
    return (*kept, new)


def spread(facing: FloatArray) -> float:
    """Return the variance of directions: the sum of the variances of unit vectors' components **[ours]**.

    It is 1 - |mean|^2, 0 for equal directions; about the variance of yaw plus that of pitch, rad^2, where
    they are small, and unlike that the same however the camera is turned.

    Args:
        facing: (n, 3) unit vectors.
    """
    mean = facing.mean(axis=0)
    return float(1.0 - mean @ mean)


def spreads_without(facing: FloatArray) -> FloatArray:
    """Return (n,) the spread of the others without each of n >= 2 directions (n, 3); time linear in n."""
    means = (facing.sum(axis=0) - facing) / (len(facing) - 1)
    spreads: FloatArray = 1.0 - np.einsum("ni,ni->n", means, means)
    return spreads


def angle_variances_without(facing: FloatArray) -> FloatArray:
    """Return (n,) the variance of yaw plus that of pitch, rad^2, without each of n >= 2 directions (n, 3)."""
    angles = angles_of(facing)
    return np.array([np.delete(angles, i, axis=0).var(axis=0).sum() for i in range(len(angles))])
