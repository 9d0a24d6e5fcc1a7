"""Seams are welded, holes closed, and what is whole is left as it is."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.rendering.decimation import closed, rims, simplified, welded
from posetrack_cli.rendering.mesh import SkinnedMesh, is_closed
from support.rendering import octahedron


def volume(mesh: SkinnedMesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0)


def torn() -> SkinnedMesh:
    """The octahedron with corners of its own for every triangle."""
    mesh = octahedron()
    corners = mesh.triangles.reshape(-1)
    return SkinnedMesh(mesh.vertices[corners], mesh.weights[corners], np.arange(24).reshape(-1, 3))


def test_seams_are_welded_and_nothing_else_changes() -> None:
    mesh = torn()
    shaken = SkinnedMesh(mesh.vertices + 1e-6 * np.tile([1, -1], 12)[:, None], mesh.weights, mesh.triangles)
    whole = welded(shaken, 1e-3)
    assert len(whole.vertices) == 6 and is_closed(whole.triangles)
    assert volume(whole) == pytest.approx(volume(octahedron()), rel=1e-5)


def test_triangles_that_collapse_or_come_twice_are_left_out() -> None:
    mesh = octahedron()
    doubled = np.concatenate([mesh.triangles, mesh.triangles[:1], [[0, 0, 2]]])
    assert len(welded(SkinnedMesh(mesh.vertices, mesh.weights, doubled), 1e-3).triangles) == 8


@pytest.mark.parametrize("missing", [[0], [0, 1], [0, 7]])
def test_holes_are_closed_facing_outwards(missing: list[int]) -> None:
    mesh = octahedron()
    holed = SkinnedMesh(mesh.vertices, mesh.weights, np.delete(mesh.triangles, missing, axis=0))
    assert rims(holed.triangles)
    mended = closed(holed)
    assert is_closed(mended.triangles)
    assert 0.3 * volume(mesh) < volume(mended) <= volume(mesh) + 1e-12
    np.testing.assert_allclose(mended.weights.sum(axis=1), 1.0)


def test_what_is_closed_stays_as_it_is() -> None:
    mesh = octahedron()
    assert rims(mesh.triangles) == []
    np.testing.assert_array_equal(closed(mesh).triangles, mesh.triangles)


def test_a_mesh_of_few_triangles_is_not_simplified() -> None:
    mesh = octahedron()
    assert simplified(mesh, 8) is mesh
