"""The lean skin against the smooth one: nearer than the cage it replaces, in any shape, on both sides."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.model.anatomy import MIRROR, HandAnatomy, make_anatomy
from posetrack_cli.hand.model.hand import LEAN_TRIANGLES, bent_hands, hand_mesh, lean_mesh
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.rendering.mesh import SkinnedMesh, closest_points, is_closed
from support.hand import random_poses

WIDE = make_anatomy("right", 1.1, (1.1, 0.9, 1.0, 1.05, 0.95), (1.2, 1.1, 1.2, 0.9, 1.0))


def off_surface(mesh: SkinnedMesh, smooth: SkinnedMesh, transforms: FloatArray) -> FloatArray:
    """Signed distances (V,) of the smooth skin's posed vertices from a posed mesh, mm, outside positive."""
    corners = mesh.posed(transforms[None])[0][mesh.triangles]
    points = smooth.posed(transforms[None])[0]
    triangle, shares = closest_points(points, corners)
    offset = points - np.einsum("pc,pcx->px", shares, corners[triangle])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[triangle]
    sign = np.sign((offset * normals).sum(axis=1))
    return sign * np.linalg.norm(offset, axis=1)


@pytest.mark.parametrize("anatomy", [make_anatomy(), WIDE], ids=["average", "wide"])
def test_the_lean_skin_is_the_smooth_one_to_a_millimetre(anatomy: HandAnatomy) -> None:
    lean, cage, fine = lean_mesh(anatomy), hand_mesh(anatomy, "lean"), hand_mesh(anatomy, "fine")
    assert len(lean.triangles) <= LEAN_TRIANGLES
    assert len(cage.triangles) == 410
    assert is_closed(lean.triangles)
    for transforms in bent_hands(anatomy):
        found = off_surface(lean, fine, transforms)
        assert np.abs(found).mean() < 0.6 * anatomy.scale
        assert abs(found.mean()) < 0.3
        assert np.abs(found).mean() < 0.7 * np.abs(off_surface(cage, fine, transforms)).mean()


def test_a_left_hand_is_the_mirror_image() -> None:
    right, left = (
        lean_mesh(WIDE),
        lean_mesh(make_anatomy("left", 1.1, (1.1, 0.9, 1.0, 1.05, 0.95), (1.2, 1.1, 1.2, 0.9, 1.0))),
    )
    np.testing.assert_allclose(left.vertices, right.vertices * MIRROR, atol=1e-9)
    a, b, c = np.moveaxis(left.vertices[left.triangles], 1, 0)
    assert np.einsum("ti,ti->", a, np.cross(b, c)) > 0  # its faces are outside


def test_bent_hands_are_open_and_closed() -> None:
    anatomy = make_anatomy()
    fine, bends = hand_mesh(anatomy, "medium"), bent_hands(anatomy)
    np.testing.assert_allclose(bends[0], skinning_transforms(anatomy, random_poses(1) * 0 + np.eye(22)[6])[0])
    spans = np.ptp(fine.posed(bends), axis=1)[:, 1]
    assert spans[0] > 165.0  # from wrist to fingertips
    assert spans[2] < 130.0  # a fist
