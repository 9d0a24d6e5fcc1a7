"""Tracker of all heads in the images of one camera: one head tracker per person **[ours]**.

Heads exclude each other: what shows the face of one is not searched for another. New people are searched for
now and then where no tracked head is. The tracker of a second pass knows the people of the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.initialisation.mono import eye_distance_px
from posetrack_cli.head.tracker.codecs import MonoState
from posetrack_cli.head.tracker.frame_tracker import LONG_AGO_NS, TrackState
from posetrack_cli.head.tracker.mono import MonoTracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import Stamp
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.state_codec import Codec, Maybe, Numbered, codec_of, joined, part_of
from posetrack_cli.tracking.two_pass import Learned

SEARCH_EVERY_NS = 500_000_000
"""Interval of searches for new people; a search in which no face is found takes some 100 ms."""
ABSENT_AFTER_NS, ABSENT_EVERY_NS = 1_000_000_000, 200_000_000
"""A head that is lost for longer is searched for at this interval instead of in every frame."""
COVERED_EYES = (1.5, 1.9)
"""Half axes, across and along the face, of the region that a head covers, in eye distances."""
ONE_FACE_EYES = 0.7
"""Heads closer than this in the image, in eye distances, follow the same face."""
LEAST_FRAMES, LEAST_SHARE = 10, 0.02
"""A person needs this number, and share, of tracked frames; other faces are false detections."""


@dataclass(frozen=True, eq=False)
class Member:
    """One head.

    Attributes:
        state: of its tracker.
        tracked: number of frames in which it was tracked.
        searched_ns: stamp of the last search while it is lost.
    """

    state: MonoState
    tracked: int = 0
    searched_ns: Stamp = LONG_AGO_NS

    @property
    def is_seen(self) -> bool:
        """Whether the last frame shows the head."""
        return self.state.track is not None and self.state.lost == 0


@dataclass(frozen=True, eq=False)
class HeadsState:
    """State of all heads after a frame.

    Attributes:
        members: the heads, in order of detection.
        seeker: state of the search for another person; None in a second pass.
        sought_ns: stamp of its last frame.
        frames: number of frames.
    """

    members: tuple[Member, ...] = ()
    seeker: MonoState | None = None
    sought_ns: Stamp = LONG_AGO_NS
    frames: int = 0


class HeadsTracker:
    """Tracker of several heads; implements ``tracking.two_pass.LearningTracker``.

    Args:
        camera: of the recording.
        trackers: of each known person, for a second pass; of a single unknown one for a first pass.
        is_second_pass: whether the people are known.
    """

    def __init__(self, camera: Camera, trackers: Sequence[MonoTracker], *, is_second_pass: bool) -> None:
        self._camera, self._trackers, self._knows_people = camera, tuple(trackers), is_second_pass
        of_head = self._trackers[0].codec
        members = Numbered(codec_of(Member, state=of_head), counted="heads", called="head", most=limits.FACES)
        self.codec: Codec[HeadsState] = codec_of(HeadsState, members=members, seeker=Maybe(of_head))

    @property
    def count(self) -> int:
        """Number of heads in a second pass."""
        return len(self._trackers)

    def start(self, frame: Frame, rng: np.random.Generator) -> HeadsState:
        """Return the state before the first frame."""
        states = [tracker.start(frame, rng) for tracker in self._trackers]
        if self._knows_people:
            return HeadsState(tuple(Member(state) for state in states))
        return HeadsState(seeker=states[0])

    def step(
        self, state: HeadsState, frame: Frame, rng: np.random.Generator
    ) -> tuple[HeadsState, tuple[Estimate, ...]]:
        """Advance all heads by one frame; a first pass also searches for other people."""
        found = self._followed(state, frame, rng)
        found |= self._searched(state, found, frame, rng)
        members = tuple(_after(member, found[k], frame.stamp_ns) for k, member in enumerate(state.members))
        state = replace(state, members=members, frames=state.frames + 1)
        estimates = tuple(found[k].estimate for k in range(len(members)))
        if self._knows_people or len(members) >= limits.FACES:
            return state, estimates
        # the report of a first pass shows the progress of any head
        state, estimate = self._seek(state, frame, rng)
        return state, (*estimates, estimate)[:1]

    def learned(self, state: HeadsState, *, for_second_pass: bool = False) -> Learned:
        """Return what is known of each person, without those of false detections."""
        if not state.members:
            return {}
        least = max(LEAST_FRAMES, LEAST_SHARE * state.frames)
        most = max(member.tracked for member in state.members)
        kept = [member for member in state.members if member.tracked >= min(least, most)]
        return {
            joined(f"{_FACE}{k}", name): values
            for k, member in enumerate(kept)
            for name, values in self._of(k).learned(member.state, for_second_pass=for_second_pass).items()
        }

    def not_found(self, state: HeadsState) -> str:
        """Describe an unsuccessful search; empty once a head was found."""
        if state.members or state.seeker is None:
            return ""
        return str(state.seeker.search)

    def remarks(self, state: HeadsState) -> tuple[str, ...]:
        """Return warnings about a finished run, one line each."""
        if len(state.members) == 1:
            return self._of(0).remarks(state.members[0].state)
        return tuple(
            f"face {k + 1}: {remark}"
            for k, member in enumerate(state.members)
            for remark in self._of(k).remarks(member.state)
        )

    def _of(self, k: int) -> MonoTracker:
        """Return the tracker of a head; in a first pass all have the same."""
        return self._trackers[k if self._knows_people else 0]

    def _followed(self, state: HeadsState, frame: Frame, rng: np.random.Generator) -> dict[int, _Found]:
        """Track the heads seen in the last frame; of two on one face, the less certain one is lost."""
        found: dict[int, _Found] = {}
        for k, member in enumerate(state.members):
            if not member.is_seen:
                continue
            own = _Found(*self._of(k).step(member.state, frame, rng))
            found[k] = own
            for other in [j for j in found if j != k and self._are_one(found[j].state, own.state)]:
                loser = min(other, k, key=lambda one: (found[one].estimate.confidence, -one))
                before = state.members[loser].state
                found[loser] = _Found(*self._of(loser).miss(before, frame, rng))
        return found

    def _searched(
        self, state: HeadsState, seen: dict[int, _Found], frame: Frame, rng: np.random.Generator
    ) -> dict[int, _Found]:
        """Search for the lost heads where no other head is, the best recognised first."""
        found: dict[int, _Found] = {}
        waiting = []
        for k, member in enumerate(state.members):
            if k not in seen and _is_due(member, frame.stamp_ns):
                waiting.append(k)
            elif k not in seen:
                found[k] = _Found(*self._of(k).miss(member.state, frame, rng))
        while waiting:
            image = self._covered(frame, [*seen.values(), *found.values()])
            tried = {
                k: _Found(*self._of(k).step(_strict(state.members[k], frame.stamp_ns), image, rng))
                for k in waiting
            }
            best = max(waiting, key=lambda k: (tried[k].is_seen, tried[k].state.trust, -k))
            if not tried[best].is_seen:
                return found | tried
            found[best] = tried[best]
            waiting.remove(best)
        return found

    def _seek(self, state: HeadsState, frame: Frame, rng: np.random.Generator) -> tuple[HeadsState, Estimate]:
        """Search for another person."""
        seeker, tracker = state.seeker or self._of(0).start(frame, rng), self._of(0)
        waits = state.members and frame.stamp_ns - state.sought_ns < SEARCH_EVERY_NS
        if waits and not seeker.candidates:
            seeker, estimate = tracker.miss(seeker, frame, rng)
            return replace(state, seeker=seeker), estimate
        known = [member.state for member in state.members if member.is_seen]
        seeker, estimate = tracker.step(seeker, self._covered_by(frame, known), rng)
        state = replace(state, seeker=seeker, sought_ns=frame.stamp_ns)
        if not seeker.people:
            return state, estimate
        members = (*state.members, Member(seeker, tracked=1))
        return replace(state, members=members, seeker=None), estimate

    def _are_one(self, first: MonoState, second: MonoState) -> bool:
        """Whether two seen heads are at the same place in the image."""
        one, other = (_region(state.track, self._camera) for state in (first, second))
        if one is None or other is None or first.lost or second.lost:
            return False
        apart = float(np.linalg.norm(one.middle - other.middle))
        return apart < ONE_FACE_EYES * min(one.eye_distance, other.eye_distance)

    def _covered(self, frame: Frame, found: Sequence[_Found]) -> Frame:
        return self._covered_by(frame, [one.state for one in found if one.is_seen])

    def _covered_by(self, frame: Frame, heads: Sequence[MonoState]) -> Frame:
        """Return a frame with the faces of some heads painted over."""
        (image,) = frame.images
        regions = [_region(state.track, self._camera) for state in heads]
        if image is None or not regions:
            return frame
        painted: ImageArray = image.copy()
        grey = float(image.mean())
        for region in regions:
            if region is not None:
                axes = tuple(max(round(region.eye_distance * half), 1) for half in COVERED_EYES)
                middle = tuple(np.rint(region.middle).astype(int).tolist())
                cv2.ellipse(painted, middle, axes, np.degrees(region.roll), 0.0, 360.0, grey, -1)
        return replace(frame, images=(painted,))


_FAR = 10.0
"""Faces farther outside of the image, in image sides, are of no interest."""
_FACE = "face"
"""Name prefix of a person among the learned arrays."""


def people_of(learned: Learned) -> list[Learned]:
    """Return what is known of each person, from the output of ``HeadsTracker.learned``."""
    people: list[Learned] = []
    while own := part_of(learned, f"{_FACE}{len(people)}"):
        people.append(own)
    return people


@dataclass(frozen=True, eq=False)
class _Found:
    """State and estimate of a head after a frame."""

    state: MonoState
    estimate: Estimate

    @property
    def is_seen(self) -> bool:
        return self.state.track is not None and self.state.lost == 0


@dataclass(frozen=True, eq=False)
class _Region:
    """Place of a face in the recorded image, pixels; roll in rad, clockwise."""

    middle: FloatArray
    eye_distance: float
    roll: float


def _region(track: TrackState | None, camera: Camera) -> _Region | None:
    if track is None:
        return None
    pixels = project((camera,), track.pose.points(track.shape)).pixels[0]
    far = _FAR * max(camera.width, camera.height)
    if not np.isfinite(pixels).all() or np.abs(pixels).max() > far:
        return None
    across = pixels[2:4].mean(axis=0) - pixels[:2].mean(axis=0)
    roll = float(np.arctan2(across[1], across[0]))
    return _Region(pixels.mean(axis=0), eye_distance_px(track.pose, camera), roll)


def _away_ns(member: Member, stamp_ns: int) -> int:
    """Return the time since a lost head was seen."""
    track = member.state.track
    return ABSENT_AFTER_NS + 1 if track is None else stamp_ns - track.stamp_ns


def _is_due(member: Member, stamp_ns: int) -> bool:
    """Whether a lost head is searched for in a frame."""
    is_absent = _away_ns(member, stamp_ns) > ABSENT_AFTER_NS
    return not is_absent or stamp_ns - member.searched_ns >= ABSENT_EVERY_NS


def _strict(member: Member, stamp_ns: int) -> MonoState:
    """Return the state to search with: after a long absence a face must look as it usually did."""
    is_absent = _away_ns(member, stamp_ns) > ABSENT_AFTER_NS
    return replace(member.state, cut=True) if is_absent else member.state


def _after(member: Member, found: _Found, stamp_ns: int) -> Member:
    """Return a head after a frame."""
    tracked = member.tracked + (found.estimate.status is not Status.LOST)
    due = not member.is_seen and _is_due(member, stamp_ns)
    return Member(found.state, tracked, stamp_ns if due else member.searched_ns)
