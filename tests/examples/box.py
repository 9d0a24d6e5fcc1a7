"""A subject of one's own, from beginning to end: a rigid box in depth images.

Everything that a box needs and no other subject has: what it is (``SUBJECT``, ``SKIN``), how its poses are
counted (``RigidSpace``), how an image scores them and a frame changes what is known (``BoxTracker``), where a
run begins (``BoxRun``), and what is measured of a result (``BOX``). Loop, checkpoints, result, truth, figures
and pictures are those of hands and heads.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from posetrack_cli.arrays import FloatArray
from posetrack_cli.configuration import Settings
from posetrack_cli.evaluation.measuring import pose_metrics
from posetrack_cli.evaluation.measuring.evaluation import Curve
from posetrack_cli.evaluation.measuring.measures import Matched, Measures, Metric
from posetrack_cli.evaluation.measuring.subjects.kind import SubjectKind
from posetrack_cli.filtering.filters import MarginalState, Prior
from posetrack_cli.filtering.model import Dynamics, FilterModel
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.mcap.sink import McapSink, serialised
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.conversion import CALIBRATION_TOPIC, IMAGE_TOPIC
from posetrack_cli.recording.image_files import encode_png
from posetrack_cli.recording.message_cameras import calibration_message
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.port import Comparison, RenderingDevice, Window
from posetrack_cli.results.columns import Layout, floats
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.messages import JointStates
from posetrack_cli.synthesis.recording import TruthChannels, recording_file, write_all
from posetrack_cli.tracking.options import RunOptions, common_record
from posetrack_cli.tracking.run import Run
from posetrack_cli.tracking.state_codec import Codec, Fields, Value, stamp

CAMERA = Camera(80, 60, 90.0, 90.0, 39.5, 29.5, name="box_camera")
SIDES_MM = np.array([160.0, 110.0, 70.0])
CORNERS: FloatArray = (
    0.5 * SIDES_MM * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
)
_QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
SKIN = SkinnedMesh(
    CORNERS,
    np.ones((8, 1)),
    np.array([triangle for a, b, c, d in _QUADS for triangle in ((a, b, c), (a, c, d))]),
)
SUBJECT = Subject(
    name="box",
    camera_frame=CAMERA.name,
    shape_names=(),
    point_names=tuple(f"corner_{k}" for k in range(8)),
    point_parents=(-1, 0, 0, 1, 0, 1, 2, 3),
    triangles=SKIN.triangles,
    lines=tuple((a, b) for a, b in combinations(range(8), 2) if (a ^ b).bit_count() == 1),  # its edges
)
FRAME_NS = 33_333_333
FIRST_NS = 1_700_000_000_000_000_000


class RigidSpace:
    """Poses (N, 7), position and quaternion, with tangent vectors (N, 6); rotations are the body's."""

    def retract(self, x: FloatArray, delta: FloatArray) -> FloatArray:
        """Return x (+) delta."""
        turned = rotations.multiply(x[:, 3:], rotations.exponential(delta[:, 3:]))
        return np.concatenate([x[:, :3] + delta[:, :3], rotations.canonical(turned)], axis=1)

    def local(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return y (-) x."""
        between = rotations.logarithm(rotations.multiply(rotations.conjugate(x[..., 3:]), y[..., 3:]))
        return np.concatenate([y[..., :3] - x[..., :3], between], axis=-1)

    def mean(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the weighted mean (7,)."""
        return np.concatenate([weights @ x[:, :3], rotations.mean_quaternion(x[:, 3:], weights)])

    def log_volume(self, delta: FloatArray) -> FloatArray:
        """Return what turning does to volume; see the hand's."""
        half_turns = np.linalg.norm(delta[..., 3:], axis=-1) / (2.0 * np.pi)
        return 2.0 * np.log(np.sinc(half_turns))


class BoxSettings(Settings):
    """A box tracker's configuration.

    Attributes:
        particles: their number.
        clamp_mm: no pixel's difference counts for more.
        temperature: of the likelihood, pixels.
    """

    particles: int = 400
    clamp_mm: float = 40.0
    temperature: float = 4.0


@dataclass(frozen=True, eq=False)
class BoxState:
    """What is known after a frame."""

    particles: MarginalState
    stamp_ns: int


class BoxTracker:
    """A marginalised particle filter whose likelihood compares rendered boxes with the whole image."""

    def __init__(self, settings: BoxSettings, camera: Camera, device: RenderingDevice) -> None:
        self._settings, self._camera, self._window = settings, camera, Window.whole(camera)
        tile = (camera.width, camera.height)
        self._renderer = device.depth_renderer(SKIN, tile, settings.particles)
        noise = np.repeat([20.0, 0.15], 3) ** 2
        velocity_noise = np.repeat([300.0, 2.0], 3) ** 2
        self._model = FilterModel(
            Dynamics(noise, velocity_noise), RigidSpace(), Resampling("systematic", 0.5)
        )

    @property
    def codec(self) -> Codec[BoxState]:
        """How states are kept."""
        count = self._settings.particles
        particles = Fields(
            MarginalState,
            poses=Value(Layout("float64", (count, 7), unit=(3, 7))),
            velocities=Value(floats(count, 6)),
            velocity_variance=Value(floats(6, least=0.0)),
            log_weights=Value(floats(count, least=-np.inf)),
        )
        return Fields(BoxState, particles=particles, stamp_ns=stamp())

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> BoxState:
        """Return what is known of a box near a pose (7,), a frame before the first."""
        prior = Prior(pose, np.repeat([15.0, 0.2], 3), np.repeat([100.0, 1.0], 3))
        particles = MarginalState.initial(prior, self._settings.particles, self._model.space, rng)
        return BoxState(particles, stamp_ns - FRAME_NS)

    def step(self, state: BoxState, frame: Frame, rng: np.random.Generator) -> tuple[BoxState, Estimate]:
        """Advance by one frame."""
        observed = frame.depth.astype(np.float32)
        dt = (frame.stamp_ns - state.stamp_ns) * 1e-9

        def log_likelihood(poses: FloatArray) -> FloatArray:
            return -self._costs(poses, observed) / self._settings.temperature

        particles, posterior = state.particles.step(dt, self._model, log_likelihood, rng)
        seen = max(int((observed > 0).sum()), 1)
        misfit = float(self._costs(posterior.pose[None], observed)[0]) / seen
        assert isinstance(particles, MarginalState) and posterior.velocity is not None
        rate = rotations.quaternion_rate(posterior.pose[3:], posterior.velocity[3:])
        estimate = Estimate(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            status=Status.TRACKING if misfit < 0.5 else Status.LOST,
            confidence=max(0.0, 1.0 - misfit),
            position=posterior.pose[:3],
            quaternion=posterior.pose[3:],
            shape=np.zeros(0),
            pose_rate=np.concatenate([posterior.velocity[:3], rate]),
            twist=posterior.velocity,
            pose_variance=posterior.pose_variance,
            twist_variance=posterior.velocity_variance,
            points=posed(posterior.pose),
            effective_sample_size=posterior.effective_sample_size,
            resampled=posterior.resampled,
            cost=misfit * self._settings.clamp_mm,
        )
        return BoxState(particles, frame.stamp_ns), estimate

    def _costs(self, poses: FloatArray, observed: Any) -> FloatArray:
        """Pixels (N,) that differ, those of both by the share of ``clamp_mm`` that their depths do."""
        clamp = self._settings.clamp_mm
        comparison = Comparison(observed, clamp)
        sums = self._renderer.sums(transforms(poses), self._camera, self._window, comparison)
        return sums.error / clamp + sums.unread + sums.observed - sums.both


class BoxRun(Run):
    """One run of the box tracker, which begins near a pose that is given."""

    tracker: BoxTracker

    def __init__(
        self,
        recording: Recording,
        settings: BoxSettings,
        options: RunOptions,
        device: RenderingDevice,
        pose: FloatArray,
    ) -> None:
        super().__init__(recording, options, flush_frames=5)
        self._pose = pose
        self.tracker = BoxTracker(settings, self.cameras[0], device)
        self.subjects = (SUBJECT,)
        self.record = common_record("box", recording, self.cameras[0], settings, options)

    def start_state(self, frame: Frame, rng: np.random.Generator) -> BoxState:
        """Return the state at the pose that is given."""
        return self.tracker.start(self._pose, frame.stamp_ns, rng)

    def vertices(self, estimate: Estimate, subject: int = 0) -> FloatArray:
        """Return the corners."""
        return estimate.points


def transforms(poses: FloatArray) -> Any:
    """Return the bone transforms (N, 1, 3, 4) of poses (N, 7)."""
    matrices = rotations.matrices_from_quaternions(poses[:, 3:])
    return np.concatenate([matrices, poses[:, :3, None]], axis=2)[:, None].astype(np.float32)


def posed(pose: FloatArray) -> FloatArray:
    """Return the corners (8, 3) of a box at a pose (7,), mm."""
    corners: FloatArray = CORNERS @ rotations.matrices_from_quaternions(pose[None, 3:])[0].T + pose[:3]
    return corners


def true_pose(index: int) -> FloatArray:
    """Return where the box is in a frame: it sways and turns, (7,)."""
    t = index / 30.0
    turned = rotations.exponential(
        np.array([[0.5 + 0.6 * np.sin(t), 0.8 * np.sin(1.3 * t), 0.3 * np.cos(t)]])
    )
    position = np.array([40.0 * np.sin(1.7 * t), 25.0 * np.cos(1.1 * t), 600.0 + 60.0 * np.sin(t)])
    return np.concatenate([position, rotations.canonical(turned)[0]])


@dataclass(frozen=True, eq=False)
class BoxFrame:
    """A synthetic frame (``synthesis.recording.SyntheticFrame``)."""

    index: int
    depth: FloatArray

    @property
    def stamp_ns(self) -> int:
        """When it was taken, ns."""
        return FIRST_NS + self.index * FRAME_NS

    def truth(self) -> Estimate:
        """Where the box is, without doubt."""
        pose, nothing = true_pose(self.index), np.zeros(6)
        return Estimate(
            frame_index=self.index,
            stamp_ns=self.stamp_ns,
            status=Status.TRACKING,
            confidence=1.0,
            position=pose[:3],
            quaternion=pose[3:],
            shape=np.zeros(0),
            pose_rate=None,
            twist=None,
            pose_variance=nothing,
            twist_variance=None,
            points=posed(pose),
            effective_sample_size=None,
            resampled=False,
        )

    def joint_states(self) -> JointStates:
        """Nothing: a box does not move in itself."""
        return JointStates()


def write_boxes(path: Path, count: int, device: RenderingDevice) -> None:
    """Write a recording of a moving box with its truth; there is nothing else, and no noise."""
    renderer = device.depth_renderer(SKIN, (CAMERA.width, CAMERA.height), 1)

    def frames() -> Iterator[BoxFrame]:
        for index in range(count):
            drawn = renderer.depth(transforms(true_pose(index)[None]), CAMERA, Window.whole(CAMERA))
            yield BoxFrame(index, np.rint(drawn[0]).astype(np.uint16))

    with recording_file(path) as sink:
        write_all(sink, {}, frames(), _Channels)


class _Channels:
    """Puts calibration, images and truth on their topics."""

    def __init__(self, sink: McapSink) -> None:
        self._sink = sink
        calibration = calibration_message(CAMERA, FIRST_NS, CAMERA.name)
        sink.write(sink.channel(CALIBRATION_TOPIC, type(calibration)), FIRST_NS, serialised(calibration))
        self._images = sink.channel(IMAGE_TOPIC, CompressedImage)
        self._truth = TruthChannels(sink, SUBJECT, "joint_states")

    def write(self, frame: BoxFrame) -> None:
        """Write one frame and the truth about it."""
        image = CompressedImage(frame_id=CAMERA.name, format="png", data=encode_png(frame.depth, 1))
        image.timestamp.FromNanoseconds(frame.stamp_ns)
        self._sink.write(self._images, frame.stamp_ns, serialised(image))
        self._truth.write(frame)


def measure(measures: Measures, matched: Matched, missed: int = 0) -> Curve | None:
    """Add the distance of the corners and of the middle, and the angle between the boxes."""
    position = (matched.of_estimate("position"), matched.of_truth("position"))
    rotation = (matched.of_estimate("quaternion"), matched.of_truth("quaternion"))
    corners = matched.of_estimate("points", slice(None)) - matched.of_truth("points", slice(None))
    measures.add("position_mm", pose_metrics.distances(*position))
    measures.add("rotation_deg", pose_metrics.rotation_errors_deg(*rotation))
    measures.add_parts("corner_error_mm", np.linalg.norm(corners, axis=2), SUBJECT.point_names)
    return None


BOX = SubjectKind(
    name="box",
    body="Box",
    metrics=(
        Metric("position_mm", "mm", "Distance between the estimated and the true middle of the box."),
        Metric("rotation_deg", "deg", "Angle between the estimated and the true box, 0 to 180."),
        Metric("corner_error_mm", "mm", "Distance between an estimated and the true corner.", "point"),
    ),
    measure=measure,
    parts={"point": SUBJECT.point_names},
    point_part="point",
    shape_part="",
    point_metric="corner_error_mm",
    key_figures=("coverage", "position_mm.mean", "rotation_deg.mean", "corner_error_mm.mean"),
    studied_figures=(),
    lead=("corner_error_mm",),
    readings=("corner_error_mm",),
    worst_by=("corner_error_mm",),
)
