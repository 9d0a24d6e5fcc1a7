"""The skinned mesh in a glTF file, as the file shows it at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.geometry import rotations
from posetrack_cli.rendering.gltf import Gltf, damage_named

_TRIANGLES = 4


@dataclass(frozen=True)
class GltfSkin:
    """A skin with all that is bound to it, in the scene's axes and units.

    Attributes:
        joint_names: (J) of the joints' nodes.
        joint_parents: (J) the nearest joint above each joint, -1 where there is none.
        joint_positions: (J, 3).
        vertices: (V, 3) as skinned by the nodes' transforms.
        weights: (V, J), each row sums to 1.
        triangles: (T, 3).
    """

    joint_names: tuple[str, ...]
    joint_parents: tuple[int, ...]
    joint_positions: FloatArray
    vertices: FloatArray
    weights: FloatArray
    triangles: IntArray


def read_skin(gltf: Gltf) -> GltfSkin:
    """Return the first skin that triangles are bound to.

    A vertex is shown at sum_j w_j G_j B_j v with G_j the joint's transform in the scene and B_j its inverse
    bind matrix; the mesh's own node does not count (glTF 2.0, section 3.7.3.1).

    Raises:
        UsageError: there is no skin, or parts of the file do not fit each other.
    """
    with damage_named(gltf.path):
        nodes, skins = gltf.items("nodes"), gltf.items("skins")
        bound = [node for node in nodes if "mesh" in node and "skin" in node]
        if not skins or not bound:
            raise UsageError(
                "no skinned mesh in the glTF file", where=gltf.path, expected="a mesh bound to joints"
            )
        chosen = bound[0]["skin"]
        meshes = [gltf.items("meshes")[node["mesh"]] for node in bound if node["skin"] == chosen]
        primitives = [primitive for mesh in meshes for primitive in mesh["primitives"]]
        return _assembled(gltf, skins[chosen], primitives)


def _assembled(gltf: Gltf, skin: dict[str, Any], primitives: list[dict[str, Any]]) -> GltfSkin:
    joints: list[int] = skin["joints"]
    parents = _parents(gltf)
    scene = _scene_transforms(gltf, parents)[joints]
    parts = [_primitive(gltf, primitive, len(joints)) for primitive in primitives]
    starts = np.cumsum([0, *(len(points) for points, _, _ in parts[:-1])])
    bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in skin:  # stored column by column
        bind = gltf.numbers(skin["inverseBindMatrices"]).reshape(-1, 4, 4)[: len(joints)].swapaxes(1, 2)
    vertices = np.concatenate([points for points, _, _ in parts])
    weights = np.concatenate([shares for _, shares, _ in parts])
    homogeneous = np.hstack([vertices, np.ones((len(vertices), 1))])
    shown = np.einsum("vj,jik,vk->vi", weights, (scene @ bind)[:, :3], homogeneous, optimize=True)
    if not (np.isfinite(shown).all() and np.isfinite(scene).all()):
        raise UsageError("glTF mesh has points that are no numbers", where=gltf.path)
    return GltfSkin(
        tuple(str(gltf.items("nodes")[node].get("name", f"node {node}")) for node in joints),
        tuple(_joint_above(node, joints, parents) for node in joints),
        scene[:, :3, 3],
        shown,
        weights,
        np.concatenate([faces + start for (_, _, faces), start in zip(parts, starts, strict=True)]),
    )


def _parents(gltf: Gltf) -> list[int]:
    nodes = gltf.items("nodes")
    parents = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        for child in node.get("children", []):
            parents[child] = index
    return parents


def _joint_above(node: int, joints: list[int], parents: list[int]) -> int:
    while (node := parents[node]) >= 0:
        if node in joints:
            return joints.index(node)
    return -1


def _scene_transforms(gltf: Gltf, parents: list[int]) -> FloatArray:
    """(N, 4, 4) scene_T_node of every node."""
    local = np.array([_local_transform(node) for node in gltf.items("nodes")])
    out = local.copy()
    for index in range(len(parents)):
        above, steps = parents[index], 0
        while above >= 0:
            out[index] = local[above] @ out[index]
            above, steps = parents[above], steps + 1
            if steps > len(parents):
                raise UsageError("nodes of the glTF file form a ring", where=gltf.path)
    return out


def _local_transform(node: dict[str, Any]) -> FloatArray:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    transform = np.eye(4)
    quaternion = np.array(node.get("rotation", [0.0, 0.0, 0.0, 1.0]), dtype=np.float64)
    rotation = rotations.matrices_from_quaternions((quaternion / np.linalg.norm(quaternion))[None])[0]
    transform[:3, :3] = rotation * np.array(node.get("scale", [1.0, 1.0, 1.0]), dtype=np.float64)
    transform[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
    return transform


def _primitive(gltf: Gltf, primitive: dict[str, Any], joints: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Points (V, 3), weights (V, J) and triangles (T, 3) of one part of a mesh."""
    if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
        raise UsageError(
            "glTF mesh of other things than triangles", where=gltf.path, hint="export it as triangles"
        )
    attributes = primitive["attributes"]
    points = gltf.numbers(attributes["POSITION"])
    weights = np.zeros((len(points), joints))
    rows, count = np.arange(len(points))[:, None], 0
    while f"JOINTS_{count}" in attributes:
        bones = gltf.integers(attributes[f"JOINTS_{count}"])
        np.add.at(weights, (rows, bones), gltf.numbers(attributes[f"WEIGHTS_{count}"]))
        count += 1
    total = weights.sum(axis=1, keepdims=True)
    if not (total > 0.0).all():
        found = f"{np.count_nonzero(~(total > 0.0))} of {len(points)} points without a weight"
        raise UsageError("glTF mesh is not wholly bound to its joints", where=gltf.path, found=found)
    if "indices" in primitive:
        faces = gltf.integers(primitive["indices"]).reshape(-1, 3)
    else:
        faces = np.arange(len(points)).reshape(-1, 3)
    if faces.size and not 0 <= faces.min() <= faces.max() < len(points):
        raise UsageError("glTF mesh has triangles of points that it lacks", where=gltf.path)
    return points, weights / total, faces
