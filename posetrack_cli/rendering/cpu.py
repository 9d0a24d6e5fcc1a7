"""Depth rendering on the CPU."""

from __future__ import annotations

import platform
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.compiled import borrowing, inlined, thread_count
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.pixel_model import (
    LOGISTIC_OF_NORMAL,
    NEIGHBOUR_MISFIT,
    REACH_PX,
    PixelMixture,
    outline_distances,
)
from posetrack_cli.rendering.port import (
    MOST_TILES,
    Comparison,
    RendererInfo,
    RenderingDevice,
    Surface,
    SurfaceRenderer,
    TileSums,
    Window,
    check_observed,
    check_poses,
)
from posetrack_cli.rendering.raster import Drawing, RestMesh, View, draw_depth, empty_drawing, rest_mesh

# Sums over one rendered tile, as defined by ``port.sums_in_numpy``; compiled. CPU version of
# ``gl/shaders/tile_sums.comp``.

_FAR = 40.0  # log odds beyond which the smaller share is below the last bit of the larger one
_SMALL = 0.1  # exp of smaller arguments is computed by a polynomial
_MUCH = np.exp(NEIGHBOUR_MISFIT)  # ratio of densities at a misfit of NEIGHBOUR_MISFIT
_LARGE, _TINY = 1e150, 1e-150  # range of products of densities, far from overflow
ROW = 8
"""Sums per tile, in the order of ``TileSums.from_rows``."""


class Reading(NamedTuple):
    """Observation that tiles are compared with, in the form used by the kernels.

    Attributes:
        image: (h, w) as ``Comparison.observed``.
        off: (h, w) distance to the nearest target pixel, pixels.
        before: (h, w) exp(-l y) of target pixels, with l the rate of occluders.
        clamp_mm, match_mm: see ``Comparison``.
        slope: width of a pixel, mm, per mm of depth.
    """

    image: FloatArray
    off: FloatArray
    before: FloatArray
    clamp_mm: float
    match_mm: float
    slope: float


class Mixture(NamedTuple):
    """Parameters of a ``PixelMixture``; ``enabled`` is False without one."""

    enabled: bool
    near_sd: float = 1.0
    sd_growth: float = 0.0
    occluder_rate: float = 1.0
    occluded_per_sd: float = 0.0
    outlier_per_sd: float = 0.0
    outline_sd: float = 1.0
    unread_weight: float = 0.0


def mixture_of(model: PixelMixture | None) -> Mixture:
    """Return a pixel model in the form used by the kernels."""
    return Mixture(False) if model is None else Mixture(True, **model.uniforms)


def reading_of(comparison: Comparison, off: FloatArray, slope: float) -> Reading:
    """Return an observation and comparison parameters in the form used by the kernels."""
    image = comparison.observed.astype(np.float64)
    rate = 0.0 if comparison.model is None else comparison.model.uniforms["occluder_rate"]
    before = np.exp(-rate * np.maximum(image, 0.0))
    return Reading(image, off, before, comparison.clamp_mm, comparison.match_mm, slope)


def empty_depths(height: int, width: int) -> FloatArray:
    """Return depths (h + 2 r, w + 2 r) of a tile with a border of r = ``REACH_PX``, all inf (empty)."""
    return np.full((height + 2 * REACH_PX, width + 2 * REACH_PX), np.inf)


@inlined
def _exponential(x: float) -> float:
    """Return exp(x), with relative error 2e-11 for small x, as between two depths of one hand."""
    if abs(x) > _SMALL:
        return float(np.exp(x))
    return 1.0 + x * (1.0 + x * (1.0 / 2 + x * (1.0 / 6 + x * (1.0 / 24 + x * (1.0 / 120 + x / 720)))))


@inlined
def _densities(d: float, y: float, before: float, off: float, model: Mixture) -> tuple[float, float]:
    """Return the densities of the best possible reading and of y, up to a common factor.

    The logarithm of their ratio is the misfit.
    """
    sd = model.near_sd + model.sd_growth * d * d
    outlier, occluded = model.outlier_per_sd * sd, model.occluded_per_sd * sd
    t, s = (y - d) / sd, off / model.outline_sd
    far_end = before * _exponential(model.occluder_rate * (y - d))
    nearer, front = 1.0 - far_end, occluded * before if y <= d else 0.0
    here = np.exp(-0.5 * (t * t + s * s))
    return nearer * (1.0 + outlier) + occluded * far_end, nearer * (here + outlier) + front


@inlined
def _misfit_of_other(d: float, y: float, off: float, model: Mixture) -> float:
    """Return ``PixelMixture.misfit_of_other`` of a reading -y, or ``misfit_of_unread`` for y = 0."""
    sd = model.near_sd + model.sd_growth * d * d
    outlier, t = model.outlier_per_sd * sd, off / model.outline_sd
    behind = -LOGISTIC_OF_NORMAL * (d + y) / sd
    if y < 0.0 and behind < -_FAR:  # clearly in front: explained as an occluder
        return 0.0
    beside = (np.exp(-0.5 * t * t) + outlier) / (1.0 + outlier)
    if y == 0.0:
        return float(-model.unread_weight * np.log(beside))
    front = 1.0 / (1.0 + np.exp(behind)) if behind < _FAR else 0.0
    return float(-np.log(front + (1.0 - front) * beside))


@inlined
def _unexplained(y: float, model: Mixture) -> float:
    """Return ``PixelMixture.unexplained``."""
    outlier = model.outlier_per_sd * (model.near_sd + model.sd_growth * y * y)
    return float(np.log(1.0 + 1.0 / outlier))


@borrowing
def _fill_depths(inverses: FloatArray, depths: FloatArray) -> None:
    """Write a tile's depths, inf where empty, into the interior of ``empty_depths``."""
    for j in range(inverses.shape[0]):
        for i in range(inverses.shape[1]):
            depths[j + REACH_PX, i + REACH_PX] = 1.0 / inverses[j, i]


@borrowing
def _misfit_with_neighbours(depths: FloatArray, i: int, j: int, reading: Reading, model: Mixture) -> float:
    """Return the misfit of a target pixel with the best-fitting surface within ``REACH_PX``."""
    y = reading.image[j, i]
    per_sd, pixel = 1.0 / (model.near_sd + model.sd_growth * y * y), reading.slope * y
    per_pixel2 = (pixel / model.outline_sd) ** 2
    least, depth, nearest = np.inf, np.inf, 0.0
    for dj in range(-REACH_PX, REACH_PX + 1):
        for di in range(-REACH_PX, REACH_PX + 1):
            off2 = float(di * di + dj * dj)
            if off2 == 0.0 or off2 > REACH_PX * REACH_PX:
                continue
            d = depths[j + dj + REACH_PX, i + di + REACH_PX]
            square = ((y - d) * per_sd) ** 2 + off2 * per_pixel2
            if square < least:
                least, depth, nearest = square, d, off2
    if depth == np.inf:
        return np.inf
    best, found = _densities(depth, y, reading.before[j, i], np.sqrt(nearest) * pixel, model)
    return float(np.log(best / found))


@inlined
def _relief(depths: FloatArray, i: int, j: int, reading: Reading, model: Mixture) -> float:
    """Return the cost reduction of an uncovered target pixel due to a surface next to it."""
    beside = _misfit_with_neighbours(depths, i, j, reading, model)
    return max(0.0, _unexplained(reading.image[j, i], model) - beside) if beside < np.inf else 0.0


@borrowing
def _box(drawing: Drawing) -> tuple[int, int, int, int]:
    """Return first column and row, then one past the last, of the covered area and its surroundings."""
    screen, (height, width) = drawing.screen, drawing.inverse.shape
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for v in range(len(screen)):
        x, y = screen[v, 0], screen[v, 1]
        left, right = min(left, x), max(right, x)
        top, bottom = min(top, y), max(bottom, y)
    reach = REACH_PX + 1.0  # one more pixel for rounding
    return (
        int(min(max(left - reach, 0.0), width)),
        int(min(max(top - reach, 0.0), height)),
        int(min(max(right + reach, 0.0), width)),
        int(min(max(bottom + reach, 0.0), height)),
    )


@borrowing
def add_sums(drawing: Drawing, depths: FloatArray, reading: Reading, model: Mixture, row: FloatArray) -> None:
    """Write the sums over a rendered tile to a row (8,).

    Misfits are summed as the logarithm of a ratio of products, i.e. one logarithm for many pixels.

    Args:
        drawing: rendered tile.
        depths: buffer of ``empty_depths``; overwritten.
        reading, model: observation and pixel model.
        row: output.
    """
    image = reading.image
    _fill_depths(drawing.inverse, depths)
    left, top, right, bottom = _box(drawing)
    error, misfit, relief, most, found = 0.0, 0.0, 0.0, 1.0, 1.0
    both, other, unread, hidden, matched = 0, 0, 0, 0, 0
    for j in range(top, bottom):
        for i in range(left, right):
            d, y = depths[j + REACH_PX, i + REACH_PX], image[j, i]
            if d == np.inf:
                if model.enabled and y > 0.0:
                    relief += _relief(depths, i, j, reading, model)
                continue
            if y > 0.0:
                apart = abs(d - y)
                both, error = both + 1, error + min(apart, reading.clamp_mm)
                matched += apart < reading.match_mm
                if model.enabled:
                    of_best, of_this = _densities(d, y, reading.before[j, i], 0.0, model)
                    if of_best > _MUCH * of_this:
                        beside = _misfit_with_neighbours(depths, i, j, reading, model)
                        misfit += min(np.log(of_best / of_this), beside)
                        continue
                    most, found = most * of_best, found * of_this
                    if most > _LARGE or found < _TINY:
                        misfit += np.log(most / found)
                        most, found = 1.0, 1.0
                continue
            unread, other = unread + (y == 0.0), other + (y < 0.0)
            hidden += (y < 0.0) & (-y < d)
            if model.enabled:
                misfit += _misfit_of_other(d, y, reading.off[j, i] * reading.slope * d, model)
    misfit += np.log(most / found)
    row[0], row[1], row[2], row[3] = error, both, other, unread
    row[4], row[5], row[6], row[7] = misfit, hidden, matched, relief


@borrowing
def sum_poses(
    mesh: RestMesh,
    bones: FloatArray,
    first: int,
    stride: int,
    view: View,
    reading: Reading,
    model: Mixture,
    drawing: Drawing,
    depths: FloatArray,
    rows: FloatArray,
) -> None:
    """Render every ``stride``-th of poses (N, B, 3, 4) and write its sums (N, 8)."""
    for n in range(first, len(bones), stride):
        rows[n, :] = 0.0
        if draw_depth(mesh, bones[n], view, drawing):
            add_sums(drawing, depths, reading, model, rows[n])


@borrowing
def draw_poses(
    mesh: RestMesh,
    bones: FloatArray,
    first: int,
    stride: int,
    view: View,
    drawing: Drawing,
    depth: FloatArray,
) -> None:
    """Render every ``stride``-th of poses (N, B, 3, 4) and write its depth (N, h, w), mm; 0 if empty."""
    for n in range(first, len(bones), stride):
        drawn = draw_depth(mesh, bones[n], view, drawing)
        for j in range(depth.shape[1]):
            for i in range(depth.shape[2]):
                inverse = drawing.inverse[j, i]
                depth[n, j, i] = 1.0 / inverse if drawn and inverse > 0.0 else 0.0


# Multithreaded ``rendering.port.DepthRenderer``


class CompiledDepthRenderer:
    """Depth images of one mesh in N poses, or sums over them.

    Poses with any vertex closer than ``raster.NEAR_MM`` are not rendered. Sums do not depend on the number
    of threads.

    Args:
        mesh: mesh shared by all poses.
        tile: (width, height) of a tile, pixels.
    """

    def __init__(self, mesh: SkinnedMesh, tile: tuple[int, int]) -> None:
        self.tile, self.bones = tile, mesh.weights.shape[1]
        self._mesh, self._threads = rest_mesh(mesh), thread_count()
        self._drawings = [empty_drawing(self._mesh, tile[1], tile[0]) for _ in range(self._threads)]
        self._depths = [empty_depths(tile[1], tile[0]) for _ in range(self._threads)]
        self._pool = ThreadPoolExecutor(self._threads)

    def depth(self, transforms: Float32Array, camera: Camera, window: Window) -> Float32Array:
        """Render and return depth (N, height, width), mm."""
        check_poses(self, transforms, window)
        bones, view = _bones_of(transforms), View(*window.tile_projection(camera))
        depth = np.empty((len(bones), self.tile[1], self.tile[0]))

        def draw_part(thread: int) -> None:
            draw_poses(self._mesh, bones, thread, self._threads, view, self._drawings[thread], depth)

        self._on_all_threads(draw_part, len(bones))
        return depth.astype(np.float32)

    def sums(
        self, transforms: Float32Array, camera: Camera, window: Window, comparison: Comparison
    ) -> TileSums:
        """Render and return the sums defined by ``port.sums_in_numpy``."""
        check_observed(comparison.observed, window)
        check_poses(self, transforms, window)
        bones, view = _bones_of(transforms), View(*window.tile_projection(camera))
        model = mixture_of(comparison.model)
        off = outline_distances(comparison.observed) if model.enabled else comparison.observed
        reading = reading_of(comparison, off.astype(np.float64), window.step / camera.fx)
        rows = np.empty((len(bones), ROW))

        def sum_part(thread: int) -> None:
            drawing, depths = self._drawings[thread], self._depths[thread]
            sum_poses(self._mesh, bones, thread, self._threads, view, reading, model, drawing, depths, rows)

        self._on_all_threads(sum_part, len(bones))
        return TileSums.from_rows(rows, float(np.count_nonzero(comparison.observed > 0)))

    def _on_all_threads(self, work: Callable[[int], None], count: int) -> None:
        """Run the work of each thread, including the current one, on at most one thread per pose."""
        parts = range(1, min(count, self._threads))
        others = [self._pool.submit(work, thread) for thread in parts]
        work(0)
        for other in others:
            other.result()


def _bones_of(transforms: Float32Array) -> FloatArray:
    return np.ascontiguousarray(transforms, dtype=np.float64)


# CPU device


class CpuDevice:
    """Depth rendering on the CPU with numba (``rendering.port.RenderingDevice``).

    Textured surfaces are rendered by OpenGL, which is opened on first use.
    """

    def __init__(self) -> None:
        self._opened = ExitStack()
        self._gl: RenderingDevice | None = None

    @property
    def info(self) -> RendererInfo:
        """CPU architecture and compiler."""
        import numba

        return RendererInfo(f"processor ({platform.machine()})", "posetrack", f"numba {numba.__version__}")

    def depth_renderer(
        self, mesh: SkinnedMesh, tile: tuple[int, int], most: int = MOST_TILES
    ) -> CompiledDepthRenderer:
        """Return a renderer of a mesh in tiles of (width, height) pixels, for any number of poses."""
        return CompiledDepthRenderer(mesh, tile)

    def surface_renderer(
        self, size: tuple[int, int], surfaces: list[Surface], lights: int
    ) -> SurfaceRenderer:
        """Return a renderer of lit surfaces in images of (width, height) pixels."""
        from posetrack_cli.rendering.gl.device import GlDevice

        if self._gl is None:
            self._gl = self._opened.enter_context(closing(GlDevice()))
        return self._gl.surface_renderer(size, surfaces, lights)

    def close(self) -> None:
        """Close the OpenGL device if one was opened."""
        self._gl = None
        self._opened.close()
