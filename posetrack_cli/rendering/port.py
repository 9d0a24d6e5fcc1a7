"""Renderer interface: windows, sums over tiles, devices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.errors import RenderingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.pixel_model import PixelMixture, misfits_in_numpy

# Part of a camera's image shown by a tile, and its sampling


@dataclass(frozen=True)
class Window:
    """Grid of image pixels sampled by one tile: every ``step``-th in both directions.

    Tile pixel (i, j) shows image pixel (left + i step, top + j step). Both are rays through pixel centres,
    so nothing is blurred. The window may extend beyond the image.
    """

    left: int
    top: int
    step: int
    width: int
    height: int

    @classmethod
    def whole(cls, camera: Camera) -> Window:
        """Return the whole image, every pixel."""
        return cls(0, 0, 1, camera.width, camera.height)

    @classmethod
    def around(cls, pixel: FloatArray, size: int, step: int) -> Window:
        """Return a square of ``size`` tile pixels centred on an image pixel (2,)."""
        half = 0.5 * (size - 1) * step
        left, top = (round(float(p) - half) for p in pixel)
        return cls(left, top, step, size, size)

    @property
    def centre(self) -> FloatArray:
        """Image pixel (2,) at the centre."""
        half = 0.5 * self.step * np.array([self.width - 1, self.height - 1])
        return np.array([self.left, self.top]) + half

    def columns(self) -> IntArray:
        """Return image columns of the tile's columns, including those outside the image."""
        return self.left + self.step * np.arange(self.width)

    def rows(self) -> IntArray:
        """Return image rows of the tile's rows, including those outside the image."""
        return self.top + self.step * np.arange(self.height)

    def tile_projection(self, camera: Camera) -> tuple[float, float, float, float]:
        """Return (a, b, c, d): tile x = a X/Z + b, y = c Y/Z + d; pixel (0, 0) spans 0..1."""
        a, c = camera.fx / self.step, camera.fy / self.step
        b = (camera.cx - self.left) / self.step + 0.5
        d = (camera.cy - self.top) / self.step + 0.5
        return a, b, c, d


# Sums per tile computed on the device, and their numpy reference.
#
# With r the rendered pixels of a tile and o the target pixels of the observed image:
# the sum over r and o of min(|d - y|, c_max); |r and o|; |r \ o| with other readings, and how many of these
# are in front; |r \ o| without a reading; the sum of misfits; the number of matching pixels in r and o; the
# relief of o \ r. All costs, the papers' and ours, are functions of these and |o|.


class Comparison(NamedTuple):
    """Observed image, and parameters of the comparison with rendered depth.

    Attributes:
        observed: (h, w) float32: depth of target pixels, mm; negative for readings of other objects; 0 for
            none.
        clamp_mm: c_max of eq. (4).
        model: pixel model for the misfits; None for misfits of 0.
        match_mm: depths that differ by less match; 0 disables matching.
    """

    observed: Float32Array
    clamp_mm: float
    model: PixelMixture | None = None
    match_mm: float = 0.0


@dataclass(frozen=True)
class TileSums:
    """Sums over the pixels of each of N tiles.

    Attributes:
        error: (N,) sum of min(|d - y|, c_max) over pixels rendered and observed, mm.
        both: (N,) number of pixels rendered and observed.
        rendered_only: (N,) rendered, with a reading of another object.
        unread: (N,) rendered, without a reading.
        misfit: (N,) sum of the pixel model's rho over the rendered pixels; 0 without a model.
        occluded: (N,) pixels of ``rendered_only`` with the reading in front of the rendered surface.
        matched: (N,) pixels of ``both`` with |d - y| < ``match_mm``.
        relief: (N,) cost reduction of uncovered target pixels due to surfaces next to them; 0 without a
            model.
        observed: number of target pixels, equal for all tiles.
    """

    error: FloatArray
    both: FloatArray
    rendered_only: FloatArray
    unread: FloatArray
    misfit: FloatArray
    occluded: FloatArray
    matched: FloatArray
    relief: FloatArray
    observed: float

    @classmethod
    def from_rows(cls, rows: Float32Array | FloatArray, observed: float) -> TileSums:
        """Return the sums from the device's (N, 8) array."""
        error, both, rendered_only, unread, misfit, occluded, matched, relief = rows.astype(np.float64).T
        return cls(error, both, rendered_only, unread, misfit, occluded, matched, relief, observed)


def sums_in_numpy(depth: Float32Array, comparison: Comparison, slope: float = 0.0) -> TileSums:
    """Return the sums in plain numpy, as reference for the devices.

    Args:
        depth: (N, h, w) rendered depth, mm, 0 where empty.
        comparison: observation and comparison parameters.
        slope: width of a pixel, mm, per mm of depth, for the misfits.
    """
    observed, clamp_mm, model, match_mm = comparison
    r = depth > 0
    o, other, unread = observed > 0, observed < 0, observed == 0
    apart = np.abs(depth.astype(np.float64) - observed)
    error = np.minimum(apart, clamp_mm)
    nothing = np.zeros(len(depth))
    misfit, relief = (nothing, nothing) if model is None else misfits_in_numpy(depth, observed, model, slope)
    return TileSums(
        np.where(r & o, error, 0.0).sum(axis=(1, 2)),
        (r & o).sum(axis=(1, 2)).astype(np.float64),
        (r & other).sum(axis=(1, 2)).astype(np.float64),
        (r & unread).sum(axis=(1, 2)).astype(np.float64),
        misfit,
        (r & other & (-observed < depth)).sum(axis=(1, 2)).astype(np.float64),
        (r & o & (apart < match_mm)).sum(axis=(1, 2)).astype(np.float64),
        relief,
        float(o.sum()),
    )


# Interface of renderers.
#
# A ``RenderingDevice`` creates renderers. To add an implementation besides ``rendering.gl`` and
# ``rendering.cpu``, select it in ``rendering.devices``.

MOST_TILES = 512
"""Default maximum number of tiles per call of a depth renderer."""


@dataclass(frozen=True)
class RendererInfo:
    """Description of a device, for run records.

    Attributes:
        renderer: name of the hardware or library.
        vendor: its vendor.
        version: interface and version, e.g. ``OpenGL 4.5``.
    """

    renderer: str
    vendor: str
    version: str

    def __str__(self) -> str:
        return f"{self.renderer}, {self.version}"


@dataclass(frozen=True, eq=False)
class Surface:
    """Constant part of a textured surface.

    Attributes:
        triangles: (T, 3) vertex indices, counter-clockwise seen from outside; back faces are culled.
        texcoords: (V, 2) texture coordinates, 0 to 1; (0, 0) is the corner of the first texel.
        texture: (height, width, 2) uint8, reflectance and gloss.
    """

    triangles: IntArray
    texcoords: FloatArray
    texture: ImageArray


@dataclass(frozen=True, eq=False)
class Lighting:
    """Directional lights and ambient light.

    Attributes:
        directions: (L, 3) unit vectors towards the lights, reference axes.
        strengths: (L,) strengths of the lights.
        ambient: uniform ambient light.
        from_above: (3,) a, additional ambient light a . n for surface normals n.
    """

    directions: FloatArray
    strengths: FloatArray
    ambient: float
    from_above: FloatArray


class DepthRenderer(Protocol):
    """Renderer of one skinned mesh in N poses, each in its own tile."""

    @property
    def tile(self) -> tuple[int, int]:
        """(width, height) of a tile, pixels."""

    @property
    def bones(self) -> int:
        """Number of bones of a pose."""

    def depth(self, transforms: Float32Array, camera: Camera, window: Window) -> Float32Array:
        """Return the depth z of N poses, mm, (N, height, width); 0 where empty.

        Args:
            transforms: (N, B, 3, 4) camera_T_rest of every bone, mm.
            camera: pinhole intrinsics; lens distortion is ignored.
            window: window shown by the tiles.

        Raises:
            RenderingError: transforms or window do not fit.
        """

    def sums(
        self, transforms: Float32Array, camera: Camera, window: Window, comparison: Comparison
    ) -> TileSums:
        """Return the sums over the depth of N poses, as defined by ``sums_in_numpy``.

        Args:
            transforms: (N, B, 3, 4) rigid camera_T_rest of every bone, mm.
            camera: pinhole intrinsics.
            window: window shown by the tiles and the observed image.
            comparison: observed image and comparison parameters.

        Raises:
            RenderingError: transforms, window or observed image do not fit.
        """


class SurfaceRenderer(Protocol):
    """Renderer of textured, lit surfaces with moving vertices, seen by a grey camera."""

    def place(self, index: int, vertices: FloatArray, normals: FloatArray) -> None:
        """Move a surface: vertices (V, 3) mm and normals (V, 3); zero normals disable shading."""

    def paint(self, index: int, first: tuple[int, int], texels: ImageArray) -> None:
        """Replace texels (height, width, 2) of a surface's texture, from a first row and column.

        Coarser levels of the texture follow as far as powers of two divide the window's place and size.
        """

    def image(self, camera: Camera, lighting: Lighting) -> Float32Array:
        """Return the camera's image (height, width), reflectance times light; 0 where empty."""

    def release(self) -> None:
        """Release the device memory."""


class RenderingDevice(Protocol):
    """Factory of renderers, which are valid until it is closed."""

    @property
    def info(self) -> RendererInfo:
        """Description of the device."""

    def depth_renderer(
        self, mesh: SkinnedMesh, tile: tuple[int, int], most: int = MOST_TILES
    ) -> DepthRenderer:
        """Return a renderer of one mesh.

        Args:
            mesh: mesh shared by all poses.
            tile: (width, height) of a tile, pixels.
            most: usual maximum number of poses per call; more are allowed.

        Raises:
            RenderingError: the device cannot render such tiles, or has too little memory.
        """

    def surface_renderer(
        self, size: tuple[int, int], surfaces: list[Surface], lights: int
    ) -> SurfaceRenderer:
        """Return a renderer of grey images of (width, height) pixels.

        Args:
            size: size of the images.
            surfaces: surfaces to render; vertices and normals are in the recording's reference axes.
            lights: number of lights in ``Lighting``.

        Raises:
            RenderingError: the device cannot create the required objects.
        """

    def close(self) -> None:
        """Release all resources."""


def check_poses(renderer: DepthRenderer, transforms: Float32Array, window: Window) -> None:
    """Raise RenderingError unless bone transforms (N, B, 3, 4) and window fit a renderer."""
    if transforms.shape[1:] != (renderer.bones, 3, 4):
        raise RenderingError(
            "bone transforms do not fit the mesh",
            found=transforms.shape,
            expected=f"(N, {renderer.bones}, 3, 4)",
        )
    if (window.width, window.height) != renderer.tile:
        raise RenderingError(
            "window does not fit the tile", found=(window.width, window.height), expected=renderer.tile
        )


def check_observed(observed: Float32Array, window: Window) -> None:
    """Raise RenderingError unless an observed image fits a window."""
    expected = (window.height, window.width)
    if observed.shape != expected:
        raise RenderingError(
            "observed image does not fit the window", found=observed.shape, expected=expected
        )
