"""The processor as a device."""

from __future__ import annotations

import platform
from contextlib import ExitStack, closing

from posetrack_cli.rendering.cpu.tiled import CompiledDepthRenderer
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.port import MOST_TILES, RendererInfo, RenderingDevice, Surface, SurfaceRenderer


class CpuDevice:
    """Draws depth on the processor, compiled by numba (``rendering.port.RenderingDevice``).

    Textured surfaces are drawn by OpenGL, which is opened for them when the first is asked for.
    """

    def __init__(self) -> None:
        self._opened = ExitStack()
        self._gl: RenderingDevice | None = None

    @property
    def info(self) -> RendererInfo:
        """The processor's architecture, and what compiles for it."""
        import numba

        return RendererInfo(f"processor ({platform.machine()})", "posetrack", f"numba {numba.__version__}")

    def depth_renderer(
        self, mesh: SkinnedMesh, tile: tuple[int, int], most: int = MOST_TILES
    ) -> CompiledDepthRenderer:
        """Return what draws a mesh in tiles of (width, height) pixels, as many as are asked for."""
        return CompiledDepthRenderer(mesh, tile)

    def surface_renderer(
        self, size: tuple[int, int], surfaces: list[Surface], lights: int
    ) -> SurfaceRenderer:
        """Return what draws lit surfaces in images of (width, height) pixels."""
        from posetrack_cli.rendering.gl.device import GlDevice

        if self._gl is None:
            self._gl = self._opened.enter_context(closing(GlDevice()))
        return self._gl.surface_renderer(size, surfaces, lights)

    def close(self) -> None:
        """Release what was opened."""
        self._gl = None
        self._opened.close()
