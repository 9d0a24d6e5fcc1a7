"""Fewer triangles for a skinned mesh: edges collapsed by quadric error (Garland and Heckbert 1997)."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.rendering.mesh import SkinnedMesh

_NEIGHBOURS = 4


def simplified(mesh: SkinnedMesh, triangles: int) -> SkinnedMesh:
    """Return a mesh of about so many triangles, or the mesh itself if it has no more.

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
