"""Depth rendering on the CPU."""

from __future__ import annotations

import platform
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.compiled import borrowing, thread_count
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.lanes import (
    BLOCK,
    Lanes,
    above,
    add_block,
    append,
    append_indices,
    below,
    bit_count,
    emitted,
    multiply_block,
    padded,
)
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
#
# With a pixel model, pixels are first sorted into lists by what they need. Loops over lists of float32 have
# no branches and few arrays, so that LLVM vectorises them. Sums have a fixed order, in float64.

_MUCH = np.float32(np.exp(NEIGHBOUR_MISFIT))  # ratio of densities at a misfit of NEIGHBOUR_MISFIT
_LARGE, _TINY = 1e200, 1e-200  # range of products of densities, far from overflow
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_NONE = np.float32(1e30)  # depth, or ratio of densities, of no surface
_LEAST, _MOST = np.float32(-80.0), np.float32(80.0)  # range of exponents
_TO_INTEGER = np.float32(1.5 * 2**23)  # adding and subtracting it rounds
_LOG2_E, _LN_2 = np.float32(1.0 / np.log(2.0)), np.float32(np.log(2.0))
_TAYLOR = tuple(np.float32(1.0 / factor) for factor in (720, 120, 24, 6, 2, 1))
_BIAS, _FRACTION_BITS = np.int32(127), np.int32(23)  # of float32
_INDEX = np.int32(15)
"""Bits of a float32 that hold the index of a neighbour."""
_MANY = np.int32(2**31 - 1)
_REACH = range(-REACH_PX, REACH_PX + 1)
_NEIGHBOURS = tuple((j, i) for j in _REACH for i in _REACH if 0 < i * i + j * j <= REACH_PX * REACH_PX)
_SQUARES = tuple(np.float32(j * j + i * i) for j, i in _NEIGHBOURS)
"""Rows and columns of neighbours from a pixel, and their squared distances, pixels."""
ROW = 8
"""Sums per tile, in the order of ``TileSums.from_rows``."""
_LISTS = 12
_ENOUGH = 4096
"""Number of densities' ratios up to ``_MUCH`` whose products, in 16 lanes, stay in the range of float64."""
_APART = 48
"""Numbers between lists beyond the pixels: lists at multiples of 4096 bytes would share cache lines."""


class Reading(NamedTuple):
    """Observation that tiles are compared with, in the form used by the kernels; images are ``padded``.

    Attributes:
        image: (h, w) as ``Comparison.observed``.
        off: (h, w) distance to the nearest target pixel, pixels.
        before: (h, w) exp(-l y) of target pixels, with l the rate of occluders.
        clamp_mm, match_mm: see ``Comparison``.
        slope: width of a pixel, mm, per mm of depth.
    """

    image: Float32Array
    off: Float32Array
    before: Float32Array
    clamp_mm: float
    match_mm: float
    slope: np.float32


class Mixture(NamedTuple):
    """Parameters of a ``PixelMixture``; ``enabled`` is False without one."""

    enabled: bool
    near_sd: np.float32 = _ONE
    sd_growth: np.float32 = _ZERO
    occluder_rate: np.float32 = _ONE
    occluded_per_sd: np.float32 = _ZERO
    outlier_per_sd: np.float32 = _ZERO
    outline_sd: np.float32 = _ONE
    unread_weight: np.float32 = _ZERO


class Pixels(NamedTuple):
    """Buffers for lists of pixels.

    Attributes:
        depths: ((h + 2 r) (w + 2 r),) rendered, with a border of r = ``REACH_PX``; inf where empty.
        lists: (12, P) depth, reading and ``Reading.before`` of covered target pixels; four intermediate
            results; depth, reading and ``Reading.off`` of other pixels; reading and ``Reading.before`` of
            target pixels that surfaces next to them may explain.
        near: (12, P) depths of neighbours.
        places: (2, P) indices in ``depths`` of the first and the last of these lists.
        bits, floats: (P,) bits of float32, and the same memory as float32.
        keys: (P,) least squares of neighbours, with indices in their last bits.
        totals: (2, 16) sums and products of lanes.
    """

    depths: Float32Array
    lists: Float32Array
    near: Float32Array
    places: ImageArray
    bits: ImageArray
    floats: Float32Array
    keys: ImageArray
    totals: FloatArray


def mixture_of(model: PixelMixture | None) -> Mixture:
    """Return a pixel model in the form used by the kernels."""
    if model is None:
        return Mixture(False)
    return Mixture(True, **{name: np.float32(value) for name, value in model.uniforms.items()})


def reading_of(comparison: Comparison, off: Float32Array, slope: float) -> Reading:
    """Return an observation and comparison parameters in the form used by the kernels."""
    image = comparison.observed
    rate = 0.0 if comparison.model is None else comparison.model.uniforms["occluder_rate"]
    before = np.exp(-rate * np.maximum(image.astype(np.float64), 0.0)).astype(np.float32)
    images = padded(image), padded(off), padded(before)
    return Reading(*images, comparison.clamp_mm, comparison.match_mm, np.float32(slope))


def empty_pixels(height: int, width: int) -> Pixels:
    """Return the buffers for one tile."""
    count = height * width + _APART
    bits = np.zeros(count, np.int32)
    return Pixels(
        padded(np.full((height + 2 * REACH_PX) * (width + 2 * REACH_PX), np.inf, np.float32)),
        np.zeros((_LISTS, count), np.float32),
        np.zeros((len(_NEIGHBOURS), count), np.float32),
        np.zeros((2, count), np.int32),
        bits,
        bits.view(np.float32),
        np.zeros(count, np.int32),
        np.zeros((2, BLOCK)),
    )


@borrowing
def _exponentiate(values: Float32Array, bits: ImageArray, floats: Float32Array, count: int) -> None:
    """Replace the first ``count`` values x by exp(x), with relative error 2e-7; x is at most ``_MOST``."""
    a, b, c, d, e, f = _TAYLOR
    for n in range(count):
        x = max(values[n], _LEAST) * _LOG2_E
        whole = (x + _TO_INTEGER) - _TO_INTEGER
        x = (x - whole) * _LN_2
        values[n] = _ONE + x * (f + x * (e + x * (d + x * (c + x * (b + x * a)))))
        bits[n] = (np.int32(whole) + _BIAS) << _FRACTION_BITS
    for n in range(count):
        values[n] *= floats[n]


@emitted
def _touching(depths: Lanes, at: Lanes, width: Lanes) -> Lanes:
    """Return bits of the pixels that have a surface next to them."""
    least = None
    for j, i in _NEIGHBOURS:
        one = depths.load(at + width * j + i, BLOCK)
        least = one if least is None else one.least(least)
    assert least is not None
    return (least < float(_NONE)).bits


@borrowing
def _sort(box: tuple[int, int, int, int], reading: Reading, pixels: Pixels) -> tuple[int, int, int]:
    """List the pixels of a tile by what they need; return how many are in the three lists.

    Returns:
        Number of covered target pixels, of uncovered target pixels with a surface next to them, and of
        covered other pixels.
    """
    (left, top, right, bottom), depths, image, lists = box, pixels.depths, reading.image, pixels.lists
    both, uncovered, other, width = 0, 0, 0, image.shape[1]
    bordered = width + 2 * REACH_PX
    for j in range(top, bottom):
        for i in range(left, right, BLOCK):
            at, place, count = j * width + i, (j + REACH_PX) * bordered + i + REACH_PX, right - i
            target, covered = above(image, at, count, _ZERO), below(depths, place, count, _NONE)
            if target & covered:
                append(target & covered, depths, place, lists[0], both)
                append(target & covered, image, at, lists[1], both)
                append(target & covered, reading.before, at, lists[2], both)
                append_indices(target & covered, place, pixels.places[0], both)
                both += bit_count(target & covered)
            if covered & ~target:
                append(covered & ~target, depths, place, lists[7], other)
                append(covered & ~target, image, at, lists[8], other)
                append(covered & ~target, reading.off, at, lists[9], other)
                other += bit_count(covered & ~target)
            if target & ~covered:
                near = target & ~covered & _touching(depths, place, bordered)
                append(near, image, at, lists[10], uncovered)
                append(near, reading.before, at, lists[11], uncovered)
                append_indices(near, place, pixels.places[1], uncovered)
                uncovered += bit_count(near)
    return both, uncovered, other


@borrowing
def _write_ratios(
    count: int, y: Float32Array, before: Float32Array, off: Float32Array, model: Mixture, pixels: Pixels
) -> None:
    """Write the ratio of the densities of the best possible reading and of y to list 3.

    Its logarithm is the misfit.

    Args:
        count: number of pixels, with depths in list 0.
        y, before: (P,) readings, and ``Reading.before``.
        off: (P,) half the squared distance of surface and pixel in standard deviations of the outline.
        model: of a pixel.
        pixels: buffers; lists 3 to 5 are overwritten.
    """
    d = pixels.lists[0]
    here, behind, front = pixels.lists[3], pixels.lists[4], pixels.lists[5]
    near_sd, growth, rate = model.near_sd, model.sd_growth, model.occluder_rate
    for n in range(count):
        t = (y[n] - d[n]) / (near_sd + growth * d[n] * d[n])
        here[n] = -_HALF * t * t - off[n]
    for n in range(count):
        behind[n] = min(rate * (y[n] - d[n]), _MOST)
    _exponentiate(here, pixels.bits, pixels.floats, count)
    _exponentiate(behind, pixels.bits, pixels.floats, count)
    outlier_per_sd, occluded_per_sd = model.outlier_per_sd, model.occluded_per_sd
    for n in range(count):
        behind[n] *= before[n]
        front[n] = before[n] if y[n] <= d[n] else _ZERO
    for n in range(count):
        sd = near_sd + growth * d[n] * d[n]
        outlier, occluded, nearer = outlier_per_sd * sd, occluded_per_sd * sd, _ONE - behind[n]
        best = nearer * (_ONE + outlier) + occluded * behind[n]
        here[n] = best / (nearer * (here[n] + outlier) + occluded * front[n])


@borrowing
def _log_product(factors: FloatArray) -> float:
    """Return the logarithm of a product, and set the factors to 1."""
    total, product = 0.0, 1.0
    for k in range(len(factors)):
        product *= factors[k]
        factors[k] = 1.0
        if product > _LARGE:
            total, product = total + np.log(product), 1.0
    return float(total + np.log(product))


@borrowing
def _add_targets(
    both: int, uncovered: int, reading: Reading, model: Mixture, pixels: Pixels, row: FloatArray
) -> int:
    """Add the sums over covered target pixels; return the number of misfits, and append those to list 10.

    Those misfits are above ``NEIGHBOUR_MISFIT`` and not added.
    """
    lists, totals, products = pixels.lists, pixels.totals[0], pixels.totals[1]
    d, y, before, ratios, apart, own = lists[0], lists[1], lists[2], lists[3], lists[4], lists[6]
    own[:both] = _ZERO
    _write_ratios(both, y, before, own, model, pixels)
    match, clamp = np.float32(reading.match_mm), np.float32(reading.clamp_mm)
    for n in range(both):
        apart[n] = abs(d[n] - y[n])
    totals[:], products[:], matched, misfit, last = 0.0, 1.0, 0, 0.0, uncovered
    for n in range(0, both, BLOCK):
        matched += bit_count(below(apart, n, both - n, match))
        far = above(ratios, n, both - n, _MUCH)
        if far:
            append(far, y, n, lists[10], last)
            append(far, before, n, lists[11], last)
            append(far, ratios, n, own, last - uncovered)
            append(far, pixels.places[0], n, pixels.places[1], last)
            last += bit_count(far)
    for n in range(both):
        ratios[n] = ratios[n] if ratios[n] <= _MUCH else _ONE
        apart[n] = min(apart[n], clamp)
    for n in range(0, both, BLOCK):
        add_block(apart, n, both - n, totals)
        multiply_block(ratios, n, both - n, products)
        if n % _ENOUGH == 0:
            misfit += _log_product(products)
    row[0], row[1], row[6] = np.sum(totals), both, matched
    row[4] += misfit + _log_product(products)
    return last - uncovered


@borrowing
def _find_surfaces(count: int, reading: Reading, model: Mixture, pixels: Pixels) -> None:
    """Write the depth of the best-fitting surface next to each pixel of the lists to list 0.

    List 5 gets half its squared distance, in standard deviations of the outline; ``_NONE`` without a surface.
    """
    y, places, near, depths = pixels.lists[10], pixels.places[1], pixels.near, pixels.depths
    d, precision, outline, off = pixels.lists[0], pixels.lists[3], pixels.lists[4], pixels.lists[5]
    width = reading.image.shape[1] + 2 * REACH_PX
    for k in range(len(_NEIGHBOURS)):
        across = _NEIGHBOURS[k][0] * width + _NEIGHBOURS[k][1]
        for n in range(count):
            near[k, n] = depths[places[n] + across]
    near_sd, growth, scale = model.near_sd, model.sd_growth, reading.slope / model.outline_sd
    keys, bits, squares = pixels.keys, pixels.bits, pixels.floats
    keys[:count] = _MANY
    for n in range(count):
        precision[n] = _ONE / (near_sd + growth * y[n] * y[n])
        outline[n] = scale * y[n] * scale * y[n]
    for k in range(len(_NEIGHBOURS)):
        one, square = near[k], _SQUARES[k]
        for n in range(count):
            t = (y[n] - one[n]) * precision[n]
            squares[n] = min(t * t + square * outline[n], _NONE)
        # non-negative floats sort like their bits, the last of which hold the index; such minima vectorise
        for n in range(count):
            keys[n] = min(keys[n], np.int32((bits[n] & ~_INDEX) | np.int32(k)))
    for n in range(count):
        best = np.int64(keys[n] & _INDEX)
        found = near[best, n] < _NONE
        d[n] = near[best, n] if found else _ONE
        off[n] = _HALF * _SQUARES[best] * outline[n] if found else _NONE


@borrowing
def _add_neighbours(
    far: int, uncovered: int, reading: Reading, model: Mixture, pixels: Pixels, row: FloatArray
) -> None:
    """Add the relief of uncovered target pixels, then the misfits of ``far`` covered ones."""
    y, before, ratios, relief = pixels.lists[10], pixels.lists[11], pixels.lists[3], pixels.lists[4]
    own, off, count = pixels.lists[6], pixels.near[0], uncovered + far
    _find_surfaces(count, reading, model, pixels)
    for n in range(count):
        off[n] = pixels.lists[5][n]
    _write_ratios(count, y, before, off, model, pixels)
    near_sd, growth, outlier_per_sd = model.near_sd, model.sd_growth, model.outlier_per_sd
    for n in range(uncovered):
        relief[n] = (_ONE + _ONE / (outlier_per_sd * (near_sd + growth * y[n] * y[n]))) / ratios[n]
    misfit, product = 0.0, 1.0
    for n in range(uncovered, count):
        own_ratio = own[n - uncovered]
        product *= float(min(own_ratio, ratios[n]) if off[n] < _NONE else own_ratio)
        if product > _LARGE:
            misfit, product = misfit + np.log(product), 1.0
    row[4] += misfit + np.log(product)
    misfit, product = 0.0, 1.0
    for n in range(uncovered):
        product *= float(max(_ONE, relief[n]))
        if product > _LARGE:
            misfit, product = misfit + np.log(product), 1.0
    row[7] = misfit + np.log(product)


@borrowing
def _add_others(count: int, reading: Reading, model: Mixture, pixels: Pixels, row: FloatArray) -> None:
    """Add the sums over covered pixels of other objects, and over those without a reading."""
    d, y, off = pixels.lists[7], pixels.lists[8], pixels.lists[9]
    beside, behind = pixels.lists[3], pixels.lists[4]
    near_sd, growth, outlier_per_sd = model.near_sd, model.sd_growth, model.outlier_per_sd
    scale, logistic = reading.slope / model.outline_sd, np.float32(LOGISTIC_OF_NORMAL)
    for n in range(count):
        t = scale * off[n] * d[n]
        beside[n] = -_HALF * t * t
    for n in range(count):
        t = min(-logistic * (d[n] + y[n]) / (near_sd + growth * d[n] * d[n]), _MOST)
        behind[n] = t if y[n] < _ZERO else _MOST
    _exponentiate(beside, pixels.bits, pixels.floats, count)
    _exponentiate(behind, pixels.bits, pixels.floats, count)
    for n in range(count):
        outlier, front = outlier_per_sd * (near_sd + growth * d[n] * d[n]), _ONE / (_ONE + behind[n])
        beside[n] = front + (_ONE - front) * (beside[n] + outlier) / (_ONE + outlier)
    other, hidden, product, of_unread, misfit, unread_misfit = 0, 0, 1.0, 1.0, 0.0, 0.0
    for n in range(count):
        if y[n] < _ZERO:
            other, hidden, product = other + 1, hidden + (-y[n] < d[n]), product * beside[n]
            if product < _TINY:
                misfit, product = misfit - np.log(product), 1.0
            continue
        of_unread *= beside[n]
        if of_unread < _TINY:
            unread_misfit, of_unread = unread_misfit - np.log(of_unread), 1.0
    row[2], row[3], row[5] = other, count - other, hidden
    row[4] += misfit - np.log(product) + model.unread_weight * (unread_misfit - np.log(of_unread))


@emitted
def _write_depths(inverses: Lanes, at: Lanes, count: Lanes, depths: Lanes, place: Lanes) -> None:
    """Write the depths of a block of pixels; inf where empty."""
    before = depths.load(place, BLOCK)
    inverse = inverses.load(at, BLOCK)
    within = count.constant(0).counted(BLOCK) < count
    depths.store(place, (1.0 / inverse).converted("float").where(within, before))


@borrowing
def _fill_depths(box: tuple[int, int, int, int], inverses: FloatArray, depths: Float32Array) -> None:
    """Write a tile's depths, inf where empty, in and around a box into the interior of a bordered image."""
    height, width = inverses.shape
    left, right = max(0, box[0] - REACH_PX), min(width, box[2] + REACH_PX)
    for j in range(max(0, box[1] - REACH_PX), min(height, box[3] + REACH_PX)):
        for i in range(left, right, BLOCK):
            place = (j + REACH_PX) * (width + 2 * REACH_PX) + i + REACH_PX
            _write_depths(inverses, j * width + i, right - i, depths, place)


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
def _add_counts(drawing: Drawing, box: tuple[int, int, int, int], reading: Reading, row: FloatArray) -> None:
    """Add the sums over a rendered tile that need no pixel model."""
    left, top, right, bottom = box
    error, both, other, unread, hidden, matched = 0.0, 0, 0, 0, 0, 0
    for j in range(top, bottom):
        for i in range(left, right):
            inverse, y = drawing.inverse[j, i], reading.image[j, i]
            if inverse == 0.0:
                continue
            d = 1.0 / inverse
            if y > _ZERO:
                apart = abs(d - y)
                both, error = both + 1, error + min(apart, reading.clamp_mm)
                matched += apart < reading.match_mm
                continue
            unread, other = unread + (y == _ZERO), other + (y < _ZERO)
            hidden += (y < _ZERO) & (-y < d)
    row[0], row[1], row[2], row[3], row[5], row[6] = error, both, other, unread, hidden, matched


@borrowing
def add_sums(drawing: Drawing, reading: Reading, model: Mixture, pixels: Pixels, row: FloatArray) -> None:
    """Write the sums over a rendered tile to a row (8,).

    Misfits are summed as the logarithm of a ratio of products, i.e. one logarithm for many pixels.

    Args:
        drawing: rendered tile.
        reading, model: observation and pixel model.
        pixels: buffers; overwritten.
        row: output.
    """
    row[:] = 0.0
    box = _box(drawing)
    if not model.enabled:
        _add_counts(drawing, box, reading, row)
        return
    _fill_depths(box, drawing.inverse, pixels.depths)
    both, uncovered, other = _sort(box, reading, pixels)
    _add_others(other, reading, model, pixels, row)
    far = _add_targets(both, uncovered, reading, model, pixels, row)
    _add_neighbours(far, uncovered, reading, model, pixels, row)


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
    pixels: Pixels,
    rows: FloatArray,
) -> None:
    """Render every ``stride``-th of poses (N, B, 3, 4) and write its sums (N, 8)."""
    for n in range(first, len(bones), stride):
        rows[n, :] = 0.0
        if draw_depth(mesh, bones[n], view, drawing):
            add_sums(drawing, reading, model, pixels, rows[n])


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
        self._pixels = [empty_pixels(tile[1], tile[0]) for _ in range(self._threads)]
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
        reading = reading_of(comparison, off, window.step / camera.fx)
        rows = np.empty((len(bones), ROW))

        def sum_part(thread: int) -> None:
            drawing, pixels = self._drawings[thread], self._pixels[thread]
            sum_poses(self._mesh, bones, thread, self._threads, view, reading, model, drawing, pixels, rows)

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
