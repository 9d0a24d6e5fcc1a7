"""Patches and templates of a face's points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.head.face.points import POINT_COUNT, POINT_NORMALS, HeadPose
from posetrack_cli.head.face.rig_images import Projection, RigImages, project
from posetrack_cli.results.columns import Layout, places, units

# Square patches as vectors of zero mean and unit norm; compiled.
#
# A patch has ``PATCH`` x ``PATCH`` pixels at the offsets (i - 7.5, j - 7.5) from its centre, i along the
# rows. With p = (I - mean I) / |I - mean I| the scalar product of two patches is their normalised correlation
# (ncc), and |p - q|^2 = 2 (1 - ncc); both are invariant to brightness and contrast **[ours]**.

PATCH = 16
SIZE = PATCH * PATCH
GRID = PATCH + 2
"""A patch with a margin of one pixel for gradients."""
CENTRE = 0.5 * (GRID - 1)
LEAST_CONTRAST = 1.0
"""Minimum standard deviation of a patch, grey levels: less than a camera's noise."""


@inlined
def covers(width: int, height: int, u: float, v: float, warp: FloatArray) -> bool:
    """Whether a warped patch at (u, v), including its gradients, lies within an image."""
    reach_u = CENTRE * (abs(warp[0, 0]) + abs(warp[0, 1]))
    reach_v = CENTRE * (abs(warp[1, 0]) + abs(warp[1, 1]))
    inside_u: bool = u - reach_u >= 0.0 and u + reach_u < width - 1.0
    inside_v: bool = v - reach_v >= 0.0 and v + reach_v < height - 1.0
    return inside_u and inside_v


@kernel
def sample_grid(
    image: ImageArray, width: int, height: int, u: float, v: float, warp: FloatArray, out: FloatArray
) -> bool:
    """Sample intensities at (u, v) + W (i - CENTRE, j - CENTRE), bilinear, into out (GRID, GRID).

    Args:
        image: (>= height, >= width).
        width, height: of the readable part.
        u, v: centre, pixels.
        warp: (2, 2) W, pixels of the image per pixel of the patch.
        out: row j, column i.

    Returns:
        Whether all samples lie in the image; otherwise nothing is written.
    """
    if not covers(width, height, u, v, warp):
        return False
    for j in range(GRID):
        for i in range(GRID):
            x = u + warp[0, 0] * (i - CENTRE) + warp[0, 1] * (j - CENTRE)
            y = v + warp[1, 0] * (i - CENTRE) + warp[1, 1] * (j - CENTRE)
            column, row = int(x), int(y)
            s, t = x - column, y - row
            upper = (1.0 - s) * image[row, column] + s * image[row, column + 1]
            lower = (1.0 - s) * image[row + 1, column] + s * image[row + 1, column + 1]
            out[j, i] = (1.0 - t) * upper + t * lower
    return True


@kernel
def normalise(grid: FloatArray, patch: FloatArray) -> float:
    """Write the patch (SIZE,) of a grid (GRID, GRID), zero mean and unit norm; return |I - mean I|.

    Patch and norm are 0 without contrast.
    """
    for j in range(PATCH):
        for i in range(PATCH):
            patch[j * PATCH + i] = grid[j + 1, i + 1]
    mean = total(patch) / SIZE
    for n in range(SIZE):
        patch[n] -= mean
    norm = np.sqrt(product(patch, patch))
    shown = norm >= LEAST_CONTRAST * PATCH
    scale = 1.0 / norm if shown else 0.0
    for n in range(SIZE):
        patch[n] *= scale
    return float(norm) if shown else 0.0


@kernel
def differentiate(grid: FloatArray, patch: FloatArray, norm: float, gradient: FloatArray) -> None:
    """Write dp / dc (2, SIZE), per pixel of motion of the centre c along columns and rows of the grid.

    dp = (1 - p p^T) (dI - mean dI) / |I - mean I|, with dI from central differences.

    Args:
        grid: (GRID, GRID) intensities.
        patch, norm: of ``normalise``.
        gradient: out.
    """
    for j in range(PATCH):
        for i in range(PATCH):
            gradient[0, j * PATCH + i] = 0.5 * (grid[j + 1, i + 2] - grid[j + 1, i])
            gradient[1, j * PATCH + i] = 0.5 * (grid[j + 2, i + 1] - grid[j, i + 1])
    for axis in range(2):
        slope = gradient[axis]
        mean, along = total(slope) / SIZE, product(slope, patch)
        for n in range(SIZE):
            slope[n] = (slope[n] - mean - along * patch[n]) / norm


@inlined
def product(a: FloatArray, b: FloatArray) -> float:
    """Return the scalar product of two vectors (SIZE,); four partial sums allow vectorisation."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    for n in range(0, SIZE, 4):
        s0 += a[n] * b[n]
        s1 += a[n + 1] * b[n + 1]
        s2 += a[n + 2] * b[n + 2]
        s3 += a[n + 3] * b[n + 3]
    return (s0 + s1) + (s2 + s3)


@inlined
def total(a: FloatArray) -> float:
    """Return the sum of a vector (SIZE,), in four partial sums."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    for n in range(0, SIZE, 4):
        s0 += a[n]
        s1 += a[n + 1]
        s2 += a[n + 2]
        s3 += a[n + 3]
    return (s0 + s1) + (s2 + s3)


# Templates of the feature points, warped to the current pose.
#
# The skin at each point is approximated by its tangent plane. With T the derivative (2, 2) of a camera's
# pixels by coordinates in that plane, a shift d of current pixels is a shift T_then T_now^-1 d of the
# template's pixels. Templates are sampled under that affine warp **[ours]**, so the reference stays valid
# when the head turns or approaches. Templates from other directions (keyframes) are stored in addition.

CAMERAS = "cameras"
"""Name of the camera dimension in layouts."""
WINDOW = 48
"""Side of a stored window, pixels: a rotated patch at up to twice its size."""
LARGEST_STRETCH = 4.0
"""Maximum template pixels per current pixel; beyond, the plane is seen edge-on."""


@dataclass(frozen=True, eq=False)
class TemplateSet:
    """The K feature points in the images of C cameras at one time.

    Attributes:
        windows: (C, K, WINDOW, WINDOW) image around each point.
        centres: (C, K, 2) the point in its window, pixels.
        tangents: (C, K, 2, 2) T, pixels per mm in the tangent plane.
        seen: (C, K) whether camera and point have a window.
        facing: (3,) direction of the face, in the reference camera's axes.
    """

    windows: Annotated[ImageArray, Layout("uint8", (CAMERAS, POINT_COUNT, WINDOW, WINDOW))]
    centres: Annotated[FloatArray, places(CAMERAS, POINT_COUNT, 2)]
    tangents: Annotated[FloatArray, places(CAMERAS, POINT_COUNT, 2, 2)]
    seen: Annotated[BoolArray, Layout("bool", (CAMERAS, POINT_COUNT))]
    facing: Annotated[FloatArray, units(3)]

    def resized(self, factor: float) -> TemplateSet:
        """Return the templates of a head scaled by a factor, with the same distance and appearance."""
        return self if factor == 1.0 else replace(self, tangents=self.tangents / factor)


def take_templates(
    images: RigImages, pose: HeadPose, shape: FloatArray, pixels: FloatArray | None = None
) -> TemplateSet:
    """Return the templates of a frame.

    Args:
        images: of all cameras of the recording.
        pose: of the head.
        shape: (K, 3) points in the head's frame, mm.
        pixels: (C, K, 2) of the points; projected from pose and shape by default.
    """
    projection = project(images.cameras, pose.points(shape))
    pixels = projection.pixels if pixels is None else pixels
    windows = np.zeros((*pixels.shape[:2], WINDOW, WINDOW), dtype=np.uint8)
    corners = np.zeros(pixels.shape)
    seen = np.zeros(pixels.shape[:2], dtype=bool)
    for c, image in enumerate(images.images):
        if image is not None:
            corners[c], seen[c] = _cut(image, pixels[c], windows[c])
    seen &= projection.in_front
    return TemplateSet(windows, pixels - corners, tangents(projection, pose), seen, pose.facing)


def tangents(projection: Projection, pose: HeadPose) -> FloatArray:
    """Return T (C, K, 2, 2), the derivative of pixels by coordinates in each tangent plane, per mm."""
    planes = pose.rotation @ _planes()
    found: FloatArray = projection.jacobians @ planes
    return found


def visibility(projection: Projection, pose: HeadPose) -> FloatArray:
    """Return (C, K) visibility: cosine between normal and ray, 0 from behind."""
    normals = POINT_NORMALS @ pose.rotation.T
    cosines = np.einsum("kj,ckj->ck", normals, projection.rays)
    return np.where(projection.in_front, np.maximum(cosines, 0.0), 0.0)


def warped(templates: TemplateSet, now: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the templates warped to the current pose.

    Args:
        templates: of an earlier time.
        now: (C, K, 2, 2) ``tangents`` at the current pose.

    Returns:
        (C, K, SIZE) patches of zero mean and unit norm, row by row, and (C, K) whether they are valid: seen
            then,
        with contrast, and not edge-on now.
    """
    warps = warps_between(now, templates.tangents)
    patches = np.zeros((*templates.seen.shape, SIZE))
    known = np.zeros(templates.seen.shape, dtype=np.bool_)
    _sample_all(templates.windows, templates.centres, warps, templates.seen, patches, known)
    return patches, known


def unwarped(templates: TemplateSet) -> FloatArray:
    """Return the stored intensities (C, K, GRID, GRID) at each point; NaN if it was not seen."""
    grids = np.full((*templates.seen.shape, GRID, GRID), np.nan)
    for c, k in np.argwhere(templates.seen):
        u, v = templates.centres[c, k]
        sample_grid(templates.windows[c, k], WINDOW, WINDOW, u, v, np.eye(2), grids[c, k])
    return grids


def template_images(patches: FloatArray) -> ImageArray:
    """Return patches (..., SIZE) as float32 images (..., PATCH, PATCH) for cv2.matchTemplate."""
    return patches.reshape(*patches.shape[:-1], PATCH, PATCH).astype(np.float32)


ADJUGATE_SIGNS = np.array([[1.0, -1.0], [-1.0, 1.0]])


def warps_between(source: FloatArray, target: FloatArray) -> FloatArray:
    """Return T_target T_source^-1 (..., 2, 2), NaN if undefined or stretched too much."""
    a, b, c, d = source[..., 0, 0], source[..., 0, 1], source[..., 1, 0], source[..., 1, 1]
    determinant = a * d - b * c
    determinant[determinant == 0.0] = np.nan
    adjugate = source[..., ::-1, ::-1].swapaxes(-1, -2) * ADJUGATE_SIGNS
    warps: FloatArray = target @ adjugate / determinant[..., None, None]
    stretched = ~(np.abs(warps).max(axis=(-2, -1)) <= LARGEST_STRETCH)
    warps[stretched] = np.nan
    return warps


def _cut(image: ImageArray, pixels: FloatArray, windows: ImageArray) -> tuple[FloatArray, BoolArray]:
    """Fill windows (K, WINDOW, WINDOW); return their corners (K, 2), and which lie in the image.

    Windows at the image's edge are shifted into it.
    """
    height, width = image.shape
    largest = np.array([width - WINDOW, height - WINDOW])
    wanted = np.floor(np.nan_to_num(pixels, nan=-1e6)) - WINDOW // 2
    corners = np.clip(wanted, 0, largest)
    seen = np.all((np.abs(corners - wanted) < WINDOW // 2) & (largest >= 0), axis=-1)
    for k in np.flatnonzero(seen):
        x, y = int(corners[k, 0]), int(corners[k, 1])
        windows[k] = image[y : y + WINDOW, x : x + WINDOW]
    return corners, seen


@cache
def _planes() -> FloatArray:
    """Return (K, 3, 2) two unit vectors of each point's tangent plane, in the head's frame."""
    across = np.cross([0.0, 1.0, 0.0], POINT_NORMALS)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([across, np.cross(POINT_NORMALS, across)], axis=-1)


@kernel
def _sample_all(
    windows: ImageArray,
    centres: FloatArray,
    warps: FloatArray,
    seen: BoolArray,
    patches: FloatArray,
    known: BoolArray,
) -> None:
    """Write the normalised patch of every window under its warp, and its validity."""
    grid = np.empty((GRID, GRID))
    for c in range(seen.shape[0]):
        for k in range(seen.shape[1]):
            if not seen[c, k] or np.isnan(warps[c, k, 0, 0]):
                continue
            u, v = centres[c, k, 0], centres[c, k, 1]
            if sample_grid(windows[c, k], WINDOW, WINDOW, u, v, warps[c, k], grid):
                known[c, k] = normalise(grid, patches[c, k]) > 0.0


def nearest_templates(templates: Sequence[TemplateSet], facing: FloatArray) -> tuple[TemplateSet, ...]:
    """Return the reference, and the keyframe closest in direction if it is closer."""
    nearest = min(templates, key=lambda one: angle_deg(one.facing, facing))
    return (templates[0],) if nearest is templates[0] else (templates[0], nearest)


def is_new_direction(templates: Sequence[TemplateSet], facing: FloatArray, apart_deg: float) -> bool:
    """Whether a direction differs by more than an angle from those of all templates."""
    return all(angle_deg(one.facing, facing) > apart_deg for one in templates)


def angle_deg(a: FloatArray, b: FloatArray) -> float:
    """Return the angle, degrees, between unit vectors (3,)."""
    return float(np.degrees(np.arccos(np.clip(a @ b, -1.0, 1.0))))
