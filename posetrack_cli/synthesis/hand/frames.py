"""Frames of synthetic hand recordings, and their file."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import (
    ANGLE_NAMES,
    ANGLES,
    BONE_COUNT,
    JOINT_NAMES,
    JOINT_PARENTS,
    MIRROR,
    TANGENT_SIZE,
    HandAnatomy,
)
from posetrack_cli.hand.model.hand import MESH_DIGEST, HandModel
from posetrack_cli.hand.model.kinematics import joint_positions, mirrored_poses, skinning_transforms
from posetrack_cli.mcap.sink import McapSink, serialised
from posetrack_cli.outputs import check_output
from posetrack_cli.recording.conversion import CALIBRATION_TOPIC, IMAGE_TOPIC
from posetrack_cli.recording.identity import file_digest
from posetrack_cli.recording.image_files import encode_png
from posetrack_cli.recording.message_cameras import calibration_message
from posetrack_cli.rendering.devices import device_or_default
from posetrack_cli.rendering.mesh import SkinnedMesh, joined
from posetrack_cli.rendering.port import RenderingDevice, Window
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.synthesis.hand import person
from posetrack_cli.synthesis.hand.motion import Motion, WalkNoise, make_motion
from posetrack_cli.synthesis.hand.options import Switches, SynthOptions
from posetrack_cli.synthesis.hand.sensors import JUMP_MM, KINECT_2, SENSORS, nearer_side, smooth_field
from posetrack_cli.synthesis.recording import (
    Synthesis,
    Timeline,
    TruthChannels,
    make_timeline,
    numbers_text,
    recording_file,
    reported,
    synth_record,
    write_all,
)
from posetrack_cli.tracking.velocity import pose_rates

# Scene: one skinned mesh of hand and person, and the room behind

_MIRRORED_TRANSFORM = np.outer(MIRROR, [*MIRROR, 1.0])  # M T M, entry by entry

# Normals n and offsets c of planes n . p = c, mm: a wall slightly tilted, ceiling, floor.
PLANES = (
    (np.array([0.05, 0.03, 1.0]), 2750.0),
    (np.array([0.0, 1.0, 0.06]), -1050.0),
    (np.array([0.0, 1.0, 0.0]), 1250.0),
)
# Corners of furniture, mm: a cabinet on the left, a seat on the right.
BOXES = (
    (np.array([-1600.0, 250.0, 2150.0]), np.array([-850.0, 1250.0, 2600.0])),
    (np.array([650.0, 560.0, 2000.0]), np.array([1500.0, 1250.0, 2600.0])),
)


class Scene:
    """Hand, and the parts of its owner selected by the switches.

    Args:
        hand: bones and skin. A left hand has the mirror image of a right hand's owner.
        switches: ``body`` and ``forearm`` are used.
    """

    def __init__(self, hand: HandModel, switches: Switches) -> None:
        self._anatomy = hand.anatomy
        self._switches = switches
        self.mesh = joined([hand.skin("fine"), *self._person_meshes()])

    def transforms(self, pose: FloatArray, seconds: float) -> Float32Array:
        """Return camera_T_rest (1, B, 3, 4) of every bone for a pose (22,) at a time, s."""
        out = np.empty((1, self.mesh.weights.shape[1], 3, 4), dtype=np.float32)
        out[0, :BONE_COUNT] = skinning_transforms(self._anatomy, pose[None])[0]
        first = BONE_COUNT
        for bones in self._person_bones(pose, seconds):
            out[0, first : first + len(bones)] = bones
            first += len(bones)
        return out

    def _person_meshes(self) -> Iterator[SkinnedMesh]:
        scale = self._anatomy.scale
        if self._switches.forearm:
            yield person.forearm_mesh(scale)
        if self._switches.forearm and self._switches.body:
            yield person.upper_arm_mesh(scale)
        if self._switches.body:
            yield person.trunk_mesh()
            yield person.head_mesh()

    def _person_bones(self, pose: FloatArray, seconds: float) -> Iterator[FloatArray]:
        """Yield transforms in the order of the meshes, which are symmetric under x -> -x."""
        left = self._anatomy.is_left
        right_pose = mirrored_poses(pose[None])[0] if left else pose
        for bones in self._right_bones(right_pose, seconds):
            yield bones * _MIRRORED_TRANSFORM if left else bones

    def _right_bones(self, pose: FloatArray, seconds: float) -> Iterator[FloatArray]:
        if self._switches.forearm:
            forearm = person.forearm_bones(pose, self._anatomy.scale)
            yield forearm
            if self._switches.body:
                yield person.upper_arm_bones(forearm[1, :, 3], seconds)
        if self._switches.body:
            yield person.body_bones(seconds)


def room_depth(camera: Camera) -> Float32Array:
    """Return the depth z of the room (height, width), mm: the nearest of all planes and boxes."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([u, v], axis=-1).astype(np.float64)
    rays = camera.points_from_pixels(pixels, np.ones(u.shape))
    depths = [_plane_depth(rays, *plane) for plane in PLANES] + [_box_depth(rays, *box) for box in BOXES]
    return np.asarray(np.min(depths, axis=0), dtype=np.float32)


def _plane_depth(rays: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """Return the depth of a plane along rays (..., 3) with z = 1, infinite if it is missed."""
    slope = rays @ normal
    safe = np.where(slope == 0.0, 1.0, slope)
    depth = np.where(slope == 0.0, np.inf, offset / safe)
    return np.where(depth > 0.0, depth, np.inf)


def _box_depth(rays: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the depth of a box along rays with z = 1 by the slab method, infinite if it is missed."""
    with np.errstate(divide="ignore"):
        first, second = low / rays, high / rays
    enters = np.minimum(first, second).max(axis=-1)
    leaves = np.maximum(first, second).min(axis=-1)
    return np.where((enters <= leaves) & (enters > 0.0), enters, np.inf)


# A Kinect v2's camera, range, noise, and missing readings at depth edges; see ``sensors`` for others.
#
# On the farther side of an edge, light of both surfaces mixes and the projector is shadowed, so the sensor
# drops the reading. ``MISSING_FRACTIONS`` are measured fractions 1 to 8 px outside a hand's edge (hand.md),
# averaged over all edge directions. Holes are correlated: they form patches, mostly on the side of the
# projector's shadow.

CAMERA = Camera(width=512, height=424, fx=365.0, fy=365.0, cx=255.5, cy=211.5, name="camera")
"""Kinect v2 with a central principal point, so that a mirrored scene gives a mirrored image."""

RANGE_MM = (500.0, 4500.0)
"""Measurement range."""

NEAR_SD_MM, SD_PER_M2 = 0.96, 0.086
CORNER_FACTOR = 2.5

MISSING_FRACTIONS = (0.82, 0.65, 0.37, 0.30, 0.24, 0.21, 0.18, 0.16)
REACH_PX = 12.0
"""[ours] Beyond the measured 8 px the fraction falls linearly to 0 at this distance."""

FULL_JUMP_MM = 200.0
"""[ours] Step of the edges that were measured, 300 mm and more, with a margin.

At smaller steps, distances are scaled by FULL_JUMP_MM / step, so that fingers in front of the palm keep
their rim.
"""

PATCH_PX = 2.5
SHADOW_SHARE = 0.55
"""Share of the variance due to the side of the edge; the rest is due to patches."""
SHADOW_SIDE = -1.0
"""Image x direction of the projector's shadow: left."""


def noise_sd(depth: Float32Array, camera: Camera) -> Float32Array:
    """Return the standard deviation of the readings of a depth image (height, width), mm.

    sd(z, r) = (0.96 + 0.086 z^2) (1 + 1.5 r^2), z in metres, r the distance from the principal point
    relative to the farthest corner's. [ours], fitted to measurements of a Kinect v2 (hand.md).
    """
    metres = depth * np.float32(1e-3)
    near = np.float32(NEAR_SD_MM) + np.float32(SD_PER_M2) * metres * metres
    sd: Float32Array = near * _radial_factor(camera)
    return sd


def noisy(depth: Float32Array, camera: Camera, rng: np.random.Generator) -> Float32Array:
    """Return the readings (height, width), mm, of a depth image: with noise, 0 outside the range.

    Args:
        depth: mm, 0 where empty.
        camera: camera of the image.
        rng: draws one number per pixel.
    """
    noise = rng.standard_normal(depth.shape, dtype=np.float32)
    readings = depth + noise * noise_sd(depth, camera)
    low, high = RANGE_MM
    readings[(depth < low) | (readings < low) | (readings > high)] = 0.0
    return readings


def quantised(depth: Float32Array) -> ImageArray:
    """Return depth in the sensor's format: (height, width) uint16, whole millimetres."""
    return np.rint(depth).astype(np.uint16)


def _radial_factor(camera: Camera) -> Float32Array:
    x = np.arange(camera.width) - camera.cx
    y = np.arange(camera.height) - camera.cy
    corner = np.max(np.abs(x)) ** 2 + np.max(np.abs(y)) ** 2
    r2 = (x[None, :] ** 2 + y[:, None] ** 2) / corner
    return np.asarray(1.0 + (CORNER_FACTOR - 1.0) * r2, dtype=np.float32)


def missing_beside_edges(
    depth: Float32Array, rng: np.random.Generator, *, mirrored: bool = False
) -> BoolArray:
    """Draw the missing readings (height, width) at depth edges.

    A pixel at distance x from the nearest edge is missing where U < f(x): f interpolates the measured
    fractions, and U = F(g) is uniform, with g = a sqrt(2) s cos(direction) + sqrt(1 - a^2) n, n a smooth
    Gaussian field of patches, the direction from edge to pixel, and F the distribution of g over all
    directions.

    Args:
        depth: mm, 0 where empty.
        rng: draws one number per pixel.
        mirrored: whether the projector is on the other side.
    """
    patches = smooth_field(depth.shape, PATCH_PX, rng)
    rows, columns, distance, cosine = _band(depth)
    side = -SHADOW_SIDE if mirrored else SHADOW_SIDE
    field = np.sqrt(1.0 - SHADOW_SHARE) * patches[rows, columns] + (
        np.sqrt(2.0 * SHADOW_SHARE) * side * cosine
    )
    missing = np.zeros(depth.shape, dtype=np.bool_)
    missing[rows, columns] = _uniform_of(-field) < missing_fraction(distance)
    return missing


def missing_fraction(distance: FloatArray) -> FloatArray:
    """Return the fraction of missing readings at a distance from an edge, px, counted from 1."""
    count = len(MISSING_FRACTIONS)
    return np.interp(distance, [*range(1, count + 1), REACH_PX], [*MISSING_FRACTIONS, 0.0])


def _band(depth: Float32Array) -> tuple[ImageArray, ImageArray, FloatArray, FloatArray]:
    """Return the pixels on the farther side of edges, within the reach of holes.

    Returns:
        (P,) rows, columns, effective distance from the nearest edge, px, and the cosine of the angle
        between the image's x axis and the direction from edge to pixel.
    """
    import cv2

    edge = nearer_side(depth)
    if not edge.any():
        return np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros(0)
    distance, labels = cv2.distanceTransformWithLabels(
        (~edge).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero((distance > 0.0) & (distance < REACH_PX) & (depth > 0.0))
    edge_rows, edge_columns = np.nonzero(edge)
    pixel_of_label = np.zeros(len(edge_rows) + 1, dtype=np.int64)
    pixel_of_label[labels[edge_rows, edge_columns]] = np.arange(len(edge_rows))
    nearest = pixel_of_label[labels[rows, columns]]
    jump = depth[rows, columns] - depth[edge_rows[nearest], edge_columns[nearest]]
    offset_x, offset_y = columns - edge_columns[nearest], rows - edge_rows[nearest]
    far = jump > JUMP_MM
    pixels = np.hypot(offset_x, offset_y)
    counted = pixels * np.maximum(1.0, FULL_JUMP_MM / np.maximum(jump, JUMP_MM))
    return rows[far], columns[far], counted[far], (offset_x / pixels)[far]


def _uniform_of(field: FloatArray) -> FloatArray:
    grid, probability = _distribution()
    return np.interp(field, grid, probability)


@functools.cache
def _distribution() -> tuple[FloatArray, FloatArray]:
    """Return tabulated F(g) over all directions and patches: the mean of Phi over the circle."""
    from scipy.special import ndtr

    grid = np.linspace(-6.0, 6.0, 601)
    cosines = np.cos((np.arange(64) + 0.5) * (2.0 * np.pi / 64))
    shift = np.sqrt(2.0 * SHADOW_SHARE) * cosines
    probability = ndtr((grid[:, None] - shift) / np.sqrt(1.0 - SHADOW_SHARE)).mean(axis=1)
    return grid, probability


# Frames

SUBJECT = Subject("hand", CAMERA.name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)


@dataclass(frozen=True, eq=False)
class SyntheticHandFrame:
    """One frame with its ground truth.

    Attributes:
        index: position among the existing frames, from 0.
        instant: position among all instants including dropped ones, from 0.
        stamp_ns: time of frame and truth, integer nanoseconds.
        depth: (height, width) uint16, mm, 0 = no reading.
        pose: (22,) of the hand, camera axes.
        twist: (21,) velocity in the tangent space, per second; None for a motion without velocity (A).
        joints: (21, 3) mm, camera axes, in the order of ``JOINT_NAMES``.
    """

    index: int
    instant: int
    stamp_ns: int
    depth: ImageArray
    pose: FloatArray
    twist: FloatArray | None
    joints: FloatArray

    def truth(self) -> Estimate:
        """Return the ground truth as an estimate, without velocity if the motion has none."""
        none = np.zeros(TANGENT_SIZE)
        return Estimate(
            frame_index=self.index,
            stamp_ns=self.stamp_ns,
            status=Status.TRACKING,
            confidence=1.0,
            position=self.pose[:3],
            quaternion=self.pose[3:7],
            shape=self.pose[ANGLES],
            pose_rate=None if self.twist is None else pose_rates(self.pose, self.twist),
            twist=self.twist,
            pose_variance=none,
            twist_variance=None if self.twist is None else none,
            points=self.joints,
            effective_sample_size=0.0,
            resampled=False,
        )

    def joint_states(self) -> messages.JointStates:
        """Return the finger angles."""
        return messages.joint_states(self.truth(), SUBJECT)


@dataclass(frozen=True, eq=False)
class Plan:
    """Synthetic recording without its images.

    Attributes:
        options: options of the recording.
        hand: bones and skin.
        timeline: instants.
        motion: poses and velocities at every instant.
        rng: random stream of the sensor noise, unused so far.
    """

    options: SynthOptions
    hand: HandModel
    timeline: Timeline
    motion: Motion
    rng: np.random.Generator

    @property
    def anatomy(self) -> HandAnatomy:
        """Bones of the hand."""
        return self.hand.anatomy

    @property
    def camera(self) -> Camera:
        """Camera of the sensor."""
        return CAMERA if self.options.sensor == KINECT_2 else SENSORS[self.options.sensor].camera

    @property
    def written(self) -> BoolArray:
        """(T,) whether an instant has a frame."""
        return ~self.timeline.dropped


def make_plan(options: SynthOptions, noise: WalkNoise | None = None) -> Plan:
    """Draw instants and motion of a recording, each from its own random stream.

    Sensor switches therefore do not change poses, and the motion of a seed is the same with and without
    dropped frames.

    Args:
        options: options of the recording.
        noise: noise of the random walks A and B.
    """
    timing, moving, sensing = np.random.default_rng(options.seed).spawn(3)
    switches = options.switches
    timeline = make_timeline(
        options.frames, options.fps, drops=switches.drops, late=switches.late, rng=timing
    )
    motion = make_motion(options, timeline.seconds, moving, noise)
    return Plan(options, options.hand(), timeline, motion, sensing)


def synthesise(
    options: SynthOptions, *, noise: WalkNoise | None = None, device: RenderingDevice | None = None
) -> Iterator[SyntheticHandFrame]:
    """Yield the frames of a synthetic recording.

    Args:
        options: options of the recording.
        noise: noise of the random walks A and B.
        device: rendering device; by default one is opened, and closed at the end.

    Raises:
        RenderingError: no working renderer.
    """
    yield from render_plan(make_plan(options, noise), device=device)


def render_plan(plan: Plan, *, device: RenderingDevice | None = None) -> Iterator[SyntheticHandFrame]:
    """Yield the frames of a plan; see ``synthesise``."""
    with device_or_default(device) as drawing:
        yield from _frames(plan, drawing)


def _frames(plan: Plan, device: RenderingDevice) -> Iterator[SyntheticHandFrame]:
    sensor = _Sensor(plan, device)
    joints = joint_positions(plan.anatomy, plan.motion.poses)
    seconds, twists = plan.timeline.seconds, plan.motion.twists
    for index, instant in enumerate(np.flatnonzero(plan.written).tolist()):
        pose = plan.motion.poses[instant]
        yield SyntheticHandFrame(
            index=index,
            instant=instant,
            stamp_ns=int(plan.timeline.stamps_ns[instant]),
            depth=sensor.image(pose, float(seconds[instant])),
            pose=pose,
            twist=None if twists is None else twists[instant],
            joints=joints[instant],
        )


class _Sensor:
    """Renders the scene and simulates a sensor's readings."""

    def __init__(self, plan: Plan, device: RenderingDevice) -> None:
        self._switches, self._rng = plan.options.switches, plan.rng
        self._mirrored, self._camera = plan.anatomy.is_left, plan.camera
        self._sensor = SENSORS.get(plan.options.sensor)
        self._scene = Scene(plan.hand, self._switches)
        self._window = Window.whole(self._camera)
        size = (self._camera.width, self._camera.height)
        self._renderer = device.depth_renderer(self._scene.mesh, size, most=1)
        room = room_depth(self._camera)
        self._room = room[:, ::-1] if self._mirrored else room

    def image(self, pose: FloatArray, seconds: float) -> ImageArray:
        """Return the readings (height, width) uint16, mm."""
        depth = self._ideal(pose, seconds)
        if self._sensor is not None:
            sensor = self._sensor.limited(noise=self._switches.noise, edges=self._switches.edges)
            return quantised(sensor.readings(depth, self._rng, mirrored=self._mirrored))
        readings = noisy(depth, CAMERA, self._rng) if self._switches.noise else depth.copy()
        if self._switches.edges:
            readings[missing_beside_edges(depth, self._rng, mirrored=self._mirrored)] = 0.0
        return quantised(readings)

    def _ideal(self, pose: FloatArray, seconds: float) -> Float32Array:
        """Return the ideal depth (height, width), mm, 0 where empty."""
        transforms = self._scene.transforms(pose, seconds)
        drawn: Float32Array = self._renderer.depth(transforms, self._camera, self._window)[0]
        if not self._switches.background:
            return drawn
        return np.where(drawn > 0.0, np.minimum(drawn, self._room), self._room)


# MCAP file

PNG_LEVEL = 1
"""Noise hardly compresses: level 9 is ten times slower for a few per cent."""

Report = Callable[[SyntheticHandFrame], None]


def write_synthetic(
    options: SynthOptions,
    out: Path,
    *,
    overwrite: bool = False,
    noise: WalkNoise | None = None,
    report: Report = lambda frame: None,
) -> Synthesis:
    """Write a synthetic recording; equal options give equal bytes on the same machine.

    Depth is 16-bit PNG (foxglove.CompressedImage) on ``/camera/depth/image``, ground truth is on
    ``/truth/hand/...``, and the options are in the metadata ``posetrack.synth``. The file is written as
    ``out`` + ``.part`` and renamed when complete.

    Args:
        options: options of the recording.
        out: output file, named ``*.mcap``.
        overwrite: whether ``out`` may be replaced.
        noise: noise of the random walks A and B.
        report: called with every written frame.

    Raises:
        UsageError: ``out`` exists and may not be replaced, or does not end in ``.mcap``.
        ResultError: the file cannot be written.
        RenderingError: no working GL.
    """
    check_output(out, overwrite=overwrite)
    noise = noise or WalkNoise()
    plan = make_plan(options, noise)
    stamps = plan.timeline.stamps_ns[plan.written]
    record = synth_record(options, _facts(plan, noise))
    frames = reported(render_plan(plan), report)
    with recording_file(out) as sink:
        write_all(sink, record, frames, lambda sink: _Channels(sink, plan.camera, int(stamps[0])))
    return Synthesis(len(stamps), int(plan.timeline.dropped.sum()), float(stamps[-1] - stamps[0]) * 1e-9)


def _facts(plan: Plan, noise: WalkNoise) -> dict[str, str]:
    """Return further metadata entries."""
    options = plan.options
    facts = {
        "frames_written": str(int(plan.written.sum())),
        "velocity": "none" if plan.motion.twists is None else "exact",
        **{f"switch.{name}": str(value).lower() for name, value in asdict(options.switches).items()},
        "anatomy.segments_mm": numbers_text(plan.anatomy.segments),
        "anatomy.base_positions_mm": numbers_text(plan.anatomy.base_positions),
    }
    if options.mesh is not None:
        facts[MESH_DIGEST] = file_digest(Path(options.mesh))[1]
    if options.motion == "A":
        facts["noise.pose_sd"] = numbers_text(options.speed * noise.walk.vector())
    if options.motion == "B":
        facts["noise.pose_sd"] = numbers_text(options.speed * noise.pose.vector())
        facts["noise.velocity_sd"] = numbers_text(options.speed * noise.velocity.vector())
    return facts


class _Channels:
    """Writer of calibration, images and truth."""

    def __init__(self, sink: McapSink, camera: Camera, first_ns: int) -> None:
        self._sink = sink
        calibration = calibration_message(camera, first_ns, camera.name)
        calibrations = sink.channel(CALIBRATION_TOPIC, type(calibration))
        self._images = sink.channel(IMAGE_TOPIC, CompressedImage)
        self._truth = TruthChannels(sink, SUBJECT, "joint_states")
        sink.write(calibrations, first_ns, serialised(calibration))

    def write(self, frame: SyntheticHandFrame) -> None:
        """Write one frame and its ground truth."""
        image = encode_png(frame.depth, PNG_LEVEL)
        message = CompressedImage(frame_id=CAMERA.name, format="png", data=image)
        message.timestamp.FromNanoseconds(frame.stamp_ns)
        self._sink.write(self._images, frame.stamp_ns, serialised(message))
        self._truth.write(frame)
