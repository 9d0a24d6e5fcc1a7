from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.rendering.mesh import SkinnedMesh, is_closed
from posetrack_cli.synthesis.hand import person
from posetrack_cli.synthesis.hand.frames import CAMERA, room_depth
from posetrack_cli.synthesis.hand.motion import WalkNoise, pose_walk, start_pose, walk_region
from posetrack_cli.synthesis.hand.person import ellipsoid

STRETCH = np.stack([np.hstack([np.eye(3), [[0.0], [y], [0.0]]]) for y in (0.0, 250.0)])


def volume(mesh: SkinnedMesh, transforms: np.ndarray) -> float:
    """Positive if the faces are counter-clockwise seen from outside."""
    a, b, c = np.moveaxis(mesh.posed(transforms[None])[0][mesh.triangles], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize(
    ("mesh", "bones"),
    [
        (person.forearm_mesh(1.0), STRETCH),
        (person.upper_arm_mesh(1.0), STRETCH),
        (person.trunk_mesh(), STRETCH[:1]),
        (person.head_mesh(), STRETCH[:1]),
    ],
)
def test_solids_are_closed_and_face_outwards(mesh: SkinnedMesh, bones: np.ndarray) -> None:
    assert is_closed(mesh.triangles)
    assert volume(mesh, bones) > 0.0
    assert mesh.weights.sum(axis=1) == pytest.approx(1.0)


def test_ellipsoid_has_nearly_its_volume() -> None:
    exact = 4.0 / 3.0 * np.pi * 10.0 * 20.0 * 30.0
    made = volume(ellipsoid((10.0, 20.0, 30.0)), STRETCH[:1])
    assert 0.93 * exact < made < exact  # inscribed: 24 sides and 13 rings lose 4 per cent


def test_the_forearm_begins_in_the_wrist_and_bends_within_reason() -> None:
    density = WalkNoise().walk.vector()
    seconds = np.arange(300) / 30.0
    poses = pose_walk(start_pose(1.0), seconds, density, walk_region(1.0), np.random.default_rng(0))
    for pose in poses:
        near, far = person.forearm_bones(pose, 1.0)
        assert np.linalg.norm(near[:, 3] - pose[:3]) == pytest.approx(person.WRIST_OFFSET_MM)
        assert np.linalg.norm(far[:, 3] - near[:, 3]) == pytest.approx(person.FOREARM_MM)
        assert near[:, :3].T @ near[:, :3] == pytest.approx(np.eye(3), abs=1e-12)
        hand_axis = (near[:, 3] - pose[:3]) / person.WRIST_OFFSET_MM
        assert np.arccos(hand_axis @ near[:, 1]) < person.MOST_WRIST_BEND


def test_the_room_is_behind_and_everywhere() -> None:
    depth = room_depth(CAMERA)
    assert depth.min() > 1500.0 and depth.max() < 4500.0
    u, v = 255, 200
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    assert depth[v, u] == pytest.approx(2750.0 / (0.05 * x + 0.03 * y + 1.0), rel=1e-6)
