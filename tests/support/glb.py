"""Writes our own hand as a GLB file: 25 WebXR joints, a bent rest pose, other axes, metres."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import FINGERS, HandAnatomy
from posetrack_cli.hand.model.hand import hand_mesh
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.rendering.mesh import SkinnedMesh

NAMES = {"thumb": "thumb", "index": "index-finger", "middle": "middle-finger", "ring": "ring-finger"} | {
    "little": "pinky-finger"
}


def joint_names() -> list[str]:
    """The 25 names of the W3C's WebXR Hand Input."""
    names = ["wrist"]
    for finger in FINGERS:
        parts = ["metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip"]
        if finger == "thumb":
            parts.remove("phalanx-intermediate")
        names += [f"{NAMES[finger]}-{part}" for part in parts]
    return names


def joint_places(joints: FloatArray) -> FloatArray:
    """Our 21 joints as the 25: the fingers' metacarpals begin a quarter of the way from wrist to knuckle."""
    places = [joints[0], *joints[1:5]]
    for finger in range(1, 5):
        own = joints[1 + 4 * finger : 5 + 4 * finger]
        places += [joints[0] + 0.25 * (own[0] - joints[0]), *own]
    return np.array(places)


def joint_weights(weights: FloatArray) -> FloatArray:
    """(V, 25) of our (V, 16): the palm's go to the wrist and, half of them, to the middle metacarpal."""
    names, out = joint_names(), np.zeros((len(weights), 25))
    out[:, 0] = 0.5 * weights[:, 0]
    out[:, names.index("middle-finger-metacarpal")] = 0.5 * weights[:, 0]
    for finger, name in enumerate(FINGERS):
        first = names.index(f"{NAMES[name]}-{'metacarpal' if finger == 0 else 'phalanx-proximal'}")
        out[:, first : first + 3] = weights[:, 1 + 3 * finger : 4 + 3 * finger]
    return out


class GlbWriter:
    """Collects accessors and writes the container."""

    def __init__(self) -> None:
        self.binary = b""
        self.content: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}

    def accessor(self, values: np.ndarray, kind: int, shape: str, *, padding: int = 0) -> int:
        """Add numbers; with padding the rows lie farther apart than they are long."""
        rows = values.reshape(len(values), -1)
        data = b"".join(row.tobytes() + bytes(padding) for row in rows)
        self.binary += bytes(-len(self.binary) % 4)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        if padding:
            view["byteStride"] = rows.itemsize * rows.shape[1] + padding
        self.binary += data
        self.content["bufferViews"].append(view)
        entry = {"bufferView": len(self.content["bufferViews"]) - 1, "componentType": kind}
        entry |= {"count": len(values), "type": shape}
        self.content["accessors"].append(entry)
        return len(self.content["accessors"]) - 1

    def bytes(self) -> bytes:
        """The file."""
        self.content["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.content).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + bytes(-len(self.binary) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def hand_glb(
    anatomy: HandAnatomy,
    pose: FloatArray,
    *,
    mesh: SkinnedMesh | None = None,
    per_metre: float = 1000.0,
    names: list[str] | None = None,
    chained: bool = True,
) -> GlbWriter:
    """A hand that the file shows in a pose (22,), whose position and rotation are the file's axes.

    The mesh itself lies at zero angles about the wrist, so that only the inverse bind matrices and the nodes
    together give what is shown. Vertices are doubled along the palm's edge as at a seam of a texture.

    Args:
        anatomy: the hand.
        pose: (22,).
        mesh: by default the medium one.
        per_metre: units of ours per unit of the file.
        names: of the joints.
        chained: whether joints are each other's children, or all of the scene.
    """
    mesh = mesh or hand_mesh(anatomy, "medium")
    transforms = skinning_transforms(anatomy, pose[None])[0].astype(np.float64)
    writer, content = GlbWriter(), {}
    shown = joint_places(joint_positions(anatomy, pose[None])[0]) / per_metre
    rest = np.concatenate([np.zeros(6), [1.0], np.zeros(15)])
    at_rest = joint_places(joint_positions(anatomy, rest[None])[0]) / per_metre
    frames = _joint_frames(transforms, shown)
    binds = np.tile(np.eye(4), (25, 1, 1))
    binds[:, :3, 3] = -at_rest
    doubled = np.flatnonzero(mesh.weights[:, 0] > 0.9)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[doubled]])
    weights = joint_weights(np.concatenate([mesh.weights, mesh.weights[doubled]]))
    triangles = mesh.triangles.copy()
    last = triangles[-len(triangles) // 3 :]
    seam = {int(old): len(mesh.vertices) + k for k, old in enumerate(doubled)}
    last[:] = np.vectorize(lambda v: seam.get(int(v), int(v)))(last)
    order = np.argsort(-weights, axis=1)[:, :8]
    shares = np.take_along_axis(weights, order, axis=1)
    attributes = {"POSITION": writer.accessor((vertices / per_metre).astype("<f4"), 5126, "VEC3", padding=8)}
    for k in range(2):
        part = slice(4 * k, 4 * k + 4)
        attributes[f"JOINTS_{k}"] = writer.accessor(order[:, part].astype("<u1"), 5121, "VEC4")
        attributes[f"WEIGHTS_{k}"] = writer.accessor(shares[:, part].astype("<f4"), 5126, "VEC4")
    indices = writer.accessor(triangles.reshape(-1).astype("<u2"), 5123, "SCALAR")
    inverse = writer.accessor(binds.swapaxes(1, 2).reshape(25, 16).astype("<f4"), 5126, "MAT4")
    content["meshes"] = [{"primitives": [{"attributes": attributes, "indices": indices}]}]
    content["skins"] = [{"joints": list(range(1, 26)), "inverseBindMatrices": inverse}]
    nodes = _nodes(frames, names or joint_names(), chained=chained)
    content["nodes"] = [{"name": "body", "mesh": 0, "skin": 0}, *nodes]
    content["scenes"] = [{"nodes": list(range(26))}]
    writer.content |= content
    return writer


def _joint_frames(transforms: FloatArray, shown: FloatArray) -> FloatArray:
    """scene_T_joint (25, 4, 4): turned as the bone that begins there."""
    bones = [0, 1, 2, 3, 3]
    for finger in range(1, 5):
        first = 1 + 3 * finger
        bones += [0, first, first + 1, first + 2, first + 2]
    frames = np.tile(np.eye(4), (25, 1, 1))
    frames[:, :3, :3] = transforms[bones, :, :3]
    frames[:, :3, 3] = shown
    return frames


def _nodes(frames: FloatArray, names: list[str], *, chained: bool) -> list[dict[str, Any]]:
    nodes: list[dict[str, Any]] = [{"name": name} for name in names]
    for k, node in enumerate(nodes):
        last_of_finger = names[k].endswith("tip") or k == 0
        if chained and not last_of_finger and k + 1 < len(nodes):
            node["children"] = [k + 2]  # node 0 is the body
    parents = {child - 1: k for k, node in enumerate(nodes) for child in node.get("children", [])}
    for k, node in enumerate(nodes):
        local = frames[k] if k not in parents else np.linalg.inv(frames[parents[k]]) @ frames[k]
        node["translation"] = local[:3, 3].tolist()
        node["rotation"] = _quaternion(local[:3, :3]).tolist()
    return nodes


def _quaternion(matrix: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(rotations.canonical(Rotation.from_matrix(matrix).as_quat()[None])[0])


def write_hand(path: Path, *arguments: Any, **options: Any) -> Path:
    """Write ``hand_glb``."""
    path.write_bytes(hand_glb(*arguments, **options).bytes())
    return path
