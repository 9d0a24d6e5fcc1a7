"""Repair and decimation of skinned meshes."""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.cache import cached_arrays
from posetrack_cli.npz import Arrays
from posetrack_cli.rendering.mesh import SkinnedMesh, closest_points, edges_of

# Repair, and decimation of the rest pose (Garland and Heckbert 1997)


def welded(mesh: SkinnedMesh, tolerance: float) -> SkinnedMesh:
    """Merge duplicate vertices, as exporters create at texture seams.

    Args:
        mesh: any mesh; vertices without triangles are removed.
        tolerance: maximum distance of duplicates, in mesh units.
    """
    cells = np.round(mesh.vertices / tolerance).astype(np.int64)
    _, first, index = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    triangles = first[index.reshape(-1)][mesh.triangles]
    return _used(mesh, _proper(triangles))


def closed(mesh: SkinnedMesh) -> SkinnedMesh:
    """Close every hole by a triangle fan around its centroid, with the mean of the boundary's weights."""
    vertices, weights, triangles = [mesh.vertices], [mesh.weights], [mesh.triangles]
    count = len(mesh.vertices)
    for rim in rims(mesh.triangles):
        vertices.append(mesh.vertices[rim].mean(axis=0, keepdims=True))
        weights.append(mesh.weights[rim].mean(axis=0, keepdims=True))
        triangles.append(np.stack([np.roll(rim, -1), rim, np.full(len(rim), count)], axis=1))
        count += 1
    return SkinnedMesh(np.concatenate(vertices), np.concatenate(weights), np.concatenate(triangles))


def rims(triangles: IntArray) -> list[IntArray]:
    """Return hole boundaries as loops of vertices, oriented like the triangles next to them."""
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    there = set(map(tuple, directed))
    following: dict[int, list[int]] = {}
    for a, b in directed:
        if (b, a) not in there:
            following.setdefault(a, []).append(b)  # two entries where holes touch at a vertex
    loops: list[IntArray] = []
    for start in following:
        path, places = [start], {start: 0}
        while following.get(path[-1]):
            vertex = following[path[-1]].pop()
            if vertex in places:  # a loop is closed; cut it off and continue the path
                first = places[vertex]
                loops.append(np.array(path[first:]))
                for gone in path[first:]:
                    del places[gone]
                del path[first:]
            places[vertex] = len(path)
            path.append(vertex)
    return loops


def _proper(triangles: IntArray) -> IntArray:
    """Return the distinct triangles with three different vertices."""
    a, b, c = triangles.T
    kept = triangles[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    return np.asarray(kept[np.sort(first)], dtype=np.int64)


def _used(mesh: SkinnedMesh, triangles: IntArray) -> SkinnedMesh:
    """Return the mesh with these triangles, without unused vertices."""
    used, index = np.unique(triangles, return_inverse=True)
    return SkinnedMesh(mesh.vertices[used], mesh.weights[used], index.reshape(-1, 3))


_NEIGHBOURS = 4


def simplified(mesh: SkinnedMesh, triangles: int) -> SkinnedMesh:
    """Return a mesh with about this many triangles, or the mesh itself if it has no more.

    Weights are interpolated from the nearest original vertices by inverse distance.
    """
    import fast_simplification

    if len(mesh.triangles) <= triangles:
        return mesh
    vertices, faces = fast_simplification.simplify(mesh.vertices, mesh.triangles, target_count=triangles)
    vertices = np.asarray(vertices, dtype=np.float64)
    return SkinnedMesh(vertices, weights_at(mesh, vertices), np.asarray(faces, dtype=np.int64))


def weights_at(mesh: SkinnedMesh, points: FloatArray) -> FloatArray:
    """Return skinning weights (N, B) at points (N, 3) near the mesh."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(mesh.vertices).query(points, k=min(_NEIGHBOURS, len(mesh.vertices)))
    share = 1.0 / (distance + 1e-9)
    share /= share.sum(axis=1, keepdims=True)
    weights: FloatArray = np.einsum("nk,nkb->nb", share, mesh.weights[index])
    return weights


# Decimation in many poses: edges are collapsed where this changes the posed surface least.
#
# Quadric error metrics (Garland and Heckbert 1997), summed over poses so that straight fingers keep the edge
# loops at their joints (Mohr and Gleicher 2003, deformation sensitive decimation).

SHARES = (0.0, 0.5, 1.0)
"""Candidate shares of the second end in the weights of a collapsed edge."""
REGULAR = 1e-4
"""Regularisation towards the edge, relative to a quadric's trace; a flat surface leaves the vertex free."""
LEAST_COSINE = 0.2
"""Minimum cosine of a triangle's rotation in a collapse, to prevent fold-overs."""
RIM_WEIGHT = 10.0
"""Weight of the planes that preserve an open boundary, relative to triangles."""
FIT_RIDGE = 1e-3
"""Regularisation of the fit towards the nearest vertex, relative to the median vertex area."""
_IDENTITY = np.eye(3)
_SOURCES = ("rendering/decimation.py", "rendering/mesh.py")


@dataclass(frozen=True, eq=False)
class Decimation:
    """Linear map from a mesh of fixed triangles and weights, in any shape, to a coarser mesh.

    Attributes:
        fit: (W, V) maps the original vertices to the coarse ones.
        weights: (W, B) of the coarse vertices.
        triangles: (T, 3) of the coarse mesh.
    """

    fit: FloatArray
    weights: FloatArray
    triangles: IntArray

    def of(self, vertices: FloatArray) -> SkinnedMesh:
        """Return the coarse mesh for original vertices (V, 3)."""
        return SkinnedMesh(self.fit @ vertices, self.weights, self.triangles)


def decimated(mesh: SkinnedMesh, triangles: int, transforms: FloatArray | None = None) -> SkinnedMesh:
    """Return a mesh with at most this many triangles and nearly the same surface; see ``decimation``."""
    return decimation(mesh, triangles, transforms).of(mesh.vertices)


def decimation(mesh: SkinnedMesh, triangles: int, transforms: FloatArray | None = None) -> Decimation:
    """Collapse edges until few triangles are left, then fit the coarse mesh to the original surface.

    The cost of a collapse is the sum over poses of the area-weighted squared distances of the new vertex
    from the planes of the merged triangles; the vertex is placed at the minimum. As planes are outside a
    curved surface and chords inside, the vertices are finally moved to minimise the mean squared distance
    between the surfaces, which also removes the mean offset.

    Args:
        mesh: closed or open mesh.
        triangles: target number; more may be left if the topology requires it.
        transforms: (K, B, 3, 4) bone transforms of the poses to preserve; default: the rest pose.
    """
    if transforms is None:
        transforms = np.tile(np.eye(3, 4), (1, mesh.weights.shape[1], 1, 1))
    arguments = (mesh.vertices, mesh.weights, mesh.triangles, triangles, transforms)

    def compute() -> Arrays:
        return vars(_decimation(mesh, triangles, transforms))

    return Decimation(**cached_arrays("meshes", _SOURCES, arguments, compute))


def _decimation(mesh: SkinnedMesh, triangles: int, transforms: FloatArray) -> Decimation:
    work = _Collapsing(mesh, np.asarray(transforms, dtype=np.float64))
    work.run(triangles)
    coarse = work.result()
    return Decimation(_fit(coarse, mesh), coarse.weights, coarse.triangles)


class _Placements(NamedTuple):
    """Replacement vertices of edges: costs (E,), rest positions (E, 3), weights (E, B)."""

    costs: FloatArray
    vertices: FloatArray
    weights: FloatArray


class _Collapsing:
    """Mesh during edge collapses; vertices keep their indices, removed ones are unused."""

    def __init__(self, mesh: SkinnedMesh, transforms: FloatArray) -> None:
        self._vertices, self._weights = mesh.vertices.copy(), mesh.weights.copy()
        self._triangles = mesh.triangles.copy()
        self._transforms = transforms
        self._quadrics = _vertex_quadrics(mesh, transforms)
        self._alive = np.ones(len(mesh.triangles), dtype=np.bool_)
        self._around: list[set[int]] = [set() for _ in mesh.vertices]
        for index, corners in enumerate(mesh.triangles.tolist()):
            for corner in corners:
                self._around[corner].add(index)
        self._changes = [0] * len(mesh.vertices)
        self._order = itertools.count()  # breaks ties deterministically
        self._heap: list[tuple[float, int, int, int, int, FloatArray, FloatArray]] = []

    def run(self, wanted: int) -> None:
        """Collapse the cheapest edge until the target is reached or no edge may collapse."""
        left = len(self._triangles)
        if left > wanted:
            self._offer(edges_of(self._triangles)[0])
        while left > wanted and self._heap:
            _, _, a, b, stamp, vertex, weights = heapq.heappop(self._heap)
            if stamp != self._changes[a] + self._changes[b] or not self._may_collapse(a, b, vertex, weights):
                continue
            left -= self._collapse(a, b, vertex, weights)
            self._offer(np.array([(min(a, c), max(a, c)) for c in sorted(self._neighbours(a))]))

    def result(self) -> SkinnedMesh:
        """Return the remaining mesh."""
        used, index = np.unique(self._triangles[self._alive], return_inverse=True)
        return SkinnedMesh(self._vertices[used], self._weights[used], index.reshape(-1, 3))

    def _offer(self, edges: IntArray) -> None:
        placements = self._placed(edges)
        for (a, b), cost, vertex, weights in zip(edges.tolist(), *placements, strict=True):
            stamp = self._changes[a] + self._changes[b]
            heapq.heappush(self._heap, (float(cost), next(self._order), a, b, stamp, vertex, weights))

    def _placed(self, edges: IntArray) -> _Placements:
        """Return the cheapest placements over all shares."""
        options = self._placed_with(np.tile(edges, (len(SHARES), 1)), np.repeat(SHARES, len(edges)))
        best = options.costs.reshape(len(SHARES), -1).argmin(axis=0) * len(edges) + np.arange(len(edges))
        return _Placements(*(values[best] for values in options))

    def _placed_with(self, edges: IntArray, shares: FloatArray) -> _Placements:
        """Minimise sum_k |T_k r|^2_Q over rest positions r, with T_k linear in the weights."""
        a, b = edges.T
        weights = (1.0 - shares)[:, None] * self._weights[a] + shares[:, None] * self._weights[b]
        middle = 0.5 * (self._vertices[a] + self._vertices[b])
        rest = _pulled_back(self._quadrics[a] + self._quadrics[b], weights, self._transforms)
        matrix, vector = rest[:, :3, :3], rest[:, :3, 3]
        trace = np.trace(matrix, axis1=1, axis2=2)
        # Edges without adjacent area have a zero quadric and collapse to their midpoint.
        regular = matrix + (REGULAR * trace + np.finfo(np.float64).tiny)[:, None, None] * _IDENTITY
        gradient = (matrix @ middle[..., None])[..., 0] + vector
        r = np.ones((len(edges), 4))
        r[:, :3] = middle - np.linalg.solve(regular, gradient[..., None])[..., 0]
        length2 = ((self._vertices[a] - self._vertices[b]) ** 2).sum(axis=1)
        costs = (r * (rest @ r[..., None])[..., 0]).sum(axis=1) + REGULAR * trace * length2
        return _Placements(costs, r[:, :3], weights)

    def _neighbours(self, vertex: int) -> set[int]:
        return set(self._triangles[list(self._around[vertex])].ravel().tolist()) - {vertex}

    def _may_collapse(self, a: int, b: int, vertex: FloatArray, weights: FloatArray) -> bool:
        """Return whether the mesh stays manifold (link condition) and no triangle folds over in any pose."""
        dying = self._around[a] & self._around[b]
        kept = sorted((self._around[a] | self._around[b]) - dying)
        if not kept or len(self._neighbours(a) & self._neighbours(b)) != len(dying):
            return False
        before = self._triangles[kept]
        return self._stays_unfolded(before, (before == a) | (before == b), vertex, weights)

    def _stays_unfolded(
        self, triangles: IntArray, moved: BoolArray, vertex: FloatArray, weights: FloatArray
    ) -> bool:
        used, index = np.unique(triangles, return_inverse=True)
        corners = _posed(self._vertices[used], self._weights[used], self._transforms)[index.reshape(-1, 3)]
        after = corners.copy()
        after[moved] = _posed(vertex[None], weights[None], self._transforms)
        old, new = _normals(corners), _normals(after)
        cosine = (old * new).sum(axis=-1)
        limit2 = LEAST_COSINE**2 * (old**2).sum(axis=-1) * (new**2).sum(axis=-1)
        return bool(((cosine > 0) & (cosine**2 > limit2)).all())

    def _collapse(self, a: int, b: int, vertex: FloatArray, weights: FloatArray) -> int:
        """Replace both ends by a; return the number of removed triangles."""
        dying = self._around[a] & self._around[b]
        for index in dying:
            self._alive[index] = False
            for corner in self._triangles[index].tolist():
                self._around[corner].discard(index)
        for index in self._around[b]:
            row = self._triangles[index]
            row[row == b] = a
        self._around[a] |= self._around[b]
        self._around[b] = set()
        self._vertices[a], self._weights[a] = vertex, weights
        self._quadrics[a] += self._quadrics[b]
        # Counts only grow, so an edge's sum is unchanged only if neither end has changed.
        self._changes[a] += 1
        self._changes[b] += 1
        return len(dying)


def _vertex_quadrics(mesh: SkinnedMesh, transforms: FloatArray) -> FloatArray:
    """Return (V, K, 4, 4): sums over a vertex's triangles of area times squared distance from the plane."""
    corners = np.moveaxis(mesh.posed(transforms), 0, 1)[mesh.triangles]  # (T, 3, K, 3)
    normals = _normals(corners)
    planes = _plane_quadrics(0.5 * normals, corners[:, 0])
    total = np.zeros((len(mesh.vertices), len(transforms), 4, 4))
    for corner in range(3):
        np.add.at(total, mesh.triangles[:, corner], planes)
    for triangle, corner in _rim(mesh.triangles):
        ends = [corner, (corner + 1) % 3]
        first, second = corners[triangle, ends]
        outwards = np.cross(second - first, normals[triangle])
        outwards *= (np.linalg.norm(second - first, axis=1) / np.linalg.norm(normals[triangle], axis=1))[
            :, None
        ]
        total[mesh.triangles[triangle, ends]] += RIM_WEIGHT * _plane_quadrics(outwards, first)
    return total


def _plane_quadrics(normals: FloatArray, points: FloatArray) -> FloatArray:
    """Return quadrics (..., 4, 4) of planes through points, weighted by the normals' lengths."""
    weight = np.linalg.norm(normals, axis=-1)[..., None]
    unit = np.divide(normals, weight, out=np.zeros_like(normals), where=weight > 0)
    plane = np.concatenate([unit, -np.einsum("...i,...i->...", unit, points)[..., None]], axis=-1)
    quadrics: FloatArray = weight[..., None] * plane[..., :, None] * plane[..., None, :]
    return quadrics


def _rim(triangles: IntArray) -> list[tuple[int, int]]:
    """Return triangles and start corners of boundary edges."""
    directed = {
        (row[k], row[(k + 1) % 3]): (index, k)
        for index, row in enumerate(triangles.tolist())
        for k in range(3)
    }
    return [place for (a, b), place in directed.items() if (b, a) not in directed]


def _pulled_back(quadrics: FloatArray, weights: FloatArray, transforms: FloatArray) -> FloatArray:
    """Return quadrics (E, 4, 4) of rest points from (E, K, 4, 4) of posed points: sum_k T_k^T Q_k T_k."""
    blended = np.zeros((len(weights), len(transforms), 4, 4))
    blended[:, :, :3] = _blended(weights, transforms)
    blended[:, :, 3, 3] = 1.0
    total: FloatArray = (np.swapaxes(blended, 2, 3) @ quadrics @ blended).sum(axis=1)
    return total


def _blended(weights: FloatArray, transforms: FloatArray) -> FloatArray:
    """Return blends (N, K, 3, 4) of bone transforms (K, B, 3, 4) with weights (N, B)."""
    poses, bones = transforms.shape[:2]
    by_bone = np.swapaxes(transforms.reshape(poses, bones, 12), 0, 1).reshape(bones, poses * 12)
    blended: FloatArray = (weights @ by_bone).reshape(-1, poses, 3, 4)
    return blended


def _posed(vertices: FloatArray, weights: FloatArray, transforms: FloatArray) -> FloatArray:
    """Return points (N, 3) with weights (N, B) in every pose, (N, K, 3)."""
    blended = _blended(weights, transforms)
    posed: FloatArray = (blended[..., :3] @ vertices[:, None, :, None])[..., 0] + blended[..., 3]
    return posed


def _normals(corners: FloatArray) -> FloatArray:
    """Return twice the vector areas (T, K, 3) of triangles (T, 3, K, 3)."""
    normals: FloatArray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals


def _fit(coarse: SkinnedMesh, mesh: SkinnedMesh) -> FloatArray:
    """Return the map (W, V) to the coarse vertices with the least mean squared surface distance.

    With s = S v the sample points (vertices and triangle centroids), a their areas and B their barycentric
    coordinates at the nearest points of the coarse surface: min over x of sum a |B x - S v|^2.
    """
    points, areas = _surface_points(mesh)
    triangle, shares = closest_points(points @ mesh.vertices, coarse.vertices[coarse.triangles])
    onto = np.zeros((len(points), len(coarse.vertices)))
    onto[np.arange(len(points))[:, None], coarse.triangles[triangle]] = shares
    weighted = (onto * areas[:, None]).T
    normal = weighted @ onto
    ridge = FIT_RIDGE * float(np.median(np.diag(normal)))
    offsets = coarse.vertices[:, None] - mesh.vertices[None]
    nearest = np.eye(len(mesh.vertices))[(offsets**2).sum(axis=-1).argmin(axis=1)]
    regular = normal + ridge * np.eye(len(normal))
    return np.asarray(np.linalg.solve(regular, weighted @ points + ridge * nearest), dtype=np.float64)


def _surface_points(mesh: SkinnedMesh) -> tuple[FloatArray, FloatArray]:
    """Return surface samples as averages (P, V) of the vertices, and the area (P,) of each."""
    count, faces = len(mesh.vertices), len(mesh.triangles)
    middles = np.zeros((faces, count))
    middles[np.arange(faces)[:, None], mesh.triangles] = 1.0 / 3.0
    areas = 0.5 * np.linalg.norm(_normals(mesh.vertices[mesh.triangles][:, :, None])[:, 0], axis=-1)
    # A triangle's centroid represents half of its area, its corners the other half.
    at_vertices = np.bincount(mesh.triangles.ravel(), np.repeat(areas / 6.0, 3), minlength=count)
    return np.concatenate([np.eye(count), middles]), np.concatenate([at_vertices, 0.5 * areas])
