"""Import of skinned glTF hands with WebXR joint names, straightened and rebound to our bones.

WebXR Hand Input has 25 joints. We use the wrist, the thumb's four and four of every finger; the fingers'
metacarpals belong to the palm. Files have arbitrary rest poses and axes; linear blend skinning takes them to
zero angles in hand coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.hand.model.anatomy import BONE_COUNT, FINGERS, MIRROR, HandAnatomy, make_anatomy
from posetrack_cli.rendering.decimation import closed, welded
from posetrack_cli.rendering.gltf import GltfSkin, damage_named, read_glb, read_skin
from posetrack_cli.rendering.mesh import SkinnedMesh, edges_of

_PHALANGES = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
_THUMB = ("metacarpal", "phalanx-proximal", "phalanx-distal", "tip")
WEBXR_JOINTS: tuple[str, ...] = (
    "wrist",
    *(f"thumb-{part}" for part in _THUMB),
    *(f"{name}-finger-{part}" for name in ("index", "middle", "ring", "pinky") for part in _PHALANGES),
)
_METACARPALS = tuple(name for name in WEBXR_JOINTS if name.endswith("finger-metacarpal"))
OUR_JOINTS: tuple[str, ...] = tuple(name for name in WEBXR_JOINTS if name not in _METACARPALS)
"""The 21 of them that we use, in our order."""

PER_METRE = 1000.0
_LENGTHS_MM = (90.0, 360.0)  # wrist to middle fingertip: half and twice an adult's
_WELD_MM = 0.01
_WRIST_END_MM = 8.0  # end of the average hand's mesh behind the wrist joint; beyond it is forearm
_MIN_PALM_MM2 = 100.0  # twice the area between wrist, index and little finger: 1 % of a hand's
_MAX_OPEN = 1.0 / 3.0  # share of the edges; a skin is open at the wrist, and perhaps around nails
_FLAT = 0.03  # thumb and fingers closer to the palm's plane do not determine its side


@dataclass(frozen=True, eq=False)
class FileHand:
    """A right hand from a file at zero angles, in hand coordinates, mm.

    Attributes:
        anatomy: its bones.
        skin: its full mesh, bound to the 16 bones.
    """

    anatomy: HandAnatomy
    skin: SkinnedMesh


def load_hand(path: Path) -> FileHand:
    """Read a hand from a GLB file; a left hand is mirrored.

    Raises:
        UsageError: no skinned mesh, missing joint, or implausible measures.
    """
    gltf = read_glb(path)
    with damage_named(path):
        return straightened(read_skin(gltf), path)


def straightened(skin: GltfSkin, path: Path, average: HandAnatomy | None = None) -> FileHand:
    """Return the hand of a skin at zero angles; see ``load_hand``.

    Args:
        skin: of a hand.
        path: its file, for errors.
        average: the hand to whose palm it is aligned; ours by default.
    """
    places = joint_places(skin, path)
    joints, vertices = PER_METRE * skin.joint_positions[places], PER_METRE * skin.vertices
    _check_size(joints, path)
    triangles = skin.triangles
    if _side(joints, path) == "left":
        joints, vertices, triangles = joints * MIRROR, vertices * MIRROR, triangles[:, ::-1]
    average = average or make_anatomy()
    turn, scale = _hand_axes(joints, average)
    joints, vertices = ((points - joints[0]) @ turn.T for points in (joints, vertices))
    mesh = welded(SkinnedMesh(vertices, _bone_weights(skin, places), triangles), _WELD_MM)
    anatomy, transforms = _zero_angles(joints, average, scale)
    mesh = SkinnedMesh(mesh.posed(transforms[None])[0], mesh.weights, mesh.triangles)
    mesh = _without_forearm(mesh, anatomy.scale, path)
    return FileHand(replace(anatomy, radii=_radii(anatomy, mesh, path)), mesh)


def joint_places(skin: GltfSkin, path: Path) -> list[int]:
    """Return the indices of our 21 joints among the skin's.

    Raises:
        UsageError: one of the 25 is missing.
    """
    names = [name.lower().replace("_", "-") for name in skin.joint_names]
    twice = [name for name in WEBXR_JOINTS if names.count(name) > 1]
    if twice:
        raise UsageError(f"skin has the joint '{twice[0]}' twice", where=path)
    missing = [name for name in WEBXR_JOINTS if name not in names]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise UsageError(
            f"skin lacks the joint '{missing[0]}'{more}",
            where=path,
            found=", ".join(names[:4]) + (", ..." if len(names) > 4 else ""),
            expected="the 25 joint names of WebXR",
        )
    return [names.index(name) for name in OUR_JOINTS]


def _check_size(joints: FloatArray, path: Path) -> None:
    """Refuse skins that are not a hand in metres."""
    chain = joints[[0, 9, 10, 11, 12]]
    length = float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum())
    if not _LENGTHS_MM[0] <= length <= _LENGTHS_MM[1]:
        raise UsageError(
            "implausible hand size",
            where=path,
            found=f"{length:.3g} mm from wrist to middle fingertip",
            expected="{:g} to {:g} mm".format(*_LENGTHS_MM),
            hint="export the file in metres",
        )
    parts = np.linalg.norm(np.diff(joints[1:].reshape(5, 4, 3), axis=1), axis=2)
    if parts.min() < 1.0:
        finger = FINGERS[int(parts.min(axis=1).argmin())]
        raise UsageError(f"joints of the {finger} coincide", where=path)
    index, little = joints[5] - joints[0], joints[17] - joints[0]
    if np.linalg.norm(np.cross(index, little)) < _MIN_PALM_MM2:
        raise UsageError("wrist, index and little finger knuckles are collinear", where=path)


def _side(joints: FloatArray, path: Path) -> str:
    """Return the side: fingers and thumb lie at least slightly on the palm's side of wrist and knuckles.

    Raises:
        UsageError: a flat hand, and no side in the file name.
    """
    index, little = joints[5] - joints[0], joints[17] - joints[0]
    normal = np.cross(index, little)  # out of the palm of a right hand
    normal /= np.linalg.norm(normal)
    beyond = joints[[2, 3, 4, 6, 7, 8, 10, 11, 12, 14, 15, 16, 18, 19, 20]]
    bases = joints[[0, 0, 0, 5, 5, 5, 9, 9, 9, 13, 13, 13, 17, 17, 17]]
    height = float(((beyond - bases) @ normal).mean() / np.linalg.norm(index))
    if abs(height) > _FLAT:
        return "right" if height > 0 else "left"
    named = [side for side in ("right", "left") if side in path.stem.lower()]
    if len(named) == 1:
        return named[0]
    raise UsageError(
        "side of a flat hand cannot be determined",
        where=path,
        hint="name the file right.glb or left.glb",
    )


def _hand_axes(joints: FloatArray, average: HandAnatomy) -> tuple[FloatArray, float]:
    """Return the rotation (3, 3) to hand coordinates, and the size relative to the average hand.

    Wrist and knuckles are aligned with those of the average hand (Kabsch 1976).
    """
    from scipy.spatial.transform import Rotation

    ours = np.vstack([np.zeros(3), average.base_positions[1:]])
    palms = [points - points.mean(axis=0) for points in (ours, joints[[0, 5, 9, 13, 17]])]
    turn, _ = Rotation.align_vectors(*palms)
    sizes = [float(np.sqrt((points**2).sum())) for points in palms]
    return turn.as_matrix(), sizes[1] / sizes[0]


def _bone_weights(skin: GltfSkin, places: list[int]) -> FloatArray:
    """Return the weights (V, 16) of our bones: of the joint each starts at, and of its descendants."""
    out = np.zeros((len(skin.vertices), BONE_COUNT))
    for joint in range(len(skin.joint_names)):
        above = joint
        while above >= 0 and above not in places:
            above = skin.joint_parents[above]
        out[:, _bone_of(places.index(above)) if above >= 0 else 0] += skin.weights[:, joint]
    return out


def _bone_of(joint: int) -> int:
    """Return the bone that starts at one of our joints; a tip belongs to the last bone."""
    if joint == 0:
        return 0
    finger, place = divmod(joint - 1, 4)
    return 1 + 3 * finger + min(place, 2)


def _zero_angles(joints: FloatArray, average: HandAnatomy, scale: float) -> tuple[HandAnatomy, FloatArray]:
    """Return the bones at zero angles, and the transforms (16, 3, 4) that straighten the skin."""
    chains = joints[1:].reshape(5, 4, 3)
    ways = np.diff(chains, axis=1)
    segments = np.linalg.norm(ways, axis=2)
    anatomy = HandAnatomy(
        "right", chains[:, 0], average.base_rotations, segments, scale * average.radii, scale
    )
    transforms = np.tile(np.eye(3, 4), (BONE_COUNT, 1, 1))
    for finger in range(5):
        frame = average.base_rotations[finger]
        for bone, turn in enumerate(_bends(ways[finger] @ frame / segments[finger, :, None], finger == 0)):
            back = frame @ turn.T @ frame.T
            at = transforms[1 + 3 * finger + bone]
            at[:, :3] = back
            at[:, 3] = anatomy.rest_origins[finger, bone] - back @ chains[finger, bone]
    return anatomy, transforms


def _bends(directions: FloatArray, thumb: bool) -> list[FloatArray]:
    """Return rotations (3, 3) of bones with these directions (3, 3) from zero angles, in their finger's
    frame.

    Those of our kinematics, Rz(a) Rx(t), or for the thumb Rx(s) Rz(a) Rx(t) with its first bone at Rx(s)
    Rz(a), followed by the smallest remaining rotation, so that bones do not twist.
    """
    first = _flexion(directions[0]) if thumb else np.eye(3)
    base = first @ _abduction(first.T @ directions[0])
    out = []
    for place, direction in enumerate(directions):
        model = base if thumb and place == 0 else base @ _flexion(base.T @ direction)
        out.append(_between(-model[:, 1], direction) @ model)
    return out


def _flexion(direction: FloatArray) -> FloatArray:
    """Return the Rx(t) that takes -e_y closest to a direction."""
    t = float(np.arctan2(-direction[2], -direction[1]))
    c, s = np.cos(t), np.sin(t)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _abduction(direction: FloatArray) -> FloatArray:
    """Return the Rz(a) of the first bone; identity for a finger bent away from -e_y."""
    a = float(np.arctan2(direction[0], -direction[1])) if direction[1] < -0.3 else 0.0
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _between(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the smallest rotation between unit vectors: I + [v] + [v]^2 / (1 + cos)."""
    v, cosine = np.cross(one, other), float(one @ other)
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    turn: FloatArray = np.eye(3) + cross + cross @ cross / (1.0 + cosine)
    return turn


def _without_forearm(mesh: SkinnedMesh, scale: float, path: Path) -> SkinnedMesh:
    """Flatten the mesh behind the wrist onto a plane, and close the hole that a sleeve leaves.

    Raises:
        UsageError: the mesh is not a surface with few holes.
    """
    vertices = mesh.vertices.copy()
    vertices[:, 1] = np.minimum(vertices[:, 1], _WRIST_END_MM * scale)
    flat = welded(replace(mesh, vertices=vertices), _WELD_MM)
    edges, of_triangle = edges_of(flat.triangles)
    single = np.count_nonzero(np.bincount(of_triangle.ravel(), minlength=len(edges)) == 1)
    if single > _MAX_OPEN * len(edges):
        found = f"{single} of {len(edges)} edges with only one triangle"
        raise UsageError("skin is not a surface", where=path, found=found)
    whole = closed(flat)
    most = int(np.bincount(whole.triangles.ravel(), minlength=1).max())
    if most > limits.MESH_VALENCE:
        found = f"{most} triangles at one point"
        raise UsageError(
            "skin is not a surface", where=path, found=found, expected=f"at most {limits.MESH_VALENCE}"
        )
    return whole


def _radii(anatomy: HandAnatomy, mesh: SkinnedMesh, path: Path) -> FloatArray:
    """Return the skin's distances (5, 4) from the fingers' axes at the stations of ``HandAnatomy.radii``."""
    out = np.empty((5, 4))
    for finger in range(5):
        mine = mesh.weights[:, 1 + 3 * finger : 4 + 3 * finger].sum(axis=1) > 0.6
        if not mine.any():
            raise UsageError(f"{FINGERS[finger]} has no skin", where=path)
        local = (mesh.vertices[mine] - anatomy.base_positions[finger]) @ anatomy.base_rotations[finger]
        along, radius = -local[:, 1], np.hypot(local[:, 0], local[:, 2])
        first, second, third = anatomy.segments[finger]
        stations = (0.6 * first, first, first + second, first + second + 0.7 * third)
        for k, station in enumerate(stations):
            nearest = np.argsort(np.abs(along - station))[:12]
            out[finger, k] = np.median(radius[nearest])
    return out
