"""Incremental bundle adjustment with one camera: selection of frames, and the adjustment itself."""

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
from posetrack_cli.head.adjustment.descent import adjust_in_stages, identity_variances, residual_lengths
from posetrack_cli.head.adjustment.problem import POSE, Boxes, Part, Problem, Unknowns, cost
from posetrack_cli.head.config import AdjustmentSettings, PointSettings
from posetrack_cli.head.face.points import HeadPose, of_kinds, scaled_pixels
from posetrack_cli.head.multilinear.face_model import FaceModel

# Frames to adjust. The few that are adjusted together show the face from different directions (thesis,
# 4.3.2). For an adjustment over the whole recording, an album keeps the best frames of every direction
# **[ours]**.


@dataclass(frozen=True, eq=False)
class PointView:
    """A frame with its feature points.

    Attributes:
        stamp_ns: of the frame.
        pixels: (K, 2) m^, in the image, with lens distortion.
        weights: (K,) of the points, 0 to 1; 0 excludes a point.
        pose: p, start or result of an adjustment.
        deformation: (A,) a, likewise.
    """

    stamp_ns: int
    pixels: FloatArray
    weights: FloatArray
    pose: HeadPose
    deformation: FloatArray

    def rescaled(self, ratio: float) -> PointView:
        """Return the frame for an image scaled by a ratio."""
        return replace(self, pixels=scaled_pixels(self.pixels, ratio))


@dataclass(frozen=True, eq=False)
class PersonParameters:
    """Parameters of a person, constant over all frames.

    Attributes:
        identity: (S,) s.
        offsets: (K, 3) mm in the head's frame, constant offset of each image feature from the model's point
            **[ours]**: a detected corner is not exactly the model's vertex.
    """

    identity: FloatArray
    offsets: FloatArray


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Result of an adjustment.

    Attributes:
        views: with adjusted poses and deformations, in the order given.
        person: adjusted.
        cost: final F with priors, half a sum of squares.
        residuals: (n, K) error of each point, pixels; NaN where its weight is 0.
        iterations: total number of steps.
        identity_deviations: (S,) posterior standard deviations of s, from the final Hessian with poses,
            deformations and offsets eliminated; those of the model if the person was fixed, NaN if not
            requested.
    """

    views: tuple[PointView, ...]
    person: PersonParameters
    cost: float
    residuals: FloatArray
    iterations: int
    identity_deviations: FloatArray


CELL_DEG = 5.0
"""Size of a direction cell, degrees of yaw and pitch."""
PER_CELL = 2
"""Frames kept per cell: the error of a single view must not represent a direction."""


@dataclass(frozen=True, eq=False)
class Album:
    """Frames from all directions.

    Attributes:
        pages: by cell, frames with their scores, the best first.
    """

    pages: Mapping[tuple[int, int], tuple[tuple[float, PointView], ...]] = field(default_factory=dict)

    @property
    def views(self) -> tuple[PointView, ...]:
        """All frames, in the order of time."""
        kept = (view for page in self.pages.values() for _, view in page)
        return tuple(sorted(kept, key=lambda view: view.stamp_ns))

    def sample(self, count: int) -> tuple[PointView, ...]:
        """Return up to ``count`` frames, evenly spaced over the album."""
        views = self.views
        if len(views) <= count:
            return views
        return tuple(views[i] for i in np.linspace(0, len(views) - 1, count).astype(int))

    def rescaled(self, ratio: float) -> Album:
        """Return the frames for images scaled by a ratio."""
        return Album(
            {
                cell: tuple((score, view.rescaled(ratio)) for score, view in page)
                for cell, page in self.pages.items()
            }
        )

    def with_view(self, view: PointView, score: float) -> Album:
        """Return the album with a frame, unless better ones show that direction."""
        cell = _cell(view.pose.facing)
        page = sorted((*self.pages.get(cell, ()), (score, view)), key=lambda one: -one[0])
        return Album({**self.pages, cell: tuple(page[:PER_CELL])})


def _cell(facing: FloatArray) -> tuple[int, int]:
    """Return the cell of a direction (3,)."""
    yaw, pitch = np.degrees(angles_of(facing))
    return round(yaw / CELL_DEG), round(pitch / CELL_DEG)


def angles_of(facing: FloatArray) -> FloatArray:
    """Return yaw and pitch (..., 2), rad, of directions (..., 3) relative to the camera's axis."""
    yaw = np.arctan2(facing[..., 0], -facing[..., 2])
    return np.stack([yaw, np.arcsin(np.clip(facing[..., 1], -1.0, 1.0))], axis=-1)


def choose_views(
    views: Sequence[PointView], new: PointView, count: int, *, by_angles: bool = False
) -> tuple[PointView, ...]:
    """Return the frames for the next adjustment, the new one last.

    The new frame is added while there are fewer than ``count``. Then it replaces the frame without which the
    ``spread`` of the remaining directions, or the variance of their angles, is largest; of equal frames the
    oldest.

    Args:
        views: frames of the last adjustment.
        new: the current frame.
        count: n, at least 1.
        by_angles: use yaw and pitch, as printed (4.3.2), instead of directions.
    """
    kept = list(views)
    while len(kept) >= count:
        facing = matrices_from_quaternions(np.array([view.pose.quaternion for view in (*kept, new)]))[..., 2]
        spreads = angle_variances_without(facing) if by_angles else spreads_without(facing)
        del kept[int(np.argmax(spreads[:-1]))]
    return (*kept, new)


def spread(facing: FloatArray) -> float:
    """Return the variance of directions, summed over the unit vectors' components **[ours]**.

    It is 1 - |mean|^2, 0 for equal directions and, for small angles, about the variance of yaw plus that of
    pitch, rad^2. Unlike that, it does not depend on the orientation of the camera.

    Args:
        facing: (n, 3) unit vectors.
    """
    mean = facing.mean(axis=0)
    return float(1.0 - mean @ mean)


def spreads_without(facing: FloatArray) -> FloatArray:
    """Return (n,) the spread without each of n >= 2 directions (n, 3), in linear time."""
    means = (facing.sum(axis=0) - facing) / (len(facing) - 1)
    spreads: FloatArray = 1.0 - np.einsum("ni,ni->n", means, means)
    return spreads


def angle_variances_without(facing: FloatArray) -> FloatArray:
    """Return (n,) the variance of yaw plus pitch, rad^2, without each of n >= 2 directions (n, 3)."""
    angles = angles_of(facing)
    return np.array([np.delete(angles, i, axis=0).var(axis=0).sum() for i in range(len(angles))])


# Bundle adjustment of n views with a multilinear face model: poses, deformations, one person (thesis, 4.3).
# The kernels receive whitened, undistorted data.

OFFSET_SD_MM = of_kinds(
    eyes=(1.8, 1.4, 2.0), mouth=(2.5, 1.4, 2.0), nostrils=(2.8, 1.4, 5.0), brows=(2.1, 1.4, 3.5)
)
"""(K, 3) standard deviations, in the head's frame, of the constant offsets between image features and the
model's vertices."""
STEP = np.array([20.0, 20.0, 60.0, 0.2, 0.2, 0.1])
"""(6,) lambda_p, bounds of a pose's change in one adjustment: mm along camera x, y, z; rad about them."""
DEFORMATION_STEP, IDENTITY_STEP = 1.0, 0.5
"""lambda_a and lambda_s, likewise in standard deviations; lambda_s is smaller: a person does not change."""
UNDISTORTED_PX = 1e-3
"""A pixel has a ray only if distorting it returns the pixel to within this."""


@dataclass(frozen=True, eq=False)
class Adjuster:
    """Joint adjustment of a person and views of one camera.

    Attributes:
        model: face model.
        camera: of the views, with its lens; must be the reference camera.
        settings: of the adjustment.
    """

    model: FaceModel
    camera: Camera
    settings: AdjustmentSettings

    @cached_property
    def over_recording(self) -> Adjuster:
        """The adjuster for frames of a whole recording, whose errors are less correlated."""
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

        Stage 1 moves only the poses; stage 2 poses, deformations, identity and, with ``settings.offsets``,
        constant offsets **[ours]**. The objective is in ``head.adjustment.problem``: Huber's function instead
        of squares, and priors, are **[ours]**. The resulting cost never exceeds that of the start, after
        moving it into its bounds.

        Args:
            views: n frames with start poses and deformations; points without weight or pixel are excluded.
            person: start.
            iterations: maximum steps of each stage; fewer once F stops decreasing.
            hold_person: keep identity and offsets, even outside their bounds.
            wide: no bounds about the start, only those about the mean of identity and deformation.
            deviations: compute those of the identity.
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
        """Return the least-squares problem with the views' poses as start.

        Residuals are differences of rays, converted to pixels by the lens's derivative at the observed point,
        so that the lens is undone only once. Points without weight, pixel or ray are excluded.
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
            np.array(model.mean, dtype=np.float64),  # a copy: numba compiles read-only arrays as another type
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
        """Return the start: poses and deformations of the views and the person, whitened."""
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

        A start beyond ``bound`` is moved to the bound. ``wide`` drops the bounds about the start.
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
        """Number of unknowns shared by the views."""
        return self.model.identity_size + (self.model.mean.size if self.settings.offsets else 0)

    def _rays(self, pixels: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the rays (n, K, 2) of pixels, and (n, K) which pixels have one."""
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
        """Return (n, K, 2, 2) d pixel / d ray, in units of each point's standard deviation."""
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
        size = self.model.identity_size
        identity = (unknowns.shared[:size] + problem.identity_centre) * self.model.identity_deviations
        return PersonParameters(identity, unknowns.shared[size:].reshape(-1, 3) * problem.offset_deviations)

    def _residuals(self, problem: Problem, unknowns: Unknowns) -> FloatArray:
        """Return (n, K) error lengths, pixels."""
        lengths, sd = np.empty(problem.weights.shape), self.settings.pixel_sd.values
        residual_lengths(problem, unknowns, lengths)
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
