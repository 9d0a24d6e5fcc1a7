"""Geometry of the head: profile, relief, vertex grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, IntArray
from posetrack_cli.head.face.points import MEAN_SHAPE

# Smooth steps, curves and fields


def smooth_step(s: FloatArray) -> FloatArray:
    """Return 3 s^2 - 2 s^3 of s (...) clipped to [0, 1]: from 0 to 1 with zero slope at both ends."""
    t = np.clip(s, 0.0, 1.0)
    step: FloatArray = t * t * (3.0 - 2.0 * t)
    return step


def smooth_field(
    shape: tuple[int, int], grain_px: float | tuple[float, float], rng: np.random.Generator
) -> Float32Array:
    """Return a random field (height, width) with mean 0, deviation 1 and blobs of about ``grain_px``.

    Args:
        shape: height and width.
        grain_px: spacing of the independent values that are interpolated; one value, or (rows, columns).
        rng: draws one number per grain.
    """
    down, across = grain_px if isinstance(grain_px, tuple) else (grain_px, grain_px)
    coarse = (int(np.ceil(shape[0] / down)) + 3, int(np.ceil(shape[1] / across)) + 3)
    values = rng.standard_normal(coarse, dtype=np.float32)
    size = (round(coarse[1] * across), round(coarse[0] * down))
    fine = cv2.resize(values, size, interpolation=cv2.INTER_CUBIC)[: shape[0], : shape[1]]
    fine -= fine.mean()
    field: Float32Array = fine / np.float32(max(float(fine.std()), 1e-6))
    return field


def layered_field(
    shape: tuple[int, int], grains_px: tuple[float, ...], rng: np.random.Generator
) -> Float32Array:
    """Return the sum of smooth fields of several grains, mean 0, deviation 1; coarse grains dominate."""
    total = np.zeros(shape, dtype=np.float32)
    for grain in grains_px:
        total += np.sqrt(np.float32(grain)) * smooth_field(shape, grain, rng)
    scaled: Float32Array = total / np.float32(max(float(total.std()), 1e-6))
    return scaled


class Displacements:
    """Field d(x) = sum_i w_i k(|x - x_i|) that interpolates given values and fades elsewhere.

    k(r) = (1 + s) exp(-s), s = sqrt(3) r / reach: Matern kernel of smoothness 3/2. It overshoots less than
    a Gaussian between close places.

    Args:
        places: (n, D) distinct places.
        values: (n, C) of the field there.
        reach: length over which it fades.
    """

    def __init__(self, places: FloatArray, values: FloatArray, reach: float) -> None:
        self._places, self._reach = places, reach
        self._weights = np.linalg.solve(self._kernel(places), values)

    def __call__(self, at: FloatArray) -> FloatArray:
        """Return the field (..., C) at places (..., D)."""
        flat = at.reshape(-1, at.shape[-1])
        values: FloatArray = self._kernel(flat) @ self._weights
        return values.reshape(*at.shape[:-1], -1)

    def _kernel(self, at: FloatArray) -> FloatArray:
        distance = np.linalg.norm(at[:, None, :] - self._places[None, :, :], axis=-1)
        s = np.sqrt(3.0) / self._reach * distance
        kernel: FloatArray = (1.0 + s) * np.exp(-s)
        return kernel


MINIMUM_JERK_PEAK = 1.875
"""Maximum speed of a minimum-jerk move of length 1 in time 1."""


def minimum_jerk(s: FloatArray) -> FloatArray:
    """Return 10 s^3 - 15 s^4 + 6 s^5 of s (...) clipped to [0, 1]: from 0 to 1, at rest at both ends."""
    s = np.clip(s, 0.0, 1.0)
    # The hand version computes the cube as s * s * s, which differs in the last bit; sharing one version
    # would change the bytes of existing seeds.
    step: FloatArray = s**3 * (10.0 + s * (6.0 * s - 15.0))
    return step


def pulse(times: FloatArray, start: float, rise: float, hold: float, fall: float) -> FloatArray:
    """Return a pulse (T,) of height 1 that begins at ``start``; rise, hold and fall in seconds."""
    down = minimum_jerk((times - start - rise - hold) / fall)
    return minimum_jerk((times - start) / rise) - down


@dataclass(frozen=True, eq=False)
class Sway:
    """D sums of sines: x_d(t) = sum_k a_dk sin(2 pi f_dk t + p_dk).

    Attributes:
        amplitude, frequency, phase: (D, n), the frequency in Hz.
    """

    amplitude: FloatArray
    frequency: FloatArray
    phase: FloatArray

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return values (T, D) at times (T,), s."""
        angle = 2.0 * np.pi * self.frequency * times[:, None, None] + self.phase
        values: FloatArray = np.sum(self.amplitude * np.sin(angle), axis=-1)
        return values


def random_sway(
    most: FloatArray, frequencies: tuple[float, float], rng: np.random.Generator, sines: int = 2
) -> Sway:
    """Draw sums of sines within ``most`` (D,), with frequencies from an interval, Hz."""
    size = (len(most), sines)
    share = rng.uniform(0.5, 1.0, size)
    share /= share.sum(axis=1, keepdims=True)
    return Sway(most[:, None] * share, rng.uniform(*frequencies, size), rng.uniform(0.0, 2.0 * np.pi, size))


# Surface of an average head with face and eyelids, in coordinates shared by all heads.
#
# Surface coordinates are the angle phi about the vertical axis (0 in front, positive to the subject's left)
# and a level, which is the height y up to the forehead and arc length along the skull above. Texture and
# deformation are defined in the average head's x and y, seen from the front.

AXIS_Z = -82.0
"""Depth of the vertical axis, mm: between the ears."""
DOME, DOME_RADIUS = 60.0, 62.0
TOP, BOTTOM = DOME + DOME_RADIUS * np.pi / 2.0, -210.0
"""Levels of the top of the skull and of the lower end of the neck, mm."""
MOUTH_Y = -68.7
"""Height of the line between the lips."""
MOUTH_X = 25.4
"""Half the distance between the corners of the mouth."""

# level: half width, front, back, mm; then the exponent of the front (pointedness)
_PROFILE = np.array(
    [
        (-210.0, 56.0, -24.0, -136.0, 1.0),
        (-160.0, 49.0, -34.0, -132.0, 1.0),
        (-138.0, 47.0, -39.0, -130.0, 1.0),
        (-127.0, 47.0, -31.0, -130.0, 1.1),
        (-120.0, 48.0, -11.0, -131.0, 1.35),
        (-114.0, 50.0, 5.0, -132.0, 1.5),
        (-105.0, 53.0, 12.5, -135.0, 1.5),
        (-92.0, 57.0, 11.0, -140.0, 1.35),
        (-70.0, 62.5, 15.0, -150.0, 1.15),
        (-50.0, 67.0, 17.0, -162.0, 1.05),
        (-25.0, 71.0, 14.0, -172.0, 1.0),
        (0.0, 73.0, 9.0, -180.0, 1.0),
        (25.0, 73.0, 19.0, -185.0, 1.0),
        (45.0, 72.5, 21.0, -186.0, 1.0),
        (DOME, 71.0, 19.5, -185.0, 1.0),
    ]
)

INNER, OUTER = MEAN_SHAPE[2, :2], MEAN_SHAPE[3, :2]
"""Corners of the left eye."""
LENGTH = float(np.linalg.norm(OUTER - INNER))

# forward displacement, mm; x (both sides), y of the centre; horizontal and vertical spread, mm
_BUMPS = (
    (-6.5, 30.0, 6.0, 13.0, 9.0),  # eye sockets
    (-3.5, 15.0, 3.0, 4.5, 8.0),  # sides of the nasal root
    (4.0, 31.0, -0.5, 9.5, 6.0),  # eyeballs
    (3.5, 26.0, 24.0, 17.0, 6.0),  # brow ridges
    (5.5, 45.0, -26.0, 15.0, 13.0),  # cheekbones
    (-3.0, 46.0, -62.0, 13.0, 16.0),  # hollow of the cheeks
    (3.0, 33.0, -58.0, 7.0, 10.0),  # next to the nasolabial folds
    (-2.0, 27.5, -56.0, 3.5, 9.0),  # nasolabial folds
    (-3.0, 0.0, -86.0, 13.0, 5.0),  # under the lower lip
    (4.0, 0.0, -104.0, 13.0, 9.0),  # chin
    (-2.5, 56.0, 22.0, 9.0, 16.0),  # temples
)
_NOSE_Y = np.array([14.0, 8.0, 2.0, -8.0, -20.0, -31.0, -37.0, -41.0, -44.5, -48.0, -52.0])
_NOSE_MM = np.array([0.0, 1.0, 3.5, 9.0, 16.0, 23.0, 25.0, 22.5, 15.0, 5.5, 0.0])
_NOSE_WIDTH = np.array([5.5, 5.5, 5.5, 6.0, 6.8, 8.0, 8.8, 9.2, 9.0, 8.5, 8.5])
_WINGS = (9.0, 12.0, -41.0, 4.6, 4.6)


def height(level: FloatArray) -> FloatArray:
    """Return the height y (...), mm, of a level."""
    over = np.clip((level - DOME) / DOME_RADIUS, 0.0, np.pi / 2.0)
    return np.minimum(level, DOME) + DOME_RADIUS * np.sin(over)


def half_width(level: FloatArray) -> FloatArray:
    """Return half the width (...), mm, of the head at a level."""
    return _profile(level)[0]


def smooth_head(phi: FloatArray, level: FloatArray) -> FloatArray:
    """Return points (..., 3), mm, of the head without facial relief: stacked superellipses.

    x = w sin phi; in front z = z_a + (front - z_a) cos^p phi, behind z_a - (z_a - back) |cos phi|.
    """
    width, front, back, point = _profile(level)
    cosine = np.cos(phi)
    before = AXIS_Z + (front - AXIS_Z) * np.maximum(cosine, 0.0) ** point
    behind = AXIS_Z + (AXIS_Z - back) * np.minimum(cosine, 0.0)
    z = np.where(cosine > 0.0, before, behind)
    return np.stack(np.broadcast_arrays(width * np.sin(phi), height(level), z), axis=-1)


def angle_of(x: FloatArray, level: FloatArray) -> FloatArray:
    """Return the angle phi, rad, of a frontal point with this x, mm."""
    angle: FloatArray = np.arcsin(np.clip(x / half_width(level), -1.0, 1.0))
    return angle


def on_smooth_head(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return points (..., 3), mm, of the smooth head's front at x and y."""
    return smooth_head(angle_of(x, y), y)


def _profile(level: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    from scipy.interpolate import PchipInterpolator

    below = PchipInterpolator(_PROFILE[:, 0], _PROFILE[:, 1:])(np.clip(level, BOTTOM, DOME))
    over = np.cos(np.clip((level - DOME) / DOME_RADIUS, 0.0, np.pi / 2.0))
    width, front, back, point = np.moveaxis(below, -1, 0)
    return width * over, AXIS_Z + (front - AXIS_Z) * over, AXIS_Z + (back - AXIS_Z) * over, point


def along_and_above(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return eye coordinates: s, 0 at the inner and 1 at the outer corner, and mm above their line.

    Args:
        x, y: (...) mm; the right eye is mirrored to the left one.
    """
    axis = (OUTER - INNER) / LENGTH
    dx, dy = np.abs(x) - INNER[0], y - INNER[1]
    return (dx * axis[0] + dy * axis[1]) / LENGTH, dy * axis[0] - dx * axis[1]


def eye_places(s: FloatArray, above: FloatArray, side: float) -> tuple[FloatArray, FloatArray]:
    """Return x and y (...), mm, of eye coordinates; side 1 is the subject's left, -1 right."""
    axis = (OUTER - INNER) / LENGTH
    along = LENGTH * s
    x = INNER[0] + along * axis[0] - above * axis[1]
    return side * x, INNER[1] + along * axis[1] + above * axis[0]


EYE_MIDDLE = np.array(eye_places(np.array(0.5), np.array(1.1), 1.0))
"""Place of the left pupil of an eye that looks ahead."""


class LidPlaces(NamedTuple):
    """Eye coordinates of points, and the lids there.

    Attributes:
        s: (...) 0 at the inner corner, 1 at the outer.
        above: (...) mm above the line between the corners.
        top, bottom: (...) edges of the upper and lower lid, in the same unit.
    """

    s: FloatArray
    above: FloatArray
    top: FloatArray
    bottom: FloatArray


def upper_edge(s: FloatArray, most: float) -> FloatArray:
    """Return the height (...) of the upper lid's edge, mm above the line of the corners; 0 beyond them."""
    inside = np.clip(s, 0.0, 1.0)
    edge: FloatArray = most * (4.0 * inside * (1.0 - inside)) ** 0.75 * (1.06 - 0.12 * inside)
    return edge


def lower_edge(s: FloatArray, most: float) -> FloatArray:
    """Return the height (...) of the lower lid's edge, mm, negative."""
    inside = np.clip(s, 0.0, 1.0)
    edge: FloatArray = -most * (4.0 * inside * (1.0 - inside)) ** 0.85 * (0.92 + 0.16 * inside)
    return edge


@dataclass(frozen=True)
class Relief:
    """Facial relief relative to the average face, where no landmark determines it.

    Attributes:
        nose: factor on the nose's prominence.
        nose_width: factor on the nose's width.
        lips: factor on the lips' fullness.
        bones: factor on cheeks, brow ridges and chin.
    """

    nose: float = 1.0
    nose_width: float = 1.0
    lips: float = 1.0
    bones: float = 1.0


def forward(x: FloatArray, y: FloatArray, relief: Relief) -> FloatArray:
    """Return the relief (...), mm along z, at places of the average head."""
    total = sum((_pair(x, y, bump) for bump in _BUMPS), start=np.zeros(np.shape(x))) * relief.bones
    return total + relief.nose * _nose(x / relief.nose_width, y) + relief.lips * _lips(x, y)


def _pair(x: FloatArray, y: FloatArray, bump: tuple[float, ...]) -> FloatArray:
    size, middle, up, across, down = bump
    vertical = np.exp(-0.5 * ((y - up) / down) ** 2)
    sides = np.exp(-0.5 * ((np.abs(x) - middle) / across) ** 2)
    both: FloatArray = size * vertical * sides
    return both


def _nose(x: FloatArray, y: FloatArray) -> FloatArray:
    from scipy.interpolate import PchipInterpolator

    where = np.clip(y, _NOSE_Y[-1], _NOSE_Y[0])
    ridge = PchipInterpolator(_NOSE_Y[::-1], _NOSE_MM[::-1])(where)
    width = np.interp(where, _NOSE_Y[::-1], _NOSE_WIDTH[::-1])
    across = np.exp(-0.5 * np.abs(x / width) ** 2.4)
    nose: FloatArray = ridge * across + _pair(x, y, _WINGS)
    return nose


def _lips(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return two rolls that meet in a crease; the upper one has a philtrum."""
    along = np.sqrt(np.clip(1.0 - (x / 27.0) ** 2, 0.0, None))
    up = y - MOUTH_Y
    upper = 7.0 * np.exp(-0.5 * ((up - 3.6) / 3.6) ** 2)
    lower = 8.0 * np.exp(-0.5 * ((up + 4.6) / 4.2) ** 2)
    crease = -4.5 * np.exp(-0.5 * (up / 1.3) ** 2)
    hollow = -1.2 * np.exp(-0.5 * (x / 2.6) ** 2 - 0.5 * ((up - 11.0) / 6.0) ** 2)
    lips: FloatArray = along * (upper + lower + crease) + hollow
    return lips


# Vertex grid of the skin, and its texture coordinates.
#
# Rows run from the top of the skull down to the neck, columns around the head starting at the back.
# Additional rows between the lips form a pocket that opens with the mouth.

POCKET_MM = 16.0
"""Depth of the pocket behind the lips."""
POCKET_ROWS = 9
POCKET_BAND = 20.0
"""Height of the pocket in the texture, in texture millimetres."""
TEXTURE_SIZE = (1536, 2048)
FRONT_DEG, FRONT_COLUMNS, BACK_COLUMNS = 82.0, 125, 30
# start level, end level, step, mm
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
        pocket: (R,) position in the mouth's pocket, from 0 at the upper lip's edge to 1 at the lower's.
        inside: (R,) whether a row is inside the pocket, without its two edges.
        texcoords: (R, C, 2) texture coordinates, 0 to 1.
    """

    places: FloatArray
    pocket: FloatArray
    inside: BoolArray
    texcoords: FloatArray

    @property
    def triangles(self) -> IntArray:
        """(T, 3) vertex indices; vertices are numbered row by row."""
        return grid_triangles(*self.places.shape[:2])


def skin_grid() -> SkinGrid:
    """Return the grid, which is the same for all heads."""
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
    """Return level and pocket position of every texture row, (rows,) each."""
    span = TOP - BOTTOM + POCKET_BAND
    along = TOP - (np.arange(rows) + 0.5) / rows * span
    pocket = np.clip((MOUTH_Y - along) / POCKET_BAND, 0.0, 1.0)
    return along + POCKET_BAND * pocket, pocket


def texel_angles(columns: int) -> FloatArray:
    """Return the angle phi (columns,) of every texture column."""
    angles: FloatArray = ((np.arange(columns) + 0.5) / columns * 2.0 - 1.0) * np.pi
    return angles


def grid_triangles(rows: int, columns: int) -> IntArray:
    """Return two triangles per cell, (T, 3), of a grid with vertices numbered row by row."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    first = np.stack([a, c, b], axis=-1).reshape(-1, 3)
    second = np.stack([b, c, d], axis=-1).reshape(-1, 3)
    return np.concatenate([first, second]).astype(np.int64)


def grid_normals(vertices: FloatArray) -> FloatArray:
    """Return unnormalised normals (R, C, 3) of a closed grid (R, C, 3): across times down.

    The first and the last column coincide.
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
    """Return the levels of consecutive parts without duplicates, including both ends."""
    pieces = [
        np.linspace(start, end, max(round((start - end) / step), 1), endpoint=False)
        for start, end, step in parts
    ]
    return np.concatenate([*pieces, [parts[-1][1]]])


def _angles() -> FloatArray:
    """Return the columns from -pi to pi, dense in front, two of them through the corners of the mouth."""
    edge = np.radians(FRONT_DEG)
    front = np.linspace(-edge, edge, FRONT_COLUMNS)
    corner = float(angle_of(np.array(MOUTH_X), np.array(MOUTH_Y)))
    for wanted in (-corner, corner):
        front[np.argmin(np.abs(front - wanted))] = wanted
    back = np.linspace(edge, np.pi, BACK_COLUMNS // 2 + 1)[1:]
    return np.concatenate([-back[::-1], front, back])
