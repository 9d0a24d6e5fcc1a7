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

# Square patches of an image as vectors of zero mean and unit norm; compiled.
#
# A patch has ``PATCH`` x ``PATCH`` pixels at the offsets (i - 7.5, j - 7.5) from its centre, i along the
# rows. With p = (I - mean I) / |I - mean I| the scalar product of two patches is their normalised correlation
# (ncc), and |p - q|^2 = 2 (1 - ncc): a change of brightness or contrast leaves both alone **[ours]**.


PATCH = 16
SIZE = PATCH * PATCH
GRID = PATCH + 2
"""A patch with one pixel more on each side, for the gradients."""
CENTRE = 0.5 * (GRID - 1)
LEAST_CONTRAST = 1.0
"""Standard deviation, grey levels, below which a patch shows nothing: less than the noise of a camera."""


@inlined
def covers(width: int, height: int, u: float, v: float, warp: FloatArray) -> bool:
    """Whether a warped patch about (u, v), its gradients included, lies within an image."""
    reach_u = CENTRE * (abs(warp[0, 0]) + abs(warp[0, 1]))
    reach_v = CENTRE * (abs(warp[1, 0]) + abs(warp[1, 1]))
    inside_u: bool = u - reach_u >= 0.0 and u + reach_u < width - 1.0
    inside_v: bool = v - reach_v >= 0.0 and v + reach_v < height - 1.0
    return inside_u and inside_v


@kernel
def sample_grid(
    image: ImageArray, width: int, height: int, u: float, v: float, warp: FloatArray, out: FloatArray
) -> bool:
    """Write the intensities at (u, v) + W (i - CENTRE, j - CENTRE), bilinear, into out (GRID, GRID).

    Args:
        image: (>= height, >= width).
        width, height: of the part that may be read.
        u, v: centre, pixels.
        warp: (2, 2) W, pixels of the image per pixel of the patch.
        out: row j, column i.

    Returns:
        Whether all of it lies in the image; else nothing is written.
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

    A patch without contrast becomes 0 and its norm is returned as 0.
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
    """Write dp / dc (2, SIZE), per pixel that the patch's centre c moves along columns and rows of the grid.

    dp = (1 - p p^T) (dI - mean dI) / |I - mean I|, with dI the central differences of neighbouring samples.

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
    """The scalar product of two vectors (SIZE,), in four partial sums: they are added side by side."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    for n in range(0, SIZE, 4):
        s0 += a[n] * b[n]
        s1 += a[n + 1] * b[n + 1]
        s2 += a[n + 2] * b[n + 2]
        s3 += a[n + 3] * b[n + 3]
    return (s0 + s1) + (s2 + s3)


@inlined
def total(a: FloatArray) -> float:
    """The sum of a vector (SIZE,), in four partial sums."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    for n in range(0, SIZE, 4):
        s0 += a[n]
        s1 += a[n + 1]
        s2 += a[n + 2]
        s3 += a[n + 3]
    return (s0 + s1) + (s2 + s3)


# What the feature points looked like at some time, and how that looks from where the head is now.
#
# About each point the skin is taken for its tangent plane. With T the derivative (2, 2) of a camera's pixels
# by coordinates in that plane, a shift d of pixels now is a shift T_then T_now^-1 d of pixels then: templates
# are sampled under that affine warp **[ours]**, so that a head that turns or comes nearer keeps its
# reference. Templates of further directions, the keyframes, are kept beside the reference.


CAMERAS = "cameras"
"""Name of how many there are, in layouts."""
WINDOW = 48
"""Side of what is kept about a point, pixels: a patch at up to twice its size and turned."""
LARGEST_STRETCH = 4.0
"""Pixels then for a pixel now at most; beyond, the plane is seen edge on."""


@dataclass(frozen=True, eq=False)
class TemplateSet:
    """The K feature points on the images of C cameras at one time.

    Attributes:
        windows: (C, K, WINDOW, WINDOW) image about each point.
        centres: (C, K, 2) the point in its window, pixels.
        tangents: (C, K, 2, 2) T, pixels per mm in the tangent plane.
        seen: (C, K) whether camera and point had a window.
        facing: (3,) direction out of the face, in the reference camera's axes.
    """

    windows: Annotated[ImageArray, Layout("uint8", (CAMERAS, POINT_COUNT, WINDOW, WINDOW))]
    centres: Annotated[FloatArray, places(CAMERAS, POINT_COUNT, 2)]
    tangents: Annotated[FloatArray, places(CAMERAS, POINT_COUNT, 2, 2)]
    seen: Annotated[BoolArray, Layout("bool", (CAMERAS, POINT_COUNT))]
    facing: Annotated[FloatArray, units(3)]

    def resized(self, factor: float) -> TemplateSet:
        """Return the templates of a head that is so many times as large, as far away, and looks the same."""
        return self if factor == 1.0 else replace(self, tangents=self.tangents / factor)


def take_templates(
    images: RigImages, pose: HeadPose, shape: FloatArray, pixels: FloatArray | None = None
) -> TemplateSet:
    """Return the templates of a frame.

    Args:
        images: of all cameras of the recording.
        pose: of the head.
        shape: (K, 3) points in the head's frame, mm.
        pixels: (C, K, 2) where the points are; without, where pose and shape put them.
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
    """Return T (C, K, 2, 2): how pixels change with coordinates in each point's tangent plane, per mm."""
    planes = pose.rotation @ _planes()
    found: FloatArray = projection.jacobians @ planes
    return found


def visibility(projection: Projection, pose: HeadPose) -> FloatArray:
    """Return (C, K) how much each camera sees of each point: the cosine of normal and ray, 0 from behind."""
    normals = POINT_NORMALS @ pose.rotation.T
    cosines = np.einsum("kj,ckj->ck", normals, projection.rays)
    return np.where(projection.in_front, np.maximum(cosines, 0.0), 0.0)


def warped(templates: TemplateSet, now: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the templates as they look now.

    Args:
        templates: of some time.
        now: (C, K, 2, 2) ``tangents`` at the head's present pose.

    Returns:
        (C, K, SIZE) patches of zero mean and unit norm, row by row, and (C, K) whether there is one: the
        point was seen then, with some contrast, and is not seen edge on now.
    """
    warps = warps_between(now, templates.tangents)
    patches = np.zeros((*templates.seen.shape, SIZE))
    known = np.zeros(templates.seen.shape, dtype=np.bool_)
    _sample_all(templates.windows, templates.centres, warps, templates.seen, patches, known)
    return patches, known


def unwarped(templates: TemplateSet) -> FloatArray:
    """Return the intensities (C, K, GRID, GRID) about each point as they were; NaN where it was not seen."""
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
    """Return T_target T_source^-1 (..., 2, 2), NaN where that cannot be told or stretches too much."""
    a, b, c, d = source[..., 0, 0], source[..., 0, 1], source[..., 1, 0], source[..., 1, 1]
    determinant = a * d - b * c
    determinant[determinant == 0.0] = np.nan
    adjugate = source[..., ::-1, ::-1].swapaxes(-1, -2) * ADJUGATE_SIGNS
    warps: FloatArray = target @ adjugate / determinant[..., None, None]
    stretched = ~(np.abs(warps).max(axis=(-2, -1)) <= LARGEST_STRETCH)
    warps[stretched] = np.nan
    return warps


def _cut(image: ImageArray, pixels: FloatArray, windows: ImageArray) -> tuple[FloatArray, BoolArray]:
    """Fill windows (K, WINDOW, WINDOW); return their corners (K, 2), and which lie wholly in the image.

    A window at the image's edge is shifted into it.
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
    """Return (K, 3, 2) two unit vectors across each point's normal, in the head's frame."""
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
    """Write the normalised patch of every window under its warp, and whether there is one."""
    grid = np.empty((GRID, GRID))
    for c in range(seen.shape[0]):
        for k in range(seen.shape[1]):
            if not seen[c, k] or np.isnan(warps[c, k, 0, 0]):
                continue
            u, v = centres[c, k, 0], centres[c, k, 1]
            if sample_grid(windows[c, k], WINDOW, WINDOW, u, v, warps[c, k], grid):
                known[c, k] = normalise(grid, patches[c, k]) > 0.0


def nearest_templates(templates: Sequence[TemplateSet], facing: FloatArray) -> tuple[TemplateSet, ...]:
    """Return the reference, and the keyframe whose direction is nearest to ``facing`` if it is nearer."""
    nearest = min(templates, key=lambda one: angle_deg(one.facing, facing))
    return (templates[0],) if nearest is templates[0] else (templates[0], nearest)


def is_new_direction(templates: Sequence[TemplateSet], facing: FloatArray, apart_deg: float) -> bool:
    """Whether a direction is farther than that from those of all templates."""
    return all(angle_deg(one.facing, facing) > apart_deg for one in templates)


def angle_deg(a: FloatArray, b: FloatArray) -> float:
    """Return the angle, degrees, between unit vectors (3,)."""
    return float(np.degrees(np.arccos(np.clip(a @ b, -1.0, 1.0))))
