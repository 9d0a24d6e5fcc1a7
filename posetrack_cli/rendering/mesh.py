"""Triangle meshes: skinning, smooth subdivision, closest points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class SkinnedMesh:
    """Triangle mesh with linear blend skinning.

    Attributes:
        vertices: (V, 3) rest positions, mm.
        weights: (V, B) skinning weights; rows sum to 1.
        triangles: (T, 3) vertex indices, counter-clockwise seen from outside.
    """

    vertices: FloatArray
    weights: FloatArray
    triangles: IntArray

    def posed(self, transforms: FloatArray) -> FloatArray:
        """Return vertices (N, V, 3), mm, for bone transforms camera_T_rest (N, B, 3, 4)."""
        n, bones = transforms.shape[:2]
        rows = np.moveaxis(transforms, 1, 2).reshape(n * 3, bones * 4)
        return np.moveaxis((rows @ self.skinning_matrix).reshape(n, 3, -1), 1, 2)

    @cached_property
    def skinning_matrix(self) -> FloatArray:
        """Constant skinning matrix S (4 B, V): [T_1 .. T_B] S are the posed vertices.

        Linear blend skinning, v' = sum_b w_b T_b (v, 1), is linear in the bone transforms.
        """
        homogeneous = np.concatenate([self.vertices, np.ones((len(self.vertices), 1))], axis=1)
        return np.ascontiguousarray(
            (self.weights[:, :, None] * homogeneous[:, None, :]).reshape(len(self.vertices), -1).T
        )

    def grown(self, mm: float) -> SkinnedMesh:
        """Return the mesh with every vertex moved outwards along its area-weighted normal."""
        if mm == 0.0:
            return self
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        by_area, normals = np.cross(b - a, c - a), np.zeros_like(self.vertices)
        for k in range(3):
            np.add.at(normals, self.triangles[:, k], by_area)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        outwards = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
        return SkinnedMesh(self.vertices + mm * outwards, self.weights, self.triangles)

    def flipped(self, axis_signs: FloatArray) -> SkinnedMesh:
        """Return the mirror image under an odd number of sign changes (3,), with faces still outwards."""
        return SkinnedMesh(self.vertices * axis_signs, self.weights, self.triangles[:, ::-1].copy())


def joined(meshes: list[SkinnedMesh]) -> SkinnedMesh:
    """Return one mesh of several, with their bones concatenated."""
    bones = sum(m.weights.shape[1] for m in meshes)
    bound, first_bone = [], 0
    for mesh in meshes:
        bound.append(bound_to(mesh, bones, first_bone))
        first_bone += mesh.weights.shape[1]
    return merged(bound)


def bound_to(mesh: SkinnedMesh, bones: int, first: int = 0) -> SkinnedMesh:
    """Return the mesh with ``bones`` bones, its own starting at ``first``."""
    weights = np.zeros((len(mesh.vertices), bones))
    weights[:, first : first + mesh.weights.shape[1]] = mesh.weights
    return SkinnedMesh(mesh.vertices, weights, mesh.triangles)


def merged(meshes: list[SkinnedMesh]) -> SkinnedMesh:
    """Return one mesh of several that share their bones."""
    first = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return SkinnedMesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.weights for m in meshes]),
        np.concatenate([m.triangles + at for m, at in zip(meshes, first, strict=False)]),
    )


def edges_of(triangles: IntArray) -> tuple[IntArray, IntArray]:
    """Return edges (E, 2), lower vertex first, and the edge indices (T, 3) of ab, bc, ca of each triangle."""
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, index = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    return edges, index.reshape(-1, 3)


def is_closed(triangles: IntArray) -> bool:
    """Return whether every edge is shared by exactly two triangles with opposite directions."""
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    there = set(map(tuple, directed.tolist()))
    return len(there) == len(directed) and all((b, a) in there for a, b in there)


def _adjacency(triangles: IntArray, count: int) -> FloatArray:
    """Return the adjacency matrix (V, V)."""
    matrix = np.zeros((count, count))
    edges, _ = edges_of(triangles)
    matrix[edges[:, 0], edges[:, 1]] = matrix[edges[:, 1], edges[:, 0]] = 1.0
    return matrix


def _loop_beta(valence: FloatArray) -> FloatArray:
    """Return Loop's neighbour weight, (5/8 - (3/8 + cos(2 pi / n) / 4)^2) / n."""
    return (0.625 - (0.375 + 0.25 * np.cos(2.0 * np.pi / valence)) ** 2) / valence


def loop_limit_matrix(triangles: IntArray, count: int) -> FloatArray:
    """Return the matrix (V, V) from the vertices of a closed mesh to their Loop limit positions.

    v_limit = (1 - n w) v + w sum of neighbours, w = 1 / (3 / (8 beta) + n) (Loop 1987).
    """
    matrix = _adjacency(triangles, count)
    valence = matrix.sum(axis=1)
    w = 1.0 / (0.375 / _loop_beta(valence) + valence)
    matrix *= w[:, None]
    np.fill_diagonal(matrix, 1.0 - valence * w)
    return matrix


def loop_subdivided(mesh: SkinnedMesh) -> SkinnedMesh:
    """Return a closed mesh after one step of Loop subdivision, which is also applied to the weights."""
    count = len(mesh.vertices)
    values = np.concatenate([mesh.vertices, mesh.weights], axis=1)
    neighbours = _adjacency(mesh.triangles, count)
    valence = neighbours.sum(axis=1)
    beta = _loop_beta(valence)
    even = (1.0 - valence * beta)[:, None] * values + beta[:, None] * (neighbours @ values)
    edges, of_triangle = edges_of(mesh.triangles)
    # Edge rule: 3/8 of each end, 1/8 of each opposite corner. Each triangle adds 1/8 of all its corners.
    odd = 0.25 * values[edges].sum(axis=1)
    np.add.at(odd, of_triangle.ravel(), np.repeat(0.125 * values[mesh.triangles].sum(axis=1), 3, axis=0))
    odd -= 0.125 * values[edges].sum(axis=1)
    new = np.concatenate([even, odd])
    a, b, c = mesh.triangles.T
    ab, bc, ca = (count + of_triangle).T
    triangles = np.concatenate(
        [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    )
    return SkinnedMesh(new[:, :3], new[:, 3:], triangles)


@dataclass(frozen=True)
class Smoothing:
    """Linear map from a closed mesh to a smooth surface, for any vertices and weights.

    Attributes:
        through: (W, V) maps the vertices to those of the surface, which interpolates them.
        blend: (W, V) maps the weights to those of the surface; averages, so weights stay non-negative.
        triangles: (T, 3) of the surface; its first V vertices correspond to the mesh's.
    """

    through: FloatArray
    blend: FloatArray
    triangles: IntArray


def smoothing(triangles: IntArray, steps: int) -> Smoothing:
    """Return ``steps`` of subdivision of a closed mesh with these triangles.

    Loop's scheme shrinks the surface; inverting its limit map first gives the control mesh whose limit
    interpolates the given vertices.
    """
    count = int(triangles.max()) + 1
    fine = SkinnedMesh(np.zeros((count, 3)), np.eye(count), triangles)
    for _ in range(steps):
        fine = loop_subdivided(fine)
    control = np.linalg.inv(loop_limit_matrix(triangles, count))
    limit = loop_limit_matrix(fine.triangles, len(fine.vertices))
    return Smoothing(limit @ (fine.weights @ control), fine.weights, fine.triangles)


CANDIDATES = 32
"""Number of triangles, by nearest centroid, that are tested per point."""


def closest_points(points: FloatArray, corners: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the nearest triangle (P,) of each point, and the barycentric coordinates (P, 3) on it.

    Only the ``CANDIDATES`` triangles with the nearest centroids are tested: exact for points near a surface
    without elongated triangles.

    Args:
        points: (P, 3).
        corners: (T, 3, 3) corners of the triangles.
    """
    from scipy.spatial import KDTree

    count = min(CANDIDATES, len(corners))
    _, near = KDTree(corners.mean(axis=1)).query(points, k=range(1, count + 1))
    candidates = corners[near]  # (P, K, 3, 3)
    shares = np.stack([_within(points, candidates), *(_on_edge(points, candidates, k) for k in range(3))])
    distances = ((np.einsum("opkc,pkcx->opkx", shares, candidates) - points[:, None]) ** 2).sum(axis=-1)
    distances[0][(shares[0] < 0.0).any(axis=-1)] = np.inf
    best = distances.transpose(1, 2, 0).reshape(len(points), -1).argmin(axis=1)
    place, option, rows = best // 4, best % 4, np.arange(len(points))
    return near[rows, place], shares[option, rows, place]


def _within(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return barycentric coordinates (P, K, 3) of projections on the planes of triangles (P, K, 3, 3).

    With sides a and b: s = ((p.a)(b.b) - (p.b)(a.b)) / |a x b|^2, t likewise.
    """
    a, b = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    p = points[:, None] - corners[..., 0, :]
    aa, bb, ab = ((x * y).sum(axis=-1) for x, y in ((a, a), (b, b), (a, b)))
    pa, pb = (p * a).sum(axis=-1), (p * b).sum(axis=-1)
    area2 = np.maximum(aa * bb - ab * ab, np.finfo(np.float64).tiny)
    s, t = (pa * bb - pb * ab) / area2, (pb * aa - pa * ab) / area2
    return np.stack([1.0 - s - t, s, t], axis=-1)


def _on_edge(points: FloatArray, corners: FloatArray, first: int) -> FloatArray:
    """Return those of the nearest points on the edges from one corner to the next."""
    second = (first + 1) % 3
    start = corners[..., first, :]
    along = corners[..., second, :] - start
    length2 = np.maximum((along**2).sum(axis=-1), np.finfo(np.float64).tiny)
    share = np.clip(((points[:, None] - start) * along).sum(axis=-1) / length2, 0.0, 1.0)
    out = np.zeros((*share.shape, 3))
    out[..., first], out[..., second] = 1.0 - share, share
    return out
