"""The face model learned while tracking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.rigid import rigid_alignment
from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.face.points import HeadPose, ShapeModel, rigid_model
from posetrack_cli.head.face.templates import WINDOW, TemplateSet, angle_deg

# Where a face went from one frame to the next as a whole, when its points were lost **[ours]**.
#
# Ten small patches follow a head that moves as was expected. Where it moves by more than they reach, the
# surroundings of all of them together, which are nearly all of a face, still say how far: of all shifts the
# one is taken under which the windows about the points in the frame before correlate best with the image, on
# average. Each may then be a little beside its place, as they are where a head turns, comes nearer or moves
# its mouth; where each is best tells of the turn.


REDUCED = 2
"""Images and windows are looked at at half their size: a pixel more or less is no matter for a start."""
REACH_PX = 96
"""The longest shift along an axis: a little more than the eyes' distance in images as they are reduced."""
SLACK = 5
"""Reduced pixels by which a point may go another way than the whole along an axis: an eighth of that
distance, as in a turn by some 20 degrees within a frame."""


class Shift(NamedTuple):
    """How a face moved in an image.

    Attributes:
        pixels: (2,) x and y.
        likeness: mean correlation there, -1 to 1, each window's the best within its slack.
        places: (K, 2) pixels of the points where these are; NaN of a point that was not seen before.
        likenesses: (K,) the correlations, 0 where they are below or the point was not seen before.
    """

    pixels: FloatArray
    likeness: float
    places: FloatArray
    likenesses: FloatArray


def shift_of(image: ImageArray, templates: TemplateSet, pixels: FloatArray) -> Shift | None:
    """Return where a face went, None where no point of it was seen before.

    Args:
        image: (height, width) grey, of the one camera.
        templates: of the frame before.
        pixels: (K, 2) where its points were then.
    """
    seen = np.flatnonzero(templates.seen[0])
    if not len(seen):
        return None
    margin = (REACH_PX + WINDOW) // REDUCED
    small = cv2.resize(image, None, fx=1.0 / REDUCED, fy=1.0 / REDUCED, interpolation=cv2.INTER_AREA)
    wide = cv2.copyMakeBorder(small, margin, margin, margin, margin, cv2.BORDER_REPLICATE)
    corners = np.rint((pixels - templates.centres[0]) / REDUCED).astype(int)
    corners = np.clip(corners, 0, np.array(small.shape[::-1]) - WINDOW // REDUCED)
    each = [_likeness(wide, templates.windows[0, k], corners[k] + margin) for k in seen]
    near = np.ones((2 * SLACK + 1, 2 * SLACK + 1), np.uint8)
    mean = np.mean([cv2.dilate(one, near) for one in each], axis=0)
    roughly = np.array(np.unravel_index(int(np.argmax(mean)), mean.shape))
    middle = np.rint(np.median(_best_near(each, roughly), axis=0)).astype(int)
    places, likenesses = np.full(pixels.shape, np.nan), np.zeros(len(pixels))
    best = _best_near(each, middle)
    places[seen] = pixels[seen] + _moved(best)
    likenesses[seen] = [
        max(float(one[row, column]), 0.0) for one, (row, column) in zip(each, best, strict=True)
    ]
    return Shift(_moved(middle), float(mean[tuple(roughly)]), places, likenesses)


def _best_near(each: Sequence[Float32Array], place: IntArray) -> IntArray:
    """Return the row and column (n, 2), within the slack of a place, where each of n maps is greatest."""
    first, found = np.maximum(place - SLACK, 0), []
    for one in each:
        part = one[first[0] : place[0] + SLACK + 1, first[1] : place[1] + SLACK + 1]
        found.append(first + np.unravel_index(int(np.argmax(part)), part.shape))
    return np.array(found)


def _moved(places: IntArray) -> FloatArray:
    """Return the shifts (..., 2), pixels along x and y, of rows and columns in a map of likenesses."""
    shifts: FloatArray = REDUCED * places[..., ::-1].astype(np.float64) - REACH_PX
    return shifts


def _likeness(wide: ImageArray, window: ImageArray, corner: IntArray) -> Float32Array:
    """Return the correlations of a window with an image under all shifts from its corner."""
    side, reach = WINDOW // REDUCED, REACH_PX // REDUCED
    template = cv2.resize(window, (side, side), interpolation=cv2.INTER_AREA)
    left, top = int(corner[0]) - reach, int(corner[1]) - reach
    around = wide[top : top + side + 2 * reach, left : left + side + 2 * reach]
    return np.asarray(cv2.matchTemplate(around, template, cv2.TM_CCOEFF_NORMED), dtype=np.float32)


# What a face's shape is learnt from, when, and how (thesis, 3.2.4).
#
# Principal components of shapes that come one by one: CCIPCA (Weng, Zhang and Hwang 2003).
#
#     Mbar_t = (t-1)/t Mbar_{t-1} + 1/t M'_t                                                        (3.20)
#     v_j    = (t-1)/t v_j + 1/t u (u . v_j/|v_j|)                                                  (3.24)
#     u     <- u - (u . v_j/|v_j|) v_j/|v_j|,    u = M'_t - Mbar_t at first                         (3.25)
#
# for j = 1..B in turn. v_j goes to +-lambda_j x_j, an eigenvalue times its eigenvector. A component begins as
# the first residue that is left for it. Time and memory of an update depend on K and B alone.


MEAN_RATE = 0.02
"""Of the mean shape per frame while it is refined; a running average at first."""
FACING_DEG = 25.0
"""Learnt from are frames whose face is turned from the camera by less ..."""
LEAST_MM, MOST_MM = 3.0, 40.0
"""... and whose shape is so far from the mean (length of 3K numbers): farther, a point left its feature."""


@dataclass(frozen=True, eq=False)
class FaceLearning:
    """One face's model while it is learnt.

    Attributes:
        statistics: mean and principal components so far.
        frames: in which the face was tracked since it was first found.
        settings: when and what is learnt.
        found: the shape that was found first, rigid; only where the first frames are tracked with it
            (``rigid_phase = "printed"``).
    """

    statistics: Ccipca
    frames: int
    settings: ModelSettings
    found: ShapeModel | None = None

    @property
    def model(self) -> ShapeModel:
        """The model that the next frame is tracked with; the same object until it changes."""
        is_rigid = self.settings.kind == "rigid"
        if self.found is not None and (is_rigid or self.frames < self.settings.rigid_frames):
            return self.found
        return self.statistics.rigid if is_rigid else self.statistics.model

    def after(
        self,
        places: FloatArray,
        weights: FloatArray,
        pose: HeadPose,
        correlations: FloatArray,
        expected: FloatArray,
    ) -> FaceLearning:
        """Return what is known after a tracked frame.

        The points' own places hold what the pose is wrong by, too: where they are ``align_above_mm`` from the
        model's, they are laid on the mean shape first. The first ``rigid_frames`` frames refine that mean,
        exponentially forgetting the start's **[ours]**; later ones are learnt from as deformations. With
        ``rigid_phase = "printed"`` so are the first ones, and M'_1 to M'_t of all clear frames make the mean.

        Args:
            places: (K, 3) M', mm.
            weights: (K,) how much each point counts in laying them on the mean.
            pose: of the head.
            correlations: (K,) of each point's patches, the best camera's.
            expected: (K, 3) M, the shape that the model has in this frame, mm.
        """
        settings = self.settings
        later = replace(self, frames=self.frames + 1)
        if off_axis_deg(pose) > FACING_DEG or not np.all(correlations > settings.correlation):
            return later
        shape = places
        if np.linalg.norm(places - expected) >= settings.align_above_mm:
            R, t = rigid_alignment(places, self.statistics.mean, weights)
            shape = places @ R.T + t
        if self.found is None and self.frames < settings.rigid_frames:
            return replace(later, statistics=replace(self.statistics, mean=self._refined_mean(shape)))
        distance = float(np.linalg.norm(shape - self.statistics.mean))
        if settings.kind != "rigid" and LEAST_MM < distance < MOST_MM:
            return replace(later, statistics=self.statistics.updated(shape))
        if self.found is not None:
            return replace(later, statistics=self.statistics.averaged(shape))
        return later

    def _refined_mean(self, shape: FloatArray) -> FloatArray:
        """A running average first, which forgets once ``MEAN_RATE`` is more than its own weight."""
        rate = max(MEAN_RATE, 1.0 / (self.frames + 1))
        mean: FloatArray = self.statistics.mean + rate * (shape - self.statistics.mean)
        return mean


def new_face(shape: FloatArray, settings: ModelSettings) -> FaceLearning:
    """Return what is known of a face (K, 3), mm, that was just found: its shape, which does not deform."""
    if settings.rigid_phase == "printed":  # M'_1 is the first sample of (3.20)
        statistics = untrained_statistics(shape, settings.components, mean_count=1)
        return FaceLearning(statistics, 0, settings, rigid_model(shape))
    statistics = untrained_statistics(shape, settings.components, mean_count=settings.rigid_frames)
    return FaceLearning(statistics, 0, settings)


def off_axis_deg(pose: HeadPose) -> float:
    """Return the angle, degrees, between the direction out of the face and that to the reference camera."""
    towards = -pose.position / np.linalg.norm(pose.position)
    return angle_deg(pose.facing, towards)


NOTHING_MM = 1e-9
"""A residue shorter than this has no direction and begins no component."""


@dataclass(frozen=True, eq=False)
class Ccipca:
    """What was learnt of a face's deformations so far.

    Attributes:
        mean: (K, 3) Mbar_t, mm.
        components: (B, 3K) v_j = lambda_j x_j, mm^2, nearly orthogonal; zero where none has begun.
        variance: mean of |M' - Mbar|^2, mm^2: the sum of all 3K eigenvalues.
        count: t, samples seen, with those that the mean began with.
        learnt: samples seen since.
    """

    mean: FloatArray
    components: FloatArray
    variance: float = 0.0
    count: int = 0
    learnt: int = 0

    def averaged(self, shape: FloatArray) -> Ccipca:
        """Return the state whose mean has another shape M' (K, 3), mm; (3.20)."""
        count = self.count + 1
        return replace(self, mean=self.mean + (shape - self.mean) / count, count=count)

    def updated(self, shape: FloatArray) -> Ccipca:
        """Return the state after another shape M' (K, 3), mm; (3.20), (3.24), (3.25)."""
        after, learnt = self.averaged(shape), self.learnt + 1
        residue = (shape - after.mean).ravel()
        variance = self.variance + (float(residue @ residue) - self.variance) / learnt
        components = self.components.copy()
        for component in components:
            residue = _learn(component, residue, learnt)
        return replace(after, components=components, variance=variance, learnt=learnt)

    @property
    def eigenvalues(self) -> FloatArray:
        """(B,) |v_j|, mm^2, descending."""
        return np.sort(np.linalg.norm(self.components, axis=1))[::-1]

    @property
    def contribution(self) -> FloatArray:
        """(B,) cumulative contribution ratio: share of the variance that the first 1..B components hold.

        Zeros before anything was learnt. Eigenvalues and variance are both running estimates, so that the
        ratio may pass 1 by a little at first; it is cut there.
        """
        if not self.variance > 0.0:
            return np.zeros(len(self.components))
        return np.minimum(np.cumsum(self.eigenvalues) / self.variance, 1.0)

    @cached_property
    def rigid(self) -> ShapeModel:
        """The mean as a face that does not deform."""
        return rigid_model(self.mean)

    @cached_property
    def model(self) -> ShapeModel:
        """The shape model (3.1): mean, begun components by descending eigenvalue, mu = sqrt of eigenvalues.

        The v_j are orthogonal in the limit only: the basis is made so in that order (Gram-Schmidt).
        """
        lengths = np.linalg.norm(self.components, axis=1)
        order = [j for j in np.argsort(-lengths, kind="stable") if lengths[j] > 0.0]
        if not order:
            return ShapeModel(self.mean, np.zeros((*self.mean.shape, 0)), np.zeros(0))
        basis, triangle = np.linalg.qr((self.components[order] / lengths[order, None]).T)
        basis *= np.where(np.diagonal(triangle) < 0.0, -1.0, 1.0)
        return ShapeModel(self.mean, basis.reshape(*self.mean.shape, -1), np.sqrt(lengths[order]))


def untrained_statistics(mean: FloatArray, components: int, mean_count: int = 0) -> Ccipca:
    """Return the state before any deformation was seen.

    Args:
        mean: (K, 3) shape so far, mm.
        components: B.
        mean_count: how many samples that mean counts for **[ours]**; with 0, as printed, the first shape
            replaces it, and is itself no deformation.
    """
    return Ccipca(np.array(mean, dtype=np.float64), np.zeros((components, mean.size)), count=mean_count)


def _learn(component: FloatArray, residue: FloatArray, t: int) -> FloatArray:
    """Update one v_j in place by u, (3.24), and return what is left for the next, (3.25)."""
    length = float(np.linalg.norm(component))
    if length == 0.0:
        if np.linalg.norm(residue) > NOTHING_MM:
            component += residue * (float(np.linalg.norm(residue)) / t)
        return np.zeros_like(residue)
    component += (residue * (float(residue @ component) / length) - component) / t
    direction = component / np.linalg.norm(component)
    left: FloatArray = residue - (residue @ direction) * direction
    return left
