"""Frames of synthetic head recordings: cameras, light, scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import in_camera
from posetrack_cli.geometry.rotations import quaternion_rate
from posetrack_cli.head.dense.numbers import CLOSED_BELOW, TRUE_NUMBERS
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.subject import head_subject
from posetrack_cli.rendering.devices import device_or_default
from posetrack_cli.rendering.port import Lighting, RenderingDevice, Surface
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.synthesis.head.eyes import LOOKING_AHEAD, EyePainter, OpenEye, gazes_at, lid_opening_mm
from posetrack_cli.synthesis.head.form import (
    SkinGrid,
    Sway,
    grid_normals,
    grid_triangles,
    layered_field,
    minimum_jerk,
    random_sway,
    skin_grid,
    smooth_field,
    smooth_step,
)
from posetrack_cli.synthesis.head.movement import BEGIN_S, Movement, Occluder, make_movement, make_occluder
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.painting import head_texture
from posetrack_cli.synthesis.head.person import (
    EXPRESSIONS,
    ExpressionScript,
    Identity,
    Looks,
    Person,
    identity_of_seed,
    make_person,
    make_script,
)
from posetrack_cli.synthesis.recording import Timeline, dropped_images, nominal_stamps

# Grey cameras: one, or several that converge; with blur, distortion, exposure, noise

EXPOSURE = 245.0
"""Grey value of light 1."""
BLUR_PX = 0.5
READ_SD, SHOT = 1.1, 0.022
"""Noise of a grey value g: variance READ_SD^2 + SHOT g; standard deviation 2.2 at g = 170."""
BORDER = 0.12
"""Border rendered around the undistorted image for the distorting lens, relative to the width."""

FOCAL_WIDTHS = 1000.0 / 640.0
"""Focal length in image widths: a field of view of 35.5 degrees."""
DISTORTION = (-0.14, 0.06, 0.0006, -0.0004, 0.0)
"""Left or only lens; the first two coefficients of the right one are a tenth smaller."""
NAMES = ("left", "right", "third", "fourth")
DIRECTIONS = ((1.0, 0.0), (-1.0, 0.0), (0.0, -1.0))
"""Directions of the other cameras from the first, in its image: right and down."""


class Sensor:
    """Converts the light seen through an ideal lens to a camera's 8-bit image.

    Args:
        camera: camera with its distortion.
        noise: factor on the noise's standard deviation.
    """

    def __init__(self, camera: Camera, noise: float) -> None:
        self.camera = camera
        self._noise = noise
        self.drawn = _drawn_camera(camera) if camera.is_distorted else camera
        self._maps = _distortion_maps(camera, self.drawn) if camera.is_distorted else None

    def image(self, light: Float32Array, rng: np.random.Generator) -> ImageArray:
        """Return the image (height, width) uint8.

        Args:
            light: light as seen by ``drawn``, the camera without distortion.
            rng: draws one number per pixel, even without noise.
        """
        import cv2

        if self._maps is not None:
            light = np.asarray(cv2.remap(light, *self._maps, cv2.INTER_LINEAR), dtype=np.float32)
        grey = EXPOSURE * cv2.GaussianBlur(light, (0, 0), BLUR_PX)
        noise = rng.standard_normal(grey.shape, dtype=np.float32)
        sd = np.float32(self._noise) * np.sqrt(np.float32(READ_SD**2) + np.float32(SHOT) * grey)
        codes: ImageArray = np.rint(np.clip(grey + sd * noise, 0.0, 255.0)).astype(np.uint8)
        return codes


def _drawn_camera(camera: Camera) -> Camera:
    """Return the camera without distortion, with a border."""
    border = round(BORDER * camera.width)
    return replace(
        camera,
        width=camera.width + 2 * border,
        height=camera.height + 2 * border,
        cx=camera.cx + border,
        cy=camera.cy + border,
        distortion=(),
    )


def _distortion_maps(camera: Camera, drawn: Camera) -> tuple[Float32Array, Float32Array]:
    """Return columns and rows (height, width) in the rendered image for each distorted pixel."""
    import cv2

    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
    ideal = cv2.undistortPointsIter(
        pixels, camera.matrix, np.array(camera.distortion), np.eye(3), drawn.matrix, criteria
    )
    maps = ideal.reshape(camera.height, camera.width, 2).astype(np.float32)
    return np.ascontiguousarray(maps[..., 0]), np.ascontiguousarray(maps[..., 1])


def make_cameras(options: HeadSynthOptions) -> tuple[Camera, ...]:
    """Return the cameras, the reference camera first.

    The others are ``baseline_mm`` to its right, to its left and above, and look at the point ``distance_mm``
    in front of it.
    """
    reference = _camera(options, NAMES[0] if options.cameras > 1 else "camera", DISTORTION)
    others = zip(NAMES[1 : options.cameras], DIRECTIONS, strict=False)
    return reference, *(_other_camera(options, name, direction) for name, direction in others)


def _other_camera(options: HeadSynthOptions, name: str, direction: tuple[float, float]) -> Camera:
    """Return the camera in a direction (right, down) from the reference, turned towards the head."""
    x, y = direction
    toe_in = float(np.arctan2(options.baseline_mm, options.distance_mm))
    c, s = np.cos(toe_in), np.sin(toe_in)
    # rotation by the toe-in about the axis in the image plane at right angles to the direction
    rotation = np.array(
        [
            [y * y + c * x * x, (c - 1.0) * x * y, s * x],
            [(c - 1.0) * x * y, x * x + c * y * y, s * y],
            [-s * x, -s * y, c],
        ]
    )
    translation = -rotation @ [options.baseline_mm * x, options.baseline_mm * y, 0.0]
    rows = (np.column_stack([rotation, translation]) + 0.0).tolist()  # no negative zeros
    lens = tuple(0.9 * value for value in DISTORTION[:2]) + DISTORTION[2:]
    return _camera(options, name, lens, tuple(tuple(row) for row in rows))


def _camera(
    options: HeadSynthOptions,
    name: str,
    distortion: tuple[float, ...],
    transform: tuple[tuple[float, ...], ...] | None = None,
) -> Camera:
    focal = FOCAL_WIDTHS * options.width
    camera = Camera(
        width=options.width,
        height=options.height,
        fx=focal,
        fy=focal,
        cx=(options.width - 1) / 2.0,
        cy=(options.height - 1) / 2.0,
        distortion=distortion if options.distortion else (),
        name=name,
    )
    if transform is None:
        return camera
    from dataclasses import replace

    return replace(camera, camera_T_reference=transform)


# Light: two lamps and ambient light, drifting slowly

LAMPS = 2
STRENGTHS = np.array([0.52, 0.26])
AMBIENT, FROM_ABOVE = 0.46, np.array([0.0, -0.12, 0.0])
DRIFT = np.array([0.22, 0.3, 0.08, 0.25, 0.12])
"""Ranges of drift: strengths of lamps and ambient light (relative), first lamp's direction (rad)."""
DRIFT_HZ = (0.03, 0.12)
SWITCH_S, SWITCH_PART = 0.04, 0.5
SWITCHED = np.array([0.45, 1.9])
"""Factors on the lamps' strengths after the switch."""


@dataclass(frozen=True, eq=False)
class Illumination:
    """Light as a function of time.

    Attributes:
        directions: (L, 3) towards the lamps, reference axes.
        drift: of the lamps' strengths, ambient light, and the first lamp's two angles; None for none.
        switch_s: time of the sudden change of the lamps' strengths; None for none.
    """

    directions: FloatArray
    drift: Sway | None
    switch_s: float | None

    def at(self, seconds: float) -> Lighting:
        """Return the light at a time, s."""
        time = np.array([seconds])
        drift = np.zeros(5) if self.drift is None else self.drift(time)[0]
        strengths = STRENGTHS * (1.0 + drift[:2])
        if self.switch_s is not None:
            step = float(minimum_jerk((time - self.switch_s) / SWITCH_S)[0])
            strengths = strengths * (1.0 + step * (SWITCHED - 1.0))
        directions = self.directions.copy()
        directions[0, :2] += drift[3:]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return Lighting(directions, strengths, AMBIENT * (1.0 + float(drift[2])), FROM_ABOVE)


def make_illumination(options: HeadSynthOptions, rng: np.random.Generator) -> Illumination:
    """Draw the lamps' positions and drift."""
    side = 1.0 if rng.random() < 0.5 else -1.0
    main = [side * rng.uniform(0.15, 0.6), -rng.uniform(0.4, 0.8), -1.0]
    fill = [-side * rng.uniform(0.5, 0.9), -rng.uniform(0.0, 0.4), -1.0]
    drift = random_sway(DRIFT, DRIFT_HZ, rng)
    return Illumination(
        np.array([main, fill]),
        None if options.light == "steady" else drift,
        SWITCH_PART * options.duration_s if options.light == "sudden" else None,
    )


# Scene: head, trunk, wall, occluder

NECK_FROM_Y, NECK_TO_Y = -116.0, -160.0
"""Heights between which the neck blends from the head's motion to the trunk's."""
TRUNK_FOLLOWS, TRUNK_TURNS = 0.4, 0.15
"""Shares of the head's translation and rotation that the trunk follows."""
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
    """Head, trunk, wall and an occluder; ``renderer`` renders them without distortion.

    Args:
        device: rendering device.
        person, looks: the person.
        grid: skin grid.
        size: (width, height) of the rendered images.
        rest: pose of the head at rest.
        rng: random stream of cloth, wall and occluder.
    """

    def __init__(
        self,
        device: RenderingDevice,
        person: Person,
        looks: Looks,
        grid: SkinGrid,
        size: tuple[int, int],
        rest: HeadPose,
        rng: np.random.Generator,
    ) -> None:
        self._person, self._rest = person, rest
        self._eyes = EyePainter(person.surface, looks)
        self._trunk = trunk_vertices()
        ears, cloth, wall, board = rng.spawn(4)
        ear = ear_surface(looks, ears)
        skin = Surface(grid.triangles, grid.texcoords.reshape(-1, 2), head_texture(looks))
        others = (trunk_surface(cloth), wall_surface(wall))
        surfaces = [skin, ear, ear, *others, occluder_surface(board)]
        self.renderer = device.surface_renderer(size, surfaces, LAMPS)
        self._place(WALL, wall_vertices(float(rest.position[2])), facing=True)

    def set(
        self, pose: HeadPose, strengths: FloatArray, eyes: tuple[OpenEye, ...], occluder: FloatArray | None
    ) -> None:
        """Set the head's pose, its expressions (J,), both eyes, and the occluder's centre (3,)."""
        for first, texels in self._eyes(eyes):
            self.renderer.paint(SKIN, first, texels)
        trunk = self._trunk_pose(pose)
        skin = self._person.skin(strengths)
        self._place(SKIN, _between(skin, pose, trunk))
        for index, ear in zip((RIGHT_EAR, LEFT_EAR), self._person.ears, strict=True):
            self._place(index, pose.points(ear))
        self._place(TRUNK, trunk.points(self._trunk))
        away = np.array([0.0, 0.0, -1e6])  # behind the cameras, i.e. invisible
        middle = away if occluder is None else occluder
        self._place(OCCLUDER, occluder_vertices() + middle, facing=True)

    def release(self) -> None:
        """Release the device memory."""
        self.renderer.release()

    def _place(self, index: int, vertices: FloatArray, *, facing: bool = False) -> None:
        to_camera = np.broadcast_to([0.0, 0.0, -1.0], vertices.shape)
        normals = to_camera if facing else grid_normals(vertices)
        self.renderer.place(index, vertices.reshape(-1, 3), normals.reshape(-1, 3))

    def _trunk_pose(self, pose: HeadPose) -> HeadPose:
        rest = self._rest
        turn = rotations.logarithm(rotations.multiply(pose.quaternion, rotations.conjugate(rest.quaternion)))
        quaternion = rotations.multiply(rotations.exponential(TRUNK_TURNS * turn), rest.quaternion)
        position = rest.position + TRUNK_FOLLOWS * (pose.position - rest.position)
        return HeadPose(position, rotations.canonical(quaternion))


def _between(skin: FloatArray, head: HeadPose, trunk: HeadPose) -> FloatArray:
    """Return vertices (R, C, 3) in camera axes, blended from head to trunk along the neck."""
    share = smooth_step((NECK_FROM_Y - skin[..., 1:2]) / (NECK_FROM_Y - NECK_TO_Y))
    placed: FloatArray = head.points(skin)
    return placed + share * (in_camera(skin, trunk.position, trunk.quaternion) - placed)


def ear_surface(looks: Looks, rng: np.random.Generator) -> Surface:
    """Return an ear's texture: skin, darker in the middle."""
    rows, columns = 96, 192
    v, u = np.mgrid[0:rows, 0:columns]
    down, across = (v + 0.5) / rows * 2.0 - 1.0, (u + 0.5) / columns * 2.0 - 1.0
    outer = np.exp(-0.5 * ((np.abs(across) - 0.5) / 0.13) ** 2 - 0.5 * (down / 0.38) ** 2)
    tone = looks.skin * 0.9 * (1.0 - 0.45 * outer) * (1.0 + 0.06 * smooth_field((rows, columns), 6.0, rng))
    return grid_surface((13, 25), _two_channels(tone, 0.05))


def trunk_vertices() -> FloatArray:
    """Return the grid (20, 61, 3) of neck, shoulders and chest, mm, in the head's frame at rest."""
    heights = [*np.linspace(_TRUNK[0, 0], -250.0, 16).tolist(), -300.0, -340.0, -380.0, -420.0]
    profile = [np.interp(heights, _TRUNK[::-1, 0], _TRUNK[::-1, k]) for k in (1, 2)]
    phi = np.linspace(-np.pi, np.pi, 61)
    x = profile[0][:, None] * np.sin(phi)
    z = TRUNK_Z + profile[1][:, None] * np.cos(phi)
    y = np.broadcast_to(np.array(heights)[:, None], x.shape)
    return np.stack([x, y, z], axis=-1)


def trunk_surface(rng: np.random.Generator) -> Surface:
    """Return the cloth: woven, sometimes striped, with a collar."""
    rows, columns = 512, 1024
    tone = rng.uniform(0.12, 0.6) * np.ones((rows, columns))
    tone *= 1.0 + 0.12 * layered_field((rows, columns), (40.0, 12.0, 4.0), rng)
    if rng.random() < 0.5:
        tone *= 1.0 + 0.25 * np.sign(np.sin(np.arange(rows) / rng.uniform(3.0, 7.0)))[:, None]
    tone *= 1.0 + 0.1 * rng.standard_normal((rows, columns))
    tone[: rows // 24] *= 0.6
    return grid_surface((20, 61), _two_channels(tone, 0.02))


def wall_vertices(distance_mm: float) -> FloatArray:
    """Return the grid (2, 2, 3) of the wall behind the head, mm, reference axes."""
    half_x, half_y = WALL_MM[0] / 2.0, WALL_MM[1] / 2.0
    x, y = np.meshgrid([-half_x, half_x], [-half_y, half_y])
    return np.stack([x, y, np.full((2, 2), distance_mm + WALL_BEHIND_MM)], axis=-1)


def wall_surface(rng: np.random.Generator) -> Surface:
    """Return the wall's texture: plaster with pictures or shelves."""
    rows, columns = 768, 1024
    tone = rng.uniform(0.28, 0.6) * (1.0 + 0.10 * layered_field((rows, columns), (200.0, 60.0, 15.0), rng))
    for _ in range(int(rng.integers(5, 12))):
        row, column = int(rng.integers(0, rows - 60)), int(rng.integers(0, columns - 60))
        high, wide = int(rng.integers(30, 220)), int(rng.integers(25, 160))
        part = tone[row : row + high, column : column + wide]
        part[...] = rng.uniform(0.1, 0.75) * (1.0 + 0.15 * smooth_field(part.shape, 12.0, rng))
    return grid_surface((2, 2), _two_channels(tone, 0.0))


def occluder_vertices() -> FloatArray:
    """Return the grid (2, 2, 3) of the occluder, a board, mm, about its centre."""
    x, y = np.meshgrid([-48.0, 48.0], [-170.0, 170.0])
    return np.stack([x, y, np.zeros((2, 2))], axis=-1)


def occluder_surface(rng: np.random.Generator) -> Surface:
    """Return the occluder's texture, printed in patches."""
    tone = 0.45 * (1.0 + 0.35 * layered_field((512, 160), (50.0, 15.0, 5.0), rng))
    return grid_surface((2, 2), _two_channels(tone, 0.05))


def grid_surface(shape: tuple[int, int], texture: ImageArray) -> Surface:
    """Return the surface of a vertex grid covered by a texture."""
    rows, columns = shape
    v, u = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    return Surface(grid_triangles(rows, columns), np.stack([u, v], axis=-1).reshape(-1, 2), texture)


def _two_channels(tone: FloatArray | Float32Array, gloss: float) -> ImageArray:
    both = np.stack([np.clip(tone, 0.0, 1.0), np.full(tone.shape, gloss)], axis=-1)
    codes: ImageArray = np.rint(both * 255.0).astype(np.uint8)
    return codes


# Frames

COMPONENTS = 0
"""The truth has no deformation coefficients, as they are specific to a model; points show the deformation."""


@dataclass(frozen=True, eq=False)
class SyntheticHeadFrame:
    """One frame with its ground truth.

    Attributes:
        index: frame number, from 0.
        stamp_ns: time of the frame, integer nanoseconds.
        images: one per camera, (height, width) uint8; None if dropped.
        pose: ``camera_T_head`` of the reference camera.
        twist: (6,) velocity: mm/s in camera axes, rad/s in the head's frame.
        strengths: (J,) of ``EXPRESSIONS``.
        shape: (K, 3) landmarks, mm, head's frame.
        eyes: right and left eye.
        lids_mm: openings of their lids when they are open and look ahead, and now.
    """

    index: int
    stamp_ns: int
    images: tuple[ImageArray | None, ...]
    pose: HeadPose
    twist: FloatArray
    strengths: FloatArray
    shape: FloatArray
    eyes: tuple[OpenEye, ...]
    lids_mm: tuple[FloatArray, FloatArray]

    def truth(self) -> Estimate:
        """Return the ground truth as an estimate; its points are the ten landmarks in reference axes.

        Its numbers are those of the eyes, ``TRUE_NUMBERS``.
        """
        none = np.zeros(6)
        turning = quaternion_rate(self.pose.quaternion, self.twist[3:])
        return Estimate(
            frame_index=self.index,
            stamp_ns=self.stamp_ns,
            status=Status.TRACKING,
            confidence=1.0,
            position=self.pose.position,
            quaternion=self.pose.quaternion,
            shape=np.zeros(COMPONENTS),
            pose_rate=np.concatenate([self.twist[:3], turning]),
            twist=self.twist,
            pose_variance=none,
            twist_variance=none,
            points=self.pose.points(self.shape),
            effective_sample_size=None,
            resampled=False,
            numbers=self._face_numbers(),
        )

    def _face_numbers(self) -> FloatArray:
        usual, present = self.lids_mm
        shares = present / usual
        gazes = [np.append(eye.angles, self.pose.rotation @ eye.gaze) for eye in self.eyes]
        return np.concatenate([present, shares, [float(shares.mean() < CLOSED_BELOW)], *gazes])

    def joint_states(self) -> messages.JointStates:
        """Return the strengths of the expressions, which results do not have."""
        message = messages.JointStates()
        message.timestamp.FromNanoseconds(self.stamp_ns)
        for name, value in zip(EXPRESSIONS, self.strengths.tolist(), strict=True):
            message.joints.add(name=name, position=value)
        return message


@dataclass(frozen=True, eq=False)
class Plan:
    """Synthetic recording without its images.

    Attributes:
        options: options of the recording.
        cameras: cameras, the reference camera first.
        identity, person, grid: the person.
        timeline: instants and missing images.
        movement, script, occluder, illumination: the events.
        scenery: random stream of the surroundings, unused so far.
        noise_seed: seed of the sensor noise.
    """

    options: HeadSynthOptions
    cameras: tuple[Camera, ...]
    identity: Identity
    person: Person
    grid: SkinGrid
    timeline: Timeline
    movement: Movement
    script: ExpressionScript
    occluder: Occluder | None
    illumination: Illumination
    scenery: np.random.Generator
    noise_seed: int

    @property
    def subject(self) -> Subject:
        """Subject of the ground truth, in the reference camera."""
        subject = head_subject(self.cameras[0].name, COMPONENTS)
        return replace(subject, number_names=TRUE_NUMBERS)


def make_plan(options: HeadSynthOptions) -> Plan:
    """Draw all events, each kind from its own random stream.

    Motion, expressions and light of a seed are thus the same for all persons and numbers of cameras.
    """
    streams = np.random.default_rng(options.seed).spawn(7)
    moving, speaking, occluding, lighting, scenery, sensing, missing = streams
    cameras, identity, grid = make_cameras(options), identity_of_seed(options.identity), skin_grid()
    dropped = dropped_images(len(cameras), options.frames, missing) & options.drops
    return Plan(
        options=options,
        cameras=cameras,
        identity=identity,
        person=make_person(identity, grid),
        grid=grid,
        timeline=Timeline(nominal_stamps(options.frames, options.fps), dropped),
        movement=make_movement(options, moving),
        script=make_script(options, speaking),
        occluder=make_occluder(options, occluding),
        illumination=make_illumination(options, lighting),
        scenery=scenery,
        noise_seed=int(sensing.integers(2**32)),
    )


def synthesise(
    options: HeadSynthOptions, *, device: RenderingDevice | None = None
) -> Iterator[SyntheticHeadFrame]:
    """Yield the frames of a synthetic recording; its cameras are ``make_cameras(options)``.

    Args:
        options: options of the recording.
        device: rendering device; by default one is opened, and closed at the end.

    Raises:
        RenderingError: no working renderer.
    """
    yield from render_plan(make_plan(options), device=device)


def render_plan(plan: Plan, *, device: RenderingDevice | None = None) -> Iterator[SyntheticHeadFrame]:
    """Yield the frames of a plan; see ``synthesise``."""
    with device_or_default(device) as drawing:
        sensors = [Sensor(camera, plan.options.noise) for camera in plan.cameras]
        size = (sensors[0].drawn.width, sensors[0].drawn.height)
        rest = HeadPose(plan.movement.origin, plan.movement.rest)
        looks, times = plan.identity.looks, plan.timeline.seconds
        scene = Scene(drawing, plan.person, looks, plan.grid, size, rest, plan.scenery)
        poses, twists = plan.movement.poses(times), plan.movement.twists(times)
        strengths = plan.script.strengths(times)
        eyes = _eyes(plan, poses, strengths)
        usual_mm = _lids_mm(plan, (LOOKING_AHEAD, LOOKING_AHEAD))
        try:
            for index, seconds in enumerate(times.tolist()):
                pose = HeadPose(poses[index, :3], poses[index, 3:])
                occluder = None if plan.occluder is None else plan.occluder.place(seconds, pose.position)
                scene.set(pose, strengths[index], eyes[index], occluder)
                yield SyntheticHeadFrame(
                    index=index,
                    stamp_ns=int(plan.timeline.stamps_ns[index]),
                    images=_images(scene, sensors, plan, index),
                    pose=pose,
                    twist=twists[index],
                    strengths=strengths[index],
                    shape=plan.person.shape(strengths[index]),
                    eyes=eyes[index],
                    lids_mm=(usual_mm, _lids_mm(plan, eyes[index])),
                )
        finally:
            scene.release()


def _eyes(plan: Plan, poses: FloatArray, strengths: FloatArray) -> list[tuple[OpenEye, ...]]:
    """Return both eyes in every frame; they begin with a look at the reference camera."""
    gazes = np.broadcast_to(LOOKING_AHEAD.gaze, (len(poses), 2, 3))
    if plan.script.target is not None:
        times = plan.timeline.seconds
        targets = minimum_jerk(times / BEGIN_S)[:, None] * plan.script.target(times)
        gazes = gazes_at(targets, poses, plan.person.surface.eyeballs)
    closing = np.clip(strengths[:, EXPRESSIONS.index("blink")], 0.0, 1.0).tolist()
    return [
        (OpenEye(right, closed), OpenEye(left, closed))
        for (right, left), closed in zip(gazes, closing, strict=True)
    ]


def _lids_mm(plan: Plan, eyes: tuple[OpenEye, ...]) -> FloatArray:
    looks = plan.identity.looks
    return np.array([lid_opening_mm(plan.person.surface, looks, side, eye) for side, eye in enumerate(eyes)])


def _images(scene: Scene, sensors: list[Sensor], plan: Plan, index: int) -> tuple[ImageArray | None, ...]:
    lighting = plan.illumination.at(float(plan.timeline.seconds[index]))
    streams = [np.random.default_rng([plan.noise_seed, number, index]) for number in range(len(sensors))]
    return tuple(
        None if dropped else sensor.image(scene.renderer.image(sensor.drawn, lighting), rng)
        for sensor, rng, dropped in zip(
            sensors, streams, plan.timeline.dropped[:, index].tolist(), strict=True
        )
    )
