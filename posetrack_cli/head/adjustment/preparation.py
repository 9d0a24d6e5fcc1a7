"""From views, person, model and camera to what the kernels read: everything whitened, lens removed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.distortion import distortion_jacobian
from posetrack_cli.geometry.projection import largest_radius, normalised_from_pixels, pixels_from_normalised
from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.head.adjustment.solver.problem import POSE, Boxes, Problem, Unknowns
from posetrack_cli.head.adjustment.views import PersonParameters, PointView
from posetrack_cli.head.config import AdjustmentSettings, OffsetSettings
from posetrack_cli.head.face.points import BROWS, EYES, MOUTH, NOSTRILS, POINT_COUNT
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.refinement.refine import point_values

UNDISTORTED_PX = 1e-3
"""A pixel whose ray the lens does not put back there to within this has no ray."""


def make_problem(
    views: Sequence[PointView], model: FaceModel, camera: Camera, settings: AdjustmentSettings
) -> Problem:
    """Return what is minimised, with the views' poses as start.

    Residuals are taken between rays and brought to recorded pixels by the lens's derivative at the observed
    point: the lens is undone once. Points without weight, pixel or ray are left out.
    """
    count = len(views), len(model.mean)
    pixels = np.array([view.pixels for view in views], dtype=np.float64).reshape(*count, 2)
    weights = np.array([view.weights for view in views], dtype=np.float64).reshape(count)
    rays, seen = _rays(camera, pixels)
    used = seen & np.isfinite(weights) & (weights > 0.0)
    identity, deformation = model.identity_deviations, model.deformation_deviations
    quaternions = np.array([view.pose.quaternion for view in views], dtype=np.float64).reshape(-1, 4)
    return Problem(
        np.array(model.mean, dtype=np.float64),  # its own: for numba read-only is another type
        np.ascontiguousarray(model.core * (identity[:, None] * deformation)),
        model.identity_mean / identity,
        model.deformation_mean / deformation,
        offset_deviations(settings.offset_mm),
        np.ascontiguousarray(matrices_from_quaternions(quaternions)),
        np.array([view.pose.position for view in views], dtype=np.float64).reshape(-1, 3),
        np.ascontiguousarray(np.where(used[..., None], rays, 0.0)),
        _scales(camera, rays, used, point_values(settings.pixel_sd)),
        np.where(used, weights, 0.0),
        float(settings.huber),
        float(settings.prior),
    )


def _rays(camera: Camera, pixels: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return rays (n, K, 2) of pixels, and (n, K) which pixels have one."""
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


def _scales(camera: Camera, rays: FloatArray, used: BoolArray, pixel_sd: FloatArray) -> FloatArray:
    """Return (n, K, 2, 2) d pixel / d ray at the rays, in units of each point's standard deviation."""
    scales = np.zeros((*used.shape, 2, 2))
    focal = np.array([[camera.fx], [camera.fy]])
    if camera.is_distorted:
        at = np.where(used[..., None], rays, 0.0)
        lens = np.stack(distortion_jacobian(camera, at[..., 0], at[..., 1]), axis=-1)
        scales[:] = lens.reshape(*used.shape, 2, 2) * focal
    else:
        scales[:] = np.eye(2) * focal
    scales /= pixel_sd[:, None, None]
    return scales


@lru_cache(maxsize=16)
def offset_deviations(settings: OffsetSettings) -> FloatArray:
    """Return (K, 3) mm, each point's deviations of its offset; not to be written to."""
    deviations = np.empty((POINT_COUNT, 3))
    deviations[EYES], deviations[MOUTH] = settings.eyes, settings.mouth
    deviations[NOSTRILS], deviations[BROWS] = settings.nostrils, settings.brows
    return deviations


def make_start(
    views: Sequence[PointView], person: PersonParameters, model: FaceModel, problem: Problem
) -> Unknowns:
    """Return the start: the views' own poses, deformations and the person, whitened."""
    local = np.zeros((len(views), POSE + model.deformation_size))
    for row, view in zip(local, views, strict=True):
        row[POSE:] = view.deformation
    local[:, POSE:] /= model.deformation_deviations
    local[:, POSE:] -= problem.deformation_centre
    identity = person.identity / model.identity_deviations - problem.identity_centre
    return Unknowns(local, np.concatenate([identity, (person.offsets / problem.offset_deviations).ravel()]))


def make_boxes(start: Unknowns, settings: AdjustmentSettings, identity_size: int, wide: bool) -> Boxes:
    """Return C_p, C_a and C_s, (4.31), (4.35), (4.37); offsets have no bounds.

    A start farther out than ``bound`` is taken for one at the bound. ``wide`` drops the bounds about the
    start.
    """
    pose = np.array([*settings.pose_mm, *settings.pose_rad])
    local, shared = np.full_like(start.local, np.inf), np.full_like(start.shared, np.inf)
    boxes = Boxes(-local, local, -shared, shared)
    if not wide:
        boxes.local_lower[:, :POSE], boxes.local_upper[:, :POSE] = -pose, pose
    around = np.inf if wide else settings.deformation
    _bound(
        start.local[:, POSE:],
        around,
        settings.bound,
        boxes.local_lower[:, POSE:],
        boxes.local_upper[:, POSE:],
    )
    who = slice(identity_size)
    around = np.inf if wide else settings.identity
    _bound(start.shared[who], around, settings.bound, boxes.shared_lower[who], boxes.shared_upper[who])
    return boxes


def _bound(start: FloatArray, around: float, bound: float, lower: FloatArray, upper: FloatArray) -> None:
    """Write bounds about a whitened start and about the mean; the start must then lie within them."""
    inside = np.clip(start, -bound, bound)
    np.clip(inside - around, -bound, bound, out=lower)
    np.clip(inside + around, -bound, bound, out=upper)


def clipped(start: Unknowns, boxes: Boxes) -> Unknowns:
    """Return the start within its boxes, (4.27)."""
    return Unknowns(
        np.clip(start.local, boxes.local_lower, boxes.local_upper),
        np.clip(start.shared, boxes.shared_lower, boxes.shared_upper),
    )
