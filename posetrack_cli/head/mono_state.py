"""A one-camera tracker's state, and how it becomes arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.cuts import HEIGHT, WIDTH
from posetrack_cli.head.face import POINT_COUNT
from posetrack_cli.head.following import Following
from posetrack_cli.head.mono_config import AdjustmentSettings
from posetrack_cli.head.mono_start.detected import DetectedFace
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.person import KnownPerson
from posetrack_cli.head.person_codec import people_codec
from posetrack_cli.head.start.search import Search
from posetrack_cli.head.state_codecs import POSE, following_codec, search_codec, template_codec
from posetrack_cli.head.templates import TemplateSet
from posetrack_cli.results.layouts import LayoutError, counts, floats, places
from posetrack_cli.tracking.state_codec import Codec, Fields, Maybe, Stacked, Value, flag, stamp, whole

_LEAST_EYES_PX = 1e-3


@dataclass(frozen=True, eq=False)
class MonoState:
    """What a one-camera tracker knows after a frame.

    Attributes:
        people: who was seen so far; empty before a head is first found.
        current: index of the one who is followed.
        following: the head when it was last tracked; None before.
        lost: frames in a row, up to the last one, in which it was not.
        strange: how often since then a face was found that looks like none of the people.
        detected: frames with a face that is to be found in more of them, in the order of time.
        reference: templates of the first of these.
        clicked: points of the first frame that are to be begun with.
        search: what looking for a face came to before one was first found.
        checked_ns: when a doubtful track was last compared with a detection.
        scene: thumbnail of the last frame; None before the first.
        cut: whether the scene changed since a head was last tracked.
        changes: (frame, and index of the person) of every change to another person.
    """

    people: tuple[KnownPerson, ...] = ()
    current: int = 0
    following: Following | None = None
    lost: int = 0
    strange: int = 0
    detected: tuple[DetectedFace, ...] = ()
    reference: TemplateSet | None = None
    clicked: DetectedFace | None = None
    search: Search = field(default_factory=Search)
    checked_ns: int = -(2**62)
    scene: FloatArray | None = None
    cut: bool = False
    changes: tuple[tuple[int, int], ...] = ()

    @property
    def person(self) -> KnownPerson:
        """The person who is followed."""
        return self.people[self.current]

    @property
    def eye_distance(self) -> float | None:
        """Pixels between the eyes of the first face that was detected; None before."""
        if self.detected:
            return self.detected[0].eye_distance
        return None if self.clicked is None else self.clicked.eye_distance

    @property
    def first_templates(self) -> TemplateSet:
        """Templates of the first frame in which a face was detected."""
        if self.reference is None:
            raise RuntimeError("no face was detected yet")  # a state that the tracker never asks so
        return self.reference

    def with_person(self, person: KnownPerson) -> MonoState:
        """Return the state in which more is known of the person followed."""
        people = (*self.people[: self.current], person, *self.people[self.current + 1 :])
        return replace(self, people=people)

    def turned_to(self, index: int, frame_index: int) -> MonoState:
        """Return the state that follows another of the people, or still the same."""
        if index == self.current:
            return self
        return replace(self, current=index, changes=(*self.changes, (frame_index, index)))

    def with_new(self, person: KnownPerson, following: Following, frame_index: int) -> MonoState:
        """Return the state that follows a head that was just found."""
        index = len(self.people)
        changes = self.changes if index == 0 else (*self.changes, (frame_index, index))
        return replace(
            MonoState((*self.people, person), index, following),
            search=self.search,
            scene=self.scene,
            changes=changes,
        )

    def seen(self, face: DetectedFace, templates: TemplateSet) -> MonoState:
        """Return the state with another frame with a face."""
        reference = templates if self.reference is None else self.reference
        return replace(self, detected=(*self.detected, face), reference=reference)

    def not_before(self, stamp_ns: int) -> MonoState:
        """Return the state without frames that were taken earlier: then the search begins anew."""
        if self.detected and self.detected[0].stamp_ns < stamp_ns:
            return replace(self, detected=(), reference=None)
        return self

    def anew(self) -> MonoState:
        """Return the state without the frames collected: they begin no head."""
        return replace(self, detected=(), reference=None)


def state_codec(model: FaceModel, settings: AdjustmentSettings) -> Codec[MonoState]:
    """Return how the states of a tracker with a face model are kept."""
    detected: Codec[DetectedFace] = Fields(
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
    return Fields(
        _state,
        people=people_codec(model, settings),
        current=whole(),
        following=Maybe(following_codec(1)),
        lost=whole(),
        strange=whole(),
        detected=Stacked(detected, "detected"),
        reference=Maybe(template_codec(1)),
        clicked=Maybe(detected),
        search=search_codec(1),
        checked_ns=stamp(),
        scene=(_pixels, Value(floats("scene?"), lambda pixels: pixels if pixels.size else None)),
        cut=flag(),
        changes=(lambda state: np.array(state.changes, dtype=np.int64).reshape(-1, 2), changes),
    )


def _state(**parts: Any) -> MonoState:
    """Only people who are known are followed, and frames with a face have their templates."""
    state = MonoState(**parts)
    if state.current > max(len(state.people) - 1, 0) or (state.following is not None and not state.people):
        raise LayoutError(f"'current' as {state.current}, of {len(state.people)} people")
    if len(_pixels(state)) not in (0, WIDTH * HEIGHT):
        raise LayoutError(f"'scene' of {len(_pixels(state))} pixels, not {WIDTH * HEIGHT}")
    if state.detected and state.reference is None:
        raise LayoutError("no array 'reference.windows'")
    return state


def _pixels(state: MonoState) -> FloatArray:
    """The thumbnail of the last frame, without pixels before the first."""
    return np.zeros(0) if state.scene is None else state.scene


def _detected_face(stamps: int, single: np.ndarray[Any, Any], **parts: Any) -> DetectedFace:
    score, eye_distance, misfit = (float(value) for value in single)
    return DetectedFace(stamp_ns=stamps, score=score, eye_distance=eye_distance, misfit=misfit, **parts)
