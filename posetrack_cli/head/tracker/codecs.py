"""State of the one-camera tracker, and conversion of tracker states to arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, TypeAlias

import cv2
import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import ResultError
from posetrack_cli.head.adjustment.adjuster import Album, PersonParameters, PointView
from posetrack_cli.head.config import LARGEST_SCALE, AdjustmentSettings
from posetrack_cli.head.face.points import COEFFICIENTS, POINT_COUNT, UNSCALED, HeadPose, scaled_pixels
from posetrack_cli.head.face.templates import CAMERAS, TemplateSet
from posetrack_cli.head.initialisation.mono import DetectedFace
from posetrack_cli.head.initialisation.search import Search
from posetrack_cli.head.model_file import damaged_model
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.skin.map import SkinMap
from posetrack_cli.head.skin.matching import HEIGHT, WIDTH, SkinAlbum, SkinView
from posetrack_cli.head.tracker.frame_tracker import LONG_AGO_NS, HeadState, SoughtFace, TrackState
from posetrack_cli.head.tracker.person import (
    IdentityHistory,
    KnownPerson,
    Size,
    person_shape,
)
from posetrack_cli.results.columns import (
    Arrays,
    Layout,
    LayoutError,
    Stamp,
    counts,
    floats,
    places,
    stamps,
    units,
)
from posetrack_cli.tracking.state_codec import (
    Array,
    Codec,
    Fields,
    Maybe,
    Numbered,
    Stacked,
    Value,
    codec_of,
    flag,
    parts_of,
    real,
    stamp,
    whole,
)

# Codecs shared by checkpoints, model files and second passes

PEOPLE = "people"
"""Name of the array with the number of people."""
FOCAL_PX = "focal_px"
"""Name of the array with the focal length at which people were observed."""
_ScoredView: TypeAlias = tuple[float, PointView]
ONE = {CAMERAS: 1}
"""Dimensions of the templates of one camera."""
_LEAST_AREA = 1e-18
"""Minimum area, image pixels, of a crop's pixel."""


def search_codec(cameras: int) -> Codec[Search]:
    """Return the codec of a search with this number of cameras."""

    def build(best: float, counts: Array, order: Array, reasons: Array, times: Array) -> Search:
        frames, swapped = (int(value) for value in counts)
        failures = Counter(dict(zip(reasons.tolist(), times.tolist(), strict=True)))
        return Search(frames, best, failures, tuple(order.tolist()), swapped)

    return Fields(
        build,
        best=("best_score", real(floats(least=0.0))),
        counts=(lambda one: [one.frames, one.swapped], Value(counts(2))),
        order=Value(counts("order?", most=cameras - 1)),
        reasons=(lambda one: list(one.reasons.keys()), Value(Layout("str", ("reasons?",)))),
        times=(lambda one: list(one.reasons.values()), Value(counts("reasons?"))),
    )


def people_codec(model: FaceModel, settings: AdjustmentSettings) -> Codec[tuple[KnownPerson, ...]]:
    """Return the codec of people described by a face model."""

    def known(
        identity: Array,
        offsets: Array,
        history: Array,
        counts: int,
        single: Array,
        sets: tuple[TemplateSet, ...],
        size: Size | None,
        **parts: Any,
    ) -> KnownPerson:
        person = PersonParameters(identity, offsets)
        return KnownPerson(
            person=person,
            history=IdentityHistory(history, settings.average),
            shape=person_shape(model, person, size),
            size=size,
            templates=sets,
            adjusted_frames=counts,
            rms_px=float(single[0]),
            mean_score=float(single[1]),
            **parts,
        )

    one = Fields(
        known,
        identity=("person.identity", Value(floats(model.identity_size))),
        offsets=("person.offsets", Value(floats(POINT_COUNT, 3))),
        history=("history.identities", Value(floats("history", model.identity_size))),
        counts=("adjusted_frames", whole()),
        single=(lambda known: [known.rms_px, known.mean_score], Value(floats(2, missing=True))),
        is_settled=flag(),
        is_held=flag(),
        size=Maybe(codec_of(Size)),
        album=_AlbumCodec(model),
        skin=skin_codec(1, model.deformation_size),
        skin_map=Maybe(map_codec(1)),
        views=Stacked(Fields(_view, **_view_parts(model.deformation_size)), "views"),
        sets=("templates", Stacked(codec_of(TemplateSet, ONE), "sets", least=1)),
    )
    return Numbered(one, counted=PEOPLE, called="person", most=limits.PEOPLE)


def known_people(learned: Arrays, people: Codec[tuple[KnownPerson, ...]]) -> tuple[KnownPerson, ...]:
    """Decode people learned by another tracker with the same face model.

    Raises:
        ResultError: an array is missing or does not have the layout of ``people_codec``.
    """
    try:
        if PEOPLE not in learned:
            raise LayoutError(f"array '{PEOPLE}' is missing")
        return people.from_arrays(learned)
    except LayoutError as error:
        raise damaged_people(error) from error


def damaged_people(found: object) -> ResultError:
    """Return the error for learned people with an unexpected layout."""
    return damaged_model(found, "a model saved by a run with this face model")


class _AlbumCodec(Codec[Album]):
    """Codec of an album's frames with their scores; an empty album has no scores."""

    def __init__(self, model: FaceModel) -> None:
        of_view = {
            name: (_second(take), codec)
            for name, (take, codec) in _view_parts(model.deformation_size).items()
        }
        self._frames: Stacked[_ScoredView] = Stacked(
            Fields(
                lambda scores, **view: (scores, _view(**view)),
                scores=(lambda pair: pair[0], real()),
                **of_view,
            ),
            "album",
        )

    def to_arrays(self, value: Album) -> dict[str, Array]:
        """Return the scores and the stacked frames."""
        pages: Sequence[_ScoredView] = [scored for page in value.pages.values() for scored in page]
        return self._frames.to_arrays(pages) or {"scores": np.zeros(0)}

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layouts of frames if there are any."""
        if any(array.size for array in arrays.values()):
            return self._frames.layouts(arrays)
        return {name: floats(0) for name in arrays}

    def build(self, arrays: Arrays) -> Album:
        """Rebuild the album by adding the frames in order."""
        album = Album()
        for score, view in self._frames.build(arrays):
            album = album.with_view(view, score)
        return album


def skin_codec(cameras: int, deformations: int) -> Codec[SkinAlbum]:
    """Return the codec of the frames with skin, seen by C cameras, with deformations (A,)."""

    def build(placements: Array, **parts: Any) -> SkinView:
        turns = placements[:, :, :2]
        # a rotation with scale has a determinant of half the squared norm; 0.4 allows for rounding
        least = np.maximum(_LEAST_AREA, 0.4 * np.sum(turns**2, axis=(1, 2)))
        if np.any(turns[:, 0, 0] * turns[:, 1, 1] - turns[:, 0, 1] * turns[:, 1, 0] < least):
            raise LayoutError("'placements' are not similarity transforms")
        return SkinView(placements=placements, **parts)

    view: Codec[SkinView] = Fields(
        build,
        view=Fields(_view, **_view_parts(deformations)),
        crops=Value(Layout("uint8", (cameras, HEIGHT, WIDTH))),
        placements=Value(floats(cameras, 2, 3)),
    )
    return Fields(SkinAlbum, views=Stacked(view, "skin"), every_ns=whole())


def map_codec(cameras: int) -> Codec[SkinMap]:
    """Return the codec of a skin map of C cameras."""

    def build(images: Array, positions: Array, quaternions: Array, **parts: Any) -> SkinMap:
        if np.any(np.diff(images) < 0) or images[-1] >= cameras * len(parts["stamps"]):
            raise LayoutError("'images' is not in ascending order")
        return SkinMap(images=images, poses=HeadPose(positions, quaternions), **parts)

    return Fields(
        build,
        stamps=Value(stamps("map views")),
        crops=Value(Layout("uint8", ("map views", cameras, HEIGHT, WIDTH))),
        positions=(lambda found: found.poses.position, Value(floats("map views", 3))),
        quaternions=(lambda found: found.poses.quaternion, Value(units("map views", 4))),
        images=Value(counts("map points")),
        places=Value(floats("map points", 2)),
        points=Value(floats("map points", 3)),
        share=real(floats(least=0.0, most=1.0)),
    )


def _view_parts(deformations: int) -> dict[str, tuple[Callable[[PointView], Any], Codec[Any]]]:
    """Return the fields of a view with deformations (A,), with their codecs."""
    return {
        "stamps": (lambda view: view.stamp_ns, stamp()),
        "pixels": (lambda view: view.pixels, Value(places(POINT_COUNT, 2))),
        "weights": (lambda view: view.weights, Value(floats(POINT_COUNT, least=0.0))),
        "positions": (lambda view: view.pose.position, Value(floats(3))),
        "quaternions": (lambda view: view.pose.quaternion, Value(units(4))),
        "deformations": (lambda view: view.deformation, Value(floats(deformations))),
    }


def _view(
    stamps: int, pixels: Array, weights: Array, positions: Array, quaternions: Array, deformations: Array
) -> PointView:
    return PointView(stamps, pixels, weights, HeadPose(positions, quaternions), deformations)


def _second(take: Callable[[PointView], Any]) -> Callable[[_ScoredView], Any]:
    return lambda pair: take(pair[1])


# Tracker state and detection of scene cuts.
#
# A video may cut to another scene, perhaps with another person **[ours]**. The feature points do not show it,
# because ten small patches match something in any face, but the whole image changes more than it ever does
# between two frames of one scene.

SCENE_WIDTH, SCENE_HEIGHT = 32, 24
"""Size of thumbnails."""
SAME_SCENE = 0.9
"""Minimum correlation of two thumbnails of one scene. Fast heads near the camera stay above 0.95; cuts reach
0.55 to 0.83."""
_LEAST_EYES_PX, _LEAST_SCALE = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class ReportedPose:
    """Pose and deformation reported for a frame.

    Attributes:
        pose: of the head.
        coefficients: of its deformation, relative to the mean.
    """

    pose: HeadPose
    coefficients: Annotated[FloatArray, floats(COEFFICIENTS)]


TURNED_DEG = 30.0
"""Direction from which a reference lacks points on the far side of the face."""


@dataclass(frozen=True, eq=False)
class MonoState(HeadState):
    """State of a one-camera tracker after a frame.

    Attributes:
        people: learned so far; empty before the first detection.
        current: index of the tracked person.
        strange: number of detections unlike all people since the last recognised frame.
        candidates: frames with a face to initialise from, in order of time.
        reference: templates of the first candidate.
        checked_ns: stamp of the last comparison of a poor fit with a detection.
        scene: thumbnail of the last frame; None before the first.
        cut: whether the scene changed since a head was last tracked.
        elsewhere: whether an unknown face was found at another place or of another size after the cut.
        changes: (frame, index of the person) of each change of the person.
        begun_frame: frame in which the first person was begun.
        scale: of the processed images, 1 is unscaled; None before the first detection.
        stated: reported pose of the last tracked frame, if it differs from the track.
    """

    people: tuple[KnownPerson, ...] = ()
    current: int = 0
    strange: int = 0
    candidates: tuple[DetectedFace, ...] = ()
    reference: TemplateSet | None = None
    checked_ns: Stamp = LONG_AGO_NS
    scene: FloatArray | None = None
    cut: bool = False
    elsewhere: bool = False
    changes: tuple[tuple[int, int], ...] = ()
    begun_frame: int = 0
    scale: Annotated[float, floats(least=_LEAST_SCALE, most=LARGEST_SCALE)] | None = None
    stated: ReportedPose | None = None

    @property
    def is_found(self) -> bool:
        """Whether a face was found in any frame so far."""
        return self.track is not None or bool(self.candidates)

    @property
    def sought(self) -> SoughtFace | None:
        """The last candidate."""
        if not self.candidates:
            return None
        last, scale = self.candidates[-1], self.scale or UNSCALED
        middle = scaled_pixels(last.pixels.mean(axis=0), 1.0 / scale)
        return SoughtFace(self.candidates[0].stamp_ns, middle, last.eye_distance / scale)

    def after_absence(self) -> MonoState:
        """Return the state to search with after a long absence: as after a cut."""
        return replace(self, cut=True)

    @property
    def is_continuous(self) -> bool:
        """Whether the head may still be near its last tracked pose."""
        return not self.cut

    @property
    def person(self) -> KnownPerson:
        """The tracked person."""
        return self.people[self.current]

    @property
    def begun_late(self) -> int | None:
        """The frame in which the first person was begun; None if that was possible at once."""
        return self.begun_frame if self.people and self.search.frames else None

    @property
    def is_provisional(self) -> bool:
        """Whether the only person was begun from a turned face in this run."""
        if len(self.people) != 1 or self.person.is_settled or self.person.is_held:
            return False
        return bool(-self.person.templates[0].facing[2] < np.cos(np.radians(TURNED_DEG)))

    @property
    def first_templates(self) -> TemplateSet:
        """Templates of the first candidate."""
        if self.reference is None:
            raise RuntimeError("no face was detected yet")
        return self.reference

    def update_person(self, person: KnownPerson) -> MonoState:
        """Return the state with the tracked person updated."""
        people = (*self.people[: self.current], person, *self.people[self.current + 1 :])
        return replace(self, people=people)

    def switch_person(self, index: int, frame_index: int) -> MonoState:
        """Return the state with another person tracked."""
        if index == self.current:
            return self
        return replace(self, current=index, changes=(*self.changes, (frame_index, index)))

    def with_new_person(self, person: KnownPerson, track: TrackState, frame_index: int) -> MonoState:
        """Return the state with a newly initialised person tracked."""
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
            begun_frame=self.begun_frame if index else frame_index,
            changes=(*self.changes, (frame_index, index)) if index else self.changes,
        )

    def at_scale(self, scale: float) -> MonoState:
        """Return the state for another image scale; collected candidates are discarded."""
        if self.scale is None or scale == self.scale:
            return self
        people = tuple(one.rescaled(scale / self.scale) for one in self.people)
        return replace(self.clear_candidates(), people=people, scale=scale)

    def with_candidate(self, face: DetectedFace, templates: TemplateSet) -> MonoState:
        """Return the state with another candidate frame."""
        reference = templates if self.reference is None else self.reference
        return replace(self, candidates=(*self.candidates, face), reference=reference)

    def drop_before(self, stamp_ns: int) -> MonoState:
        """Discard all candidates if the first is older than a time stamp."""
        outdated = self.candidates and self.candidates[0].stamp_ns < stamp_ns
        return self.clear_candidates() if outdated else self

    def clear_candidates(self) -> MonoState:
        """Return the state without candidate frames."""
        return replace(self, candidates=(), reference=None)


def thumbnail(image: ImageArray) -> FloatArray:
    """Return a thumbnail (SCENE_HEIGHT * SCENE_WIDTH,) of an image, zero mean and unit norm.

    A uniform image gives zeros.
    """
    small = (
        cv2.resize(image, (SCENE_WIDTH, SCENE_HEIGHT), interpolation=cv2.INTER_AREA)
        .astype(np.float64)
        .ravel()
    )
    small -= small.mean()
    norm = float(np.linalg.norm(small))
    scaled: FloatArray = small / norm if norm > 0.0 else small
    return scaled


def is_cut(before: FloatArray, after: FloatArray) -> bool:
    """Whether two thumbnails show different scenes."""
    return float(before @ after) < SAME_SCENE


def mono_codec(people: Codec[tuple[KnownPerson, ...]]) -> Codec[MonoState]:
    """Return the codec of the tracker's state, given that of its people."""
    candidate: Codec[DetectedFace] = Fields(
        _detected_face,
        stamps=("stamp_ns", stamp()),
        pixels=Value(places(POINT_COUNT, 2)),
        responses=Value(floats(POINT_COUNT)),
        single=(
            lambda face: [face.score, face.eye_distance, face.misfit],
            Value(floats(3, least=(0.0, _LEAST_EYES_PX, 0.0))),
        ),
        pose=codec_of(HeadPose),
    )
    changes = Value(
        counts("changes?", 2), lambda array: tuple((int(frame), int(who)) for frame, who in array)
    )
    scene = Value(floats("scene?"), _thumbnail_or_none)
    parts = parts_of(
        MonoState,
        ONE,
        search=search_codec(1),
        people=people,
        candidates=Stacked(candidate, "candidates"),
        scene=(lambda state: np.zeros(0) if state.scene is None else state.scene, scene),
        changes=(lambda state: np.array(state.changes, dtype=np.int64).reshape(-1, 2), changes),
    )
    return Fields(_state, **parts)


def _state(**parts: Any) -> MonoState:
    """Build a state; a track requires a known person and a scale, and candidates their templates."""
    state = MonoState(**parts)
    if state.current > max(len(state.people) - 1, 0) or (state.track is not None and not state.people):
        raise LayoutError(f"'current' is {state.current}, with {len(state.people)} people")
    if state.candidates and state.reference is None:
        raise LayoutError("array 'reference.windows' is missing")
    if (state.candidates or state.people) and state.scale is None:
        raise LayoutError("array 'scale' is missing")
    return state


def _thumbnail_or_none(array: FloatArray) -> FloatArray | None:
    if array.size not in (0, SCENE_WIDTH * SCENE_HEIGHT):
        raise LayoutError(f"'scene' has {array.size} pixels, expected {SCENE_WIDTH * SCENE_HEIGHT}")
    return array if array.size else None


def _detected_face(stamps: int, single: np.ndarray[Any, Any], **parts: Any) -> DetectedFace:
    score, eye_distance, misfit = (float(value) for value in single)
    return DetectedFace(stamp_ns=stamps, score=score, eye_distance=eye_distance, misfit=misfit, **parts)
