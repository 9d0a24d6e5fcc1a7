"""ICT-FaceKit's face model: mesh, identities and expressions, in the head's frame.

ICT-FaceKit is a face model of the USC Institute for Creative Technologies (MIT licence).
"""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray

FOLDER = "FaceXModel"
MM = 10.0
"""Millimetres per unit of the model's files."""
# fmt: off
LANDMARKS = np.array(
    [
        1225, 1888, 1052, 367, 1719, 1722, 2199, 1447, 966, 3661, 4390, 3927, 3924, 2608, 3272, 4088, 3443,
        268, 493, 1914, 2044, 1401, 3615, 4240, 4114, 2734, 2509, 978, 4527, 4942, 4857, 1140, 2075, 1147,
        4269, 3360, 1507, 1542, 1537, 1528, 1518, 1511, 3742, 3751, 3756, 3721, 3725, 3732, 5708, 5695, 2081,
        0, 4275, 6200, 6213, 6346, 6461, 5518, 5957, 5841, 5702, 5711, 5533, 6216, 6207, 6470, 5517, 5966,
    ],
    dtype=np.intp,
)
# fmt: on
"""(68,) vertices of the usual 68 points, from the model's documentation."""
SKIN, BACK, GUMS, TEETH, EYEBALLS = 0, 1, 2, 3, 4
"""Kinds of triangles that are drawn; tear film, lashes and occlusion meshes are not."""
_KIND_OF_MATERIAL = {
    "M_Face": SKIN,
    "M_BackHead": BACK,
    "M_GumsTongue": GUMS,
    "M_Teeth": TEETH,
    "M_ScleraLeft": EYEBALLS,
    "M_ScleraRight": EYEBALLS,
}


@dataclass(frozen=True, eq=False)
class FaceKit:
    """The face model.

    Attributes:
        neutral: (V, 3) mm, mean face; origin between the eyes, x to the subject's left, y up, z forward.
        identities: (M, V, 3) mm, one standard deviation each.
        expressions: (V, 3) mm by name, displacements at full strength.
        triangles: (T, 3) vertices.
        corners: (T, 3, 2) texture coordinates, 0 to 1, y down.
        kinds: (T,) of the surface, such as ``SKIN``.
        eyeballs: vertices of the right and of the left eyeball.
    """

    neutral: FloatArray
    identities: FloatArray
    expressions: dict[str, FloatArray]
    triangles: IntArray
    corners: FloatArray
    kinds: IntArray
    eyeballs: tuple[IntArray, IntArray]

    def on_skin(self, texture: FloatArray) -> SkinPlaces:
        """Return the places on the skin of texture coordinates (N, 2)."""
        skin = self.kinds == SKIN
        a, b, c = (self.corners[skin, one] for one in range(3))
        across, down, from_a = b - a, c - a, texture[:, None] - a
        area = _cross(across, down)
        with np.errstate(divide="ignore", invalid="ignore"):
            v, w = _cross(from_a, down) / area, _cross(across, from_a) / area
        inside = np.nan_to_num(np.minimum(np.minimum(v, w), 1.0 - v - w), nan=-np.inf)
        best = inside.argmax(axis=1)
        at = np.arange(len(texture)), best
        weights = np.stack([1.0 - v[at] - w[at], v[at], w[at]], axis=1)
        return SkinPlaces(self.triangles[skin][best], weights)


@dataclass(frozen=True, eq=False)
class SkinPlaces:
    """Places on the skin: vertices (N, 3) of triangles, and weights (N, 3)."""

    triangles: IntArray
    weights: FloatArray

    def of(self, vertices: FloatArray) -> FloatArray:
        """Return the places (N, 3) on a face with vertices (V, 3)."""
        places: FloatArray = np.einsum("nk,nki->ni", self.weights, vertices[self.triangles])
        return places


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def read_face_kit(folder: Path) -> FaceKit:
    """Read a checkout of ICT-FaceKit."""
    folder = folder / FOLDER
    names = json.loads((folder / "vertex_indices.json").read_text(encoding="utf-8"))["expressions"]
    lines = (folder / "generic_neutral_mesh.obj").read_text(encoding="utf-8").splitlines()
    neutral = _vertices(lines)
    texture = np.array([line.split()[1:3] for line in lines if line.startswith("vt ")], dtype=np.float64)
    faces: list[list[tuple[int, int]]] = []
    kinds: list[int] = []
    kind: int | None = None
    for line in lines:
        if line.startswith("usemtl"):
            kind = _KIND_OF_MATERIAL.get(line.split()[1])
        elif kind is not None and line.startswith("f "):
            ring = [tuple(int(part) - 1 for part in one.split("/")[:2]) for one in line.split()[1:]]
            for second, third in itertools.pairwise(ring[1:]):
                faces.append([ring[0], second, third])  # type: ignore[list-item]
                kinds.append(kind)
    corners = np.array(faces)
    vertices, kind_of = corners[..., 0], np.array(kinds)
    ball = np.unique(vertices[kind_of == EYEBALLS])
    sides = ball[neutral[ball, 0] < 0.0], ball[neutral[ball, 0] > 0.0]
    paths = sorted(folder.glob("identity*.obj"))
    origin = neutral[LANDMARKS[[36, 39, 42, 45]]].mean(axis=0)
    return FaceKit(
        (neutral - origin) * MM,
        np.array([(_read_vertices(path) - neutral) * MM for path in paths], dtype=np.float32),
        {name: (_read_vertices(folder / f"{name}.obj") - neutral) * MM for name in names},
        vertices,
        texture[corners[..., 1]] * (1.0, -1.0) % 1.0,
        kind_of,
        sides,
    )


def _read_vertices(path: Path) -> FloatArray:
    return _vertices(path.read_text(encoding="utf-8").splitlines())


def _vertices(lines: list[str]) -> FloatArray:
    text = " ".join(line[2:] for line in lines if line.startswith("v "))
    return np.fromstring(text, sep=" ").reshape(-1, 3)
