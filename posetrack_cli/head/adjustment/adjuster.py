"""Incremental bundle adjustment of one camera: which views, and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import (
    Camera,
    distortion_jacobian,
    largest_radius,
    normalised_from_pixels,
    pixels_from_normalised,
)
from posetrack_cli.geometry.rotations import canonical, exponential, matrices_from_quaternions, multiply
from posetrack_cli.head.adjustment.descent import adjust_in_stages, all_lengths, identity_variances
from posetrack_cli.head.adjustment.problem import POSE, Boxes, Part, Problem, Unknowns, cost
from posetrack_cli.head.config import AdjustmentSettings, PointSettings
from posetrack_cli.head.face.points import HeadPose, of_kinds, scaled_pixels
from posetrack_cli.head.multilinear.face_model import FaceModel

# What is adjusted: frames in which a person was seen, and which of them are kept.
#
# Those that are adjusted together show the face in different directions (thesis, 4.3.2). They are few, and
# change. For an adjustment over a whole recording an album keeps the frames of every direction that the face
# was seen in whose points looked most like themselves **[ours]**.


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

    def rescaled(self, ratio: float) -> PointView:
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

    def rescaled(self, ratio: float) -> Album:
        """Return the same frames as images show them that are so many times as large."""
        return Album(
            {
                cell: tuple((score, view.rescaled(ratio)) for score, view in page)
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


# Bundle adjustment of n views with a separated face model: poses, deformations, one person (thesis, 4.3).
#
# What the kernels read is whitened, and the lens is removed from it.


OFFSET_SD_MM = of_kinds(
    eyes=(1.8, 1.4, 2.0), mouth=(2.5, 1.4, 2.0), nostrils=(2.8, 1.4, 5.0), brows=(2.1, 1.4, 3.5)
)
"""(K, 3) standard deviations, in the head's frame, of how far what the camera sees of a point lies from the
model's vertex, always alike."""
STEP = np.array([20.0, 20.0, 60.0, 0.2, 0.2, 0.1])
"""(6,) lambda_p, how far one adjustment moves a pose: mm along camera x, y, z; rad about them."""
DEFORMATION_STEP, IDENTITY_STEP = 1.0, 0.5
"""lambda_a and lambda_s, the same in standard deviations; the latter is less, as a person does not change."""
UNDISTORTED_PX = 1e-3
"""A pixel whose ray the lens does not put back there to within this has no ray."""


@dataclass(frozen=True, eq=False)
class Adjuster:
    """Adjusts a person, and the views that one camera took of the person, to each other.

    Attributes:
        model: what faces are like.
        camera: that saw them, with its lens; must be the reference camera.
        settings: of the adjustment.
    """

    model: FaceModel
    camera: Camera
    settings: AdjustmentSettings

    @cached_property
    def over_recording(self) -> Adjuster:
        """The adjuster of frames of a whole recording, whose points err less alike."""
        sd = self.settings.pixel_sd
        share = {name: value * self.settings.whole_share for name, value in sd.model_dump().items()}
        closer = self.settings.model_copy(update={"pixel_sd": PointSettings(**share)})
        return replace(self, settings=closer)

    def adjust(
        self,
        views: Sequence[PointView],
        person: PersonParameters,
        *,
        iterations: int,
        hold_person: bool = False,
        wide: bool = False,
        deviations: bool = True,
    ) -> Adjusted:
        """Adjust views and person to each other, (4.29)-(4.37).

        Stage 1 moves the poses only; stage 2 poses, deformations, identity and, with ``settings.offsets``,
        the constant offsets of points **[ours]**. What is minimised stands in ``head.adjustment.problem``:
        Huber's function of residuals instead of their squares, and priors, are **[ours]**. The result's cost
        is never above that of the start (moved into its bounds, should it be outside).

        Args:
            views: n frames with start poses and deformations; points without weight or pixel are left out.
            person: start.
            iterations: steps of each of the two stages at most; fewer where F falls no more.
            hold_person: leave identity and offsets as they are, also where they are out of bounds.
            wide: no bounds about the start, only those about the mean of identity and deformation.
            deviations: whether to tell the identity's; NaN without.
        """
        problem = self.problem(views)
        start = self.start(views, person)
        boxes = self.boxes(start, wide)
        unknowns = clipped(start, boxes)
        if hold_person:
            unknowns = Unknowns(unknowns.local, start.shared)
        shared = 0 if hold_person else self._shared_size
        taken = adjust_in_stages(problem, boxes, unknowns, iterations, shared)
        everything = Part(0, len(views), unknowns.local.shape[1], shared)
        return Adjusted(
            self._views(views, unknowns, problem),
            person if hold_person else self._person(unknowns, problem),
            cost(problem, unknowns, everything),
            self._residuals(problem, unknowns),
            taken,
            self._deviations(problem, unknowns, everything)
            if deviations
            else np.full(self.model.identity_size, np.nan),
        )

    def problem(self, views: Sequence[PointView]) -> Problem:
        """Return what is minimised, with the views' poses as start.

        Residuals are taken between rays and brought to recorded pixels by the lens's derivative at the
        observed point: the lens is undone once. Points without weight, pixel or ray are left out.
        """
        model, settings = self.model, self.settings
        count = len(views), len(model.mean)
        pixels = np.array([view.pixels for view in views], dtype=np.float64).reshape(*count, 2)
        weights = np.array([view.weights for view in views], dtype=np.float64).reshape(count)
        rays, seen = self._rays(pixels)
        used = seen & np.isfinite(weights) & (weights > 0.0)
        identity, deformation = model.identity_deviations, model.deformation_deviations
        quaternions = np.array([view.pose.quaternion for view in views], dtype=np.float64).reshape(-1, 4)
        return Problem(
            np.array(model.mean, dtype=np.float64),  # its own: for numba read-only is another type
            np.ascontiguousarray(model.core * (identity[:, None] * deformation)),
            model.identity_mean / identity,
            model.deformation_mean / deformation,
            OFFSET_SD_MM,
            np.ascontiguousarray(matrices_from_quaternions(quaternions)),
            np.array([view.pose.position for view in views], dtype=np.float64).reshape(-1, 3),
            np.ascontiguousarray(np.where(used[..., None], rays, 0.0)),
            self._scales(rays, used),
            np.where(used, weights, 0.0),
            float(settings.huber),
            float(settings.prior),
        )

    def start(self, views: Sequence[PointView], person: PersonParameters) -> Unknowns:
        """Return the start: the views' own poses, deformations and the person, whitened."""
        model, offsets = self.model, person.offsets / OFFSET_SD_MM
        local = np.zeros((len(views), POSE + model.deformation_size))
        for row, view in zip(local, views, strict=True):
            row[POSE:] = view.deformation
        local[:, POSE:] /= model.deformation_deviations
        local[:, POSE:] -= model.deformation_mean / model.deformation_deviations
        identity = person.identity / model.identity_deviations
        identity -= model.identity_mean / model.identity_deviations
        return Unknowns(local, np.concatenate([identity, offsets.ravel()]))

    def boxes(self, start: Unknowns, wide: bool) -> Boxes:
        """Return C_p, C_a and C_s, (4.31), (4.35), (4.37); offsets have no bounds.

        A start farther out than ``bound`` is taken for one at the bound. ``wide`` drops the bounds about the
        start.
        """
        bound, who = self.settings.bound, slice(self.model.identity_size)
        local, shared = np.full_like(start.local, np.inf), np.full_like(start.shared, np.inf)
        boxes = Boxes(-local, local, -shared, shared)
        if not wide:
            boxes.local_lower[:, :POSE], boxes.local_upper[:, :POSE] = -STEP, STEP
        lower, upper = boxes.local_lower[:, POSE:], boxes.local_upper[:, POSE:]
        for values, around, lowest, highest in (
            (start.local[:, POSE:], DEFORMATION_STEP, lower, upper),
            (start.shared[who], IDENTITY_STEP, boxes.shared_lower[who], boxes.shared_upper[who]),
        ):
            reach = np.inf if wide else around
            inside = np.clip(values, -bound, bound)  # the start must lie within its bounds
            np.clip(inside - reach, -bound, bound, out=lowest)
            np.clip(inside + reach, -bound, bound, out=highest)
        return boxes

    @property
    def _shared_size(self) -> int:
        """How many unknowns the views share."""
        return self.model.identity_size + (self.model.mean.size if self.settings.offsets else 0)

    def _rays(self, pixels: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return rays (n, K, 2) of pixels, and (n, K) which pixels have one."""
        camera = self.camera
        finite = np.isfinite(pixels[..., 0]) & np.isfinite(pixels[..., 1])
        known = np.where(finite[..., None], pixels, [camera.cx, camera.cy])
        if not camera.is_distorted:
            return normalised_from_pixels(camera, known), finite
        with np.errstate(all="ignore"):
            rays = normalised_from_pixels(camera, known)
            back = pixels_from_normalised(camera, rays)
            same: BoolArray = np.abs(back - known).max(axis=-1) < UNDISTORTED_PX
            same &= np.hypot(rays[..., 0], rays[..., 1]) < largest_radius(camera)
        return rays, finite & same

    def _scales(self, rays: FloatArray, used: BoolArray) -> FloatArray:
        """Return (n, K, 2, 2) d pixel / d ray at the rays, in units of each point's standard deviation."""
        scales = np.zeros((*used.shape, 2, 2))
        focal = np.array([[self.camera.fx], [self.camera.fy]])
        if self.camera.is_distorted:
            at = np.where(used[..., None], rays, 0.0)
            lens = np.stack(distortion_jacobian(self.camera, at[..., 0], at[..., 1]), axis=-1)
            scales[:] = lens.reshape(*used.shape, 2, 2) * focal
        else:
            scales[:] = np.eye(2) * focal
        scales /= self.settings.pixel_sd.values[:, None, None]
        return scales

    def _views(
        self, views: Sequence[PointView], unknowns: Unknowns, problem: Problem
    ) -> tuple[PointView, ...]:
        """Return the views with adjusted poses and deformations."""
        tangents, whitened = unknowns.local[:, :POSE], unknowns.local[:, POSE:]
        deformations = (whitened + problem.deformation_centre) * self.model.deformation_deviations
        before = np.array([view.pose.quaternion for view in views]).reshape(-1, 4)
        quaternions = canonical(multiply(exponential(tangents[:, 3:]), before))
        positions = problem.positions + tangents[:, :3]
        return tuple(
            replace(view, pose=HeadPose(position, quaternion), deformation=deformation)
            for view, position, quaternion, deformation in zip(
                views, positions, quaternions, deformations, strict=True
            )
        )

    def _person(self, unknowns: Unknowns, problem: Problem) -> PersonParameters:
        """Return the adjusted person."""
        size = self.model.identity_size
        identity = (unknowns.shared[:size] + problem.identity_centre) * self.model.identity_deviations
        return PersonParameters(identity, unknowns.shared[size:].reshape(-1, 3) * problem.offset_deviations)

    def _residuals(self, problem: Problem, unknowns: Unknowns) -> FloatArray:
        """Return (n, K) lengths of errors, recorded pixels."""
        lengths, sd = np.empty(problem.weights.shape), self.settings.pixel_sd.values
        all_lengths(problem, unknowns, lengths)
        pixels: FloatArray = np.where(problem.weights > 0.0, lengths * sd, np.nan)
        return pixels

    def _deviations(self, problem: Problem, unknowns: Unknowns, part: Part) -> FloatArray:
        """Return (S,) posterior standard deviations of s."""
        if part.shared == 0:
            return self.model.identity_deviations
        variances = np.empty(self.model.identity_size)
        identity_variances(problem, unknowns, part, variances)
        deviations: FloatArray = np.sqrt(variances) * self.model.identity_deviations
        return deviations


def clipped(start: Unknowns, boxes: Boxes) -> Unknowns:
    """Return the start within its boxes, (4.27)."""
    return Unknowns(
        np.clip(start.local, boxes.local_lower, boxes.local_upper),
        np.clip(start.shared, boxes.shared_lower, boxes.shared_upper),
    )
