"""Scenes whose depth is known: meshes made here, and rays cut with their triangles one by one."""

from __future__ import annotations

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.port import Window

CAMERA = Camera(64, 48, 90.0, 95.0, 31.2, 24.7)
STILL = np.eye(3, 4)
SUBPIXEL_PX = 1.0 / 256.0
"""GPUs round the corners of triangles to such a grid (OpenGL's SUBPIXEL_BITS)."""


def rigid(vertices: np.ndarray, triangles: np.ndarray) -> SkinnedMesh:
    """A mesh on one bone."""
    return SkinnedMesh(np.asarray(vertices, float), np.ones((len(vertices), 1)), np.asarray(triangles))


def moved(*offsets: tuple[float, float, float]) -> np.ndarray:
    """One translation per offset: (N, 1, 3, 4)."""
    transforms = np.tile(STILL, (len(offsets), 1, 1, 1))
    transforms[:, 0, :, 3] = offsets
    return transforms.astype(np.float32)


def octahedron() -> SkinnedMesh:
    """Six unit vertices, eight faces, counter-clockwise from outside."""
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    return rigid(vertices, np.array(faces))


def sphere(radius: float, halvings: int) -> SkinnedMesh:
    """An octahedron halved so often and blown up to a sphere about the origin."""
    mesh = octahedron()
    vertices, faces = mesh.vertices.tolist(), mesh.triangles.tolist()
    for _ in range(halvings):
        middles: dict[tuple[int, int], int] = {}

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                point = np.add(vertices[a], vertices[b])
                vertices.append((point / np.linalg.norm(point)).tolist())
                middles[key] = len(vertices) - 1
            return middles[key]

        halved = []
        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            halved += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = halved
    return rigid(radius * np.array(vertices), np.array(faces))


def sagitta(mesh: SkinnedMesh, radius: float) -> float:
    """How far a sphere's triangles lie inside it at most: at each triangle's point nearest the centre."""
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    distance = np.einsum("ti,ti->t", normals, corners[:, 0]) / np.linalg.norm(normals, axis=1)
    return radius - float(distance.min())


def moved_a_subpixel(depth: np.ndarray) -> np.ndarray:
    """How much each depth of images (..., h, w) changes within SUBPIXEL_PX, mm, by its steepest neighbour."""
    steepest = np.zeros(depth.shape)
    for axis in (-2, -1):
        one, other = (np.moveaxis(a, axis, 0) for a in (depth, steepest))
        steps = np.where((one[1:] > 0) & (one[:-1] > 0), np.abs(np.diff(one, axis=0)), 0.0)
        np.maximum(other[1:], steps, out=other[1:])
        np.maximum(other[:-1], steps, out=other[:-1])
    return SUBPIXEL_PX * steepest


def plane(z: float, slope_x: float, slope_y: float, half: float = 2000.0) -> SkinnedMesh:
    """The square of the plane z + slope_x x + slope_y y that faces the sensor."""
    x, y = half * np.array([-1, 1, 1, -1]), half * np.array([-1, -1, 1, 1])
    return rigid(np.stack([x, y, z + slope_x * x + slope_y * y], axis=1), np.array([(0, 2, 1), (0, 3, 2)]))


def rays(camera: Camera, window: Window) -> np.ndarray:
    """Directions (h, w, 3) with z = 1 through the centres of the window's pixels."""
    u, v = np.meshgrid(window.columns(), window.rows())
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def cast(vertices: np.ndarray, triangles: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Depth of the nearest triangle along each ray, 0 where there is none: plain arithmetic, no renderer.

    Ray d hits the triangle a b c at z where z d = a + s (b - a) + t (c - a) with s, t >= 0, s + t <= 1.
    """
    nearest = np.full(directions.shape[:2], np.inf)
    for a, b, c in vertices[triangles]:
        matrix = np.stack([a - b, a - c], axis=1)
        normal = np.cross(b - a, c - a)
        slope = directions @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (a @ normal) / slope
        s_t = (a - z[..., None] * directions) @ np.linalg.pinv(matrix).T
        inside = (s_t >= 0).all(axis=-1) & (s_t.sum(axis=-1) <= 1) & (z > 0)
        nearest = np.where(inside & (z < nearest), z, nearest)
    return np.where(np.isfinite(nearest), nearest, 0.0)
