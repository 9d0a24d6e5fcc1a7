"""The headless OpenGL context."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from posetrack_cli.errors import RenderingError

REQUIRED_GL = 430
INSTALL_HINT = (
    "install an OpenGL driver with EGL (Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri; "
    "NVIDIA: the driver's libEGL), then try: posetrack doctor"
)


@dataclass(frozen=True)
class RendererInfo:
    """What draws: the driver's names."""

    renderer: str
    vendor: str
    version: str

    def __str__(self) -> str:
        return f"{self.renderer}, OpenGL {self.version}"


def open_context(device: int | None = None) -> Any:
    """Return a standalone moderngl context over EGL, OpenGL 4.3 or later.

    Args:
        device: EGL device index, None for the driver's default.

    Raises:
        RenderingError: no EGL, no such device, or an OpenGL older than 4.3.
    """
    import moderngl

    options: Any = {"backend": "egl"} if device is None else {"backend": "egl", "device_index": device}
    try:
        return moderngl.create_context(standalone=True, require=REQUIRED_GL, **options)
    except Exception as error:  # glcontext raises bare Exception for every failure
        where = "OpenGL" if device is None else f"OpenGL device {device}"
        raise RenderingError(
            "no headless context",
            where=where,
            found=str(error) or type(error).__name__,
            expected="EGL with OpenGL 4.3",
            hint=INSTALL_HINT,
        ) from error


def describe(context: Any) -> RendererInfo:
    """Return the driver's names of a context."""
    info = context.info
    return RendererInfo(info["GL_RENDERER"], info["GL_VENDOR"], info["GL_VERSION"])
