"""Fewer triangles for a skinned mesh: edges collapsed by quadric error (Garland and Heckbert 1997)."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.rendering.mesh import SkinnedMesh


def welded(mesh: SkinnedMesh, tolerance: float) -> SkinnedMesh:
    """Join vertices that lie together, as exporters double them at the seams of textures.

    Args:
        mesh: any mesh; what is left without a triangle is left out.
        tolerance: how far apart vertices of one place are at most, in its units.
    """
    cells = np.round(mesh.vertices / tolerance).astype(np.int64)
    _, first, index = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    triangles = first[index.reshape(-1)][mesh.triangles]
    return _used(mesh, _proper(triangles))


def closed(mesh: SkinnedMesh) -> SkinnedMesh:
    """Close every hole by a fan around the middle of its rim, whose weights are the rim's mean."""
    vertices, weights, triangles = [mesh.vertices], [mesh.weights], [mesh.triangles]
    count = len(mesh.vertices)
    for rim in rims(mesh.triangles):
        vertices.append(mesh.vertices[rim].mean(axis=0, keepdims=True))
        weights.append(mesh.weights[rim].mean(axis=0, keepdims=True))
        triangles.append(np.stack([np.roll(rim, -1), rim, np.full(len(rim), count)], axis=1))
        count += 1
    return SkinnedMesh(np.concatenate(vertices), np.concatenate(weights), np.concatenate(triangles))


def rims(triangles: IntArray) -> list[IntArray]:
    """The rims of holes: loops of vertices along edges of one triangle only, in the triangles' sense."""
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    there = set(map(tuple, directed))
    following: dict[int, list[int]] = {}
    for a, b in directed:
        if (b, a) not in there:
            following.setdefault(a, []).append(b)  # two where holes touch at a vertex
    loops: list[IntArray] = []
    for start in following:
        path, places = [start], {start: 0}
        while following.get(path[-1]):
            vertex = following[path[-1]].pop()
            if vertex in places:  # round: what began there is a loop, the path goes on from it
                first = places[vertex]
                loops.append(np.array(path[first:]))
                for gone in path[first:]:
                    del places[gone]
                del path[first:]
            places[vertex] = len(path)
            path.append(vertex)
    return loops


def _proper(triangles: IntArray) -> IntArray:
    """The triangles with three different vertices, each once."""
    a, b, c = triangles.T
    kept = triangles[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    return np.asarray(kept[np.sort(first)], dtype=np.int64)


def _used(mesh: SkinnedMesh, triangles: IntArray) -> SkinnedMesh:
    """The mesh of some of its triangles, without the vertices that none of them has."""
    used, index = np.unique(triangles, return_inverse=True)
    return SkinnedMesh(mesh.vertices[used], mesh.weights[used], index.reshape(-1, 3))


_NEIGHBOURS = 4


def simplified(mesh: SkinnedMesh, triangles: int) -> SkinnedMesh:
    """Return a mesh of about this many triangles, or the mesh itself if it has no more.

    Weights are those of the nearest old vertices, by inverse distance.
    """
    import fast_simplification

    if len(mesh.triangles) <= triangles:
        return mesh
    vertices, faces = fast_simplification.simplify(mesh.vertices, mesh.triangles, target_count=triangles)
    vertices = np.asarray(vertices, dtype=np.float64)
    return SkinnedMesh(vertices, weights_at(mesh, vertices), np.asarray(faces, dtype=np.int64))


def weights_at(mesh: SkinnedMesh, points: FloatArray) -> FloatArray:
    """Skinning weights (N, B) at points (N, 3) near a mesh's vertices."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(mesh.vertices).query(points, k=min(_NEIGHBOURS, len(mesh.vertices)))
    share = 1.0 / (distance + 1e-9)
    share /= share.sum(axis=1, keepdims=True)
    weights: FloatArray = np.einsum("nk,nkb->nb", share, mesh.weights[index])
    return weights
