"""The hand's skin: closed, outside out, bound to its bones, as thick and as large as hands are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import FINGERS, JOINT_NAMES, JOINT_PARENTS, MIRROR, make_anatomy
from posetrack_cli.hand.kinematics import joint_positions, mirrored_poses, skinning_transforms
from posetrack_cli.hand.mesh import LEVELS, hand_mesh
from posetrack_cli.rendering.mesh import SkinnedMesh
from support.hand import REST, bent, enclosed_volume, posed_from, random_poses

RIGHT, LEFT = make_anatomy("right"), make_anatomy("left")
FLOAT32_MM = 1e-3
"""Skinning transforms are float32: lengths of 1e3 mm times 1.2e-7, several terms."""
COUNTS = {"lean": 410, "medium": 1640, "fine": 6560}

every_level = pytest.mark.parametrize("level", LEVELS)


def posed(mesh: SkinnedMesh, anatomy: object, poses: np.ndarray) -> np.ndarray:
    return mesh.posed(skinning_transforms(anatomy, poses).astype(np.float64))


@every_level
@pytest.mark.parametrize("anatomy", [RIGHT, LEFT], ids=["right", "left"])
def test_the_skin_is_one_closed_surface_without_a_hole_and_faces_outwards(
    level: str, anatomy: object
) -> None:
    mesh = hand_mesh(anatomy, level)
    triangles, count = mesh.triangles, len(mesh.vertices)
    assert len(triangles) == COUNTS[level]
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    # each directed edge once, and each has its opposite: every edge belongs to two triangles
    there = np.zeros((count, count), dtype=int)
    np.add.at(there, (directed[:, 0], directed[:, 1]), 1)
    assert there.max() == 1
    assert (there == there.T).all()
    parts, _ = connected_components(coo_array((np.ones(len(directed)), directed.T), (count, count)))
    assert parts == 1  # also: no vertex lies unused
    assert count - len(directed) // 2 + len(triangles) == 2  # Euler: a sphere
    assert enclosed_volume(mesh.vertices, triangles) > 0


@every_level
def test_weights_are_shares_of_few_bones(level: str) -> None:
    weights = hand_mesh(RIGHT, level).weights
    assert weights.shape[1] == 16
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert (weights > 0).sum(axis=1).max() <= (4 if level == "lean" else 6)
    assert (weights.max(axis=0) > 0.6).all()  # every bone moves something


def test_lean_fingers_are_hexagons_of_the_circle_s_area_and_all_else_is_alike() -> None:
    lean, medium = hand_mesh(RIGHT, "lean"), hand_mesh(RIGHT, "medium")
    # the smooth surface passes through the cage's vertices, which come first
    palm = lean.weights[:, 0] == 1.0
    np.testing.assert_allclose(medium.vertices[: len(palm)][palm], lean.vertices[palm], atol=1e-9)
    rings = lean.weights[:, 0] == 0.0
    for f in range(5):
        mine = np.flatnonzero(rings & (lean.weights[:, 1 + 3 * f : 4 + 3 * f].sum(axis=1) > 0))[:-1]  # no tip
        ring, circle = lean.vertices[mine].reshape(-1, 6, 3), medium.vertices[mine].reshape(-1, 6, 3)
        middle = ring.mean(axis=1, keepdims=True)
        np.testing.assert_allclose(circle.mean(axis=1, keepdims=True), middle, atol=1e-9)
        # a hexagon of circumradius R has area 3 sqrt(3) / 2 R^2; that of a circle is pi r^2
        np.testing.assert_allclose(
            1.5 * np.sqrt(3.0) * ((ring - middle) ** 2).sum(-1),
            np.pi * ((circle - middle) ** 2).sum(-1),
        )


@every_level
def test_the_rest_pose_is_the_mesh_itself_and_rigid_motion_moves_it_rigidly(level: str) -> None:
    mesh = hand_mesh(RIGHT, level)
    np.testing.assert_allclose(posed(mesh, RIGHT, REST[None])[0], mesh.vertices, atol=FLOAT32_MM)
    position, vector = np.array([50.0, -30.0, 700.0]), np.array([0.4, -1.2, 2.0])
    turned = rotations.rotate(rotations.exponential(vector), mesh.vertices) + position
    pose = posed_from(position, vector, np.zeros(15))
    np.testing.assert_allclose(posed(mesh, RIGHT, pose[None])[0], turned, atol=FLOAT32_MM)


@every_level
def test_the_left_hand_is_the_mirror_image_in_every_pose(level: str) -> None:
    right, left = hand_mesh(RIGHT, level), hand_mesh(LEFT, level)
    np.testing.assert_array_equal(left.vertices, right.vertices * MIRROR)
    poses = random_poses(5)
    there = posed(right, RIGHT, poses) * MIRROR
    np.testing.assert_allclose(posed(left, LEFT, mirrored_poses(poses)), there, atol=FLOAT32_MM)


def test_scale_and_finger_lengths_reach_the_skin() -> None:
    usual = hand_mesh(RIGHT)
    np.testing.assert_allclose(hand_mesh(make_anatomy(scale=0.5)).vertices, 0.5 * usual.vertices, atol=1e-9)
    longer = make_anatomy(finger_lengths=(1.0, 1.0, 1.3, 1.0, 1.0))
    tip = joint_positions(longer, REST[None])[0, JOINT_NAMES.index("middle_tip")]
    grown = hand_mesh(longer)
    np.testing.assert_allclose(grown.vertices[grown.vertices[:, 1].argmin()], tip, atol=1e-9)
    others = grown.weights[:, 7:10].sum(axis=1) == 0
    np.testing.assert_array_equal(grown.vertices[others], usual.vertices[others])


@every_level
def test_a_hand_s_size(level: str) -> None:
    vertices = hand_mesh(RIGHT, level).vertices
    assert 170.0 < -vertices[:, 1].min() < 200.0  # wrist to the middle finger's tip
    knuckles = vertices[(vertices[:, 1] < -75.0) & (vertices[:, 1] > -95.0) & (vertices[:, 0] < 55.0)]
    assert 75.0 < np.ptp(knuckles[:, 0]) < 95.0
    # an adult's hand displaces 300-400 ml with the whole wrist; ours ends at the wrist
    volume_ml = enclosed_volume(vertices, hand_mesh(RIGHT, level).triangles) / 1000.0
    assert 230.0 < volume_ml < 400.0


def bone_distances(points: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Distance of points (N, V, 3) from each of the 20 segments between joints (N, 21, 3): (N, V, 20)."""
    start = joints[:, list(JOINT_PARENTS[1:])]
    along = joints[:, 1:] - start
    offset = points[:, :, None] - start[:, None]
    share = np.einsum("nvsi,nsi->nvs", offset, along) / (along**2).sum(axis=-1)[:, None]
    nearest = offset - np.clip(share, 0.0, 1.0)[..., None] * along[:, None]
    return np.linalg.norm(nearest, axis=-1)


def section_radius(mesh: SkinnedMesh, finger: int, bone: int, share: float) -> float:
    """Radius of the circle with the area of a finger's cross-section, share of the way along a bone."""
    axis = -RIGHT.base_rotations[finger][:, 1]
    centre = RIGHT.rest_origins[finger, bone] + share * RIGHT.segments[finger, bone] * axis
    faces = mesh.vertices[mesh.triangles]
    distance = bone_distances(faces.mean(axis=1)[None], joint_positions(RIGHT, REST[None]))[0]
    mine = distance.reshape(len(faces), 5, 4).min(axis=2).argmin(axis=1) == finger
    return float(np.sqrt(section_area(faces[mine], centre, axis) / np.pi))


def section_area(faces: np.ndarray, centre: np.ndarray, axis: np.ndarray) -> float:
    """Area that triangles (T, 3, 3) enclose about a centre in the plane through it across an axis, mm^2."""
    area = 0.0
    for corners in faces - centre:
        height = corners @ axis
        cut = [
            corners[i] + height[i] / (height[i] - height[j]) * (corners[j] - corners[i])
            for i, j in ((0, 1), (1, 2), (2, 0))
            if (height[i] > 0) != (height[j] > 0)
        ]
        if cut:
            area += 0.5 * abs(np.cross(*cut) @ axis)
    return area


@every_level
@pytest.mark.parametrize("finger", range(5), ids=FINGERS)
def test_fingers_are_as_thick_as_published(level: str, finger: int) -> None:
    # hand.md: about 10 / 8 / 7 mm, little 7.7 / 6.9 / 6.3, thumb 10 / 9.4; the proximal segment beyond
    # the web, the distal one before the tip rounds off
    table = {0: (None, 10.0, 9.4), 4: (7.7, 6.9, 6.3)}.get(finger, (10.0, 8.0, 7.0))
    mesh = hand_mesh(RIGHT, level)
    for bone, share in ((0, 0.6), (1, 0.5), (2, 0.25)):
        if table[bone] is not None:
            about_mm = 1.3  # "about" in the table, and what a hexagon's sides lie inside the circle
            assert abs(section_radius(mesh, finger, bone, share) - table[bone]) < about_mm


def bent_joint_2(mesh: SkinnedMesh, finger: int, angle: float) -> tuple[np.ndarray, float]:
    """Vertices with a finger's joint 2 bent, and the area of the section that halves the angle, mm^2."""
    name = FINGERS[finger]
    pose = bent(**{f"{name}_{'mcp' if finger == 0 else 'pip'}_flexion": angle})[None]
    vertices = posed(mesh, RIGHT, pose)[0]
    chain = joint_positions(RIGHT, pose)[0, 1:].reshape(5, 4, 3)[finger]
    near, far = (part / np.linalg.norm(part) for part in np.diff(chain, axis=0)[:2])
    across = (near + far) / np.linalg.norm(near + far)
    moves = mesh.weights[:, 1 + 3 * finger : 3 + 3 * finger]
    mine = (moves.sum(axis=1) > 0.6)[mesh.triangles].all(axis=1)
    return vertices, section_area(vertices[mesh.triangles[mine]], chain[1], across)


@every_level
@pytest.mark.parametrize("finger", range(5), ids=FINGERS)
def test_a_bent_joint_neither_collapses_nor_tears(level: str, finger: int) -> None:
    # at 90 deg the palmar skin of both sides meets in the plane that halves the angle: a crease, no section
    mesh, angle = hand_mesh(RIGHT, level), np.deg2rad(74.0 if finger == 0 else 85.0)
    rest, whole = bent_joint_2(mesh, finger, 0.0)
    vertices, area = bent_joint_2(mesh, finger, angle)
    # what two bones share half and half keeps cos(angle / 2) of its distance in the plane of the bend
    assert area > 0.9 * np.cos(angle / 2) * whole
    # no skin is pulled longer than the arc that the back of the finger, a radius away, goes round
    edges = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]]
    lengths = [np.linalg.norm(v[edges[..., 0]] - v[edges[..., 1]], axis=-1) for v in (rest, vertices)]
    assert (lengths[1] - lengths[0]).max() < angle * RIGHT.radii[finger, 1]


@pytest.mark.parametrize("finger", range(5), ids=FINGERS)
def test_the_rings_beside_a_bent_joint_keep_their_size(finger: int) -> None:
    mesh, angle = hand_mesh(RIGHT), np.deg2rad(74.0 if finger == 0 else 90.0)
    first, second = mesh.weights[:, 1 + 3 * finger], mesh.weights[:, 2 + 3 * finger]
    for ring in (first == 0.75) & (second == 0.25), (first == 0.25) & (second == 0.75):
        assert ring.sum() == 6
        areas = []
        for turn in (0.0, angle):
            corners = bent_joint_2(mesh, finger, turn)[0][ring]
            areas.append(0.5 * np.linalg.norm(np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)))
        # |3/4 + 1/4 exp(i angle)| = .79 at 90 deg is what the blend leaves of the diameter in its plane
        left = abs(0.75 + 0.25 * np.exp(1j * angle))
        assert areas[1] > 0.95 * left * areas[0]


@every_level
def test_the_skin_stays_around_the_bones_whatever_the_pose(level: str) -> None:
    mesh, poses = hand_mesh(RIGHT, level), random_poses(20, seed=9)
    vertices, joints = posed(mesh, RIGHT, poses), joint_positions(RIGHT, poses)
    distance = bone_distances(vertices, joints).min(axis=-1)
    assert distance.max() < 35.0  # the wrist is 31 mm wide to either side of its joint
    fingers = mesh.weights[:, 0] < 0.01
    assert distance[:, fingers].max() < 14.0  # the thumb's base is the thickest: 12.5 mm, with its girth
    # linear blending loses some volume at every bend, but nothing collapses or turns inside out
    rest = enclosed_volume(mesh.vertices, mesh.triangles)
    volumes = np.array([enclosed_volume(v, mesh.triangles) for v in vertices])
    assert (volumes > 0.85 * rest).all()
    assert (volumes < 1.05 * rest).all()
