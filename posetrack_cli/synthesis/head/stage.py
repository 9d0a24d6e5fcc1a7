"""The scene of a synthetic recording on the graphics device: what it is made of and how it moves."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.poses import in_camera
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.rendering.port import Lighting, RenderingDevice, Surface
from posetrack_cli.synthesis.head import surroundings
from posetrack_cli.synthesis.head.identity import Looks
from posetrack_cli.synthesis.head.illumination import LAMPS
from posetrack_cli.synthesis.head.movement import FACING
from posetrack_cli.synthesis.head.painting import head_texture
from posetrack_cli.synthesis.head.person import Person
from posetrack_cli.synthesis.head.skin_grid import SkinGrid, grid_normals

NECK_FROM_Y, NECK_TO_Y = -116.0, -160.0
"""Between these heights the neck passes from the head's motion to the trunk's."""
TRUNK_FOLLOWS, TRUNK_TURNS = 0.4, 0.15
"""Parts of the head's way and turn that the trunk goes along with."""
SKIN, RIGHT_EAR, LEFT_EAR, TRUNK, WALL, OBJECT = range(6)


class Stage:
    """Head, trunk, wall and an object, drawn as cameras see them.

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
        self._trunk = surroundings.trunk_vertices()
        ears, cloth, wall, thing = rng.spawn(4)
        ear = surroundings.ear_surface(looks, ears)
        skin = Surface(grid.triangles, grid.texcoords.reshape(-1, 2), head_texture(looks))
        others = (surroundings.trunk_surface(cloth), surroundings.wall_surface(wall))
        surfaces = [skin, ear, ear, *others, surroundings.object_surface(thing)]
        self._renderer = device.surface_renderer(size, surfaces, LAMPS)
        self._place(WALL, surroundings.wall_vertices(float(origin[2])), facing=True)

    def set(self, pose: HeadPose, strengths: FloatArray, thing: FloatArray | None) -> None:
        """Move everything: the head's pose, strengths (J,) of its expressions, the object's middle (3,)."""
        trunk = self._trunk_pose(pose)
        skin = self._person.skin(strengths)
        self._place(SKIN, _between(skin, pose, trunk))
        for index, ear in zip((RIGHT_EAR, LEFT_EAR), self._person.ears, strict=True):
            self._place(index, pose.points(ear))
        self._place(TRUNK, trunk.points(self._trunk))
        away = np.array([0.0, 0.0, -1e6])  # behind the cameras
        middle = away if thing is None else thing
        self._place(OBJECT, surroundings.object_vertices() + middle, facing=True)

    def seen(self, camera: Camera, lighting: Lighting) -> Float32Array:
        """What a camera without distortion sees, (height, width)."""
        return self._renderer.image(camera, lighting)

    def release(self) -> None:
        """Give the device's memory back."""
        self._renderer.release()

    def _place(self, index: int, vertices: FloatArray, *, facing: bool = False) -> None:
        to_camera = np.broadcast_to([0.0, 0.0, -1.0], vertices.shape)
        normals = to_camera if facing else grid_normals(vertices)
        self._renderer.place(index, vertices.reshape(-1, 3), normals.reshape(-1, 3))

    def _trunk_pose(self, pose: HeadPose) -> HeadPose:
        turn = rotations.logarithm(rotations.multiply(pose.quaternion, rotations.conjugate(FACING)))
        quaternion = rotations.multiply(rotations.exponential(TRUNK_TURNS * turn), FACING)
        position = self._origin + TRUNK_FOLLOWS * (pose.position - self._origin)
        return HeadPose(position, rotations.canonical(quaternion))


def _between(skin: FloatArray, head: HeadPose, trunk: HeadPose) -> FloatArray:
    """Vertices (R, C, 3) in camera axes: of the head with it, of the neck's end with the trunk."""
    s = np.clip((NECK_FROM_Y - skin[..., 1:2]) / (NECK_FROM_Y - NECK_TO_Y), 0.0, 1.0)
    share = s * s * (3.0 - 2.0 * s)
    placed: FloatArray = head.points(skin)
    return placed + share * (in_camera(skin, trunk.position, trunk.quaternion) - placed)
