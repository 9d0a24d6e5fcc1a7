"""What is seen beside the head: ears, trunk, the wall behind, and an object that passes."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.rendering.port import Surface
from posetrack_cli.synthesis.head.identity import Looks
from posetrack_cli.synthesis.head.noise_fields import layered_field, smooth_field
from posetrack_cli.synthesis.head.skin_grid import grid_triangles

EAR_MIDDLE = np.array([72.0, -16.0, -88.0])
EAR_MM = np.array([7.0, 31.0, 17.0])
TRUNK_TOP_Y = -150.0
# height, half width, half depth, mm
_TRUNK = np.array(
    [
        (TRUNK_TOP_Y, 52.0, 46.0),
        (-160.0, 62.0, 54.0),
        (-170.0, 88.0, 64.0),
        (-185.0, 132.0, 76.0),
        (-212.0, 180.0, 90.0),
        (-265.0, 203.0, 104.0),
        (-420.0, 205.0, 112.0),
    ]
)
TRUNK_Z = -95.0
WALL_MM, WALL_BEHIND_MM = (4200.0, 3200.0), 1100.0


def ear_vertices(side: float) -> FloatArray:
    """Return the grid (13, 25, 3) of an ear, mm, head's frame; side 1 is the subject's left, -1 the right."""
    across = np.linspace(-np.pi, np.pi, 25)[None, :]
    down = np.linspace(0.5 * np.pi, -0.5 * np.pi, 13)[:, None]
    y, z = np.broadcast_arrays(np.sin(down), np.cos(down) * np.cos(across))
    x = np.cos(down) * np.sin(across)
    rim = 1.0 - 0.75 * np.exp(-0.5 * ((np.hypot(y, 1.3 * z)) / 0.45) ** 2)  # hollow in the middle
    ear = np.stack([x * rim, y, z - 0.2 * y], axis=-1) * EAR_MM
    ear[..., 0] += 0.3 * np.maximum(-ear[..., 2], 0.0)
    placed: FloatArray = (ear + EAR_MIDDLE) * [side, 1.0, 1.0]
    return placed


def ear_surface(looks: Looks, rng: np.random.Generator) -> Surface:
    """Return the texture of an ear: skin, darker in the middle."""
    rows, columns = 96, 192
    v, u = np.mgrid[0:rows, 0:columns]
    down, across = (v + 0.5) / rows * 2.0 - 1.0, (u + 0.5) / columns * 2.0 - 1.0
    outer = np.exp(-0.5 * ((np.abs(across) - 0.5) / 0.13) ** 2 - 0.5 * (down / 0.38) ** 2)
    tone = looks.skin * 0.9 * (1.0 - 0.45 * outer) * (1.0 + 0.06 * smooth_field((rows, columns), 6.0, rng))
    return grid_surface((13, 25), _two_channels(tone, 0.05))


def trunk_vertices() -> FloatArray:
    """Return the grid (20, 61, 3) of neck's base, shoulders and chest, mm, in the head's frame at rest."""
    heights = [*np.linspace(_TRUNK[0, 0], -250.0, 16).tolist(), -300.0, -340.0, -380.0, -420.0]
    profile = [np.interp(heights, _TRUNK[::-1, 0], _TRUNK[::-1, k]) for k in (1, 2)]
    phi = np.linspace(-np.pi, np.pi, 61)
    x = profile[0][:, None] * np.sin(phi)
    z = TRUNK_Z + profile[1][:, None] * np.cos(phi)
    y = np.broadcast_to(np.array(heights)[:, None], x.shape)
    return np.stack([x, y, z], axis=-1)


def trunk_surface(rng: np.random.Generator) -> Surface:
    """Return the cloth: woven, with stripes on some, a collar at its upper edge."""
    rows, columns = 512, 1024
    tone = rng.uniform(0.12, 0.6) * np.ones((rows, columns))
    tone *= 1.0 + 0.12 * layered_field((rows, columns), (40.0, 12.0, 4.0), rng)
    if rng.random() < 0.5:
        tone *= 1.0 + 0.25 * np.sign(np.sin(np.arange(rows) / rng.uniform(3.0, 7.0)))[:, None]
    tone *= 1.0 + 0.1 * rng.standard_normal((rows, columns))
    tone[: rows // 24] *= 0.6
    return grid_surface((20, 61), _two_channels(tone, 0.02))


def wall_vertices(distance_mm: float) -> FloatArray:
    """Return the grid (2, 2, 3) of a wall behind the head, mm, reference camera's axes."""
    half_x, half_y = WALL_MM[0] / 2.0, WALL_MM[1] / 2.0
    x, y = np.meshgrid([-half_x, half_x], [-half_y, half_y])
    return np.stack([x, y, np.full((2, 2), distance_mm + WALL_BEHIND_MM)], axis=-1)


def wall_surface(rng: np.random.Generator) -> Surface:
    """Return the wall: plaster, and pictures or shelves on it."""
    rows, columns = 768, 1024
    tone = rng.uniform(0.28, 0.6) * (1.0 + 0.10 * layered_field((rows, columns), (200.0, 60.0, 15.0), rng))
    for _ in range(int(rng.integers(5, 12))):
        row, column = int(rng.integers(0, rows - 60)), int(rng.integers(0, columns - 60))
        high, wide = int(rng.integers(30, 220)), int(rng.integers(25, 160))
        part = tone[row : row + high, column : column + wide]
        part[...] = rng.uniform(0.1, 0.75) * (1.0 + 0.15 * smooth_field(part.shape, 12.0, rng))
    return grid_surface((2, 2), _two_channels(tone, 0.0))


def object_vertices() -> FloatArray:
    """Return the grid (2, 2, 3) of the object that passes, a board, mm, about its own middle."""
    x, y = np.meshgrid([-48.0, 48.0], [-170.0, 170.0])
    return np.stack([x, y, np.zeros((2, 2))], axis=-1)


def object_surface(rng: np.random.Generator) -> Surface:
    """Return the object: printed in patches."""
    tone = 0.45 * (1.0 + 0.35 * layered_field((512, 160), (50.0, 15.0, 5.0), rng))
    return grid_surface((2, 2), _two_channels(tone, 0.05))


def grid_surface(shape: tuple[int, int], texture: ImageArray) -> Surface:
    """Return the surface of a grid of vertices that a texture covers from edge to edge."""
    rows, columns = shape
    v, u = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    return Surface(grid_triangles(rows, columns), np.stack([u, v], axis=-1).reshape(-1, 2), texture)


def _two_channels(tone: FloatArray | Float32Array, gloss: float) -> ImageArray:
    both = np.stack([np.clip(tone, 0.0, 1.0), np.full(tone.shape, gloss)], axis=-1)
    codes: ImageArray = np.rint(both * 255.0).astype(np.uint8)
    return codes
