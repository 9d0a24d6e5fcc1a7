"""Another implementation of the renderers' port: rays through pixel centres, cut with triangles by numpy.

Slow and plain: what OpenGL draws is compared with it, and whatever asks for a device runs on it. Surfaces
have one sample a pixel and the nearest texel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.port import (
    MOST_TILES,
    Comparison,
    Lighting,
    RendererInfo,
    Surface,
    TileSums,
    Window,
    check_observed,
    check_poses,
    sums_in_numpy,
)
from support.rendering import rays

NEAR_MM = 50.0
SHININESS = 24.0


@dataclass(frozen=True)
class Hits:
    """Where rays (P, 3) meet triangles first.

    Attributes:
        depth: (P,) mm, 0 where they meet none.
        triangle: (P,) its number.
        shares: (P, 3) barycentric coordinates there.
    """

    depth: FloatArray
    triangle: IntArray
    shares: FloatArray


def first_hits(vertices: FloatArray, triangles: IntArray, directions: FloatArray) -> Hits:
    """Cut rays (P, 3) of z = 1 with the triangles that face the origin.

    With corners a b c, ray d meets their plane at z d = s a + t b + u c, where s = d . (b x c) / sum, t and u
    likewise, z = a . (b x c) / sum and sum = d . (b x c + c x a + a x b): so no triangle that crosses the
    plane of the sensor needs clipping.
    """
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    volume = np.einsum("ti,ti->t", a, np.cross(b, c))
    faces = np.flatnonzero(volume < 0)
    a, b, c, volume = a[faces], b[faces], c[faces], volume[faces]
    edges = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])  # (3, T, 3)
    parts = np.einsum("pi,kti->kpt", directions, edges, optimize=True)
    total = parts.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where((parts <= 0).all(axis=0) & (total < 0), volume / total, np.inf)
    z[z < NEAR_MM] = np.inf
    if not faces.size:
        nothing = np.zeros(len(directions))
        return Hits(nothing, nothing.astype(np.int64), np.zeros((len(directions), 3)))
    rows, nearest = np.arange(len(directions)), z.argmin(axis=1)
    depth = z[rows, nearest]
    hit = np.isfinite(depth)
    shares = np.zeros((len(directions), 3))
    shares[hit] = (parts[:, rows, nearest] / np.where(hit, total[rows, nearest], 1.0)).T[hit]
    return Hits(np.where(hit, depth, 0.0), faces[nearest], shares)


class NumpyDepthRenderer:
    """Draws poses one after the other (``rendering.port.DepthRenderer``)."""

    def __init__(self, mesh: SkinnedMesh, tile: tuple[int, int]) -> None:
        self.tile, self.bones, self._mesh = tile, mesh.weights.shape[1], mesh

    def depth(self, transforms: Float32Array, camera: Camera, window: Window) -> Float32Array:
        check_poses(self, transforms, window)
        directions = rays(camera, window).reshape(-1, 3)
        posed = self._mesh.posed(transforms.astype(np.float64))
        images = [first_hits(vertices, self._mesh.triangles, directions).depth for vertices in posed]
        return np.array(images, dtype=np.float32).reshape(-1, window.height, window.width)

    def sums(
        self, transforms: Float32Array, camera: Camera, window: Window, comparison: Comparison
    ) -> TileSums:
        check_observed(comparison.observed, window)
        depth = self.depth(transforms, camera, window)
        return sums_in_numpy(depth, comparison, window.step / camera.fx)


class NumpySurfaceRenderer:
    """Draws lit surfaces (``rendering.port.SurfaceRenderer``)."""

    def __init__(self, size: tuple[int, int], surfaces: list[Surface]) -> None:
        self._size, self._surfaces = size, list(surfaces)
        self._vertices = [np.zeros((len(surface.texcoords), 3)) for surface in surfaces]
        self._normals = [np.zeros((len(surface.texcoords), 3)) for surface in surfaces]

    def place(self, index: int, vertices: FloatArray, normals: FloatArray) -> None:
        self._vertices[index], self._normals[index] = np.array(vertices), np.array(normals)

    def paint(self, index: int, first: tuple[int, int], texels: ImageArray) -> None:
        row, column = first
        surface = self._surfaces[index]
        texture = surface.texture.copy()
        texture[row : row + len(texels), column : column + texels.shape[1]] = texels
        self._surfaces[index] = replace(surface, texture=texture)

    def image(self, camera: Camera, lighting: Lighting) -> Float32Array:
        transform = np.array(camera.camera_T_reference)
        window = Window(0, 0, 1, *self._size)
        directions = rays(camera, window).reshape(-1, 3)
        grey, nearest = np.zeros(len(directions)), np.full(len(directions), np.inf)
        eye = -transform[:, :3].T @ transform[:, 3]
        for surface, vertices, normals in zip(self._surfaces, self._vertices, self._normals, strict=True):
            hits = first_hits(vertices @ transform[:, :3].T + transform[:, 3], surface.triangles, directions)
            seen = (hits.depth > 0) & (hits.depth < nearest)
            corners, shares = surface.triangles[hits.triangle[seen]], hits.shares[seen]
            at, facing, texel = (
                np.einsum("pk,pkc->pc", shares, values[corners])
                for values in (vertices, normals, surface.texcoords)
            )
            grey[seen] = shade(_material(surface, texel), facing, eye - at, lighting)
            nearest[seen] = hits.depth[seen]
        return grey.astype(np.float32).reshape(window.height, window.width)

    def release(self) -> None:
        self._surfaces = []


def _material(surface: Surface, texel: FloatArray) -> FloatArray:
    """Reflectance and gloss (P, 2), 0 to 1, of the texels nearest to coordinates (P, 2)."""
    height, width = surface.texture.shape[:2]
    columns = np.clip(texel[:, 0] * width, 0, width - 1).astype(int)
    rows = np.clip(texel[:, 1] * height, 0, height - 1).astype(int)
    return surface.texture[rows, columns] / 255.0


def shade(material: FloatArray, facing: FloatArray, towards: FloatArray, lighting: Lighting) -> FloatArray:
    """Grey values (P,): Lambert's diffuse and Blinn's specular reflection; without a normal the material."""
    plain = np.einsum("pi,pi->p", facing, facing) < 1e-12
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    n = facing / np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-9)
    n = np.where(np.einsum("pi,pi->p", n, towards)[:, None] < 0.0, -n, n)
    diffuse = np.maximum(lighting.ambient + n @ lighting.from_above, 0.0)
    specular = np.zeros(len(n))
    for direction, strength in zip(lighting.directions, lighting.strengths, strict=True):
        lit, middle = n @ direction, direction + towards
        diffuse = diffuse + strength * np.maximum(lit, 0.0)
        half = np.einsum("pi,pi->p", n, middle / np.linalg.norm(middle, axis=1, keepdims=True))
        step = np.clip(lit / 0.2, 0.0, 1.0)
        specular += strength * np.maximum(half, 0.0) ** SHININESS * step * step * (3.0 - 2.0 * step)
    return np.where(plain, material[:, 0], material[:, 0] * diffuse + material[:, 1] * specular)


class NumpyDevice:
    """Needs no driver (``rendering.port.RenderingDevice``)."""

    info = RendererInfo("numpy", "tests", f"numpy {np.__version__}")

    def depth_renderer(
        self, mesh: SkinnedMesh, tile: tuple[int, int], most: int = MOST_TILES
    ) -> NumpyDepthRenderer:
        return NumpyDepthRenderer(mesh, tile)

    def surface_renderer(
        self, size: tuple[int, int], surfaces: list[Surface], lights: int
    ) -> NumpySurfaceRenderer:
        return NumpySurfaceRenderer(size, surfaces)

    def close(self) -> None:
        pass
