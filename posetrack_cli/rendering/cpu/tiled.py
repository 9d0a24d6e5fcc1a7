"""Depth of one skinned mesh in many poses, drawn on all cores (``rendering.port.DepthRenderer``)."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.compiled import thread_count
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.cpu.tile_sums import (
    ROW,
    draw_poses,
    empty_depths,
    mixture_of,
    reading_of,
    sum_poses,
)
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.pixel_model import outline_distances
from posetrack_cli.rendering.port import check_observed, check_poses
from posetrack_cli.rendering.raster import View, empty_drawing, rest_mesh
from posetrack_cli.rendering.sums import Comparison, TileSums
from posetrack_cli.rendering.window import Window


class CompiledDepthRenderer:
    """Depth images, or sums over them, of one mesh in N poses.

    A mesh of which anything comes nearer than ``raster.NEAR_MM`` is not drawn at all. Sums do not depend on
    how many cores there are.

    Args:
        mesh: the mesh that all poses share.
        tile: (width, height) of a tile, pixels.
    """

    def __init__(self, mesh: SkinnedMesh, tile: tuple[int, int]) -> None:
        self.tile, self.bones = tile, mesh.weights.shape[1]
        self._mesh, self._threads = rest_mesh(mesh), thread_count()
        self._drawings = [empty_drawing(self._mesh, tile[1], tile[0]) for _ in range(self._threads)]
        self._depths = [empty_depths(tile[1], tile[0]) for _ in range(self._threads)]
        self._pool = ThreadPoolExecutor(self._threads)

    def depth(self, transforms: Float32Array, camera: Camera, window: Window) -> Float32Array:
        """Draw, and return depth (N, height, width), mm."""
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
        """Draw, and sum what ``sums.sums_in_numpy`` defines."""
        check_observed(comparison.observed, window)
        check_poses(self, transforms, window)
        bones, view = _bones_of(transforms), View(*window.tile_projection(camera))
        model = mixture_of(comparison.model)
        off = outline_distances(comparison.observed) if model.is_asked else comparison.observed
        reading = reading_of(comparison, off.astype(np.float64), window.step / camera.fx)
        rows = np.empty((len(bones), ROW))

        def sum_part(thread: int) -> None:
            drawing, depths = self._drawings[thread], self._depths[thread]
            sum_poses(self._mesh, bones, thread, self._threads, view, reading, model, drawing, depths, rows)

        self._on_all_threads(sum_part, len(bones))
        return TileSums.from_rows(rows, float(np.count_nonzero(comparison.observed > 0)))

    def _on_all_threads(self, work: Callable[[int], None], count: int) -> None:
        """Do each thread's part of the work, on as many as poses need.

        One of them is this thread.
        """
        parts = range(1, min(count, self._threads))
        others = [self._pool.submit(work, thread) for thread in parts]
        work(0)
        for other in others:
            other.result()


def _bones_of(transforms: Float32Array) -> FloatArray:
    return np.ascontiguousarray(transforms, dtype=np.float64)
