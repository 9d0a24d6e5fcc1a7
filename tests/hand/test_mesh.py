"""The hand's skin: closed, outside out, bound to its bones, as thick and as large as hands are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import FINGERS, JOINT_PARENTS, MIRROR, make_anatomy, random_shape
from posetrack_cli.hand.model.hand import LEVELS, hand_mesh
from posetrack_cli.hand.model.kinematics import joint_positions, mirrored_poses, skinning_transforms
from posetrack_cli.rendering.mesh import SkinnedMesh
from support.hand import REST, bent, enclosed_volume, posed_from, random_poses

RIGHT, LEFT = make_anatomy("right"), make_anatomy("left")
FLOAT32_MM = 1e-3
"""Skinning transforms are float32: lengths of 1e3 mm times 1.2e-7, several terms."""
TIP_MM = {"lean": 1.0, "medium": 0.5, "fine": 1.0}
"""How far tip and skin end apart: they end together in the medium mesh, in other hands to first order."""
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


def test_the_smooth_surfaces_go_through_the_cage_and_are_bound_as_it_is() -> None:
    cage, medium, fine = (hand_mesh(RIGHT, level) for level in LEVELS)
    count = len(cage.vertices)
    np.testing.assert_allclose(medium.vertices[:count], cage.vertices, atol=1e-9)
    np.testing.assert_allclose(fine.vertices[:count], cage.vertices, atol=1e-9)
    # between them it bulges: a polyhedron lies inside what is smooth through its corners, nearly everywhere
    volumes = [enclosed_volume(mesh.vertices, mesh.triangles) for mesh in (cage, medium, fine)]
    assert volumes[0] < volumes[1] < volumes[2] < 1.2 * volumes[0]


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
    grown, bones = hand_mesh(longer), slice(7, 10)
    whole = usual.weights[:, bones].sum(axis=1) == 1.0
    frame, base = RIGHT.base_rotations[2], RIGHT.base_positions[2]
    local, long = ((mesh.vertices[whole] - base) @ frame for mesh in (usual, grown))
    assert whole.sum() > 20
    np.testing.assert_allclose(long, local * [1.0, 1.3, 1.0], atol=1e-9)
    others = usual.weights[:, bones].sum(axis=1) == 0
    np.testing.assert_allclose(grown.vertices[others], usual.vertices[others], atol=1e-9)


@every_level
def test_a_hand_s_size(level: str) -> None:
    vertices = hand_mesh(RIGHT, level).vertices
    assert 170.0 < -vertices[:, 1].min() < 190.0  # wrist to the middle finger's end
    assert 8.0 < vertices[:, 1].max() < 20.0  # behind the wrist, as a forearm begins inside the hand
    knuckles = vertices[(vertices[:, 1] < -75.0) & (vertices[:, 1] > -95.0) & (vertices[:, 0] < 55.0)]
    assert 70.0 < np.ptp(knuckles[:, 0]) < 95.0
    # an adult's hand displaces 300 to 400 ml with the whole wrist, and ours ends before it
    volume_ml = enclosed_volume(vertices, hand_mesh(RIGHT, level).triangles) / 1000.0
    assert 180.0 < volume_ml < 400.0


def windings(points: np.ndarray, mesh: SkinnedMesh) -> np.ndarray:
    """How often a closed mesh goes round points (N, 3): 1 inside, 0 outside (van Oosterom, Strackee 1983)."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles][None] - points[:, None, None], 2, 0)
    lengths = [np.linalg.norm(corner, axis=-1) for corner in (a, b, c)]
    above = np.einsum("nti,nti->nt", a, np.cross(b, c))
    below = np.prod(lengths, axis=0)
    for one, other, third in ((a, b, 2), (b, c, 0), (c, a, 1)):
        below += np.einsum("nti,nti->nt", one, other) * lengths[third]
    return np.asarray(np.arctan2(above, below).sum(axis=1) / (2.0 * np.pi))


@every_level
@pytest.mark.parametrize("seed", [None, 1, 2])
def test_joints_lie_in_the_skin_and_tips_at_its_end(level: str, seed: int | None) -> None:
    """The average hand, and others of the population: a joint outside the skin bends it wrongly."""
    drawn = () if seed is None else random_shape(np.random.default_rng(seed)).coefficients
    anatomy = make_anatomy(coefficients=drawn)
    mesh, fingers = hand_mesh(anatomy, level), joint_positions(anatomy, REST[None])[0, 1:].reshape(5, 4, 3)
    np.testing.assert_allclose(windings(fingers[:, :3].reshape(15, 3), mesh), 1.0, atol=1e-6)
    for finger, (chain, frame) in enumerate(zip(fingers, anatomy.base_rotations, strict=True)):
        last = mesh.weights[:, 3 + 3 * finger] > 0.5
        beyond = (-(mesh.vertices[last] - chain[3]) @ frame[:, 1]).max()
        assert abs(beyond) < TIP_MM[level]


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
def test_fingers_are_as_thick_as_people_s_and_thinner_towards_the_tip(level: str, finger: int) -> None:
    # hand.md: about 10 / 8 / 7 mm, little 7.7 / 6.9 / 6.3, thumb 10 / 9.4; the proximal segment beyond
    # the web, the distal one before the tip rounds off
    table = {0: (10.0, 9.4), 4: (7.7, 6.9, 6.3)}.get(finger, (10.0, 8.0, 7.0))
    places = ((0, 0.6), (1, 0.5), (2, 0.25))[3 - len(table) :]
    mesh = hand_mesh(RIGHT, level)
    found = np.array([section_radius(mesh, finger, bone, share) for bone, share in places])
    assert (np.diff(found) < 0.0).all()
    # the radii of people differ by a tenth or so about their mean; a hexagon lies a tenth inside its circle
    assert (found > 0.65 * np.array(table)).all() and (found < 1.25 * np.array(table)).all()


def bent_joint_2(mesh: SkinnedMesh, finger: int, angle: float) -> tuple[np.ndarray, float]:
    """Vertices with a finger's joint 2 bent, and the area of the section that halves the angle, mm^2."""
    name = FINGERS[finger]
    pose = bent(**{f"{name}_{'mcp' if finger == 0 else 'pip'}_flexion": angle})[None]
    vertices = posed(mesh, RIGHT, pose)[0]
    chain = joint_positions(RIGHT, pose)[0, 1:].reshape(5, 4, 3)[finger]
    near, far = (part / np.linalg.norm(part) for part in np.diff(chain, axis=0)[:2])
    across = (near + far) / np.linalg.norm(near + far)
    moves = mesh.weights[:, 1 + 3 * finger : 4 + 3 * finger]
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
    assert area > 0.85 * np.cos(angle / 2) * whole  # and a hexagon may be cut beside its corners
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
    assert distance.max() < 37.0  # half a palm is as wide, and its ball moves with the thumb
    fingers = mesh.weights[:, 0] < 0.01
    before = bone_distances(mesh.vertices[None], joint_positions(RIGHT, REST[None])).min(axis=-1)[0]
    pulled_mm = (
        6.0  # by bends, of what is bound to two bones: a finger's radius times 1 - cos(90 deg / 2), twice
    )
    assert (distance - before)[:, fingers].max() < pulled_mm
    # linear blending loses some volume at every bend, but nothing collapses or turns inside out
    rest = enclosed_volume(mesh.vertices, mesh.triangles)
    volumes = np.array([enclosed_volume(v, mesh.triangles) for v in vertices])
    assert (volumes > 0.8 * rest).all()
    assert (volumes < 1.05 * rest).all()
