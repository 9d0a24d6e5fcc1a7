"""What a one-camera tracker knows after a frame, and whether the scene was cut to another.

A video goes on with another scene, perhaps another person, from one frame to the next **[ours]**. The feature
points cannot tell: ten small patches find something like themselves in any face. But the whole image changes
in a cut, as it never does within a thirtieth of a second of one scene.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.head.config import LARGEST_SCALE
from posetrack_cli.head.face.points import POINT_COUNT
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.face.templates import TemplateSet
from posetrack_cli.head.initialisation.mono import DetectedFace
from posetrack_cli.head.tracker.codecs import (
    COEFFICIENTS,
    POSE,
    history_codecs,
    search_codec,
    template_codec,
    track_codec,
)
from posetrack_cli.head.tracker.frame_tracker import LONG_AGO_NS, HeadState, TrackState
from posetrack_cli.head.tracker.person import KnownPerson
from posetrack_cli.results.layouts import LayoutError, counts, floats, places
from posetrack_cli.tracking.state_codec import Codec, Fields, Maybe, Stacked, Value, flag, real, stamp, whole

WIDTH, HEIGHT = 32, 24
"""Of thumbnails."""
SAME_SCENE = 0.9
"""Correlation of two thumbnails. Heads that move fast before a camera leave it above .95; cuts came to .55,
and to .83 where only the face changed."""
_LEAST_EYES_PX, _LEAST_SCALE = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class Stated:
    """What a result says of a frame.

    Attributes:
        pose: of the head.
        coefficients: (B,) of its deformation, less the mean.
    """

    pose: HeadPose
    coefficients: FloatArray


@dataclass(frozen=True, eq=False)
class MonoState(HeadState):
    """What a one-camera tracker knows after a frame.

    Attributes:
        people: who was seen so far; empty before a head is first found.
        current: index of the one who is tracked.
        strange: how often since then a face was found that looks like none of the people.
        candidates: frames with a face that is to be found in more of them, in the order of time.
        reference: templates of the first of these.
        checked_ns: when a poor fit was last compared with a detection.
        scene: thumbnail of the last frame; None before the first.
        cut: whether the scene changed since a head was last tracked.
        elsewhere: whether a face that looks like nobody was then found at another place, or of another size.
        changes: (frame, and index of the person) of every change to another person.
        trust: the score of the last tracked frame, 0 to 1.
        scale: that images are looked at at, 1 for as recorded; None before a face is first found.
        stated: what the result says of the last frame that was tracked, where that is not the track.
    """

    people: tuple[KnownPerson, ...] = ()
    current: int = 0
    strange: int = 0
    candidates: tuple[DetectedFace, ...] = ()
    reference: TemplateSet | None = None
    checked_ns: int = LONG_AGO_NS
    scene: FloatArray | None = None
    cut: bool = False
    elsewhere: bool = False
    changes: tuple[tuple[int, int], ...] = ()
    trust: float = 0.0
    scale: float | None = None
    stated: Stated | None = None

    @property
    def is_found(self) -> bool:
        """Whether a face was found in any frame so far."""
        return self.track is not None or bool(self.candidates)

    @property
    def is_continuous(self) -> bool:
        """Whether the head may still be about where it was last tracked."""
        return not self.cut

    @property
    def person(self) -> KnownPerson:
        """The person who is tracked."""
        return self.people[self.current]

    @property
    def first_templates(self) -> TemplateSet:
        """Templates of the first candidate."""
        if self.reference is None:
            raise RuntimeError("no face was detected yet")  # a state that the tracker never asks so
        return self.reference

    def update_person(self, person: KnownPerson) -> MonoState:
        """Return the state in which more is known of the person tracked."""
        people = (*self.people[: self.current], person, *self.people[self.current + 1 :])
        return replace(self, people=people)

    def switch_person(self, index: int, frame_index: int) -> MonoState:
        """Return the state that tracks another of the people, or still the same."""
        if index == self.current:
            return self
        return replace(self, current=index, changes=(*self.changes, (frame_index, index)))

    def with_new_person(self, person: KnownPerson, track: TrackState, frame_index: int) -> MonoState:
        """Return the state that tracks a head that was just found."""
        index = len(self.people)
        return replace(
            self.clear_candidates(),
            people=(*self.people, person),
            current=index,
            track=track,
            lost=0,
            strange=0,
            checked_ns=LONG_AGO_NS,
            cut=False,
            elsewhere=False,
            changes=(*self.changes, (frame_index, index)) if index else self.changes,
        )

    def at_scale(self, scale: float) -> MonoState:
        """Return the state that looks at images of another scale; a search that was begun begins anew."""
        if self.scale is None or scale == self.scale:
            return self
        people = tuple(one.seen_larger(scale / self.scale) for one in self.people)
        return replace(self.clear_candidates(), people=people, scale=scale)

    def with_candidate(self, face: DetectedFace, templates: TemplateSet) -> MonoState:
        """Return the state with another frame with a face."""
        reference = templates if self.reference is None else self.reference
        return replace(self, candidates=(*self.candidates, face), reference=reference)

    def drop_before(self, stamp_ns: int) -> MonoState:
        """Return the state without candidates if the first is older: then they are collected anew."""
        outdated = self.candidates and self.candidates[0].stamp_ns < stamp_ns
        return self.clear_candidates() if outdated else self

    def clear_candidates(self) -> MonoState:
        """Return the state without the frames collected: they begin no head."""
        return replace(self, candidates=(), reference=None)


def thumbnail(image: ImageArray) -> FloatArray:
    """Return a small version (HEIGHT * WIDTH,) of an image, zero mean and unit norm; zeros of an even one."""
    small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
    small -= small.mean()
    norm = float(np.linalg.norm(small))
    scaled: FloatArray = small / norm if norm > 0.0 else small
    return scaled


def is_cut(before: FloatArray, after: FloatArray) -> bool:
    """Whether two thumbnails are of different scenes."""
    return float(before @ after) < SAME_SCENE


def mono_codec(people: Codec[tuple[KnownPerson, ...]]) -> Codec[MonoState]:
    """Return how the states of a tracker are kept, given how its people are."""
    candidate: Codec[DetectedFace] = Fields(
        _detected_face,
        stamps=("stamp_ns", stamp()),
        pixels=Value(places(POINT_COUNT, 2)),
        responses=Value(floats(POINT_COUNT)),
        single=(
            lambda face: [face.score, face.eye_distance, face.misfit],
            Value(floats(3, least=(0.0, _LEAST_EYES_PX, 0.0))),
        ),
        pose=POSE,
    )
    changes = Value(
        counts("changes?", 2), lambda array: tuple((int(frame), int(who)) for frame, who in array)
    )
    scene = Value(floats("scene?"), _thumbnail_or_none)
    return Fields(
        _state,
        track=Maybe(track_codec(1)),
        lost=whole(),
        search=search_codec(1),
        first_ns=stamp(),
        **history_codecs(),
        people=people,
        current=whole(),
        strange=whole(),
        candidates=Stacked(candidate, "candidates"),
        reference=Maybe(template_codec(1)),
        checked_ns=stamp(),
        scene=(lambda state: np.zeros(0) if state.scene is None else state.scene, scene),
        cut=flag(),
        elsewhere=flag(),
        changes=(lambda state: np.array(state.changes, dtype=np.int64).reshape(-1, 2), changes),
        trust=real(floats(least=0.0, most=1.0)),
        scale=Maybe(real(floats(least=_LEAST_SCALE, most=LARGEST_SCALE))),
        stated=Maybe(Fields(Stated, pose=POSE, coefficients=Value(floats(COEFFICIENTS)))),
    )


def _state(**parts: Any) -> MonoState:
    """Only people who are known are tracked, at a scale, and candidates have their templates."""
    state = MonoState(**parts)
    if state.current > max(len(state.people) - 1, 0) or (state.track is not None and not state.people):
        raise LayoutError(f"'current' as {state.current}, of {len(state.people)} people")
    if state.candidates and state.reference is None:
        raise LayoutError("no array 'reference.windows'")
    if (state.candidates or state.people) and state.scale is None:
        raise LayoutError("no array 'scale'")
    return state


def _thumbnail_or_none(array: FloatArray) -> FloatArray | None:
    if array.size not in (0, WIDTH * HEIGHT):
        raise LayoutError(f"'scene' of {array.size} pixels, not {WIDTH * HEIGHT}")
    return array if array.size else None


def _detected_face(stamps: int, single: np.ndarray[Any, Any], **parts: Any) -> DetectedFace:
    score, eye_distance, misfit = (float(value) for value in single)
    return DetectedFace(stamp_ns=stamps, score=score, eye_distance=eye_distance, misfit=misfit, **parts)
