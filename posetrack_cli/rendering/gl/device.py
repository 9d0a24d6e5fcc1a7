"""Headless OpenGL rendering."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from typing import Any

import moderngl
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.errors import RenderingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.pixel_model import outline_distances
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
)

# Shader sources


def shader_source(name: str, defines: Mapping[str, int]) -> str:
    """Return a file of ``shaders`` with the defines inserted after its version line."""
    source = resources.files(__package__).joinpath("shaders", name).read_text(encoding="utf-8")
    version, rest = source.split("\n", 1)
    return "\n".join([version, *(f"#define {key} {value}" for key, value in defines.items()), rest])


# Textured, lit surfaces seen by a grey camera, for synthetic recordings

RANGE_MM = (50.0, 20000.0)
SAMPLES = 4
"""Samples per pixel for antialiased edges, if supported; surfaces use texture filtering."""
SHININESS = 24.0
FLOATS = 6  # per-frame floats of a vertex: position, normal


class TexturedRenderer:
    """Grey images of surfaces with moving vertices (``rendering.port.SurfaceRenderer``).

    Args:
        context: moderngl context.
        size: (width, height) of the images, pixels.
        surfaces: surfaces to render.
        lights: L, number of lights.

    Raises:
        RenderingError: the device cannot create the required objects.
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
            raise RenderingError("OpenGL resources cannot be created", found=found) from error
        self._program["image_size"], self._program["range_mm"] = size, RANGE_MM
        self._program["shininess"] = SHININESS

    def place(self, index: int, vertices: FloatArray, normals: FloatArray) -> None:
        """Move a surface: vertices (V, 3) mm and normals (V, 3); zero normals disable shading."""
        self._surfaces[index].place(vertices, normals)

    def paint(self, index: int, first: tuple[int, int], texels: ImageArray) -> None:
        """Replace texels (height, width, 2) of a surface's texture, from a first row and column."""
        self._surfaces[index].paint(first, texels)

    def image(self, camera: Camera, lighting: Lighting) -> Float32Array:
        """Return the camera's image (height, width), reflectance times light; 0 where empty."""
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
        self._context.front_face = "cw"  # image rows run upwards in OpenGL, which flips the winding
        self._context.enable_only(moderngl.CULL_FACE | moderngl.DEPTH_TEST)
        self._target.clear()
        for surface in self._surfaces:
            surface.draw()
        self._context.copy_framebuffer(self._resolved, self._target)

    def release(self) -> None:
        """Release the device memory."""
        for surface in self._surfaces:
            surface.release()
        for made in (self._target, self._resolved, self._program):
            made.release()


class _Drawn:
    """Surface on the device."""

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

    def paint(self, first: tuple[int, int], texels: ImageArray) -> None:
        (row, column), level = first, 0
        while texels.size:
            height, width = texels.shape[:2]
            self._texture.write(texels.tobytes(), (column, row, width, height), level=level, alignment=1)
            if (row | column | height | width) % 2:
                break
            quarters = texels.reshape(height // 2, 2, width // 2, 2, 2).mean(axis=(1, 3))
            texels = np.rint(quarters).astype(np.uint8)
            row, column, level = row // 2, column // 2, level + 1

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


# Depth of one skinned mesh in many poses at once, each in a tile of one depth texture


class BoneSpheres:
    """Bounding spheres of the vertices moved by each bone.

    A skinned vertex is a convex combination of its bones' transforms of it, so a posed mesh lies in the
    convex hull of the posed spheres, and its image in the bounding box of their images.

    Args:
        mesh: the mesh; bones without vertices have no sphere.
    """

    def __init__(self, mesh: SkinnedMesh) -> None:
        moved = mesh.weights > 0
        self._bones = np.flatnonzero(moved.any(axis=0))
        boxes = [mesh.vertices[moved[:, bone]] for bone in self._bones]
        centres = [0.5 * (points.min(axis=0) + points.max(axis=0)) for points in boxes]
        radii = [
            np.linalg.norm(points - centre, axis=1).max()
            for points, centre in zip(boxes, centres, strict=True)
        ]
        self._centres = np.concatenate([centres, np.ones((len(centres), 1))], axis=1).astype(np.float32)
        self._radii = np.array(radii, dtype=np.float32)

    def tile_boxes(
        self,
        transforms: Float32Array,
        projection: tuple[float, float, float, float],
        tile: tuple[int, int],
        near_mm: float,
    ) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
        """Return boxes (N, 4) of possibly covered pixels: first column and row, then one past the last.

        Args:
            transforms: (N, B, 3, 4) rigid camera_T_rest, mm.
            projection: result of ``Window.tile_projection``.
            tile: (width, height), pixels.
            near_mm: near clipping distance.
        """
        centres = np.einsum("nbij,bj->inb", transforms[:, self._bones], self._centres)
        scale_x, shift_x, scale_y, shift_y = projection
        across = self._extent(centres[0], centres[2], near_mm, scale_x, shift_x, tile[0])
        down = self._extent(centres[1], centres[2], near_mm, scale_y, shift_y, tile[1])
        return np.stack([across[0], down[0], across[1], down[1]], axis=1).astype(np.int32)

    def _extent(
        self, x: Float32Array, z: Float32Array, near_mm: float, scale: float, shift: float, size: int
    ) -> tuple[Float32Array, Float32Array]:
        """Return the first and one past the last pixel along one axis, (N,) each.

        Within a sphere, x / z is between (x - r) / z' and (x + r) / z', with z' the nearest or farthest
        depth, whichever is more extreme. The part nearer than near_mm is not rendered.
        """
        nearest, farthest = np.maximum(z - self._radii, near_mm), np.maximum(z + self._radii, near_mm)
        low, high = x - self._radii, x + self._radii
        first = (low / np.where(low < 0, nearest, farthest)).min(axis=1)
        last = (high / np.where(high > 0, nearest, farthest)).max(axis=1)
        return (
            np.clip(np.floor(scale * first + shift), 0, size),
            np.clip(np.ceil(scale * last + shift), 0, size),
        )


NEAR_MM = 50.0
# 32 MiB: large enough to keep a GPU busy, small enough for any device.
ATLAS_PIXELS = 512 * 128 * 128
LESS_HINT = "free GPU memory, or choose another device with --device (posetrack doctor lists them)"
ROW_FLOATS = 8  # two vec4 per tile, see TileSums.from_rows
LANES = 64  # work items per tile; 32 to 128 are equally fast on llvmpipe
_GL_CLIP_DISTANCE0 = 0x3000


class TiledDepthRenderer:
    """Depth images of one mesh in N poses, or sums over them (``rendering.port.DepthRenderer``).

    One instanced draw call renders up to ``capacity`` tiles; more tiles need several passes. Sums are
    reduced on the device, so that only ROW_FLOATS numbers per tile are read back.

    Args:
        context: moderngl context.
        mesh: mesh shared by all poses.
        tile: (width, height) of a tile, pixels.
        most: usual maximum number of poses per call; determines the atlas size.

    Raises:
        RenderingError: the device has too little memory, or cannot create the textures and programs.
    """

    def __init__(self, context: Any, mesh: SkinnedMesh, tile: tuple[int, int], most: int) -> None:
        self.context = context
        self.tile = tile
        self.bones = mesh.weights.shape[1]
        self.grid = _grid(context, tile, most)
        self.capacity = self.grid[0] * self.grid[1]
        self._spheres = BoneSpheres(mesh)
        try:
            self._make_targets()
            self._make_programs(mesh)
        except moderngl.Error as error:
            found = " ".join(str(error).split())
            raise RenderingError("OpenGL resources cannot be created", found=found, hint=LESS_HINT) from error

    def _make_targets(self) -> None:
        (width, height), (columns, rows) = self.tile, self.grid
        self._atlas = self.context.depth_texture((width * columns, height * rows))
        self._atlas.compare_func = ""  # sample depth values instead of comparison results
        self._atlas.filter = (self.context.NEAREST, self.context.NEAREST)
        self._framebuffer = self.context.framebuffer([], self._atlas)
        self._observed = self.context.texture((width, height), 2, dtype="f4")
        self._readings = np.zeros((height, width, 2), dtype=np.float32)
        self._observed.filter = (self.context.NEAREST, self.context.NEAREST)
        self._transforms = self.context.buffer(reserve=self.capacity * self.bones * 48, dynamic=True)
        self._boxes = self.context.buffer(reserve=self.capacity * 16, dynamic=True)
        self._sums = self.context.buffer(reserve=self.capacity * 4 * ROW_FLOATS, dynamic=True)
        self._rows = np.empty((self.capacity, ROW_FLOATS), dtype=np.float32)

    def _make_programs(self, mesh: SkinnedMesh) -> None:
        influences = _influences(mesh)
        names = {"BONES": self.bones, "INFLUENCES": influences.shape[1]}
        self._draw = self.context.program(
            vertex_shader=shader_source("skinned_depth.vert", names),
            fragment_shader=shader_source("depth_only.frag", {}),
        )
        rest = self.context.buffer(mesh.vertices.astype("f4").tobytes())
        index = self.context.buffer(mesh.triangles.astype("i4").tobytes())
        self._vertices = self.context.vertex_array(self._draw, [(rest, "3f", "rest")], index_buffer=index)
        self._influences = self.context.buffer(influences.tobytes())
        self._reducers = {mixture: self._reducer(mixture) for mixture in (False, True)}
        self._draw["tile_size"], self._draw["grid"] = self.tile, self.grid
        self._draw["near_mm"] = NEAR_MM

    def _reducer(self, mixture: bool) -> Any:
        """Return the program that sums over tiles, with or without a pixel model's misfits."""
        names = {"LANES": LANES, "MIXTURE": int(mixture)}
        program = self.context.compute_shader(shader_source("tile_sums.comp", names))
        program["tile_size"], program["columns"], program["near_mm"] = self.tile, self.grid[0], NEAR_MM
        return program

    def depth(self, transforms: Float32Array, camera: Camera, window: Window) -> Float32Array:
        """Render and read back depth."""
        check_poses(self, transforms, window)
        parts = []
        for part in self._passes(transforms, camera, window):
            values = np.frombuffer(self._atlas.read(), dtype=np.float32)
            parts.append(self._untiled(values)[: len(part)])
        inverse = np.concatenate(parts)
        drawn = inverse > 0
        return np.divide(NEAR_MM, inverse, out=np.zeros_like(inverse), where=drawn)

    def sums(
        self, transforms: Float32Array, camera: Camera, window: Window, comparison: Comparison
    ) -> TileSums:
        """Render and reduce on the device."""
        observed, clamp_mm, model, match_mm = comparison
        check_observed(observed, window)
        check_poses(self, transforms, window)  # before writing to the device
        self._readings[..., 0] = observed
        if model is not None:
            self._readings[..., 1] = outline_distances(observed)
        self._observed.write(self._readings)
        program = self._reducers[model is not None]
        uniforms = {} if model is None else {"slope": window.step / camera.fx, **model.uniforms}
        for name, value in {"clamp_mm": clamp_mm, "match_mm": match_mm, **uniforms}.items():
            program[name] = value
        rows = np.empty((len(transforms), ROW_FLOATS), dtype=np.float32)
        first = 0
        for part in self._passes(transforms, camera, window):
            boxes = self._spheres.tile_boxes(part, window.tile_projection(camera), self.tile, NEAR_MM)
            self._boxes.write(boxes)
            rows[first : first + len(part)] = self._reduced(program, len(part))
            first += len(part)
        return TileSums.from_rows(rows, float(np.count_nonzero(observed > 0)))

    def _reduced(self, program: Any, count: int) -> Float32Array:
        """Return the sums (count, ROW_FLOATS) of the rendered tiles."""
        self._atlas.use(0)
        self._observed.use(1)
        self._sums.bind_to_storage_buffer(1)
        self._boxes.bind_to_storage_buffer(3)
        program.run(count)
        self.context.memory_barrier()  # makes shader writes visible to the read
        self._sums.read_into(self._rows, size=count * 4 * ROW_FLOATS)
        return self._rows[:count]

    def _passes(self, transforms: Float32Array, camera: Camera, window: Window) -> Any:
        """Render the tiles in passes of up to ``capacity``; yield each part after rendering."""
        self._draw["to_tile"] = window.tile_projection(camera)
        for first in range(0, len(transforms), self.capacity):
            part = transforms[first : first + self.capacity]
            self._transforms.write(np.ascontiguousarray(part, dtype=np.float32))
            self._draw_tiles(len(part))
            yield part

    def _draw_tiles(self, count: int) -> None:
        gl = self.context
        gl.enable_only(gl.DEPTH_TEST | gl.CULL_FACE)
        gl.depth_func = ">"
        # Image rows run downwards and texture rows upwards, so front faces wind clockwise.
        gl.front_face, gl.cull_face = "cw", "back"
        for k in range(4):
            gl.enable_direct(_GL_CLIP_DISTANCE0 + k)
        self._framebuffer.use()
        self._framebuffer.clear(depth=0.0)
        self._transforms.bind_to_storage_buffer(0)
        self._influences.bind_to_storage_buffer(2)
        self._vertices.render(instances=count)

    def _untiled(self, values: Float32Array) -> Float32Array:
        (width, height), (columns, rows) = self.tile, self.grid
        atlas = values.reshape(rows, height, columns, width)
        return atlas.transpose(0, 2, 1, 3).reshape(rows * columns, height, width)


def _grid(context: Any, tile: tuple[int, int], most: int) -> tuple[int, int]:
    """Return columns and rows of tiles: as many as requested, within memory budget and texture limits."""
    width, height = tile
    largest = min(context.info["GL_MAX_TEXTURE_SIZE"], 16384)
    if max(width, height) > largest:
        raise RenderingError(
            "tile is too large for this GL", found=tile, expected=f"at most {largest} pixels"
        )
    count = max(1, min(most, ATLAS_PIXELS // (width * height)))
    square = np.log2(np.sqrt(count * height / width))
    columns = min(2 ** max(0, round(square + 0.49)), count, largest // width)
    return columns, min(-(-count // columns), largest // height)


def _influences(mesh: SkinnedMesh) -> Float32Array:
    """Return each vertex's bones and weights, heaviest first, (V, k, 2), k the maximum number of bones."""
    most = int((mesh.weights > 0).sum(axis=1).max())
    order = np.argsort(-mesh.weights, axis=1, kind="stable")[:, :most]
    weights = np.take_along_axis(mesh.weights, order, axis=1)
    return np.stack([order, weights], axis=-1).astype(np.float32)


# Headless OpenGL device

REQUIRED_GL = 430
INSTALL_HINT = (
    "install an OpenGL driver with EGL (Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri; "
    "NVIDIA: the driver's libEGL), then try: posetrack doctor"
)


class GlDevice:
    """Standalone moderngl context over EGL, OpenGL 4.3 or later (``rendering.port.RenderingDevice``).

    Args:
        index: index of the EGL device; None for the driver's default.

    Raises:
        RenderingError: no EGL, no such device, or OpenGL older than 4.3.
    """

    def __init__(self, index: int | None = None) -> None:
        self.context = _open_context(index)

    @property
    def info(self) -> RendererInfo:
        """Names reported by the driver."""
        names = self.context.info
        return RendererInfo(names["GL_RENDERER"], names["GL_VENDOR"], f"OpenGL {names['GL_VERSION']}")

    def depth_renderer(
        self, mesh: SkinnedMesh, tile: tuple[int, int], most: int = MOST_TILES
    ) -> TiledDepthRenderer:
        """Return a renderer of a mesh in up to ``most`` poses at once, in tiles of (width, height) pixels."""
        return TiledDepthRenderer(self.context, mesh, tile, most)

    def surface_renderer(
        self, size: tuple[int, int], surfaces: list[Surface], lights: int
    ) -> TexturedRenderer:
        """Return a renderer of lit surfaces in images of (width, height) pixels."""
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
