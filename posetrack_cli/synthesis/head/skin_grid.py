"""The grid of vertices that a head's skin is made of, and where each lies in the texture.

Rows go down from the skull's top to the neck, columns around the head from behind to behind. Between the lips
further rows lead into the mouth and back: a pocket that opens when the lips part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.synthesis.head.form import BOTTOM, MOUTH_X, MOUTH_Y, TOP, angle_of, smooth_head

POCKET_MM = 16.0
"""Depth of the pocket behind the lips."""
POCKET_ROWS = 9
POCKET_BAND = 20.0
"""Height of the pocket's part of the texture, in the texture's millimetres."""
TEXTURE_SIZE = (1536, 2048)
FRONT_DEG, FRONT_COLUMNS, BACK_COLUMNS = 82.0, 125, 30
# from level to level, mm, with a step
_LEVELS = (
    (TOP, 60.0, 6.0),
    (60.0, 40.0, 3.0),
    (40.0, -36.0, 1.6),
    (-36.0, -52.0, 1.0),
    (-52.0, MOUTH_Y, 1.4),
    (MOUTH_Y, -86.0, 1.4),
    (-86.0, -126.0, 2.2),
    (-126.0, BOTTOM, 8.0),
)


@dataclass(frozen=True, eq=False)
class SkinGrid:
    """R x C vertices.

    Attributes:
        places: (R, C, 3) on the smooth average head, mm.
        pocket: (R,) 0 outside the mouth; inside from 0 at the upper lip's edge to 1 at the lower's.
        inside: (R,) whether a row belongs to the pocket, its two edges left out.
        texcoords: (R, C, 2) in the texture, 0 to 1.
    """

    places: FloatArray
    pocket: FloatArray
    inside: BoolArray
    texcoords: FloatArray

    @property
    def triangles(self) -> IntArray:
        """(T, 3) vertex indices; vertices are counted row by row."""
        return grid_triangles(*self.places.shape[:2])


def skin_grid() -> SkinGrid:
    """Return the grid, the same for every head."""
    above, beneath = _levels(_LEVELS[:5]), _levels(_LEVELS[5:])
    pocket_rows = np.full(POCKET_ROWS, MOUTH_Y)
    levels = np.concatenate([above, pocket_rows, beneath])
    inside = np.zeros(len(levels), dtype=np.bool_)
    inside[len(above) : len(above) + POCKET_ROWS] = True
    pocket = np.zeros(len(levels))
    pocket[inside] = (np.arange(POCKET_ROWS) + 1.0) / (POCKET_ROWS + 1.0)
    pocket[len(above) + POCKET_ROWS :] = 1.0
    phi = _angles()
    places = smooth_head(phi[None, :], levels[:, None])
    texture_level = levels - POCKET_BAND * pocket
    span = TOP - BOTTOM + POCKET_BAND
    texcoords = np.stack(
        np.broadcast_arrays((phi[None, :] + np.pi) / (2.0 * np.pi), (TOP - texture_level[:, None]) / span),
        axis=-1,
    )
    return SkinGrid(places, pocket, inside, texcoords)


def texel_levels(rows: int) -> tuple[FloatArray, FloatArray]:
    """Return the level and the place in the pocket of every texture row: (rows,) twice."""
    span = TOP - BOTTOM + POCKET_BAND
    along = TOP - (np.arange(rows) + 0.5) / rows * span
    pocket = np.clip((MOUTH_Y - along) / POCKET_BAND, 0.0, 1.0)
    return along + POCKET_BAND * pocket, pocket


def texel_angles(columns: int) -> FloatArray:
    """Return the angle phi (columns,) of every texture column."""
    angles: FloatArray = ((np.arange(columns) + 0.5) / columns * 2.0 - 1.0) * np.pi
    return angles


def grid_triangles(rows: int, columns: int) -> IntArray:
    """Return two triangles (T, 3) a cell of a grid whose vertices are counted row by row."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    first = np.stack([a, c, b], axis=-1).reshape(-1, 3)
    second = np.stack([b, c, d], axis=-1).reshape(-1, 3)
    return np.concatenate([first, second]).astype(np.int64)


def grid_normals(vertices: FloatArray) -> FloatArray:
    """Return normals (R, C, 3) of a closed grid (R, C, 3), of any length: across times down.

    The first and the last column are the same line.
    """
    across = np.empty_like(vertices)
    across[:, 1:-1] = vertices[:, 2:] - vertices[:, :-2]
    across[:, 0] = across[:, -1] = vertices[:, 1] - vertices[:, -2]
    down = np.empty_like(vertices)
    down[1:-1] = vertices[2:] - vertices[:-2]
    down[0], down[-1] = vertices[1] - vertices[0], vertices[-1] - vertices[-2]
    normals: FloatArray = np.cross(down, across)
    return normals


def _levels(parts: tuple[tuple[float, float, float], ...]) -> FloatArray:
    """Levels from part to part, each beginning and end taken once, both ends of the whole included."""
    pieces = [
        np.linspace(start, end, max(round((start - end) / step), 1), endpoint=False)
        for start, end, step in parts
    ]
    return np.concatenate([*pieces, [parts[-1][1]]])


def _angles() -> FloatArray:
    """Columns from -pi to pi, dense in front; two of them run through the mouth's corners."""
    edge = np.radians(FRONT_DEG)
    front = np.linspace(-edge, edge, FRONT_COLUMNS)
    corner = float(angle_of(np.array(MOUTH_X), np.array(MOUTH_Y)))
    for wanted in (-corner, corner):
        front[np.argmin(np.abs(front - wanted))] = wanted
    back = np.linspace(edge, np.pi, BACK_COLUMNS // 2 + 1)[1:]
    return np.concatenate([-back[::-1], front, back])
