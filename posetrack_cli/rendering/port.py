"""What renderers offer: windows, sums over tiles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.errors import RenderingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.pixel_model import PixelMixture, misfits_in_numpy

# The part of a camera's image that a tile shows, and how finely


@dataclass(frozen=True)
class Window:
    """A grid of image pixels, every ``step``-th in both directions, that one tile samples.

    Tile pixel (i, j) shows image pixel (left + i step, top + j step): both are rays through pixel
    centres, so nothing is blurred. The window may reach over the image's edge.
    """

    left: int
    top: int
    step: int
    width: int
    height: int

    @classmethod
    def whole(cls, camera: Camera) -> Window:
        """The whole image, every pixel."""
        return cls(0, 0, 1, camera.width, camera.height)

    @classmethod
    def around(cls, pixel: FloatArray, size: int, step: int) -> Window:
        """A square of size tile pixels centred on an image pixel (2,)."""
        half = 0.5 * (size - 1) * step
        left, top = (round(float(p) - half) for p in pixel)
        return cls(left, top, step, size, size)

    @property
    def centre(self) -> FloatArray:
        """The image pixel (2,) in the middle."""
        half = 0.5 * self.step * np.array([self.width - 1, self.height - 1])
        return np.array([self.left, self.top]) + half

    def columns(self) -> IntArray:
        """Image columns of the tile's columns, also those outside the image."""
        return self.left + self.step * np.arange(self.width)

    def rows(self) -> IntArray:
        """Image rows of the tile's rows, also those outside the image."""
        return self.top + self.step * np.arange(self.height)

    def tile_projection(self, camera: Camera) -> tuple[float, float, float, float]:
        """(a, b, c, d): a point falls on tile x = a X/Z + b, y = c Y/Z + d; pixel (0, 0) spans 0..1."""
        a, c = camera.fx / self.step, camera.fy / self.step
        b = (camera.cx - self.left) / self.step + 0.5
        d = (camera.cy - self.top) / self.step + 0.5
        return a, b, c, d


# What the device hands back per tile, and the same sums in numpy.
#
# With r the pixels that a tile's rendering covers and o the target pixels of the observed image:
# the sum over r and o of min(|d - y|, c_max); |r and o|; |r \ o| where there is another reading, and how
# many of those readings are in front; |r \ o| where there is none; the sum of the readings' misfits; how many
# pixels of r and o agree; the relief of o \ r. Every cost of the papers and of ours is made of these and of
# |o|.


class Comparison(NamedTuple):
    """What rendered depth is compared with, and how.

    Attributes:
        observed: (h, w) float32: depth of a target pixel, mm; negative where the reading is of something
            else; 0 where there is none.
        clamp_mm: c_max of eq. (4).
        model: of a pixel, for the misfits; without one they are 0.
        match_mm: depths that differ by less agree; at 0 none do.
    """

    observed: Float32Array
    clamp_mm: float
    model: PixelMixture | None = None
    match_mm: float = 0.0


@dataclass(frozen=True)
class TileSums:
    """Sums over the pixels of each of N tiles.

    Attributes:
        error: (N,) sum of min(|d - y|, c_max) where both are, mm.
        both: (N,) number of pixels rendered and observed.
        rendered_only: (N,) rendered, but the reading there is not of the target.
        unread: (N,) rendered where the sensor has no reading.
        misfit: (N,) sum of rho of a pixel model over the rendered pixels; 0 where no model is given.
        occluded: (N,) those of ``rendered_only`` whose reading is in front of what is rendered.
        matched: (N,) those of ``both`` with |d - y| below the distance asked for; 0 where none is.
        relief: (N,) what the target pixels that nothing covers cost less because something beside them is
            covered; 0 where no model is given.
        observed: number of target pixels, the same for all tiles.
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
        """From the (N, 8) array that the device returns."""
        error, both, rendered_only, unread, misfit, occluded, matched, relief = rows.astype(np.float64).T
        return cls(error, both, rendered_only, unread, misfit, occluded, matched, relief, observed)


def sums_in_numpy(depth: Float32Array, comparison: Comparison, slope: float = 0.0) -> TileSums:
    """The reference for the device's sums.

    Args:
        depth: (N, h, w) rendered depth, mm, 0 where nothing is drawn.
        comparison: what it is compared with.
        slope: a pixel's width, mm, per mm of depth, for the misfits.
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


# What draws, as all layers above see it.
#
# A `RenderingDevice` makes renderers. `rendering.gl` is one; another needs a folder of its own and a line in
# `rendering.devices`.


MOST_TILES = 512
"""Tiles that a call asks a depth renderer for, unless said otherwise."""


@dataclass(frozen=True)
class RendererInfo:
    """What a device draws with, as results state it.

    Attributes:
        renderer: the hardware's or the library's name.
        vendor: who made it.
        version: interface and version, ``OpenGL 4.5``, say.
    """

    renderer: str
    vendor: str
    version: str

    def __str__(self) -> str:
        return f"{self.renderer}, {self.version}"


@dataclass(frozen=True, eq=False)
class Surface:
    """What does not change about a textured surface.

    Attributes:
        triangles: (T, 3) vertex indices, counter-clockwise seen from outside; from inside nothing is drawn.
        texcoords: (V, 2) place of each vertex in the texture, 0 to 1; (0, 0) is the first texel's corner.
        texture: (height, width, 2) uint8, reflectance and gloss.
    """

    triangles: IntArray
    texcoords: FloatArray
    texture: ImageArray


@dataclass(frozen=True, eq=False)
class Lighting:
    """Distant lights, and light from all sides.

    Attributes:
        directions: (L, 3) unit vectors towards the lights, reference axes.
        strengths: (L,) of the lights.
        ambient: from all sides.
        from_above: (3,) further ambient light a n of a surface with normal n.
    """

    directions: FloatArray
    strengths: FloatArray
    ambient: float
    from_above: FloatArray


class DepthRenderer(Protocol):
    """Draws one skinned mesh in N poses, each into a tile of its own."""

    @property
    def tile(self) -> tuple[int, int]:
        """(width, height) of a tile, pixels."""

    @property
    def bones(self) -> int:
        """How many bones a pose has."""

    def depth(self, transforms: Float32Array, camera: Camera, window: Window) -> Float32Array:
        """Return the depth z of N poses, mm, (N, height, width); 0 where nothing is drawn.

        Args:
            transforms: (N, B, 3, 4) camera_T_rest of every bone, mm.
            camera: pinhole intrinsics; lens distortion is the caller's matter.
            window: what the tiles show.

        Raises:
            RenderingError: transforms or window do not fit.
        """

    def sums(
        self, transforms: Float32Array, camera: Camera, window: Window, comparison: Comparison
    ) -> TileSums:
        """Return the sums over the depth of N poses that ``sums_in_numpy`` defines.

        Args:
            transforms: (N, B, 3, 4) rigid camera_T_rest of every bone, mm.
            camera: pinhole intrinsics.
            window: what the tiles and the observed image show.
            comparison: the observed image, and how depth is compared with it.

        Raises:
            RenderingError: transforms, window or observed image do not fit.
        """


class SurfaceRenderer(Protocol):
    """Draws textured, lit surfaces whose vertices move, as a grey camera sees them."""

    def place(self, index: int, vertices: FloatArray, normals: FloatArray) -> None:
        """Move a surface: vertices (V, 3) mm and normals (V, 3); a zero normal shows plain reflectance."""

    def image(self, camera: Camera, lighting: Lighting) -> Float32Array:
        """Return what a camera sees, (height, width), reflectance times light; 0 where there is nothing."""

    def release(self) -> None:
        """Give the device's memory back."""


class RenderingDevice(Protocol):
    """Makes renderers, which are of use until it is closed."""

    @property
    def info(self) -> RendererInfo:
        """What it draws with."""

    def depth_renderer(
        self, mesh: SkinnedMesh, tile: tuple[int, int], most: int = MOST_TILES
    ) -> DepthRenderer:
        """Return a renderer of one mesh.

        Args:
            mesh: the mesh that all poses share.
            tile: (width, height) of a tile, pixels.
            most: how many poses a call has at most, usually; more are allowed.

        Raises:
            RenderingError: the device cannot draw such tiles, or has too little memory.
        """

    def surface_renderer(
        self, size: tuple[int, int], surfaces: list[Surface], lights: int
    ) -> SurfaceRenderer:
        """Return a renderer of grey images of (width, height) pixels.

        Args:
            size: of the images.
            surfaces: what is drawn; their vertices and normals are given in the axes of the recording's
                reference camera.
            lights: how many directions a ``Lighting`` has.

        Raises:
            RenderingError: the device cannot make what is needed.
        """

    def close(self) -> None:
        """Release everything that it holds."""


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
