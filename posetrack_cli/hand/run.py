"""A run of a hand tracker over a recording."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.filtering.smoothing import Memory
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import BOTH, ONE_OF_TWO, ComponentSettings, HandConfig, deviations_from_print
from posetrack_cli.hand.evidence import DepthEvidence
from posetrack_cli.hand.fit.likelihood import PROPOSALS, RenderedCosts, fits_frames
from posetrack_cli.hand.fit.local_fits import FOREARM_CONFIDENCE, INNER, HandFits
from posetrack_cli.hand.fit.skeleton import NO_INNER, THUMB, inner_of
from posetrack_cli.hand.keypoints.file import KeypointFile
from posetrack_cli.hand.keypoints.hands import KeypointHands
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS, POSE_SIZE
from posetrack_cli.hand.model.hand import MESH_DIGEST, HandModel, dynamics, hand_model, tangent_vector
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.observe.others import HandDrawer
from posetrack_cli.hand.pair import PairState, PairTracker, pinhole
from posetrack_cli.hand.search import Acquisition
from posetrack_cli.hand.smoothing import frame_fits, make_smoother, smoothed_hand
from posetrack_cli.hand.start import (
    NUMBER_NAMES,
    HandTrackerProtocol,
    centre_pose,
    forearm_confidence_of,
    read_pose,
)
from posetrack_cli.hand.state import HandState
from posetrack_cli.hand.swarm import RenderedObjective, SwarmTracker
from posetrack_cli.hand.tracker import HandTracker
from posetrack_cli.losses import Loss
from posetrack_cli.outputs import check_output, part_path
from posetrack_cli.phases import phase
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.recording.keypoints.reading import KeypointUse
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.replay import check_unfinished
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking import options as tracking_options
from posetrack_cli.tracking.options import common_record, deviations_record, frames_ahead, nothing_to_track
from posetrack_cli.tracking.run import Run
from posetrack_cli.tracking.smoothing import FrameFacts, Kept, SmoothedTrack, smoothing_path
from posetrack_cli.tracking.velocity import VelocityModel, smoothed_velocities

# Tracker of a configuration


def make_tracker(
    config: HandConfig,
    hand: HandModel,
    camera: Camera,
    device: RenderingDevice,
    keypoints: KeypointFile | None = None,
    *,
    alone: bool = True,
) -> HandTrackerProtocol[Any]:
    """Return the tracker of ``filter.kind``.

    Args:
        config: parameters.
        hand: the tracked hand.
        camera: of the depth images.
        device: renders the poses.
        keypoints: from another program, for a proposal that fits frames.
        alone: whether no other hand is tracked.

    Raises:
        RenderingError: the device cannot render such a window.
        FilterError: the swarm would not converge.
    """
    scorer = RenderedCosts(device, hand, camera, config.observation, config.filter.particles)
    finder, proposal = None, PROPOSALS[config.filter.proposal]
    if proposal.fits_frames or config.init.method == "auto":
        finder = Acquisition(config, hand, camera)
    is_swarm = config.filter.kind == "pso"
    # the paper's cost uses all readings; fits and the swarm need the hand's
    segment = is_swarm or proposal.fits_frames or config.observation.cost != "paper"
    with_arm = segment and not is_swarm
    observer = Observer(config, hand.anatomy, camera, segment=segment, with_arm=with_arm, follows=True)
    if is_swarm:
        objective = RenderedObjective(device, hand, camera, config)
        return SwarmTracker(config, hand.anatomy, objective, observer, finder)
    keypoint_hands = None
    if keypoints is not None:
        keypoint_hands = KeypointHands(keypoints, camera, hand.anatomy, alone=alone)
    return HandTracker(config, hand.anatomy, scorer, observer, finder, keypoint_hands, alone=alone)


# Two hands


def configs_of(config: HandConfig) -> tuple[HandConfig, ...]:
    """Return the configurations of all hands in view: the reported ones first, the right before the left."""
    hand, side = config.hand, config.hand.side
    if hand.count not in (BOTH, ONE_OF_TWO):
        return (config,)
    first = "left" if hand.count == ONE_OF_TWO and side == "left" else "right"
    sides = (first, "right" if first == "left" else "left")
    hands = (hand.model_copy(update={"side": one}) for one in sides)
    return tuple(config.model_copy(update={"hand": one}) for one in hands)


def tracks_of(config: HandConfig) -> int:
    """Return the number of reported hands."""
    return 2 if config.hand.count == BOTH else 1


def hand_states(state: Any) -> tuple[Any, ...]:
    """Return the states of all hands in a tracker's state."""
    return state.hands if isinstance(state, PairState) else (state,)


def _tracker_of(
    configs: Sequence[HandConfig],
    hands: Sequence[HandModel],
    camera: Camera,
    device: RenderingDevice,
    keypoints: KeypointFile | None,
) -> HandTrackerProtocol[Any]:
    """Return the tracker of one or two hands."""
    if len(configs) == 1:
        return make_tracker(configs[0], hands[0], camera, device, keypoints)
    images = pinhole(camera)
    made = (
        make_tracker(config, hand, images, device, keypoints, alone=False)
        for config, hand in zip(configs, hands, strict=True)
    )
    trackers = [tracker for tracker in made if isinstance(tracker, HandTracker)]
    drawers = [HandDrawer(device, hand, images) for hand in hands]
    return PairTracker(trackers, drawers, camera, tracks_of(configs[0]))


# A run

INIT_METHODS = ("auto", "center")
_REST: FloatArray = np.eye(1, POSE_SIZE, 6)[0]
"""(22,) pose at the origin, without rotation, all angles 0."""
_ACCELERATION = ComponentSettings(position_mm=130.0, rotation_rad=4.0, flexion_rad=7.0, abduction_rad=5.0)
"""Square root of the density of a hand's acceleration, for the velocities in the result."""
_POSE_ERROR = ComponentSettings(position_mm=0.25, rotation_rad=0.005, flexion_rad=0.013, abduction_rad=0.02)
"""Standard deviation of the pose errors, likewise."""


@dataclass(frozen=True)
class RunOptions(tracking_options.RunOptions):
    """Options of a hand run.

    Attributes:
        init: ``auto``, ``center`` or the path of a pose (see ``read_pose``); None for the configuration's.
        keypoints: from another program.
    """

    keypoints: KeypointFile | None = None


class HandRun(Run):
    """A run of the hand tracker over a recording.

    Args:
        recording: depth frames.
        config: parameters.
        options: the rest.
        device: renders the poses.

    Raises:
        UsageError: output not writable, no frame to track, or no start pose in ``options.init``.
        RenderingError: the device cannot render such a window.
    """

    tracker: HandTrackerProtocol[Any]
    _options: RunOptions

    def __init__(
        self, recording: Recording, config: HandConfig, options: RunOptions, device: RenderingDevice
    ) -> None:
        self._config = config = with_init_method(config, options)
        check_run(recording, config, options)
        super().__init__(recording, options, config.output.flush_frames)
        configs = configs_of(config)
        self._hands = hands = [hand_model(one.hand) for one in configs]
        self._camera = recording.cameras[0]
        self.tracker = _tracker_of(configs, hands, self._camera, device, options.keypoints)
        level = config.output.mesh
        self._meshes = [None if level == "none" else hand.skin(level) for hand in hands]
        self.velocity_model = velocity_model(config)
        self._start_pose = _given_pose(options)
        renderer = str(device.info)
        self.cameras = (self._camera,)
        self.subjects = tuple(
            Subject(
                "hand",
                self._camera.name,
                ANGLE_NAMES,
                JOINT_NAMES,
                JOINT_PARENTS,
                None if mesh is None else mesh.triangles,
                number_names=NUMBER_NAMES,
                label=one.hand.side if config.hand.count == BOTH else "",
            )
            for one, mesh in zip(configs[: tracks_of(config)], self._meshes, strict=False)
        )
        self.record = run_record(recording, self._camera, config, options, renderer, self._start_pose)
        self._blank: list[int] = []
        self._use = (
            None if options.keypoints is None else KeypointUse(options.keypoints.name, options.keypoints.sets)
        )

    def start_state(self, frame: Frame, rng: np.random.Generator) -> Any:
        """Return the state at the given start pose, or as configured."""
        if self._start_pose is not None:
            return self.tracker.start(self._start_pose, frame.stamp_ns, rng)
        init = self._config.init
        pose = centre_pose(frame.depth, self._camera, self._hands[0].anatomy, init.depth_mm)
        if init.method == "auto":
            return self.tracker.start_unknown(pose, frame, rng)
        return self.tracker.start(pose, frame.stamp_ns, rng)

    def vertices(self, estimate: Estimate, subject: int = 0) -> FloatArray | None:
        """Return the skin of an estimate; None if no mesh is written."""
        mesh = self._meshes[subject]
        if mesh is None:
            return None
        pose = np.concatenate([estimate.position, estimate.quaternion, estimate.shape])
        thumb = inner_of(estimate.numbers)[THUMB]
        transforms = skinning_transforms(self._hands[subject].anatomy, pose[None], thumb)
        vertices: FloatArray = mesh.posed(transforms.astype(np.float64))[0]
        return vertices

    @contextmanager
    def open_memory(self, writer: ResultWriter) -> Iterator[_Smoothing | None]:
        """Open the smoother's memory; None without smoothing."""
        if not self._options.smooth:
            yield None
            return
        path = smoothing_path(self._options.output)
        with ExitStack() as opened:
            tracks = []
            for number, subject in enumerate(self.subjects):
                fits = frame_fits(self._config, self._hands[number], self._camera_of_fits)
                track = self._smoothed_track(path.with_name(path.name + subject.label), fits, number, writer)
                tracks.append((opened.enter_context(track), fits))
            yield _Smoothing(self, tracks)

    @property
    def _camera_of_fits(self) -> Camera:
        """The camera of the images that trackers see."""
        return self._camera if len(self._hands) == 1 else pinhole(self._camera)

    def _smoothed_track(
        self, path: Path, fits: HandFits | None, number: int, writer: ResultWriter
    ) -> SmoothedTrack[Estimate]:
        smoother = make_smoother(self._config, dynamics(self._config), fits)
        kept = None
        if writer.frames_written:
            start = self.tracker.start(_REST, 0, np.random.default_rng(0))
            frame = {INNER: NO_INNER} if fits is None else fits.keep(None, None, _REST, 0.0)
            like = hand_states(start)[number].particles
            kept = Kept(writer.frames_written, like, frame | {FOREARM_CONFIDENCE: 0.0})
        is_calibrated = fits is not None and self._config.observation.models_pixels
        describe = smoothed_hand(self._hands[number].anatomy, is_calibrated=is_calibrated)
        return SmoothedTrack(path, smoother, describe, kept)

    def on_frame(self, frame: Frame) -> None:
        """Record frames without readings and frames with keypoints."""
        if self._use is not None:
            self._use.see(frame.index, frame.stamp_ns)
        if not frame.depth.any():
            self._blank.append(frame.index)

    def remarks(self, state: Any) -> tuple[str, ...]:
        """Return warnings about missing keypoints and about mostly doubtful frames."""
        unused = () if self._use is None else self._use.remarks
        hands = hand_states(state)[: len(self.subjects)]
        doubtful = (one for one in hands if isinstance(one, HandState) and 2 * one.doubtful > one.frames)
        return (*unused, *dict.fromkeys(_doubt_of(one) for one in doubtful))

    def evidence(self, frames: Sequence[Frame]) -> str:
        """Return what frames show and the likeliest reason why few were tracked, as part of a line."""
        return DepthEvidence(self._recording, self._config, frames).line

    def losses(self) -> tuple[Loss, ...]:
        """Return unreadable data and frames without readings."""
        blank = self._blank
        where = f"frame {blank[0]}" if blank else ""
        return self._recording.losses + (
            (Loss("frames without any reading", len(blank), where),) if blank else ()
        )


def _doubt_of(state: HandState) -> str:
    return (
        f"{state.doubtful} of {state.frames} frames are probably wrong (confidence below 0.5); check them"
        " with posetrack view, and set the hand's shape (--shape, --hand-mesh) or side (--hand-side)"
    )


class _Smoothing:
    """Memory of a smoothed run (``tracking.run.FrameMemory``), with a track per hand."""

    def __init__(
        self, run: HandRun, tracks: Sequence[tuple[SmoothedTrack[Estimate], HandFits | None]]
    ) -> None:
        self._run, self._tracks = run, tracks

    def remember(self, state: Any, *estimates: Estimate) -> None:
        hands = hand_states(state)[: len(estimates)]
        for hand, estimate, (track, fits) in zip(hands, estimates, self._tracks, strict=True):
            frame: Memory = {INNER: inner_of(estimate.numbers)}
            if fits is not None:
                frame = fits.keep(hand.observation, hand.modes, hand.pose, estimate.confidence)
            confidence = np.nan_to_num(forearm_confidence_of(estimate.numbers))
            frame = {**frame, FOREARM_CONFIDENCE: confidence}
            track.remember(hand.particles, FrameFacts.of(estimate), hand.dt, hand.cut, frame)

    def flush(self) -> None:
        for track, _ in self._tracks:
            track.flush()

    def finish(self, writer: ResultWriter) -> None:
        model = self._run.velocity_model
        for number, (track, _) in enumerate(self._tracks):
            with phase("smoothing", "frame", len(track)) as advance:
                for estimate in smoothed_velocities(track.backward(), model, backward=True):
                    writer.write_smoothed(estimate, self._run.vertices(estimate, number), number)
                    advance(1)
            track.delete()


def with_init_method(config: HandConfig, options: RunOptions) -> HandConfig:
    """Return the configuration with the start method of the options."""
    if options.init not in INIT_METHODS:
        return config
    return config.model_copy(update={"init": config.init.model_copy(update={"method": options.init})})


def velocity_model(config: HandConfig) -> VelocityModel | None:
    """Return the model of the result's velocities; None for those of the filter."""
    if config.velocity.method == "filter":
        return None
    return VelocityModel(
        tangent_vector(_ACCELERATION),
        tangent_vector(_POSE_ERROR),
        tangent_vector(config.init.velocity),
    )


def _given_pose(options: RunOptions) -> FloatArray | None:
    known = options.init is None or options.init in INIT_METHODS
    return None if known else read_pose(Path(str(options.init)))


def check_run(recording: Recording, config: HandConfig, options: RunOptions) -> None:
    """Check options before the shape is estimated.

    Raises:
        UsageError: output not writable, smoothing unavailable, no frame to track, or no start pose.
        ResultError: no unfinished result to resume.
    """
    if options.smooth and config.filter.kind == "pso":
        raise UsageError(
            "--smooth cannot be used",
            found="--filter pso, which has no distribution",
            expected="rbpf or pf",
        )
    if options.keypoints is not None and not fits_frames(config):
        raise UsageError(
            "--keypoints cannot be used",
            found=f"--filter {config.filter.kind} --proposal {config.filter.proposal}, which fits no frames",
            expected="--filter rbpf or pf with --proposal guided",
        )
    check_output(options.output, overwrite=options.overwrite or options.resume, source=recording.path)
    if options.resume:
        check_unfinished(part_path(options.output))
    if frames_ahead(recording, options) == 0:
        raise nothing_to_track(recording)
    _given_pose(options)


def run_record(
    recording: Recording,
    camera: Camera,
    config: HandConfig,
    options: RunOptions,
    renderer: str,
    start_pose: FloatArray | None = None,
) -> dict[str, str]:
    """Return the run record: everything the result's bytes depend on, apart from the machine.

    Args:
        recording: recorded by its identity, not its path.
        camera: intrinsics in use.
        config: resolved configuration.
        options: frames, seed and start.
        renderer: name of the driver.
        start_pose: (22,) if read from a file; recorded as ``init.pose``, since the file may change.
    """
    return {
        **common_record("hand", recording, camera, config, options),
        **deviations_record(deviations_from_print(config)),
        "init": config.init.method if start_pose is None else shown_name(Path(str(options.init))),
        "renderer": renderer,
        **({} if config.hand.mesh is None else {MESH_DIGEST: file_digest(Path(config.hand.mesh))[1]}),
        **({} if options.keypoints is None else options.keypoints.record()),
        **({} if start_pose is None else {"init.pose": json.dumps(start_pose.tolist())}),
    }
