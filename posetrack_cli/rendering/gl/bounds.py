"""Where in its tile a posed mesh can be: boxes that spare the reduction the empty rest."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array
from posetrack_cli.rendering.mesh import SkinnedMesh


class BoneSpheres:
    """A sphere around what each bone moves.

    A skinned vertex is a convex combination of where its bones take it, so a posed mesh lies in the
    convex hull of the posed spheres, and its image in the box around their images.

    Args:
        mesh: the mesh; bones that move nothing have no sphere.
    """

    def __init__(self, mesh: SkinnedMesh) -> None:
        moved = mesh.weights > 0
        self._bones = np.flatnonzero(moved.any(axis=0))
        boxes = [mesh.vertices[moved[:, bone]] for bone in self._bones]
        centres = [0.5 * (points.min(axis=0) + points.max(axis=0)) for points in boxes]
        radii = [
            np.linalg.norm(points - centre, axis=1).max()
            for points, centre in zip(boxes, centres, strict=True)
        ]
        self._centres = np.concatenate([centres, np.ones((len(centres), 1))], axis=1).astype(np.float32)
        self._radii = np.array(radii, dtype=np.float32)

    def tile_boxes(
        self,
        transforms: Float32Array,
        projection: tuple[float, float, float, float],
        tile: tuple[int, int],
        near_mm: float,
    ) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
        """Boxes (N, 4): first column and row, then one past the last, of pixels that may be covered.

        Args:
            transforms: (N, B, 3, 4) rigid camera_T_rest, mm.
            projection: of ``Window.tile_projection``.
            tile: (width, height), pixels.
            near_mm: what is nearer is not drawn.
        """
        centres = np.einsum("nbij,bj->inb", transforms[:, self._bones], self._centres)
        scale_x, shift_x, scale_y, shift_y = projection
        across = self._extent(centres[0], centres[2], near_mm, scale_x, shift_x, tile[0])
        down = self._extent(centres[1], centres[2], near_mm, scale_y, shift_y, tile[1])
        return np.stack([across[0], down[0], across[1], down[1]], axis=1).astype(np.int32)

    def _extent(
        self, x: Float32Array, z: Float32Array, near_mm: float, scale: float, shift: float, size: int
    ) -> tuple[Float32Array, Float32Array]:
        """First and one past the last pixel along one axis, (N,) each.

        Of a sphere, x / z lies between (x - r) / z' and (x + r) / z', z' its nearest or farthest depth,
        whichever is the more extreme; the part nearer than near_mm is not drawn.
        """
        nearest, farthest = np.maximum(z - self._radii, near_mm), np.maximum(z + self._radii, near_mm)
        low, high = x - self._radii, x + self._radii
        first = (low / np.where(low < 0, nearest, farthest)).min(axis=1)
        last = (high / np.where(high > 0, nearest, farthest)).max(axis=1)
        return (
            np.clip(np.floor(scale * first + shift), 0, size),
            np.clip(np.ceil(scale * last + shift), 0, size),
        )
