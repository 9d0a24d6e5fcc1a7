"""Template of the skin of a hand for registration: a closed cage over palm and five fingers.

The palm is a tube of 18-sided rings from the wrist to the knuckles. At the front, the last ring and three
webs between the fingers form four hexagons, the bases of the fingers. The thumb starts from a hexagonal hole
in the side of the palm. Every finger is a hexagonal tube.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.hand.model.anatomy import BONE_COUNT, HandAnatomy, rest_rotations
from posetrack_cli.rendering.mesh import SkinnedMesh

# Buryanov and Kotiuk 2010, mm: metacarpal, then the three moving segments out to the tip of the skin.
_METACARPAL = np.array([68.1, 64.6, 58.0, 53.7])
# (5, 3) of an adult hand, thumb first
SEGMENTS: FloatArray = np.array(
    [
        (46.2, 31.6, 21.7 + 5.7),  # thumb: metacarpal, proximal, distal with soft tip
        (39.8, 22.4, 15.8 + 3.8),
        (44.6, 26.3, 17.4 + 4.0),
        (41.4, 25.7, 17.3 + 4.0),
        (32.6, 18.1, 16.0 + 3.7),
    ]
)
# Not in that table: the start of each metacarpal, mm, and its direction, deg.
_CARPAL = np.array([(11.0, -19.0, 1.0), (2.0, -25.0, 2.0), (-7.0, -23.0, 1.0), (-14.0, -20.0, -2.0)])
_METACARPAL_FAN = np.deg2rad([10.0, 1.0, -9.0, -20.0])
# (3,) base of the thumb at the trapezium of an adult hand, hand coordinates, mm
THUMB_BASE: FloatArray = np.array([19.0, -18.0, -8.0])
_RADII = np.array(
    [
        (12.5, 10.5, 9.8, 8.0),  # thumb: at CMC side, MCP, IP, near the tip
        (10.0, 8.6, 7.6, 6.4),  # index: at MCP, PIP, DIP, near the tip
        (10.0, 8.6, 7.6, 6.4),
        (9.6, 8.3, 7.3, 6.2),
        (8.2, 7.2, 6.5, 5.6),
    ]
)
# Palm rings: position from wrist (0) to knuckles (1), half thickness in mm, factor on the half width.
_ROWS = ((0.0, 18.0, 0.80), (0.20, 17.5, 0.86), (0.66, 15.0, 0.98))
_THUMB_ROWS = (1, 2)  # the thumb's hole lies between these rings
_WRIST_HALF_WIDTH = 31.0
_WRIST_END, _CAP = 8.0, 5.0  # end of the mesh behind the wrist joint, and length of the cap behind it, mm
_COLUMNS = 18  # 8 dorsal, little finger side, 8 palmar, index finger side
_LITTLE_SIDE, _INDEX_SIDE = 8, 17


class _Builder:
    """Collects vertices, weights and triangles."""

    def __init__(self) -> None:
        self.vertices: list[FloatArray] = []
        self.weights: list[FloatArray] = []
        self.faces: list[tuple[int, ...]] = []

    def vertex(self, position: FloatArray, weights: dict[int, float]) -> int:
        """Add a vertex and return its index."""
        row = np.zeros(BONE_COUNT)
        for bone, weight in weights.items():
            row[bone] += weight
        self.vertices.append(np.asarray(position, dtype=np.float64))
        self.weights.append(row / row.sum())
        return len(self.vertices) - 1

    def quad(self, a: int, b: int, c: int, d: int) -> None:
        """Add two triangles that share the shorter diagonal."""
        self.faces.append((a, b, c, d))

    def triangle(self, a: int, b: int, c: int) -> None:
        """Add a triangle."""
        self.faces.append((a, b, c))

    def tube(self, near: list[int], far: list[int]) -> None:
        """Connect two rings, which run clockwise seen from the far side."""
        count = len(near)
        for k in range(count):
            m = (k + 1) % count
            self.quad(near[k], near[m], far[m], far[k])

    def fan(self, ring: list[int], apex: int) -> None:
        """Close a ring with a point."""
        for k in range(len(ring)):
            self.triangle(ring[k], ring[(k + 1) % len(ring)], apex)

    def build(self) -> SkinnedMesh:
        """Return the mesh."""
        triangles: list[tuple[int, ...]] = []
        for face in self.faces:
            if len(face) == 3:
                triangles.append(face)
                continue
            a, b, c, d = face
            p, q, r, t = (self.vertices[k] for k in face)
            if np.linalg.norm(p - r) <= np.linalg.norm(q - t):
                triangles += [(a, b, c), (a, c, d)]
            else:
                triangles += [(a, b, d), (b, c, d)]
        return SkinnedMesh(
            np.array(self.vertices), np.array(self.weights), np.array(triangles, dtype=np.int64)
        )


@functools.cache
def adult() -> HandAnatomy:
    """Return the bones of a right hand of scale 1 according to the tables."""
    along = np.stack([np.sin(_METACARPAL_FAN), -np.cos(_METACARPAL_FAN), np.zeros(4)], axis=1)
    positions = np.vstack([THUMB_BASE, _CARPAL + _METACARPAL[:, None] * along])
    return HandAnatomy("right", positions, rest_rotations(), SEGMENTS, _RADII, 1.0)


def cage_of(anatomy: HandAnatomy) -> SkinnedMesh:
    """Return the cage of a right hand of scale 1; its triangles are those of the adult hand."""
    built = _built_cage(anatomy)
    return SkinnedMesh(np.array(built.vertices), np.array(built.weights), _triangles())


def with_wrist(cage: FloatArray) -> FloatArray:
    """Return a registered cage (C, 3) of scale 1, extended behind the wrist joint.

    The meshes of people end at the wrist or before it, which would leave a gap to the forearm at a bent
    wrist.
    """
    ends = cage.copy()
    ends[:_COLUMNS, 1] = _WRIST_END
    x, _, z = cage[:_COLUMNS].mean(axis=0)
    ends[_COLUMNS * len(_ROWS)] = x, _WRIST_END + _CAP, z
    return ends


@functools.cache
def _triangles() -> IntArray:
    """Return the triangles of the cage, with diagonals chosen for the adult hand."""
    return _built_cage(adult()).build().triangles


def _built_cage(anatomy: HandAnatomy) -> _Builder:
    """Build the cage of a right hand of scale 1."""
    builder = _Builder()
    rows = [_palm_row(builder, anatomy, *row) for row in _ROWS]
    wrist = builder.vertex(np.array([0.0, _WRIST_END + _CAP, 0.0]), {0: 1.0})
    builder.fan(rows[0][::-1], wrist)
    for r, (near, far) in enumerate(itertools.pairwise(rows)):
        for k in range(_COLUMNS):
            if r != _THUMB_ROWS[0] or k not in (16, _INDEX_SIDE):  # the thumb's hole
                m = (k + 1) % _COLUMNS
                builder.quad(near[k], near[m], far[m], far[k])
    bases = _finger_bases(builder, anatomy, rows[-1])
    for finger in range(1, 5):
        _grow(builder, anatomy, finger, bases[finger - 1])
    below, above = (rows[k] for k in _THUMB_ROWS)
    hole = [below[_INDEX_SIDE], below[0], above[0], above[_INDEX_SIDE], above[16], below[16]]
    _grow(builder, anatomy, 0, hole)
    return builder


def _knuckle_line(anatomy: HandAnatomy) -> FloatArray:
    """Return ten points from the index finger side, two per finger, to the little finger side."""
    base, radii = anatomy.base_positions[1:], anatomy.radii[1:, 0]
    across = np.gradient(base, axis=0)
    apart = np.linalg.norm(across, axis=1, keepdims=True)
    across /= apart
    beside = np.minimum(0.45 * radii[:, None], 0.3 * apart) * across  # thick fingers on a narrow palm
    first, second = base - beside, base + beside
    pairs = np.stack([first, second], axis=1).reshape(8, 3)
    outer = base[0] - 1.12 * radii[0] * across[0]
    inner = base[3] + 1.12 * radii[3] * across[3]
    return np.vstack([outer, pairs, inner])


def _palm_row(builder: _Builder, anatomy: HandAnatomy, s: float, thickness: float, width: float) -> list[int]:
    """Add an 18-sided ring: 8 dorsal vertices (index to little), side, 8 palmar vertices back, side."""
    line = _knuckle_line(anatomy)
    broad, _, deep = anatomy.palm
    u = np.concatenate([[1.0], np.linspace(0.80, -0.80, 8), [-1.0]])
    wrist = np.stack(
        [broad * anatomy.wrist * _WRIST_HALF_WIDTH * u, np.full(10, _WRIST_END), np.zeros(10)], axis=1
    )
    middle = line.mean(axis=0)
    ring = (1.0 - s) * wrist + s * (middle + (line - middle) * (width if s > 0.3 else 1.0))
    bulge = (1.0 - np.abs(u) ** 2.6) ** (1.0 / 2.6)
    dorsal, palmar = ring.copy(), ring.copy()
    dorsal[:, 2] += 0.92 * deep * thickness * bulge
    palmar[:, 2] -= 1.08 * deep * thickness * bulge * _palm_profile(u, s)
    order = [*dorsal[1:9], ring[9], *palmar[8:0:-1], ring[0]]
    return [builder.vertex(p, {0: 1.0}) for p in order]


def _palm_profile(u: FloatArray, s: float) -> FloatArray:
    """Return the relief of the palm: thenar and hypothenar eminences, hollow in between."""
    lower = np.exp(-(((s - 0.3) / 0.3) ** 2))
    profile: FloatArray = 1.0 + lower * (
        0.28 * np.exp(-(((u - 0.62) / 0.32) ** 2)) + 0.16 * np.exp(-(((u + 0.6) / 0.35) ** 2))
    )
    profile -= 0.12 * np.exp(-((u / 0.35) ** 2)) * np.exp(-(((s - 0.6) / 0.3) ** 2))
    return profile


def _finger_bases(builder: _Builder, anatomy: HandAnatomy, last: list[int]) -> list[list[int]]:
    """Close the front of the palm around four hexagons and return them, index finger first."""
    corners = [_base_corners(builder, anatomy, f) for f in range(4)]
    webs = [_web(builder, anatomy, k) for k in range(5)]
    dorsal, palmar = last[:8], last[16:8:-1]  # two columns a finger, from the index finger's side
    for f in range(4):
        d0, d1, p0, p1 = dorsal[2 * f], dorsal[2 * f + 1], palmar[2 * f], palmar[2 * f + 1]
        builder.quad(d0, d1, corners[f][1], corners[f][0])
        builder.quad(p1, p0, corners[f][3], corners[f][2])
        if f < 3:
            here, there, web = corners[f], corners[f + 1], webs[f + 1]
            builder.quad(d1, dorsal[2 * f + 2], there[0], here[1])
            builder.triangle(here[1], there[0], web)
            builder.quad(palmar[2 * f + 2], p1, here[2], there[3])
            builder.triangle(there[3], here[2], web)
    builder.quad(last[_INDEX_SIDE], dorsal[0], corners[0][0], webs[0])
    builder.quad(palmar[0], last[_INDEX_SIDE], webs[0], corners[0][3])
    builder.quad(dorsal[7], last[_LITTLE_SIDE], webs[4], corners[3][1])
    builder.quad(last[_LITTLE_SIDE], palmar[7], corners[3][2], webs[4])
    return [[webs[f], *corners[f][:2], webs[f + 1], *corners[f][2:]] for f in range(4)]


def _base_corners(builder: _Builder, anatomy: HandAnatomy, f: int) -> list[int]:
    """Add the corners of a finger base: dorsal near the index finger, dorsal far, palmar far, palmar near."""
    base, frame = anatomy.base_positions[f + 1], anatomy.base_rotations[f + 1]
    radius = anatomy.radii[f + 1, 0]
    weights = {0: 0.5, 1 + 3 * (f + 1): 0.5}
    longer = _relative_length(anatomy, f + 1)
    # x and z in radii, and mm beyond the joint: the palm extends farther along the finger than the back
    table = ((0.5, 1.0, 4.0), (-0.5, 1.0, 4.0), (-0.5, -1.0, 18.0), (0.5, -1.0, 18.0))
    return [
        builder.vertex(base + frame @ np.array([x * radius, -longer * forward, z * radius * 0.98]), weights)
        for x, z, forward in table
    ]


def _web(builder: _Builder, anatomy: HandAnatomy, k: int) -> int:
    """Add the skin between finger bases: webs, and the outer sides of index and little finger."""
    sides = [(f, sign) for f, sign in ((k - 1, -1.0), (k, 1.0)) if 0 <= f < 4]
    points, weights = [], {0: 0.5}
    for f, sign in sides:
        base, frame = anatomy.base_positions[f + 1], anatomy.base_rotations[f + 1]
        out = (1.0 if len(sides) == 2 else 1.06) * anatomy.radii[f + 1, 0]
        forward = (16.0 if len(sides) == 2 else 8.0) * _relative_length(anatomy, f + 1)
        points.append(base + frame @ np.array([sign * out, -forward, -2.0]))
        weights[1 + 3 * (f + 1)] = 0.5 / len(sides)
    return builder.vertex(np.mean(points, axis=0), weights)


def _relative_length(anatomy: HandAnatomy, finger: int) -> float:
    """Return the length of a first segment relative to the average hand, which scales the finger base."""
    return float(anatomy.segments[finger, 0] / adult().segments[finger, 0])


def _grow(builder: _Builder, anatomy: HandAnatomy, finger: int, base: list[int]) -> None:
    """Add a finger on its base hexagon: two rings around joint 2, one at joint 1, and the tip."""
    ring = base
    for position, frame, radius, weights in _stations(anatomy, finger):
        angles = np.deg2rad([0.0, 60.0, 120.0, 180.0, 240.0, 300.0])
        local = radius * np.stack([np.cos(angles), np.zeros(6), 0.95 * np.sin(angles)], axis=1)
        following = [builder.vertex(position + frame @ p, weights) for p in local]
        builder.tube(ring, following)
        ring = following
    frame = anatomy.base_rotations[finger]
    start = anatomy.base_positions[finger]
    tip = start + frame @ np.array([0.0, -anatomy.segments[finger].sum(), 0.0])
    builder.fan(ring, builder.vertex(tip, {3 + 3 * finger: 1.0}))


def _stations(
    anatomy: HandAnatomy, finger: int
) -> list[tuple[FloatArray, FloatArray, float, dict[int, float]]]:
    """Return the rings of a finger: centre, frame, radius, weights."""
    origin, frame = anatomy.base_positions[finger], anatomy.base_rotations[finger]
    first, second, third = anatomy.segments[finger]
    r0, r1, r2, r3 = anatomy.radii[finger]
    bones = [1 + 3 * finger + k for k in range(3)]
    gap = 0.45 * r1
    table = [
        (first - gap, r1 * 1.02, {bones[0]: 0.75, bones[1]: 0.25}),
        (first + gap, r1, {bones[0]: 0.25, bones[1]: 0.75}),
        (first + second, r2 * 1.01, {bones[1]: 0.5, bones[2]: 0.5}),
        (first + second + third - 0.75 * r3, r3 * 0.92, {bones[2]: 1.0}),
    ]
    if finger == 0:
        table[0:0] = [(0.48 * first, r0 * 1.15, {0: 0.25, bones[0]: 0.75})]
    return [
        (origin + frame @ np.array([0.0, -along, 0.0]), frame, radius, weights)
        for along, radius, weights in table
    ]
