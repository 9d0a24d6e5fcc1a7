"""The headless OpenGL device."""

from __future__ import annotations

from typing import Any

from posetrack_cli.errors import RenderingError
from posetrack_cli.rendering.gl.textured import TexturedRenderer
from posetrack_cli.rendering.gl.tiled import TiledDepthRenderer
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.port import MOST_TILES, RendererInfo, Surface

REQUIRED_GL = 430
INSTALL_HINT = (
    "install an OpenGL driver with EGL (Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri; "
    "NVIDIA: the driver's libEGL), then try: posetrack doctor"
)


class GlDevice:
    """A standalone moderngl context over EGL, OpenGL 4.3 or later (``rendering.port.RenderingDevice``).

    Args:
        index: of the EGL device, None for the driver's default.

    Raises:
        RenderingError: no EGL, no such device, or an OpenGL older than 4.3.
    """

    def __init__(self, index: int | None = None) -> None:
        self.context = _open_context(index)

    @property
    def info(self) -> RendererInfo:
        """The driver's names."""
        names = self.context.info
        return RendererInfo(names["GL_RENDERER"], names["GL_VENDOR"], f"OpenGL {names['GL_VERSION']}")

    def depth_renderer(
        self, mesh: SkinnedMesh, tile: tuple[int, int], most: int = MOST_TILES
    ) -> TiledDepthRenderer:
        """Return what draws a mesh in up to ``most`` poses at once, in tiles of (width, height) pixels."""
        return TiledDepthRenderer(self.context, mesh, tile, most)

    def surface_renderer(
        self, size: tuple[int, int], surfaces: list[Surface], lights: int
    ) -> TexturedRenderer:
        """Return what draws lit surfaces in images of (width, height) pixels."""
        return TexturedRenderer(self.context, size, surfaces, lights)

    def close(self) -> None:
        """Release the context."""
        self.context.release()


def _open_context(index: int | None) -> Any:
    import moderngl

    options: Any = {"backend": "egl"} if index is None else {"backend": "egl", "device_index": index}
    try:
        return moderngl.create_context(standalone=True, require=REQUIRED_GL, **options)
    except Exception as error:  # glcontext raises bare Exception for every failure
        where = "OpenGL" if index is None else f"OpenGL device {index}"
        raise RenderingError(
            "no headless context",
            where=where,
            found=str(error) or type(error).__name__,
            expected="EGL with OpenGL 4.3",
            hint=INSTALL_HINT,
        ) from error
