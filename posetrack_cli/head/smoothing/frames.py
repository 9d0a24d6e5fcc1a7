"""What is kept of every frame of a head that will be smoothed, and which frames are of one chain."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose, rigid_model
from posetrack_cli.head.particles.particles import SPEED_LIMITS, velocity_between
from posetrack_cli.head.subject import SKIN_SHARE, WEIGHT
from posetrack_cli.head.tracker.estimates import in_body_axes
from posetrack_cli.head.tracker.frame_tracker import HeadState
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.layouts import Layout, counts, floats, stamps, units
from posetrack_cli.tracking.smoothing import STATUSES, FrameFacts
from posetrack_cli.units import NS_PER_S

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
        return says_nothing(STATUSES[self.status], self.confidence)

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


class FrameKeeper:
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
            _beside(state, estimate),
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


def says_nothing(status: Status, confidence: float) -> bool:
    """Whether no head was followed in a frame; one that was, and is doubted, has some confidence."""
    return status is Status.LOST and confidence <= 0.0


def _beside(state: HeadState, estimate: Estimate) -> FloatArray:
    """How far what is stated is from the pose that points tell; nothing without a head in the frame."""
    track = state.track
    if track is None or track.stamp_ns != estimate.stamp_ns or track.pose.position is estimate.position:
        return np.zeros(POSE_SIZE)
    return track.pose.difference(HeadPose(estimate.position, estimate.quaternion))


def _systematic(state: HeadState, estimate: Estimate) -> FloatArray:
    """What an estimate's variances (6,) have beyond those of the frame; nothing where the head is lost."""
    missed = says_nothing(estimate.status, estimate.confidence)
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


class Reach:
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


def chained(frames: Iterable[HeadFrame], reach: Reach) -> Iterator[Link]:
    """Yield the frames with the chains that they belong to.

    Lost frames belong to the chain on both sides of them, or, where that breaks or they are at its end,
    to none: each of them is a chain of its own.

    Args:
        frames: the last one first.
        reach: of a head that is not seen.
    """
    later: HeadFrame | None = None
    waiting: list[HeadFrame] = []
    for frame in frames:
        if frame.is_lost:
            waiting.append(frame)
            if later is None or not reach.in_time(frame, later):
                yield from _alone(waiting)
                later, waiting = None, []
            continue
        joined = later is not None and reach.joins(frame, later)
        yield from (Link(one, begins=False) for one in waiting) if joined else _alone(waiting)
        yield Link(frame, begins=not joined)
        later, waiting = frame, []
    yield from _alone(waiting)


def _alone(frames: Sequence[HeadFrame]) -> Iterator[Link]:
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
