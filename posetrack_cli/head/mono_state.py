"""A one-camera tracker's state, also as arrays and whole numbers: for checkpoints and second passes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.cuts import HEIGHT, WIDTH
from posetrack_cli.head.face.points import POINT_COUNT
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.face.templates import TemplateSet
from posetrack_cli.head.initialisation.detected_face import DetectedFace
from posetrack_cli.head.initialisation.search import Search
from posetrack_cli.head.learned_arrays import template_layouts
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.person_arrays import PEOPLE, check_people, people_layouts, people_of, people_parts
from posetrack_cli.head.state_arrays import (
    Arrays,
    Numbers,
    following_layouts,
    following_of,
    following_parts,
    is_following,
    search_layouts,
    search_of,
    search_parts,
    template_parts,
    templates_of,
)
from posetrack_cli.head.tracker.frame_tracker import TrackState
from posetrack_cli.head.tracker.person import KnownPerson
from posetrack_cli.results.layouts import (
    COUNTS,
    FLAGS,
    STAMPS_NS,
    Layout,
    Range,
    check_arrays,
    check_numbers,
    counts,
    floats,
    group,
    places,
    stamps,
    units,
)

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
    following: TrackState | None = None
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

    def choose_views(self, person: KnownPerson, following: TrackState, frame_index: int) -> MonoState:
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


def parts_of(state: MonoState) -> tuple[Arrays, Numbers]:
    """Take a state apart."""
    arrays: Arrays = search_parts(state.search) | people_parts(state.people)
    arrays["changes"] = np.array(state.changes, dtype=np.int64).reshape(-1, 2)
    arrays |= _detected_parts("detected", state.detected)
    arrays |= _detected_parts("clicked", () if state.clicked is None else (state.clicked,))
    numbers: Numbers = {"lost": state.lost, "strange": state.strange, "current": state.current}
    numbers |= {"checked_ns": state.checked_ns, "cut": int(state.cut)}
    arrays["scene"] = np.zeros(0) if state.scene is None else state.scene
    if state.reference is not None:
        arrays |= template_parts("reference", [state.reference])
    if state.following is not None:
        numbers["stamp_ns"] = state.following.stamp_ns
        arrays |= following_parts(state.following)
    return arrays, numbers


def state_of(
    arrays: Mapping[str, np.ndarray[Any, Any]],
    numbers: Mapping[str, int],
    model: FaceModel,
    settings: AdjustmentSettings,
) -> MonoState:
    """Put a state together from what ``parts_of`` made of it.

    Raises:
        LayoutError: they are of no state of a tracker with this face model.
    """
    check_arrays(arrays, _layouts(arrays, model))
    followed = is_following(arrays)
    check_numbers(numbers, _ranges(int(arrays[PEOPLE]) if PEOPLE in arrays else 0, followed))
    clicked = _detected_of(arrays, "clicked")
    return MonoState(
        people_of(arrays, model, settings),
        numbers["current"],
        following_of(arrays, numbers["stamp_ns"]) if followed else None,
        numbers["lost"],
        numbers["strange"],
        _detected_of(arrays, "detected"),
        templates_of(arrays, "reference")[0] if "reference.seen" in arrays else None,
        clicked[0] if clicked else None,
        search_of(arrays),
        numbers["checked_ns"],
        arrays["scene"] if arrays["scene"].size else None,
        bool(numbers["cut"]),
        tuple((int(frame), int(who)) for frame, who in arrays["changes"]),
    )


def _layouts(arrays: Mapping[str, np.ndarray[Any, Any]], model: FaceModel) -> dict[str, Layout]:
    """What the arrays of a state must be; frames with a face have their templates."""
    detected = group("detected", _detected_layouts("detected"), arrays)
    referred = detected or any(name.startswith("reference.") for name in arrays)
    return {
        "changes": counts("changes?", 2),
        **search_layouts(1),
        **people_layouts(arrays, model),
        **detected,
        **(template_layouts("reference", 1, 1) if referred else {}),
        **group("clicked", _detected_layouts(1), arrays),
        "scene": floats(WIDTH * HEIGHT if "scene" in arrays and arrays["scene"].size else 0),
        **following_layouts(arrays, 1),
    }


def _detected_layouts(length: int | str) -> dict[str, Layout]:
    """What the arrays of faces that were detected must be; no distance between eyes is 0."""
    return {
        "stamps": stamps(length),
        "pixels": places(length, POINT_COUNT, 2),
        "responses": floats(length, POINT_COUNT),
        "single": floats(length, 3, least=(0.0, _LEAST_EYES_PX, 0.0)),
        "positions": floats(length, 3),
        "quaternions": units(length, 4),
    }


def _ranges(people: int, followed: bool) -> dict[str, Range]:
    """Of a state's whole numbers, given how many people it knows and whether one is followed."""
    ranges = {"lost": COUNTS, "strange": COUNTS, "current": (0, max(people - 1, 0))}
    ranges |= {"checked_ns": STAMPS_NS, "cut": FLAGS}
    return ranges | ({"stamp_ns": STAMPS_NS} if followed else {})


def known_state(
    learned: Mapping[str, np.ndarray[Any, Any]], model: FaceModel, settings: AdjustmentSettings
) -> MonoState:
    """Return the state that begins with people whom another tracker has learned.

    Raises:
        ResultError: arrays are missing, or not what a one-camera tracker with this face model learns.
    """
    check_people(learned, model)
    return MonoState(people_of(learned, model, settings))


def _detected_parts(prefix: str, faces: Sequence[DetectedFace]) -> Arrays:
    if not faces:
        return {}
    return {
        f"{prefix}.stamps": np.array([face.stamp_ns for face in faces]),
        f"{prefix}.pixels": np.stack([face.pixels for face in faces]),
        f"{prefix}.responses": np.stack([face.responses for face in faces]),
        f"{prefix}.single": np.array([(face.score, face.eye_distance, face.misfit) for face in faces]),
        f"{prefix}.positions": np.stack([face.pose.position for face in faces]),
        f"{prefix}.quaternions": np.stack([face.pose.quaternion for face in faces]),
    }


def _detected_of(arrays: Mapping[str, np.ndarray[Any, Any]], prefix: str) -> tuple[DetectedFace, ...]:
    names = ("stamps", "pixels", "responses", "single", "positions", "quaternions")
    columns = [arrays.get(f"{prefix}.{name}", ()) for name in names]
    return tuple(
        DetectedFace(int(stamp), pixels, responses, score, distance, HeadPose(position, quaternion), misfit)
        for stamp, pixels, responses, (score, distance, misfit), position, quaternion in zip(
            *columns, strict=True
        )
    )
