"""Patch comparisons of one frame, and their normal equations in a point's coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray, IntArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import RefinementSettings
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.face.rig_images import Projection, RigImages, project
from posetrack_cli.head.face.templates import (
    GRID,
    SIZE,
    TemplateSet,
    differentiate,
    normalise,
    product,
    sample_grid,
    tangents,
    unwarped,
    visibility,
    warped,
    warps_between,
)

# Normal equations of a point's coordinates; compiled.
#
# For a point X, mm in the reference camera's axes, patches p_c(X) at its pixels m_c(X) are compared with
# templates q and with each other:
#
#     E(X) = 1/2 sum_c,s w |p_c - q_cs|^2  +  1/2 sum_(c,b) w |p_c - p_b|^2
#
# As |p| = 1, p^T dp = 0: the gradient of a template's term is -G^T q, with G = dp / dm. Weights are constant.


class Evidence(NamedTuple):
    """Patch comparisons of one point.

    Attributes:
        hessian: (3, 3) Gauss-Newton approximation for E, 1 / mm^2.
        gradient: (3,) of E, 1 / mm.
        correlations: (C,) the best with a template other than the previous frame's; NaN if there is none.
        pixels: (C, 2).
    """

    hessian: FloatArray
    gradient: FloatArray
    correlations: FloatArray
    pixels: FloatArray


class Workspace(NamedTuple):
    """Arrays reused for every point."""

    grid: FloatArray
    patches: FloatArray
    gradients: FloatArray
    norms: FloatArray
    jacobians: FloatArray
    warp: FloatArray
    other: FloatArray
    other_gradient: FloatArray
    rows: FloatArray


@kernel
def make_evidence(cameras: int) -> Evidence:
    """Allocate one point's evidence."""
    return Evidence(np.zeros((3, 3)), np.zeros(3), np.zeros(cameras), np.zeros((cameras, 2)))


@kernel
def make_workspace(cameras: int) -> Workspace:
    """Allocate the work arrays."""
    return Workspace(
        np.zeros((GRID, GRID)),
        np.zeros((cameras, SIZE)),
        np.zeros((cameras, 2, SIZE)),
        np.zeros(cameras),
        np.zeros((cameras, 2, 3)),
        np.eye(2),
        np.zeros(SIZE),
        np.zeros((2, SIZE)),
        np.zeros((4, 3)),
    )


@kernel
def project_point(optics: Optics, c: int, k: int, X: FloatArray, pixel: FloatArray, J: FloatArray) -> bool:
    """Write the pixel (2,) of point k in camera c and its derivative (2, 3); False behind the camera."""
    T, focal, lens = optics.transforms[c], optics.intrinsics[c], optics.lenses[c, k]
    local = np.empty(3)
    for i in range(3):
        local[i] = T[i, 0] * X[0] + T[i, 1] * X[1] + T[i, 2] * X[2] + T[i, 3]
    if local[2] <= 0.0:
        return False
    x, y = local[0] / local[2], local[1] / local[2]
    for i in range(2):
        f = focal[i]
        pixel[i] = f * (lens[i, 0] * x + lens[i, 1] * y + lens[i, 2]) + focal[2 + i]
        a, b = f * lens[i, 0] / local[2], f * lens[i, 1] / local[2]
        for j in range(3):
            J[i, j] = a * T[0, j] + b * T[1, j] - (a * x + b * y) * T[2, j]
    return True


@kernel
def gather_evidence(scene: Scene, k: int, X: FloatArray, work: Workspace, out: Evidence) -> None:
    """Write the evidence of point k at X (3,)."""
    out.hessian[:] = 0.0
    out.gradient[:] = 0.0
    for c in range(len(scene.images.sizes)):
        out.correlations[c] = np.nan
        _sample_patch(scene, c, k, X, work, out.pixels[c])
        if work.norms[c] > 0.0:
            _add_templates(scene, c, k, work, out)
    for pair in range(len(scene.targets.pairs)):
        _add_pair(scene, pair, k, work, out)


@kernel
def _sample_patch(scene: Scene, c: int, k: int, X: FloatArray, work: Workspace, pixel: FloatArray) -> None:
    """Sample the patch of point k in camera c; its norm is 0 if there is none."""
    work.norms[c] = 0.0
    pixel[:] = np.nan
    if not project_point(scene.optics, c, k, X, pixel, work.jacobians[c]):
        return
    images = scene.images
    u, v = pixel[0] - images.corners[c, 0], pixel[1] - images.corners[c, 1]
    work.warp[0, 0], work.warp[0, 1], work.warp[1, 0], work.warp[1, 1] = 1.0, 0.0, 0.0, 1.0
    if sample_grid(images.windows[c], images.sizes[c, 0], images.sizes[c, 1], u, v, work.warp, work.grid):
        work.norms[c] = normalise(work.grid, work.patches[c])
    if work.norms[c] > 0.0:
        differentiate(work.grid, work.patches[c], work.norms[c], work.gradients[c])


@inlined
def comparison_weight(robustness: Robustness, ncc: float) -> float:
    """Return the weight of a comparison with a correlation."""
    above = (ncc - robustness.floor) / (1.0 - robustness.floor)
    return robustness.precision * above**robustness.power if above > 0.0 else 0.0


@inlined
def likeness(robustness: Robustness, ncc: float) -> float:
    """Return the factor on the previous frame's weight, from the correlation with stored templates."""
    if robustness.likeness <= 0.0 or np.isnan(ncc):
        return 1.0
    return ncc**robustness.likeness if ncc > 0.0 else 0.0


@kernel
def _add_templates(scene: Scene, c: int, k: int, work: Workspace, out: Evidence) -> None:
    targets, gradient, J = scene.targets, work.gradients[c], work.jacobians[c]
    total, g0, g1 = 0.0, 0.0, 0.0
    for s in range(len(targets.patches)):
        if targets.weights[s, c, k] <= 0.0:
            continue
        q = targets.patches[s, c, k]
        ncc = product(work.patches[c], q)
        weight = targets.weights[s, c, k] * comparison_weight(scene.robustness, ncc)
        if s >= targets.stored:
            weight *= likeness(scene.robustness, out.correlations[c])
        total += weight
        g0 -= weight * product(gradient[0], q)
        g1 -= weight * product(gradient[1], q)
        if s < targets.stored and not out.correlations[c] > ncc:
            out.correlations[c] = ncc
    h00, h01 = total * product(gradient[0], gradient[0]), total * product(gradient[0], gradient[1])
    h11 = total * product(gradient[1], gradient[1])
    for i in range(3):
        out.gradient[i] += J[0, i] * g0 + J[1, i] * g1
        for j in range(3):
            out.hessian[i, j] += J[0, i] * (h00 * J[0, j] + h01 * J[1, j]) + J[1, i] * (
                h01 * J[0, j] + h11 * J[1, j]
            )


@kernel
def _add_pair(scene: Scene, pair: int, k: int, work: Workspace, out: Evidence) -> None:
    """Compare the patch of camera c with camera b's image under the warp between them."""
    targets, images = scene.targets, scene.images
    c, b = targets.pairs[pair, 0], targets.pairs[pair, 1]
    if targets.pair_weights[pair, k] <= 0.0 or work.norms[c] <= 0.0 or np.isnan(out.pixels[b, 0]):
        return
    u, v = out.pixels[b, 0] - images.corners[b, 0], out.pixels[b, 1] - images.corners[b, 1]
    W = targets.pair_warps[pair, k]
    if not sample_grid(images.windows[b], images.sizes[b, 0], images.sizes[b, 1], u, v, W, work.grid):
        return
    norm = normalise(work.grid, work.other)
    if norm <= 0.0:
        return
    differentiate(work.grid, work.other, norm, work.other_gradient)
    weight = targets.pair_weights[pair, k] * comparison_weight(
        scene.robustness, product(work.patches[c], work.other)
    )
    _pair_rows(work, c, b, W)
    _add_quadratic(work, c, weight, out)


@kernel
def _pair_rows(work: Workspace, c: int, b: int, W: FloatArray) -> None:
    """Write (4, 3): derivatives of both grid centres by X, in grid pixels; the second negated."""
    determinant = W[0, 0] * W[1, 1] - W[0, 1] * W[1, 0]
    J, K, rows = work.jacobians[c], work.jacobians[b], work.rows
    for j in range(3):
        rows[0, j], rows[1, j] = J[0, j], J[1, j]
        rows[2, j] = -(W[1, 1] * K[0, j] - W[0, 1] * K[1, j]) / determinant
        rows[3, j] = -(W[0, 0] * K[1, j] - W[1, 0] * K[0, j]) / determinant


@kernel
def _add_quadratic(work: Workspace, c: int, weight: float, out: Evidence) -> None:
    """Add weight/2 |p_c - p_b|^2 with d (p_c - p_b) = [G_c, G_b] rows dX."""
    rows, gram, slope = work.rows, np.empty((4, 4)), np.empty(4)
    for i in range(4):
        left = work.gradients[c, i] if i < 2 else work.other_gradient[i - 2]
        slope[i] = -product(left, work.other) if i < 2 else product(left, work.patches[c])
        for j in range(4):
            right = work.gradients[c, j] if j < 2 else work.other_gradient[j - 2]
            gram[i, j] = product(left, right)
    for n in range(4):
        for i in range(3):
            out.gradient[i] += weight * rows[n, i] * slope[n]
            for m in range(4):
                for j in range(3):
                    out.hessian[i, j] += weight * rows[n, i] * gram[n, m] * rows[m, j]


# Data of one frame for the kernels: images, optics, templates and comparisons

REFERENCE, KEYFRAME, PREVIOUS = 1.0, 2.0, 1.0
"""Weights of comparisons: with the reference, with the keyframe of the nearest direction, and with the
previous frame."""
BETWEEN_CAMERAS = 4.3
"""Weight of comparisons between cameras."""
VISIBILITY_POWER = 0.3
"""Exponent of the cosine between skin normal and ray in a comparison's weight."""
PATCH_SD = 0.4
"""Standard deviation of the difference of two patches of zero mean and unit norm, per unit of weight."""
CORRELATION_FLOOR, CORRELATION_POWER = 0.2, 6.0
"""A comparison's weight is ((ncc - floor) / (1 - floor)) ^ power."""
MARGIN = 48
"""Pixels kept around the predicted points: half a patch and the range of the refinement."""


class Images(NamedTuple):
    """Region of each camera's image that shows the face.

    Attributes:
        windows: (C, h, w), h and w the largest over the cameras.
        corners: (C, 2) column and row of a window's first pixel in the image.
        sizes: (C, 2) width and height of the used part; 0 for a missing image.
    """

    windows: ImageArray
    corners: FloatArray
    sizes: IntArray


class Optics(NamedTuple):
    """C cameras, with lenses linearised at the predicted points.

    Attributes:
        transforms: (C, 3, 4) camera_T_reference, mm.
        intrinsics: (C, 4) fx, fy, cx, cy, pixels.
        lenses: (C, K, 2, 3) of ``Projection``.
    """

    transforms: FloatArray
    intrinsics: FloatArray
    lenses: FloatArray


class Targets(NamedTuple):
    """Patches to compare the frame with.

    Attributes:
        patches: (S, C, K, SIZE) warped templates; the previous frame's, if any, is the last.
        stored: number of template sets other than the previous frame's.
        weights: (S, C, K) of each comparison, including visibility; 0 without a template.
        pairs: (P, 2) cameras whose patches are compared with each other.
        pair_warps: (P, K, 2, 2) from the first camera's patch to the second's image; NaN if there is none.
        pair_weights: (P, K).
    """

    patches: FloatArray
    stored: int
    weights: FloatArray
    pairs: IntArray
    pair_warps: FloatArray
    pair_weights: FloatArray


class Robustness(NamedTuple):
    """Weight of a comparison: precision x ((ncc - floor) / (1 - floor)) ^ power.

    For the previous frame it is multiplied by ncc ^ likeness of the point with its stored templates.
    """

    precision: float
    floor: float
    power: float
    likeness: float


class Scene(NamedTuple):
    """All data of a frame.

    Attributes:
        raw: (2, C, K, GRID, GRID) intensities of the reference and of the previous frame, not warped, NaN if
            missing; empty unless the printed recalculation is used.
    """

    images: Images
    optics: Optics
    targets: Targets
    robustness: Robustness
    raw: FloatArray


@dataclass(frozen=True, eq=False)
class ComparedFrame:
    """Images of a frame, with the templates to compare them with.

    Attributes:
        images: of all cameras.
        templates: of the reference, then of keyframes.
        previous: templates of the previous frame; None without one.
        settings: of the refinement.
    """

    images: RigImages
    templates: Sequence[TemplateSet]
    previous: TemplateSet | None
    settings: RefinementSettings

    def scene(self, pose: HeadPose, shape: FloatArray) -> tuple[Scene, FloatArray]:
        """Return the frame at a predicted pose and shape (K, 3), and its points' visibility (C, K)."""
        projection = project(self.images.cameras, pose.points(shape))
        there = np.array([image is not None for image in self.images.images])
        seen = visibility(projection, pose) * there[:, None]
        weights = seen**VISIBILITY_POWER
        return Scene(
            _cut_images(self.images.images, projection.pixels),
            _optics(self.images.cameras, projection),
            self._targets(tangents(projection, pose), weights),
            self._robustness,
            self._raw,
        ), seen

    def _targets(self, now: FloatArray, seen: FloatArray) -> Targets:
        weights = [REFERENCE, *[KEYFRAME] * (len(self.templates) - 1)]
        found = [warped(one, now) for one in self.templates]
        if self.previous is not None:
            weights.append(PREVIOUS)
            found.append(warped(self.previous, now))
        patches = np.stack([one[0] for one in found])
        known = np.stack([one[1] for one in found])
        return Targets(
            patches,
            len(self.templates),
            np.array(weights)[:, None, None] * seen * known,
            *_pairs(now, seen),
        )

    @property
    def _robustness(self) -> Robustness:
        likeness = self.settings.previous_likeness
        return Robustness(PATCH_SD**-2, CORRELATION_FLOOR, CORRELATION_POWER, likeness)

    @property
    def _raw(self) -> FloatArray:
        """Intensities for ``Scene.raw``."""
        shape, previous = (*self.templates[0].seen.shape, GRID, GRID), self.previous
        if self.settings.recalculation != "printed":
            return np.zeros((0, *shape))
        before = np.full(shape, np.nan) if previous is None else unwarped(previous)
        return np.stack([unwarped(self.templates[0]), before])


def _cut_images(images: Sequence[ImageArray | None], pixels: FloatArray) -> Images:
    """Copy the boxes around the points (C, K, 2), clipped to the images."""
    corners, sizes = np.zeros((len(images), 2)), np.zeros((len(images), 2), dtype=np.int64)
    for c, image in enumerate(images):
        if image is not None:
            limit = np.array(image.shape[::-1])
            first = np.clip(np.floor(pixels[c].min(axis=0)) - MARGIN, 0, limit)
            last = np.clip(np.ceil(pixels[c].max(axis=0)) + MARGIN, first, limit)
            corners[c], sizes[c] = first, last - first
    width, height = sizes.max(axis=0)
    windows = np.zeros((len(images), height, width), dtype=np.uint8)
    for c, image in enumerate(images):
        if image is not None:
            (x, y), (w, h) = corners[c].astype(int), sizes[c]
            windows[c, :h, :w] = image[y : y + h, x : x + w]
    return Images(windows, corners, sizes)


def _optics(cameras: Sequence[Camera], projection: Projection) -> Optics:
    transforms = np.array([camera.camera_T_reference for camera in cameras])
    intrinsics = np.array([(camera.fx, camera.fy, camera.cx, camera.cy) for camera in cameras])
    return Optics(transforms, intrinsics, projection.lenses)


def _pairs(now: FloatArray, seen: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Pair all cameras that have an image, so that none is needed for the others to agree."""
    there = np.flatnonzero(seen.any(axis=1))
    pairs = np.array([(c, b) for b, c in combinations(there, 2)], dtype=np.int64).reshape(-1, 2)
    warps = warps_between(now[pairs[:, 0]], now[pairs[:, 1]])
    weights = BETWEEN_CAMERAS * np.minimum(seen[pairs[:, 0]], seen[pairs[:, 1]])
    return pairs, warps, np.where(np.isnan(warps[..., 0, 0]), 0.0, weights)
