"""The smoothed track of a head."""

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

# What is kept of every frame of a head that will be smoothed, and which frames are of one chain


PERSON = "person"
"""Of the diagnostics, the number that tells people apart."""
AT_REST = np.zeros(2)
AROUND = 3
"""Frames before and after that tell how fast a head is: a single wild one does not make it fast."""
Record = Mapping[str, np.ndarray[Any, Any]]


@dataclass(frozen=True, eq=False)
class HeadFrame:
    """One frame of a head as it was tracked.

    Attributes:
        frame_index, stamp_ns, status, confidence: as of its estimate; the status is a place in ``STATUSES``.
        person: which of several; 0 where they are not told apart.
        position: (3,) mm, and
        quaternion: (4,) of the pose.
        points: (K, 3) mm, where they were found, camera axes.
        weights: (K,) how much each counts, 0 to 1.
        mean: (K, 3) mm, the neutral face as the tracker then knew it,
        basis: (K, 3, B) how it deforms; zeros for components that it did not know yet, and
        deviations: (B,) by how much.
        systematic: (6,) variances that its estimate states beyond the frame's own: what the whole track is
            wrong by, which no smoothing takes away.
        beside: (6,) tangent vector from the pose that its points tell to the one stated, by the skin, too.
        skin_share: how far the one stated is the skin's, 0 to 1.
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
        """Whether the frame says nothing about the head."""
        return is_unobserved(STATUSES[self.status], self.confidence)

    @property
    def facts(self) -> FrameFacts:
        """What its estimate says of the frame."""
        return FrameFacts(self.frame_index, self.stamp_ns, STATUSES[self.status], self.confidence)

    @property
    def pose(self) -> HeadPose:
        """Where the head is."""
        return HeadPose(self.position, self.quaternion)

    @property
    def record(self) -> Record:
        """The frame as arrays by name."""
        return {one.name: np.asarray(getattr(self, one.name)) for one in fields(self)}

    @classmethod
    def of_record(cls, record: Record) -> HeadFrame:
        """Return the frame that a record is of."""
        single = {name: values.item() for name, values in record.items() if values.ndim == 0}
        return cls(**{**record, **single})


class FrameRecorder:
    """Makes of a tracker's frames what is kept of them.

    Args:
        subject: names the diagnostics, and the deformation's components.
    """

    def __init__(self, subject: Subject) -> None:
        names = subject.number_names
        self._components = len(subject.shape_names)
        self._weights = [index for index, name in enumerate(names) if name.startswith(WEIGHT)]
        self._person = names.index(PERSON) if PERSON in names else None
        self._skin_share = names.index(SKIN_SHARE) if SKIN_SHARE in names else None

    def frame(self, state: HeadState, estimate: Estimate) -> HeadFrame:
        """Return what is kept of a frame.

        Args:
            state: the tracker's after it.
            estimate: of it.
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
        """Return what the arrays of a record must be."""
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
        """Return a record such as all others are: of the same names, types and shapes."""
        return {name: np.zeros(layout.shape, layout.dtype) for name, layout in self.layouts().items()}


def is_unobserved(status: Status, confidence: float) -> bool:
    """Whether no head was followed in a frame; one that was, and is doubted, has some confidence."""
    return status is Status.LOST and confidence <= 0.0


def _offset_from_points(state: HeadState, estimate: Estimate) -> FloatArray:
    """How far what is stated is from the pose that points tell; nothing without a head in the frame."""
    track = state.track
    if track is None or track.stamp_ns != estimate.stamp_ns or track.pose.position is estimate.position:
        return np.zeros(POSE_SIZE)
    return track.pose.difference(HeadPose(estimate.position, estimate.quaternion))


def _systematic(state: HeadState, estimate: Estimate) -> FloatArray:
    """What an estimate's variances (6,) have beyond those of the frame; nothing where the head is lost."""
    missed = is_unobserved(estimate.status, estimate.confidence)
    if state.track is None or missed or estimate.pose_variance is None:
        return np.zeros(POSE_SIZE)
    own = in_body_axes(state.track.particles.variance(), state.track.pose.rotation)[:POSE_SIZE]
    return np.maximum(estimate.pose_variance[:POSE_SIZE] - own, 0.0)


class Link(NamedTuple):
    """A frame in a chain of frames that show one head without a break.

    Attributes:
        frame: as it was tracked.
        begins: whether it is the first of a chain, as they are gone through: the last one in time.
        speed: (2,) of the head, mm/s and rad/s; not known before ``with_speeds``.
    """

    frame: HeadFrame
    begins: bool
    speed: FloatArray = AT_REST


class GapLimit:
    """How far a head may have moved while it was not seen, and how long it may have been away.

    Args:
        bridge_s: a head that is lost for no longer is bridged.
    """

    def __init__(self, bridge_s: float) -> None:
        self._longest_ns = round(bridge_s * NS_PER_S)

    def in_time(self, earlier: HeadFrame, later: HeadFrame) -> bool:
        """Whether no more time lies between two frames."""
        return later.stamp_ns - earlier.stamp_ns <= self._longest_ns

    def joins(self, earlier: HeadFrame, later: HeadFrame) -> bool:
        """Whether two frames that are not lost may show one head without a break."""
        if earlier.person != later.person or not self.in_time(earlier, later):
            return False
        dt = (later.stamp_ns - earlier.stamp_ns) / NS_PER_S
        return bool(np.all(np.abs(velocity_between(earlier.pose, later.pose, dt)) <= SPEED_LIMITS))


def chained(frames: Iterable[HeadFrame], limit: GapLimit) -> Iterator[Link]:
    """Yield the frames with the chains that they belong to.

    Lost frames belong to the chain on both sides of them, or, where that breaks or they are at its end,
    to none: each of them is a chain of its own.

    Args:
        frames: the last one first.
        limit: of a head that is not seen.
    """
    later: HeadFrame | None = None
    waiting: list[HeadFrame] = []
    for frame in frames:
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
        links: the last one first; lost frames do not count, nor those of other chains.
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
    later, earlier = seen[0], seen[-1]
    velocity = velocity_between(earlier.pose, later.pose, (later.stamp_ns - earlier.stamp_ns) / NS_PER_S)
    speed = np.array([np.linalg.norm(velocity[:3]), np.linalg.norm(velocity[3:])])
    return chain[index]._replace(speed=speed)


# The memory of a head run that is smoothed: frames on the way forward, the smoothed track in the end


class HeadMemory:
    """Remembers every frame of a run, and writes the smoothed track (``tracking.run.FrameMemory``).

    The frames are gone through twice more. From the last to the first a Kalman filter runs over their fits,
    backwards in time, with the face as it was known in the end; then the smoother goes on from the first to
    the last. What is held does not grow with the recording: the frames, and what the filter expects of each,
    are in files beside the result.

    Args:
        path: of the file of frames; that of the way back lies beside it.
        config: the tracker's.
        subject: what is tracked.
        cameras: how many see it.
        origin: (B,) what the coefficients of the neutral face are called in results.
        kept: of an interrupted run's frames, so many stay.

    Raises:
        ResultError: here and in every method, when a file cannot be written or read, or holds what no run
            wrote.
    """

    def __init__(
        self,
        path: Path,
        config: HeadStereoConfig | HeadMonoConfig,
        subject: Subject,
        cameras: int,
        origin: FloatArray,
        kept: int = 0,
    ) -> None:
        self._path, self._cameras, self._origin = path, cameras, origin
        self._settings, self._model = config.smoothing, track_model(config)
        self._fits = HeadFits(self._model, cameras)
        self._limit = GapLimit(self._settings.bridge_s)
        self._keeper = FrameRecorder(subject)
        self._spool = RecordSpool(path, kept, self._keeper.blank())

    def remember(self, state: Any, estimate: Estimate) -> None:
        """Keep what is needed of a frame."""
        self._spool.append(self._keeper.frame(state, estimate).record)

    def flush(self) -> None:
        """Wait until everything is on the disk."""
        self._spool.flush()

    def finish(self, writer: ResultWriter) -> None:
        """Write the smoothed track, the first frame first, and forget the frames."""
        path = self._path.with_name(f"{self._path.name}.back")
        describe = partial(posed_frame, cameras=self._cameras)
        smoother = make_head_smoother(self._settings, self._fits)
        with SmoothedTrack[PosedFrame](path, smoother, describe) as track:
            with phase("smoothing, way back", "frame", len(self._spool)) as advance:
                for link, chain, dt, end in self._linked():
                    memory = _memory(link, end, chain)
                    track.remember(self._fits.belief(memory), link.frame.facts, dt, link.begins, memory)
                    advance(1)
            placed = with_smoothed_points(track.backward(), self._origin)
            with phase("smoothing, way on", "frame", len(track)) as advance:
                for estimate in smoothed_velocities(placed, self._model.velocity):
                    writer.write_smoothed(estimate)
                    advance(1)
            track.delete()
        self._spool.delete()

    def __enter__(self) -> HeadMemory:
        return self

    def __exit__(self, *_: object) -> None:
        """Let the file lie, for a run that is resumed."""
        self._spool.close()

    def _linked(self) -> Iterator[tuple[Link, int, float, HeadFrame]]:
        """Yield frames, the last first, with their chain's number, s to the last one, and the chain's end."""
        chain, end, last_ns = 0, None, 0
        for link in with_speeds(chained(self._frames(), self._limit)):
            frame = link.frame
            if end is None or link.begins:
                chain, end = chain + 1, frame
            dt = 0.0 if link.begins else (last_ns - frame.stamp_ns) / NS_PER_S
            yield link, chain, dt, end
            last_ns = frame.stamp_ns

    def _frames(self) -> Iterator[HeadFrame]:
        """The frames, the last first, each known to be what a run wrote."""
        layouts = self._keeper.layouts()
        for record in reversed(self._spool):
            try:
                check_arrays(record, layouts)
            except LayoutError as error:
                what = "spool cannot be used"
                raise ResultError(what, where=self._path, found=error, hint=RESTART_HINT) from error
            yield HeadFrame.of_record(record)


def _memory(link: Link, end: HeadFrame, chain: int) -> Memory:
    """What fits and places need of a frame, with the face as it was known at its chain's end."""
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
