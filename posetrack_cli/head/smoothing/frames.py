"""Smoothed track of a head: stored frames, chains of frames, and the output."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.filtering.smoothing import Memory
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT, POSE_SIZE, HeadPose, rigid_model
from posetrack_cli.head.particles.particles import SPEED_LIMITS, velocity_between
from posetrack_cli.head.smoothing.fits import (
    HeadFits,
    PosedFrame,
    make_head_smoother,
    posed_frame,
    with_smoothed_points,
)
from posetrack_cli.head.subject import SKIN_SHARE, WEIGHT, track_model
from posetrack_cli.head.tracker.frame_tracker import HeadState
from posetrack_cli.head.tracker.head_tracker import in_body_axes
from posetrack_cli.phases import phase
from posetrack_cli.results.columns import Layout, LayoutError, check_arrays, counts, floats, stamps, units
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.spool import RESTART_HINT, RecordSpool
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking.smoothing import STATUSES, FrameFacts, SmoothedTrack
from posetrack_cli.tracking.velocity import smoothed_velocities
from posetrack_cli.units import NS_PER_S

# Stored data of frames, and their division into chains

PERSON = "person"
"""Name of the diagnostic that identifies the person."""
AT_REST = np.zeros(2)
AROUND = 3
"""Frames before and after that determine the speed, so that a single outlier does not."""
Record = Mapping[str, np.ndarray[Any, Any]]


@dataclass(frozen=True, eq=False)
class HeadFrame:
    """Stored data of a tracked frame.

    Attributes:
        frame_index, stamp_ns, status, confidence: of its estimate; the status is an index into ``STATUSES``.
        person: index of the person; 0 if people are not distinguished.
        position: (3,) mm, and
        quaternion: (4,) of the reported pose.
        points: (K, 3) mm, camera axes.
        weights: (K,) of the points, 0 to 1.
        mean: (K, 3) mm, the neutral face as known in this frame.
        basis: (K, 3, B) its deformation basis; zeros for unknown components.
        deviations: (B,) standard deviations of the components.
        systematic: (6,) variances of the track's systematic error, which smoothing does not reduce.
        beside: (6,) tangent vector from the pose of the points to the reported one, which includes the skin.
        skin_share: weight of the skin in the reported pose, 0 to 1.
    """

    frame_index: int
    stamp_ns: int
    status: int
    confidence: float
    person: int
    position: FloatArray
    quaternion: FloatArray
    points: FloatArray
    weights: FloatArray
    mean: FloatArray
    basis: FloatArray
    deviations: FloatArray
    systematic: FloatArray = field(default_factory=lambda: np.zeros(POSE_SIZE))
    beside: FloatArray = field(default_factory=lambda: np.zeros(POSE_SIZE))
    skin_share: float = 0.0

    @property
    def is_lost(self) -> bool:
        """Whether the frame has no information about the head."""
        return is_unobserved(STATUSES[self.status], self.confidence)

    @property
    def facts(self) -> FrameFacts:
        """Index, stamp, status and confidence of the frame."""
        return FrameFacts(self.frame_index, self.stamp_ns, STATUSES[self.status], self.confidence)

    @property
    def pose(self) -> HeadPose:
        """Reported pose of the head."""
        return HeadPose(self.position, self.quaternion)

    @property
    def record(self) -> Record:
        """The frame as arrays by name."""
        return {one.name: np.asarray(getattr(self, one.name)) for one in fields(self)}

    @classmethod
    def of_record(cls, record: Record) -> HeadFrame:
        """Return the frame of a record."""
        single = {name: values.item() for name, values in record.items() if values.ndim == 0}
        return cls(**{**record, **single})


class FrameRecorder:
    """Extracts the stored data of tracked frames.

    Args:
        subject: names the diagnostics and the deformation's components.
    """

    def __init__(self, subject: Subject) -> None:
        names = subject.number_names
        self._components = len(subject.shape_names)
        self._weights = [index for index, name in enumerate(names) if name.startswith(WEIGHT)]
        self._person = names.index(PERSON) if PERSON in names else None
        self._skin_share = names.index(SKIN_SHARE) if SKIN_SHARE in names else None

    def frame(self, state: HeadState, estimate: Estimate) -> HeadFrame:
        """Return the stored data of a frame.

        Args:
            state: of the tracker after the frame.
            estimate: of the frame.
        """
        numbers = np.zeros(0) if estimate.numbers is None else estimate.numbers
        weights = np.clip(np.nan_to_num(numbers[self._weights]), 0.0, 1.0)
        person, skin_share = (
            0.0 if index is None else float(np.nan_to_num(numbers[index]))
            for index in (self._person, self._skin_share)
        )
        model = rigid_model(MEAN_SHAPE) if state.track is None else state.track.particles.model
        missing = self._components - model.size
        return HeadFrame(
            estimate.frame_index,
            estimate.stamp_ns,
            STATUSES.index(estimate.status),
            float(estimate.confidence),
            int(person),
            estimate.position,
            estimate.quaternion,
            estimate.points,
            weights,
            model.mean,
            np.pad(model.basis, ((0, 0), (0, 0), (0, missing))),
            np.pad(model.deviations, (0, missing)),
            _systematic(state, estimate),
            _offset_from_points(state, estimate),
            min(max(skin_share, 0.0), 1.0),
        )

    def layouts(self) -> dict[str, Layout]:
        """Return the layouts of a record's arrays."""
        B, K = self._components, POINT_COUNT
        return {
            "frame_index": counts(),
            "stamp_ns": stamps(),
            "status": counts(most=len(STATUSES) - 1),
            "confidence": floats(least=0.0, most=1.0),
            "person": counts(),
            "position": floats(3),
            "quaternion": units(4),
            "points": floats(K, 3),
            "weights": floats(K, least=0.0, most=1.0),
            "mean": floats(K, 3),
            "basis": floats(K, 3, B),
            "deviations": floats(B, least=0.0),
            "systematic": floats(POSE_SIZE, least=0.0),
            "beside": floats(POSE_SIZE),
            "skin_share": floats(least=0.0, most=1.0),
        }

    def blank(self) -> Record:
        """Return an empty record with the names, types and shapes of all records."""
        return {name: np.zeros(layout.shape, layout.dtype) for name, layout in self.layouts().items()}


def is_unobserved(status: Status, confidence: float) -> bool:
    """Whether no head was tracked; a tracked but doubtful frame has a confidence above 0."""
    return status is Status.LOST and confidence <= 0.0


def _offset_from_points(state: HeadState, estimate: Estimate) -> FloatArray:
    """Return the tangent vector from the pose of the points to the reported one; 0 without a head."""
    track = state.track
    # identity, not equality: without skin the estimate contains the track's own array
    if track is None or track.stamp_ns != estimate.stamp_ns or track.pose.position is estimate.position:
        return np.zeros(POSE_SIZE)
    return track.pose.difference(HeadPose(estimate.position, estimate.quaternion))


def _systematic(state: HeadState, estimate: Estimate) -> FloatArray:
    """Return the systematic variances (6,) in an estimate; 0 if the head is lost."""
    missed = is_unobserved(estimate.status, estimate.confidence)
    if state.track is None or missed or estimate.pose_variance is None:
        return np.zeros(POSE_SIZE)
    own = in_body_axes(state.track.particles.variance(), state.track.pose.rotation)[:POSE_SIZE]
    return np.maximum(estimate.pose_variance[:POSE_SIZE] - own, 0.0)


class Link(NamedTuple):
    """A frame in a chain: consecutive frames of one head.

    Attributes:
        frame: stored data.
        begins: first of a chain in the processing order, so the last one in time.
        speed: (2,) of the head, mm/s and rad/s; set by ``with_speeds``.
    """

    frame: HeadFrame
    begins: bool
    speed: FloatArray = AT_REST


class GapLimit:
    """Maximum duration and motion of a head across a gap.

    Args:
        bridge_s: longest gap to bridge.
    """

    def __init__(self, bridge_s: float) -> None:
        self._longest_ns = round(bridge_s * NS_PER_S)

    def in_time(self, earlier: HeadFrame, later: HeadFrame) -> bool:
        """Whether two frames are close enough in time."""
        return later.stamp_ns - earlier.stamp_ns <= self._longest_ns

    def joins(self, earlier: HeadFrame, later: HeadFrame) -> bool:
        """Whether two tracked frames may belong to one chain."""
        if earlier.person != later.person or not self.in_time(earlier, later):
            return False
        dt = (later.stamp_ns - earlier.stamp_ns) / NS_PER_S
        return bool(np.all(np.abs(velocity_between(earlier.pose, later.pose, dt)) <= SPEED_LIMITS))


def chained(frames: Iterable[HeadFrame], limit: GapLimit) -> Iterator[Link]:
    """Yield the frames with their chains.

    Lost frames belong to the chain around them. Where it breaks, or at its end, each of them is a chain of
    its own.

    Args:
        frames: the last one first.
        limit: of gaps.
    """
    later: HeadFrame | None = None
    waiting: list[HeadFrame] = []
    for frame in frames:
        # lost frames wait until the next tracked one decides whether the chain continues across them
        if frame.is_lost:
            waiting.append(frame)
            if later is None or not limit.in_time(frame, later):
                yield from _singletons(waiting)
                later, waiting = None, []
            continue
        joined = later is not None and limit.joins(frame, later)
        yield from (Link(one, begins=False) for one in waiting) if joined else _singletons(waiting)
        yield Link(frame, begins=not joined)
        later, waiting = frame, []
    yield from _singletons(waiting)


def _singletons(frames: Sequence[HeadFrame]) -> Iterator[Link]:
    return (Link(one, begins=True) for one in frames)


def with_speeds(links: Iterable[Link]) -> Iterator[Link]:
    """Yield the links with the speeds of the heads, from ``AROUND`` frames before to as many after.

    Args:
        links: the last one first; lost frames and other chains are ignored.
    """
    chain: list[Link] = []
    done = 0
    for link in links:
        if link.begins:
            yield from (_moving(chain, index) for index in range(done, len(chain)))
            chain, done = [], 0
        chain.append(link)
        if len(chain) - done > AROUND:
            yield _moving(chain, done)
            done += 1
        if done > AROUND:
            chain, done = chain[1:], done - 1
    yield from (_moving(chain, index) for index in range(done, len(chain)))


def _moving(chain: Sequence[Link], index: int) -> Link:
    near = chain[max(0, index - AROUND) : index + AROUND + 1]
    seen = [link.frame for link in near if not link.frame.is_lost]
    if len(seen) < 2:
        return chain[index]
    # the mean velocity over the window is insensitive to the noise of single frames
    later, earlier = seen[0], seen[-1]
    velocity = velocity_between(earlier.pose, later.pose, (later.stamp_ns - earlier.stamp_ns) / NS_PER_S)
    speed = np.array([np.linalg.norm(velocity[:3]), np.linalg.norm(velocity[3:])])
    return chain[index]._replace(speed=speed)


class HeadMemory:
    """Stores every frame of a run, and writes the smoothed track (``tracking.run.FrameMemory``).

    A Kalman filter runs over the fits backwards in time, with the face learned by the end; the smoother then
    runs forwards. Memory use does not grow with the recording: frames and predictions are stored in files
    next to the result.

    Args:
        path: file of the frames; that of the backward pass lies next to it.
        config: of the tracker.
        subject: of the estimates.
        cameras: number of cameras.
        origin: (B,) coefficients of the neutral face in results.
        kept: number of frames kept from an interrupted run.
        number: number of the subject in the result.

    Raises:
        ResultError: here and in every method, if a file cannot be written or read, or is damaged.
    """

    def __init__(
        self,
        path: Path,
        config: HeadStereoConfig | HeadMonoConfig,
        subject: Subject,
        cameras: int,
        origin: FloatArray,
        kept: int = 0,
        number: int = 0,
    ) -> None:
        self._path, self._cameras, self._origin, self._number = path, cameras, origin, number
        self._settings, self._model = config.smoothing, track_model(config)
        self._fits = HeadFits(self._model, cameras)
        self._limit = GapLimit(self._settings.bridge_s)
        self._keeper = FrameRecorder(subject)
        self._spool = RecordSpool(path, kept, self._keeper.blank())

    def remember(self, state: Any, *estimates: Estimate) -> None:
        """Store a frame."""
        (estimate,) = estimates
        self._spool.append(self._keeper.frame(state, estimate).record)

    def flush(self) -> None:
        """Wait until all frames are on disk."""
        self._spool.flush()

    def finish(self, writer: ResultWriter) -> None:
        """Write the smoothed track in the order of time, and delete the stored frames."""
        path = self._path.with_name(f"{self._path.name}.back")
        describe = partial(posed_frame, cameras=self._cameras)
        smoother = make_head_smoother(self._settings, self._fits)
        with SmoothedTrack[PosedFrame](path, smoother, describe) as track:
            with phase("smoothing, backward pass", "frame", len(self._spool)) as advance:
                for link, chain, dt, end in self._linked():
                    memory = _memory(link, end, chain)
                    track.remember(self._fits.belief(memory), link.frame.facts, dt, link.begins, memory)
                    advance(1)
            placed = with_smoothed_points(track.backward(), self._origin)
            with phase("smoothing, forward pass", "frame", len(track)) as advance:
                for estimate in smoothed_velocities(placed, self._model.velocity):
                    writer.write_smoothed(estimate, subject=self._number)
                    advance(1)
            track.delete()
        self._spool.delete()

    def __enter__(self) -> HeadMemory:
        return self

    def __exit__(self, *_: object) -> None:
        """Keep the file, for a run that is resumed."""
        self._spool.close()

    def _linked(self) -> Iterator[tuple[Link, int, float, HeadFrame]]:
        """Yield frames, the last first, with chain number, s to the previous one, and the chain's end."""
        chain, end, last_ns = 0, None, 0
        for link in with_speeds(chained(self._frames(), self._limit)):
            frame = link.frame
            if end is None or link.begins:
                chain, end = chain + 1, frame
            dt = 0.0 if link.begins else (last_ns - frame.stamp_ns) / NS_PER_S
            yield link, chain, dt, end
            last_ns = frame.stamp_ns

    def _frames(self) -> Iterator[HeadFrame]:
        """Yield the validated frames, the last first."""
        layouts = self._keeper.layouts()
        for record in reversed(self._spool):
            try:
                check_arrays(record, layouts)
            except LayoutError as error:
                what = "spool cannot be used"
                raise ResultError(what, where=self._path, found=error, hint=RESTART_HINT) from error
            yield HeadFrame.of_record(record)


def _memory(link: Link, end: HeadFrame, chain: int) -> Memory:
    """Return the data for fits and points, with the face as known at the chain's end."""
    frame = link.frame
    return {
        "tracked": np.concatenate([frame.position, frame.quaternion]),
        "points": frame.points,
        "weights": frame.weights,
        "seen": int(not frame.is_lost),
        "chain": chain,
        "speed": link.speed,
        "systematic": frame.systematic,
        "beside": frame.beside,
        "skin_share": frame.skin_share,
        "neutral": end.mean,
        "basis": end.basis,
        "deviations": end.deviations,
    }
