"""What synthetic cameras look at: head, trunk, the wall behind and an occluder, and how all that moves."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rigid import in_camera
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.rendering.port import RenderingDevice, Surface
from posetrack_cli.synthesis.head.identity import Looks
from posetrack_cli.synthesis.head.illumination import LAMPS
from posetrack_cli.synthesis.head.movement import FACING
from posetrack_cli.synthesis.head.painting import head_texture
from posetrack_cli.synthesis.head.person import Person
from posetrack_cli.synthesis.head.skin_grid import SkinGrid, grid_normals, grid_triangles
from posetrack_cli.synthesis.head.smooth import layered_field, smooth_field, smooth_step

NECK_FROM_Y, NECK_TO_Y = -116.0, -160.0
"""Between these heights the neck passes from the head's motion to the trunk's."""
TRUNK_FOLLOWS, TRUNK_TURNS = 0.4, 0.15
"""Parts of the head's way and turn that the trunk goes along with."""
SKIN, RIGHT_EAR, LEFT_EAR, TRUNK, WALL, OCCLUDER = range(6)

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


class Scene:
    """Head, trunk, wall and an occluder; ``renderer`` draws them as cameras without distortion see them.

    Args:
        device: draws it.
        person, looks: who is seen.
        grid: of the skin.
        size: (width, height) of the images drawn.
        origin: the head's first place (3,), mm.
        rng: of cloth, wall and object.
    """

    def __init__(
        self,
        device: RenderingDevice,
        person: Person,
        looks: Looks,
        grid: SkinGrid,
        size: tuple[int, int],
        origin: FloatArray,
        rng: np.random.Generator,
    ) -> None:
        self._person, self._origin = person, origin
        self._trunk = trunk_vertices()
        ears, cloth, wall, board = rng.spawn(4)
        ear = ear_surface(looks, ears)
        skin = Surface(grid.triangles, grid.texcoords.reshape(-1, 2), head_texture(looks))
        others = (trunk_surface(cloth), wall_surface(wall))
        surfaces = [skin, ear, ear, *others, occluder_surface(board)]
        self.renderer = device.surface_renderer(size, surfaces, LAMPS)
        self._place(WALL, wall_vertices(float(origin[2])), facing=True)

    def set(self, pose: HeadPose, strengths: FloatArray, occluder: FloatArray | None) -> None:
        """Move everything: the head's pose, strengths (J,) of its expressions, the occluder's middle (3,)."""
        trunk = self._trunk_pose(pose)
        skin = self._person.skin(strengths)
        self._place(SKIN, _between(skin, pose, trunk))
        for index, ear in zip((RIGHT_EAR, LEFT_EAR), self._person.ears, strict=True):
            self._place(index, pose.points(ear))
        self._place(TRUNK, trunk.points(self._trunk))
        away = np.array([0.0, 0.0, -1e6])  # behind the cameras
        middle = away if occluder is None else occluder
        self._place(OCCLUDER, occluder_vertices() + middle, facing=True)

    def release(self) -> None:
        """Give the device's memory back."""
        self.renderer.release()

    def _place(self, index: int, vertices: FloatArray, *, facing: bool = False) -> None:
        to_camera = np.broadcast_to([0.0, 0.0, -1.0], vertices.shape)
        normals = to_camera if facing else grid_normals(vertices)
        self.renderer.place(index, vertices.reshape(-1, 3), normals.reshape(-1, 3))

    def _trunk_pose(self, pose: HeadPose) -> HeadPose:
        turn = rotations.logarithm(rotations.multiply(pose.quaternion, rotations.conjugate(FACING)))
        quaternion = rotations.multiply(rotations.exponential(TRUNK_TURNS * turn), FACING)
        position = self._origin + TRUNK_FOLLOWS * (pose.position - self._origin)
        return HeadPose(position, rotations.canonical(quaternion))


def _between(skin: FloatArray, head: HeadPose, trunk: HeadPose) -> FloatArray:
    """Vertices (R, C, 3) in camera axes: of the head with it, of the neck's end with the trunk."""
    share = smooth_step((NECK_FROM_Y - skin[..., 1:2]) / (NECK_FROM_Y - NECK_TO_Y))
    placed: FloatArray = head.points(skin)
    return placed + share * (in_camera(skin, trunk.position, trunk.quaternion) - placed)


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


def occluder_vertices() -> FloatArray:
    """Return the grid (2, 2, 3) of the object that passes, a board, mm, about its own middle."""
    x, y = np.meshgrid([-48.0, 48.0], [-170.0, 170.0])
    return np.stack([x, y, np.zeros((2, 2))], axis=-1)


def occluder_surface(rng: np.random.Generator) -> Surface:
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
