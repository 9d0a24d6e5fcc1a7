"""Draws textured, lit surfaces as a grey camera sees them; for synthetic recordings."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.errors import RenderingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.gl.shader_source import shader_source
from posetrack_cli.rendering.port import Lighting, Surface

RANGE_MM = (50.0, 20000.0)
SAMPLES = 4
"""Samples a pixel at edges, where the device has that many; inside a surface the texture's filter does."""
SHININESS = 24.0
FLOATS = 6  # of a vertex that change: position, normal


class TexturedRenderer:
    """Grey images of a fixed set of surfaces whose vertices move (``rendering.port.SurfaceRenderer``).

    Args:
        context: of moderngl.
        size: (width, height) of the images, pixels.
        surfaces: what is drawn.
        lights: L, the number of lights.

    Raises:
        RenderingError: the device cannot make what is needed.
    """

    def __init__(self, context: Any, size: tuple[int, int], surfaces: list[Surface], lights: int) -> None:
        self._context, self._size = context, size
        try:
            self._program = _program(context, lights)
            self._target = _framebuffer(context, size, min(SAMPLES, context.max_samples))
            self._resolved = _framebuffer(context, size, 0)
            self._surfaces = [_Drawn(context, self._program, surface) for surface in surfaces]
        except moderngl.Error as error:
            found = " ".join(str(error).split())
            raise RenderingError("OpenGL refuses what is drawn with", found=found) from error
        self._program["image_size"], self._program["range_mm"] = size, RANGE_MM
        self._program["shininess"] = SHININESS

    def place(self, index: int, vertices: FloatArray, normals: FloatArray) -> None:
        """Move a surface: vertices (V, 3) mm and normals (V, 3); a zero normal shows plain reflectance."""
        self._surfaces[index].place(vertices, normals)

    def image(self, camera: Camera, lighting: Lighting) -> Float32Array:
        """Return what a camera sees, (height, width), reflectance times light; 0 where there is nothing."""
        transform = np.array(camera.camera_T_reference)
        program = self._program
        program["camera_T_reference"] = tuple(transform.T.ravel().tolist())
        program["to_image"] = (camera.fx, camera.cx + 0.5, camera.fy, camera.cy + 0.5)
        program["eye"] = tuple((-transform[:, :3].T @ transform[:, 3]).tolist())
        lights = np.column_stack([lighting.directions, lighting.strengths]).astype("f4")
        program["light"].write(lights.tobytes())
        program["ambient"] = (*lighting.from_above.tolist(), lighting.ambient)
        self._draw()
        width, height = self._size
        values = np.frombuffer(self._resolved.read(components=1, dtype="f4"), dtype=np.float32)
        return values.reshape(height, width)

    def _draw(self) -> None:
        self._target.use()
        self._context.viewport = (0, 0, *self._size)
        self._context.front_face = "cw"  # rows of the image run upwards in OpenGL
        self._context.enable_only(moderngl.CULL_FACE | moderngl.DEPTH_TEST)
        self._target.clear()
        for surface in self._surfaces:
            surface.draw()
        self._context.copy_framebuffer(self._resolved, self._target)

    def release(self) -> None:
        """Give the device's memory back."""
        for surface in self._surfaces:
            surface.release()
        for made in (self._target, self._resolved, self._program):
            made.release()


class _Drawn:
    """A surface on the device."""

    def __init__(self, context: Any, program: Any, surface: Surface) -> None:
        height, width = surface.texture.shape[:2]
        texture = np.ascontiguousarray(surface.texture)
        self._texture = context.texture((width, height), 2, texture.tobytes(), alignment=1)
        self._texture.repeat_x = self._texture.repeat_y = False
        self._texture.build_mipmaps()
        self._texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        self._changing = np.zeros((len(surface.texcoords), FLOATS), dtype=np.float32)
        self._buffer = context.buffer(self._changing.tobytes(), dynamic=True)
        self._fixed = context.buffer(surface.texcoords.astype("f4").tobytes())
        self._index = context.buffer(surface.triangles.astype("i4").tobytes())
        content = [(self._buffer, "3f 3f", "position", "normal"), (self._fixed, "2f", "texcoord")]
        self._array = context.vertex_array(program, content, index_buffer=self._index)

    def place(self, vertices: FloatArray, normals: FloatArray) -> None:
        self._changing[:, :3], self._changing[:, 3:] = vertices, normals
        self._buffer.write(self._changing.tobytes())

    def draw(self) -> None:
        self._texture.use(0)
        self._array.render()

    def release(self) -> None:
        for made in (self._array, self._index, self._fixed, self._buffer, self._texture):
            made.release()


def _program(context: Any, lights: int) -> Any:
    sources = {name: shader_source(f"textured.{name}", {"LIGHTS": lights}) for name in ("vert", "frag")}
    return context.program(vertex_shader=sources["vert"], fragment_shader=sources["frag"])


def _framebuffer(context: Any, size: tuple[int, int], samples: int) -> Any:
    colour = context.renderbuffer(size, 1, samples=samples, dtype="f4")
    return context.framebuffer([colour], context.depth_renderbuffer(size, samples=samples))
