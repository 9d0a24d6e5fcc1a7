"""What draws, as all layers above see it.

A `RenderingDevice` makes renderers. `rendering.gl` is one; another needs a folder of its own and a line in
`rendering.devices`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.errors import RenderingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.sums import Comparison, TileSums
from posetrack_cli.rendering.window import Window

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
        """Return the sums over the depth of N poses that ``sums.sums_in_numpy`` defines.

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
