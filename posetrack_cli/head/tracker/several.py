"""Tracker of all heads in the images of one or more cameras: one head tracker per person **[ours]**.

Heads exclude each other: what shows the face of one is not searched for another. New people are searched for
now and then where no tracked head is. The tracker of a second pass knows the people of the first, and where
each was: ten small patches may match another face as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import cv2
import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.camera import Camera, in_camera_axes
from posetrack_cli.head.adjustment.adjuster import angles_of
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.initialisation.mono import eye_distance_px
from posetrack_cli.head.lens.lens import EstimatedLens
from posetrack_cli.head.tracker.frame_tracker import LONG_AGO_NS, HeadState, TrackState
from posetrack_cli.head.tracker.head_tracker import UNSEEN, HeadTracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import Stamp, floats
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.state_codec import Codec, Maybe, Numbered, codec_of, joined, part_of
from posetrack_cli.tracking.two_pass import Learned

SEARCH_EVERY_NS = 500_000_000
"""Interval of searches for new people; a search in which no face is found takes some 100 ms."""
ABSENT_AFTER_NS, ABSENT_EVERY_NS = 1_000_000_000, 200_000_000
"""A head that is lost for longer is searched for at this interval instead of in every frame."""
COVERED_EYES = (1.25, 1.7)
"""Half axes, across and along the face, of the region that a head covers, in eye distances."""
ONE_FACE_EYES = 0.7
"""Heads closer than this in the image, in eye distances, follow the same face."""
JUMP_NS, JUMP_RATIO = 200_000_000, 1.25
"""Within this time, no head moves by an eye distance or changes its size by this ratio."""
TRAIL_EVERY_NS = 250_000_000
"""Interval of the places of a head that a second pass knows."""
TRAIL_SIZE = 8
GUIDED_NS, GUIDED_EYES = 1_000_000_000, 2.0
"""A place is valid for this time, and this far around it, in eye distances."""
LEAST_FRAMES, LEAST_SHARE = 10, 0.02
"""A person needs this number, and share, of tracked frames; other faces are false detections."""


@dataclass(frozen=True, eq=False)
class Member:
    """One head.

    Attributes:
        state: of its tracker, for one camera or several.
        tracked: number of frames in which it was followed.
        searched_ns: stamp of the last search while it is lost.
        trail: (T, 8) in a first pass: stamp, ns, place (2) and eye distance, pixels of the reference camera,
            ray x/z and y/z, yaw and pitch, rad.
    """

    state: HeadState
    tracked: int = 0
    searched_ns: Stamp = LONG_AGO_NS
    trail: Annotated[FloatArray, floats("trail", TRAIL_SIZE)] = field(
        default_factory=lambda: np.zeros((0, TRAIL_SIZE))
    )

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
    seeker: HeadState | None = None
    sought_ns: Stamp = LONG_AGO_NS
    frames: int = 0


class HeadsTracker:
    """Tracker of several heads; implements ``tracking.two_pass.LearningTracker``.

    Args:
        cameras: of the recording, the reference first.
        trackers: of each known person, for a second pass; of a single unknown one for a first pass.
        trails: of each person in the first pass, see ``Member``; None in the first pass.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        trackers: Sequence[HeadTracker[Any, Any]],
        trails: Sequence[FloatArray] | None = None,
    ) -> None:
        self._cameras, self._trackers = tuple(cameras), tuple(trackers)
        self._knows_people, self._trails = trails is not None, trails or ()
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
        members = tuple(
            self._after(member, found[k], frame.stamp_ns) for k, member in enumerate(state.members)
        )
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
        learned: Learned = {}
        for k, member in enumerate(kept):
            own = self._of(k).learned(member.state, for_second_pass=for_second_pass)
            learned |= {joined(f"{_FACE}{k}", name): values for name, values in own.items()}
            learned[f"{_TRAIL}{k}"] = member.trail
        return learned

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

    def _of(self, k: int) -> HeadTracker[Any, Any]:
        """Return the tracker of a head; in a first pass all have the same."""
        return self._trackers[k if self._knows_people else 0]

    def _followed(self, state: HeadsState, frame: Frame, rng: np.random.Generator) -> dict[int, _Found]:
        """Track the heads seen in the last frame; of two on one face, only the more certain one."""
        found: dict[int, _Found] = {}
        for k, member in enumerate(state.members):
            own = self._of(k).follow(member.state, frame, rng) if member.is_seen else None
            if own is None:
                continue
            found[k] = _Found(*own)
            if self._is_elsewhere(k, found[k], frame.stamp_ns) or self._has_jumped(state, k, found[k]):
                del found[k]
                continue
            for other in [j for j in found if j != k and self._are_one(found[j].state, found[k].state)]:
                del found[min(other, k, key=lambda one: (found[one].estimate.confidence, -one))]
                if k not in found:
                    break
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
            others = [*seen.values(), *found.values()]
            tried = {k: self._search(state, k, others, frame, rng) for k in waiting}
            best = max(waiting, key=lambda k: (tried[k].is_seen, tried[k].state.trust, -k))
            if not tried[best].is_seen:
                return found | tried
            found[best] = tried[best]
            waiting.remove(best)
        return found

    def _search(
        self, state: HeadsState, k: int, others: Sequence[_Found], frame: Frame, rng: np.random.Generator
    ) -> _Found:
        """Search for a lost head where no other head is, or was at that time in the first pass."""
        member = state.members[k]
        places = [self._guide(j, frame.stamp_ns) for j in range(len(self._trails)) if j != k]
        places += [_sought(state.seeker, member)]
        image = self._covered(frame, [one.state for one in others if one.is_seen], places)
        found = _Found(*self._of(k).step(_strict(member, frame.stamp_ns), image, rng))
        if found.is_seen and self._is_elsewhere(k, found, frame.stamp_ns):
            return _Found(*self._of(k).miss(member.state, frame, rng))
        return found

    def _has_jumped(self, state: HeadsState, k: int, found: _Found) -> bool:
        """Whether a track has gone over to another face, near to it or about to become a person."""
        member, now = state.members[k], self._region(found.state)
        before, sought = self._region(member.state), _sought(state.seeker, member)
        if now is None or before is None or member.state.track is None:
            return False
        if sought is not None and now.is_near(sought, ONE_FACE_EYES):
            return True
        is_soon = found.estimate.stamp_ns - member.state.track.stamp_ns <= JUMP_NS
        ratio = now.eye_distance / before.eye_distance
        return is_soon and not (now.is_near(before, 1.0) and 1.0 / JUMP_RATIO < ratio < JUMP_RATIO)

    def _is_elsewhere(self, k: int, found: _Found, stamp_ns: int) -> bool:
        """Whether a head is not where it was in the first pass."""
        own, place = self._guide(k, stamp_ns), self._region(found.state)
        return own is not None and place is not None and not place.is_near(own, GUIDED_EYES)

    def _guide(self, k: int, stamp_ns: int) -> _Region | None:
        """Return where a head was in the first pass; None if unknown."""
        trail = self._trails[k] if k < len(self._trails) else np.zeros((0, TRAIL_SIZE))
        after = int(np.searchsorted(trail[:, 0], stamp_ns))
        near = [row for row in trail[max(after - 1, 0) : after + 1] if abs(row[0] - stamp_ns) <= GUIDED_NS]
        if not near:
            return None
        first, last = near[0], near[-1]
        span = last[0] - first[0]
        share = float(np.clip((stamp_ns - first[0]) / span, 0.0, 1.0)) if span > 0.0 else 0.0
        place = first + share * (last - first)
        return _Region(place[1:3], float(place[3]), 0.0)

    def _seek(self, state: HeadsState, frame: Frame, rng: np.random.Generator) -> tuple[HeadsState, Estimate]:
        """Search for another person."""
        seeker, tracker = state.seeker or self._of(0).start(frame, rng), self._of(0)
        waits = state.members and frame.stamp_ns - state.sought_ns < SEARCH_EVERY_NS
        if waits and seeker.sought is None:
            seeker, estimate = tracker.miss(seeker, frame, rng)
            return replace(state, seeker=seeker), estimate
        known = [member.state for member in state.members if member.is_seen]
        seeker, estimate = tracker.step(seeker, self._covered(frame, known), rng)
        state = replace(state, seeker=seeker, sought_ns=frame.stamp_ns)
        if not tracker.is_known(seeker):
            return state, estimate
        members = (*state.members, Member(seeker, tracked=1))
        # where there is one, there may be another: search in the next frame
        return replace(state, members=members, seeker=None, sought_ns=LONG_AGO_NS), estimate

    def _are_one(self, first: HeadState, second: HeadState) -> bool:
        """Whether two seen heads are at the same place in the reference camera's image."""
        one, other = self._region(first), self._region(second)
        return one is not None and other is not None and one.is_near(other, ONE_FACE_EYES)

    def _after(self, member: Member, found: _Found, stamp_ns: int) -> Member:
        """Return a head after a frame."""
        # not by confidence, which an uncertain focal length limits
        is_tracked = found.is_seen
        due = not member.is_seen and _is_due(member, stamp_ns)
        trail, place = member.trail, self._region(found.state) if is_tracked else None
        is_time = not len(trail) or stamp_ns - trail[-1, 0] >= TRAIL_EVERY_NS
        if place is not None and is_time and not self._knows_people:
            own = found.state.track.pose if found.state.track is not None else UNSEEN
            about = [*(own.position[:2] / own.position[2]), *angles_of(own.facing)]
            trail = np.vstack([trail, [float(stamp_ns), *place.middle, place.eye_distance, *about]])
        searched_ns = stamp_ns if due else member.searched_ns
        return Member(found.state, member.tracked + is_tracked, searched_ns, trail)

    def _region(self, state: HeadState) -> _Region | None:
        """Return the place of a head in the image of the reference camera."""
        return _region(state.track, self._cameras[0])

    def _covered(
        self, frame: Frame, seen: Sequence[HeadState], places: Sequence[_Region | None] = ()
    ) -> Frame:
        """Return a frame in which seen heads, and places of the reference image, are painted over."""
        painted: list[ImageArray | None] = []
        for camera, image in zip(self._cameras, frame.images, strict=True):
            regions = [_region(state.track, camera) for state in seen]
            painted.append(_painted(image, [*regions, *(() if painted else places)]))
        return replace(frame, images=tuple(painted))


def _painted(image: ImageArray | None, regions: Sequence[_Region | None]) -> ImageArray | None:
    """Return an image with some faces painted over."""
    known = [region for region in regions if region is not None]
    if image is None or not known:
        return image
    painted: ImageArray = image.copy()
    grey = float(image.mean())
    for region in known:
        axes = tuple(max(round(region.eye_distance * half), 1) for half in COVERED_EYES)
        middle = tuple(np.rint(region.middle).astype(int).tolist())
        cv2.ellipse(painted, middle, axes, np.degrees(region.roll), 0.0, 360.0, grey, -1)
    return painted


_FAR = 10.0
"""Faces farther outside of the image, in image sides, are of no interest."""
_FACE, _TRAIL = "face", "trail"
"""Name prefixes of a person, and of the trail, among the learned arrays."""


def people_of(learned: Learned) -> list[tuple[Learned, FloatArray]]:
    """Return what is known of each person, and the trail, from the output of ``HeadsTracker.learned``.

    Raises:
        ResultError: a trail is missing or damaged.
    """
    people: list[tuple[Learned, FloatArray]] = []
    while own := part_of(learned, f"{_FACE}{len(people)}"):
        trail = learned.get(f"{_TRAIL}{len(people)}")
        if (
            trail is None
            or trail.dtype != np.float64
            or trail.shape[1:] != (TRAIL_SIZE,)
            or not np.isfinite(trail).all()
        ):
            raise ResultError("checkpoint cannot be used", found="no places of the first pass")
        people.append((own, trail))
    return people


def of_head(lens: EstimatedLens | None, trail: FloatArray) -> EstimatedLens | None:
    """Return an estimated camera for a head with this trail, whose constant errors do not count."""
    if lens is None or not len(trail):
        return lens
    usual = np.median(trail[:, 4:], axis=0)
    return replace(lens, ray=usual[:2], angles=usual[2:])


@dataclass(frozen=True, eq=False)
class _Found:
    """State and estimate of a head after a frame."""

    state: HeadState
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

    def is_near(self, other: _Region, eyes: float) -> bool:
        """Whether another face is within this many eye distances of the smaller one."""
        apart = float(np.linalg.norm(self.middle - other.middle))
        return apart < eyes * min(self.eye_distance, other.eye_distance)


def _region(track: TrackState | None, camera: Camera) -> _Region | None:
    if track is None:
        return None
    pose = track.pose
    pixels = project((camera,), pose.points(track.shape)).pixels[0]
    far = _FAR * max(camera.width, camera.height)
    if not np.isfinite(pixels).all() or np.abs(pixels).max() > far:
        return None
    across = pixels[2:4].mean(axis=0) - pixels[:2].mean(axis=0)
    roll = float(np.arctan2(across[1], across[0]))
    there = HeadPose(in_camera_axes(camera, pose.position), pose.quaternion)
    return _Region(pixels.mean(axis=0), eye_distance_px(there, camera), roll)


def _sought(seeker: HeadState | None, member: Member) -> _Region | None:
    """Return the face of a person who is being initialised and was seen together with a head."""
    if seeker is None or seeker.sought is None or member.state.track is None:
        return None
    if seeker.sought.first_ns > member.state.track.stamp_ns:
        return None  # it may be this head
    return _Region(seeker.sought.middle, seeker.sought.eye_distance, 0.0)


def _away_ns(member: Member, stamp_ns: int) -> int:
    """Return the time since a lost head was seen."""
    track = member.state.track
    return ABSENT_AFTER_NS + 1 if track is None else stamp_ns - track.stamp_ns


def _is_due(member: Member, stamp_ns: int) -> bool:
    """Whether a lost head is searched for in a frame."""
    is_absent = _away_ns(member, stamp_ns) > ABSENT_AFTER_NS
    return not is_absent or stamp_ns - member.searched_ns >= ABSENT_EVERY_NS


def _strict(member: Member, stamp_ns: int) -> HeadState:
    """Return the state to search with: lost, and after a long absence with the look of an average frame."""
    state = replace(member.state, lost=max(member.state.lost, 1))
    return state.after_absence() if _away_ns(member, stamp_ns) > ABSENT_AFTER_NS else state


def make_heads_tracker(
    cameras: Sequence[Camera],
    known: Learned | None,
    make_one: Callable[[Learned | None, FloatArray], HeadTracker[Any, Any]],
) -> HeadsTracker:
    """Return the tracker of all heads in a pass.

    Args:
        cameras: of the recording, the reference first.
        known: output of ``HeadsTracker.learned``, for a second pass.
        make_one: creates the tracker of a head, given what is known of it and its trail.
    """
    if known is None:
        return HeadsTracker(cameras, [make_one(None, np.zeros((0, TRAIL_SIZE)))])
    people = people_of(known)
    return HeadsTracker(cameras, [make_one(*one) for one in people], [trail for _, trail in people])
