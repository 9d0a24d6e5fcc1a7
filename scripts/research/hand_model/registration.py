"""Non-rigid registration of a template surface to the skin of a hand (closest points)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.sparse import linalg
from scipy.spatial import KDTree

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.rendering.mesh import SkinnedMesh

_NORMAL_MM = 8.0  # millimetres per unit difference of normals
_DENSITY = 6  # sample points along an edge of a triangle
_REACH_MM = 12.0  # largest distance of a correspondence; skin farther away belongs to another part
_COARSE = ((100.0, 8), (20.0, 8), (5.0, 10), (1.0, 10), (0.3, 10))
_FINE = ((20.0, 2), (5.0, 2), (1.0, 2), (0.2, 2))  # stiffness of the displacement, and rounds with it
_TARGETS = 12000


class Skin:
    """Dense points and normals of a mesh."""

    def __init__(self, mesh: SkinnedMesh) -> None:
        corners = mesh.vertices[mesh.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(normals, axis=1)
        corners, normals = corners[areas > 1e-9], normals[areas > 1e-9] / areas[areas > 1e-9, None]
        n = _DENSITY
        shares = np.array([(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]) / n
        self.points = np.einsum("sk,tkx->stx", shares, corners).reshape(-1, 3)
        self.normals = np.tile(normals, (len(shares), 1))
        self._tree = KDTree(_with_normals(self.points, self.normals))

    def closest(self, points: FloatArray, normals: FloatArray) -> FloatArray:
        """Return the nearest points (N, 3) of the skin with similar normals."""
        return np.asarray(self.points[self._tree.query(_with_normals(points, normals))[1]])


class Template:
    """The template: a smooth surface controlled by a cage.

    Args:
        triangles: (T, 3) of the surface.
        through: (V, C) weights of the cage vertices for each vertex.
    """

    def __init__(self, triangles: IntArray, through: FloatArray) -> None:
        self.triangles, self._through = triangles, through
        self._bending = _bending(triangles, len(through))
        c = through.shape[1]
        self._onto_cage = np.linalg.solve(through.T @ through + 1e-3 * np.eye(c), through.T)

    def cage(self, vertices: FloatArray) -> FloatArray:
        """Return the cage (C, 3) whose surface is nearest to vertices (V, 3)."""
        return self._onto_cage @ vertices

    def laid_coarsely(self, vertices: FloatArray, skin: Skin, behind: float) -> FloatArray:
        """Register the template coarsely, with correspondences in both directions.

        Args:
            vertices: (V, 3) start.
            skin: skin of a hand, in hand coordinates.
            behind: y limit at the wrist, mm; skin beyond it is ignored.
        """
        chosen = np.random.default_rng(0).permutation(len(skin.points))[:_TARGETS]
        chosen = chosen[skin.points[chosen, 1] < behind]
        targets, facing = skin.points[chosen], skin.normals[chosen]
        for stiffness, rounds in _COARSE:
            smooth = self._smoother(stiffness)
            for _ in range(rounds):
                normals = vertex_normals(vertices, self.triangles)
                move = 0.5 * (skin.closest(vertices, normals) - vertices)
                tree = KDTree(_with_normals(vertices, normals))
                nearest = tree.query(_with_normals(targets, facing))[1]
                pull, count = np.zeros_like(vertices), np.zeros(len(vertices))
                np.add.at(pull, nearest, targets - vertices[nearest])
                np.add.at(count, nearest, 1.0)
                wanted = count > 0
                move[wanted] = 0.3 * move[wanted] + 0.7 * pull[wanted] / count[wanted, None]
                vertices = vertices + smooth(move)
                if stiffness >= 1.0:
                    vertices = self._through @ self.cage(vertices)
        return vertices

    def laid(self, vertices: FloatArray, skin: Skin) -> FloatArray:
        """Register the template to a skin near it, along its normals only, so that it does not slide."""
        for stiffness, rounds in _FINE:
            smooth = self._smoother(stiffness)
            for _ in range(rounds):
                normals = vertex_normals(vertices, self.triangles)
                way = skin.closest(vertices, normals) - vertices
                move = np.einsum("ij,ij->i", way, normals)[:, None] * normals
                move[np.linalg.norm(way, axis=1) > _REACH_MM] = 0.0
                vertices = vertices + smooth(move)
        return vertices

    def _smoother(self, stiffness: float) -> Callable[[FloatArray], FloatArray]:
        matrix = sparse.eye(self._bending.shape[0]) + stiffness * self._bending
        solve: Callable[[FloatArray], FloatArray] = linalg.factorized(matrix.tocsc())
        return solve


def vertex_normals(vertices: FloatArray, triangles: IntArray) -> FloatArray:
    """Return area-weighted unit normals (V, 3)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normals, out = np.cross(b - a, c - a), np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, triangles[:, k], normals)
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1), 1e-9)[:, None])


def _bending(triangles: IntArray, count: int) -> sparse.csr_matrix:
    """Return L^T L with L the Laplacian of the mesh graph."""
    i, j = (np.concatenate([triangles[:, k] for k in order]) for order in ((0, 1, 2), (1, 2, 0)))
    joined = sparse.coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count)).tocsr()
    joined = ((joined + joined.T) > 0).astype(float)
    laplacian = sparse.diags(np.asarray(joined.sum(axis=1)).ravel()) - joined
    return (laplacian.T @ laplacian).tocsr()


def _with_normals(points: FloatArray, normals: FloatArray) -> FloatArray:
    return np.concatenate([points, _NORMAL_MM * normals], axis=1)
