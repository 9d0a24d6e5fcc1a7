"""Recalculation of feature points, and the refinement of one frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.geometry.least_squares import student_t
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.actions import USUAL, displacements
from posetrack_cli.head.config import RefinementSettings, StereoRefinementSettings
from posetrack_cli.head.face.points import HeadPose, ShapeModel, of_kinds
from posetrack_cli.head.face.rig_images import RigImages
from posetrack_cli.head.face.templates import (
    GRID,
    PATCH,
    SIZE,
    normalise,
    product,
    sample_grid,
    take_templates,
)
from posetrack_cli.head.refinement.evidence import (
    ComparedFrame,
    Evidence,
    Scene,
    Workspace,
    gather_evidence,
    make_evidence,
    make_workspace,
    project_point,
)
from posetrack_cli.head.refinement.joint import (
    CONVERGED_PX,
    Face,
    FaceUnknowns,
    Prior,
    descend,
    move_point,
)

# Recalculation of the feature points with the pose fixed (thesis, 3.2.3); compiled.
#
# ``recalculate_points`` minimises E = sum_k E_k(R M'_k + t) + Student-t of M'_k - M_k, which replaces eps
# |M' - M|^2 of (3.3), with warped patches of zero mean and unit norm, also between cameras **[ours]**. As in
# (3.9) it starts from the previous frame's result. Each point is a system of three unknowns (3.17).
#
# ``recalculate_as_printed`` is the thesis's method, (3.3)-(3.19), and ``recalculate_2d_as_printed`` that for
# one camera's image, (4.42)-(4.52):
#
#     E = sum over cameras and 16 x 16 regions of  rho |I_t(m_t) - I_t-1(m_t-1)|^2 + |I_t(m_t) - I_1(m_1)|^2
#         + eps |M'_t - M_t|^2,                                     m = P(p_t, M')
#     E = sum over 16 x 16 regions of  rho |I_t(m_t) - I_t-1(m_t-1)|^2 + |I_t(m_t) - I_1(m_1)|^2
#         + eps |m_t - m'_t|^2,                              m'_t the projection of the filter's estimate
#
# by iterating dM = -D^-1 d, or dm = -D^-1 d until it is small. **[fix]** (3.16) has the factor 2 of the
# derivative of eps |.|^2, which (3.18) and (3.19) lack; (4.51) and (4.52) have the factor 2 of the
# derivative of E_I but not that of eps |.|^2. As E is defined, D = (rho + 1) sum K^T K + eps 1 and d = sum
# K^T (rho dI + dI_0) + eps (M'_t-1 - M_t), in the image eps (m_t-1 - m'_t). D is block-diagonal over points,
# with blocks of three or two.


@kernel
def recalculate_points(
    scene: Scene,
    rotation: FloatArray,
    position: FloatArray,
    shape: FloatArray,
    prior: Prior,
    iterations: int,
    points: FloatArray,
    correlations: FloatArray,
    pixels: FloatArray,
) -> None:
    """Minimise E over points (K, 3), in place.

    Args:
        scene: the frame.
        rotation, position: R (3, 3) and t (3,), fixed.
        shape: (K, 3) M, the filter's estimate, in the head's frame, mm.
        prior: of M' - M.
        iterations: maximum number of steps.
        points: (K, 3) M' of the previous frame; out: of this one.
        correlations: (C, K) out.
        pixels: (C, K, 2) out.
    """
    cameras = len(scene.images.sizes)
    evidence, work = make_evidence(cameras), make_workspace(cameras)
    X, d, e = np.empty(3), np.empty(3), np.empty(3)
    small = CONVERGED_PX * position[2] / scene.optics.intrinsics[0, 0]
    for k in range(len(points)):
        for n in range(iterations + 1):
            transform(rotation, points[k], position, X)
            gather_evidence(scene, k, X, work, evidence)
            if n == iterations:
                break
            transform(rotation, points[k] - shape[k], np.zeros(3), d)
            squared = d[0] ** 2 + d[1] ** 2 + d[2] ** 2
            weight = student_t(squared, 3.0, prior.freedom, prior.scales[k])
            move_point(evidence.hessian, weight, evidence.gradient + weight * d, rotation, points[k], e)
            if e[0] ** 2 + e[1] ** 2 + e[2] ** 2 < small * small:
                break
        write_point(evidence, k, correlations, pixels)


@inlined
def write_point(evidence: Evidence, k: int, correlations: FloatArray, pixels: FloatArray) -> None:
    """Write a point's pixels and correlations, element by element to keep compilation fast."""
    for c in range(len(correlations)):
        correlations[c, k] = evidence.correlations[c]
        for i in range(2):
            pixels[c, k, i] = evidence.pixels[c, i]


@kernel
def transform(R: FloatArray, v: FloatArray, t: FloatArray, out: FloatArray) -> None:
    """Write R v + t (3,)."""
    for i in range(3):
        out[i] = t[i] + R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]


class PrintedConstants(NamedTuple):
    """The thesis's constants, for 8-bit intensities and mm."""

    rho: float
    epsilon: float


@kernel
def recalculate_as_printed(
    scene: Scene,
    rotation: FloatArray,
    position: FloatArray,
    shape: FloatArray,
    printed: PrintedConstants,
    iterations: int,
    points: FloatArray,
    correlations: FloatArray,
    pixels: FloatArray,
) -> None:
    """Minimise the printed E over points (K, 3), in place; arguments as in ``recalculate_points``."""
    cameras = len(scene.images.sizes)
    evidence, work = make_evidence(cameras), make_workspace(cameras)
    X, d, e = np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(points)):
        for _ in range(iterations):
            transform(rotation, points[k], position, X)
            _gather_raw(scene, k, X, printed.rho, work, evidence)
            transform(rotation, points[k] - shape[k], np.zeros(3), d)
            pull = evidence.gradient + printed.epsilon * d
            move_point(evidence.hessian, printed.epsilon, pull, rotation, points[k], e)
        transform(rotation, points[k], position, X)
        gather_evidence(scene, k, X, work, evidence)
        write_point(evidence, k, correlations, pixels)


@kernel
def _gather_raw(scene: Scene, k: int, X: FloatArray, rho: float, work: Workspace, out: Evidence) -> None:
    """Write half the derivatives of E's image terms at X (3,), in camera axes."""
    images, upright = scene.images, np.eye(2)
    out.hessian[:] = 0.0
    out.gradient[:] = 0.0
    for c in range(len(images.sizes)):
        if not project_point(scene.optics, c, k, X, out.pixels[c], work.jacobians[c]):
            continue
        u, v = out.pixels[c, 0] - images.corners[c, 0], out.pixels[c, 1] - images.corners[c, 1]
        width, height = images.sizes[c, 0], images.sizes[c, 1]
        if not sample_grid(images.windows[c], width, height, u, v, upright, work.grid):
            continue
        for s in range(2):
            if not np.isnan(scene.raw[s, c, k, 0, 0]):
                _add_region(work.grid, scene.raw[s, c, k], work.jacobians[c], 1.0 if s == 0 else rho, out)


@kernel
def _add_region(grid: FloatArray, target: FloatArray, J: FloatArray, weight: float, out: Evidence) -> None:
    """Add weight |I - target|^2 / 2 over a region's pixels; K = (dI/dm) J is one row per pixel."""
    row = np.empty(3)
    for j in range(1, PATCH + 1):
        for i in range(1, PATCH + 1):
            along = 0.5 * (grid[j, i + 1] - grid[j, i - 1])
            down = 0.5 * (grid[j + 1, i] - grid[j - 1, i])
            difference = grid[j, i] - target[j, i]
            for n in range(3):
                row[n] = along * J[0, n] + down * J[1, n]
            for n in range(3):
                out.gradient[n] += weight * row[n] * difference
                for m in range(3):
                    out.hessian[n, m] += weight * row[n] * row[m]


REFERENCE, BEFORE = 0, 1
"""Indices of ``Scene.raw``."""


@kernel
def recalculate_2d_as_printed(
    scene: Scene,
    expected: FloatArray,
    printed: PrintedConstants,
    iterations: int,
    pixels: FloatArray,
    correlations: FloatArray,
) -> None:
    """Minimise the printed E over pixels (K, 2), in place.

    A point whose region leaves the image stays at its last place.

    Args:
        scene: the frame, of one camera, built for the printed recalculation.
        expected: (K, 2) m'_t, pixels.
        printed: rho and eps, for 8-bit intensities and pixels.
        iterations: maximum number of steps.
        pixels: (K, 2) m of the previous frame; out: of this one.
        correlations: (K,) out: the best with a template other than the previous frame's; NaN without one.
    """
    grid, upright, patch = np.empty((GRID, GRID)), np.eye(2), np.empty(SIZE)
    sums = np.empty(5)
    for k in range(len(pixels)):
        for _ in range(iterations):
            if not _sample(scene, pixels[k], upright, grid):
                break
            _regions(scene, k, grid, printed.rho, sums)
            e, f = pixels[k, 0] - expected[k, 0], pixels[k, 1] - expected[k, 1]
            a, b, c = sums[0] + printed.epsilon, sums[1], sums[2] + printed.epsilon
            g, h = sums[3] + printed.epsilon * e, sums[4] + printed.epsilon * f
            determinant = a * c - b * b
            if determinant <= 0.0:
                break
            right, down = (b * h - c * g) / determinant, (b * g - a * h) / determinant
            pixels[k, 0] += right
            pixels[k, 1] += down
            if right * right + down * down < CONVERGED_PX * CONVERGED_PX:
                break
        correlations[k] = np.nan
        if _sample(scene, pixels[k], upright, grid) and normalise(grid, patch) > 0.0:
            correlations[k] = _best(scene, k, patch)


@kernel
def _sample(scene: Scene, pixel: FloatArray, upright: FloatArray, grid: FloatArray) -> bool:
    images = scene.images
    u, v = pixel[0] - images.corners[0, 0], pixel[1] - images.corners[0, 1]
    return sample_grid(images.windows[0], images.sizes[0, 0], images.sizes[0, 1], u, v, upright, grid)


@kernel
def _regions(scene: Scene, k: int, grid: FloatArray, rho: float, sums: FloatArray) -> None:
    """Write the image terms of D (xx, xy, yy) and d (x, y): half the derivatives of E_I."""
    sums[:] = 0.0
    for s in range(2):
        target = scene.raw[s, 0, k]
        if np.isnan(target[0, 0]):
            continue
        weight = 1.0 if s == REFERENCE else rho
        for j in range(1, PATCH + 1):
            for i in range(1, PATCH + 1):
                along = 0.5 * (grid[j, i + 1] - grid[j, i - 1])
                down = 0.5 * (grid[j + 1, i] - grid[j - 1, i])
                difference = grid[j, i] - target[j, i]
                sums[0] += weight * along * along
                sums[1] += weight * along * down
                sums[2] += weight * down * down
                sums[3] += weight * along * difference
                sums[4] += weight * down * difference


@kernel
def _best(scene: Scene, k: int, patch: FloatArray) -> float:
    """Return the best correlation with a stored template; NaN if there is none."""
    targets, best = scene.targets, np.nan
    for s in range(targets.stored):
        if targets.weights[s, 0, k] > 0.0:
            ncc = product(patch, targets.patches[s, 0, k])
            if not best > ncc:
                best = ncc
    return best


# Refinement of one frame, as called by the tracker

WIDE_PRIOR = np.array([50.0] * 3 + [0.5] * 3)
"""(6,) standard deviations about the predicted pose, mm and rad; regularises unobserved directions."""
LEAST_DEVIATION_MM = 1e-3
ITERATIONS, WITH_EXPRESSIONS = 3, 5
"""Maximum number of joint Gauss-Newton steps, without and with expressions."""
RESIDUAL_MM = of_kinds(eyes=0.8, mouth=2.5, nostrils=3.0, brows=0.9)
"""(K,) standard deviations of the points about the model."""
RECALCULATION_MM = of_kinds(eyes=1.0, mouth=12.0, nostrils=2.5, brows=2.0)
"""(K,) the same for the recalculation, with the pose fixed."""
DEGREES_OF_FREEDOM = 4.0
"""Of the Student-t density of the residuals."""
KEYFRAME_NEUTRAL_MM, KEYFRAME_CORRELATION = 3.0, 0.7
"""Limits for a keyframe: maximum deformation (norm of 3K values) and minimum correlation."""


@dataclass(frozen=True, eq=False)
class Refined:
    """Refined pose and deformation of a frame.

    Attributes:
        pose: of the head.
        coefficients: (B,) a, mm.
        residuals: (K, 3) delta, difference of each point from the model, in the head's frame, mm.
        correlations: (C, K) the best with a template of ``templates``; NaN if there is none.
        visibility: (C, K) cosine of normal and ray at the predicted pose; 0 from behind and without an image.
        scene: data of the frame, for ``recalculate``.
    """

    pose: HeadPose
    coefficients: FloatArray
    residuals: FloatArray
    correlations: FloatArray
    visibility: FloatArray
    scene: Scene


@dataclass(frozen=True, eq=False)
class Recalculated:
    """Recalculated points.

    Attributes:
        shape: (K, 3) M' in the head's frame, mm.
        correlations: (C, K) as in ``Refined``.
        pixels: (C, K, 2).
    """

    shape: FloatArray
    correlations: FloatArray
    pixels: FloatArray


def refine(frame: ComparedFrame, model: ShapeModel, pose: HeadPose, coefficients: FloatArray) -> Refined:
    """Refine pose and deformation jointly from the filter's estimate (``joint``).

    Without ``settings.joint`` they are unchanged, and only correlations are computed.

    Args:
        frame: images and templates.
        model: shape model of the face.
        pose, coefficients: start, (B,) mm.
    """
    residuals, own = np.zeros_like(model.mean), len(coefficients)
    if frame.settings.expressions:
        model = _with_expressions(model)
        coefficients = np.concatenate([coefficients, np.zeros(model.size - own)])
    # lenses are linearised at the start, so distorted ones need a second round from the result
    for _ in range(2 if any(camera.is_distorted for camera in frame.images.cameras) else 1):
        shape = model.shapes(coefficients) + residuals
        scene, seen = frame.scene(pose, shape)
        state = _descended(scene, model, pose, coefficients, residuals, frame.settings)
        pose, coefficients, residuals = _pose(state), state.coefficients, state.residuals
    return Refined(pose, coefficients[:own], residuals, state.correlations, seen, scene)


def _with_expressions(model: ShapeModel) -> ShapeModel:
    """Return the model with the named actions as further directions, each with a usual strength's deviation.

    A learned model lacks expressions that it has not seen; points moved by one would turn the head.
    """
    moved = np.moveaxis(displacements(), 0, -1)
    lengths = np.linalg.norm(moved, axis=(0, 1))
    basis = np.concatenate([model.basis, moved / lengths], axis=-1)
    return ShapeModel(model.mean, basis, np.concatenate([model.deviations, USUAL * lengths]))


def recalculate(
    scene: Scene, pose: HeadPose, shape: FloatArray, start: FloatArray, settings: RefinementSettings
) -> Recalculated:
    """Recalculate the points with the pose fixed, by ``settings.recalculation``.

    As printed, several cameras move points in space (3.3), one camera moves them in its image (4.42), with
    the depths of M.

    Args:
        scene: of the frame, at nearly this pose and shape: ``Refined.scene``.
        pose: of the head.
        shape: (K, 3) M, the model's shape, in the head's frame, mm.
        start: (K, 3) M' of the previous frame.
        settings: weights, priors, steps.
    """
    count = (len(scene.images.sizes), len(shape))
    points, correlations, pixels = start.copy(), np.empty(count), np.empty((*count, 2))
    R, t, most = pose.rotation, pose.position, settings.recalculation_iterations
    if settings.recalculation == "printed" and count[0] == 1:
        return _recalculated_in_image(scene, pose, shape, start, settings)
    if settings.recalculation == "printed":
        printed = PrintedConstants(settings.rho, settings.epsilon)
        recalculate_as_printed(scene, R, t, shape, printed, most, points, correlations, pixels)
    else:
        prior = make_prior(RECALCULATION_MM)
        recalculate_points(scene, R, t, shape, prior, most, points, correlations, pixels)
    return Recalculated(points, correlations, pixels)


def _recalculated_in_image(
    scene: Scene, pose: HeadPose, shape: FloatArray, start: FloatArray, settings: RefinementSettings
) -> Recalculated:
    """Apply (4.42) to (4.52), and return the points at M's depths."""
    expected, jacobians = _seen_at(scene, pose.points(shape))
    pixels, _ = _seen_at(scene, pose.points(start))
    correlations, printed = np.empty(len(shape)), PrintedConstants(settings.rho, settings.epsilon)
    most = settings.recalculation_iterations
    recalculate_2d_as_printed(scene, expected, printed, most, pixels, correlations)
    across = np.linalg.solve(jacobians[:, :, :2], (pixels - expected)[..., None])[..., 0]
    moved = np.hstack([across, np.zeros((len(shape), 1))]) @ pose.rotation
    return Recalculated(shape + moved, correlations[None], pixels[None])


def _seen_at(scene: Scene, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the projections (K, 2) of points (K, 3), mm, in the only camera, and their derivatives."""
    pixels, jacobians = np.empty((len(points), 2)), np.empty((len(points), 2, 3))
    for k, point in enumerate(points):
        project_point(scene.optics, 0, k, point, pixels[k], jacobians[k])
    return pixels, jacobians


def _descended(
    scene: Scene,
    model: ShapeModel,
    pose: HeadPose,
    coefficients: FloatArray,
    residuals: FloatArray,
    settings: RefinementSettings,
) -> FaceUnknowns:
    count = (len(scene.images.sizes), len(model.mean))
    state = FaceUnknowns(
        pose.rotation.copy(),
        pose.position.copy(),
        np.array(coefficients, dtype=np.float64),
        residuals.copy(),
        np.zeros(6),
        np.empty(count),
    )
    precisions = np.maximum(model.deviations, LEAST_DEVIATION_MM) ** -2
    face = Face(np.array(model.mean), np.ascontiguousarray(model.basis), precisions)
    most = WITH_EXPRESSIONS if settings.expressions else ITERATIONS
    descend(scene, face, make_prior(RESIDUAL_MM), most if settings.joint else 0, state)
    return state


def _pose(state: FaceUnknowns) -> HeadPose:
    return HeadPose(state.position, quaternions_from_matrices(state.rotation))


def make_prior(scales: FloatArray) -> Prior:
    """Return the prior of points with standard deviations (K,), mm, about the model."""
    return Prior(scales, DEGREES_OF_FREEDOM, WIDE_PRIOR**-2)


ROUNDS, STEPS = 3, 5
"""Rounds of template updates, for points whose depth changed, and steps of each."""


def refine_initial_depth(
    images: RigImages, pose: HeadPose, shape: FloatArray, settings: StereoRefinementSettings
) -> FloatArray:
    """Return the shape (K, 3), mm, on which the patches of all cameras agree best **[ours]**.

    Triangulated points may lie some mm in front of or behind the skin. Reference templates of two cameras and
    the comparison between the cameras would then imply different depths and bias every later pose. The first
    camera with an image keeps the point at its pixel, and the comparison between the cameras moves it along
    the ray.

    Args:
        images: of all cameras.
        pose: of the head.
        shape: (K, 3) as found, mm.
        settings: weights, steps.
    """
    prior = make_prior(np.full(len(shape), settings.settling_mm))
    points = np.array(shape, dtype=np.float64)
    for _ in range(ROUNDS):
        templates = take_templates(images, pose, points)
        held = replace(templates, seen=_first_camera_only(templates.seen))
        scene, _seen = ComparedFrame(images, [held], None, settings).scene(pose, points)
        correlations = np.empty(templates.seen.shape)
        pixels = np.empty((*templates.seen.shape, 2))
        most = STEPS
        recalculate_points(
            scene, pose.rotation, pose.position, shape, prior, most, points, correlations, pixels
        )
    return points


def _first_camera_only(seen: BoolArray) -> BoolArray:
    """Return (C, K) points seen by the first camera that sees any."""
    first: BoolArray = np.zeros_like(seen)
    camera = int(np.argmax(seen.any(axis=1)))
    first[camera] = seen[camera]
    return first
