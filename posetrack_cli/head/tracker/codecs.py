"""A head tracker's state, in memory and as bytes."""

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
from posetrack_cli.head.face.points import COEFFICIENTS, POINT_COUNT, HeadPose
from posetrack_cli.head.face.templates import CAMERAS, TemplateSet
from posetrack_cli.head.initialisation.mono import DetectedFace
from posetrack_cli.head.initialisation.search import Search
from posetrack_cli.head.model_file import damaged_model
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.skin.map import SkinMap
from posetrack_cli.head.skin.matching import HEIGHT, WIDTH, SkinAlbum, SkinView
from posetrack_cli.head.tracker.frame_tracker import LONG_AGO_NS, HeadState, TrackState
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

# How what head trackers keep becomes arrays: for checkpoints, model files and second passes


PEOPLE = "people"
"""Name of the array that says how many there are."""
FOCAL_PX = "focal_px"
"""Name of the array that says at which focal length people were seen."""
_ScoredView: TypeAlias = tuple[float, PointView]
ONE = {CAMERAS: 1}
"""Sizes of templates of one camera."""
_LEAST_AREA = 1e-18
"""Pixels of an image that one of a crop takes."""


def search_codec(cameras: int) -> Codec[Search]:
    """Return the codec of a search with so many cameras."""

    def build(best: float, counts: Array, order: Array, reasons: Array, times: Array) -> Search:
        frames, exchanged = (int(value) for value in counts)
        failures = Counter(dict(zip(reasons.tolist(), times.tolist(), strict=True)))
        return Search(frames, best, failures, tuple(order.tolist()), exchanged)

    return Fields(
        build,
        best=("best_score", real(floats(least=0.0))),
        counts=(lambda one: [one.frames, one.exchanged], Value(counts(2))),
        order=Value(counts("order?", most=cameras - 1)),
        reasons=(lambda one: list(one.reasons.keys()), Value(Layout("str", ("reasons?",)))),
        times=(lambda one: list(one.reasons.values()), Value(counts("reasons?"))),
    )


def people_codec(model: FaceModel, settings: AdjustmentSettings) -> Codec[tuple[KnownPerson, ...]]:
    """Return the codec of people whose faces a model makes."""

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
            usual_score=float(single[1]),
            **parts,
        )

    one = Fields(
        known,
        identity=("person.identity", Value(floats(model.identity_size))),
        offsets=("person.offsets", Value(floats(POINT_COUNT, 3))),
        history=("history.identities", Value(floats("history", model.identity_size))),
        counts=("adjusted_frames", whole()),
        single=(lambda known: [known.rms_px, known.usual_score], Value(floats(2, missing=True))),
        is_settled=flag(),
        is_held=flag(),
        size=Maybe(codec_of(Size)),
        album=_AlbumCodec(model),
        skin=_skin_codec(model),
        skin_map=Maybe(_map_codec()),
        views=Stacked(Fields(_view, **_view_parts(model)), "views"),
        sets=("templates", Stacked(codec_of(TemplateSet, ONE), "sets", least=1)),
    )
    return Numbered(one, counted=PEOPLE, called="person", most=limits.PEOPLE)


def known_people(learned: Arrays, people: Codec[tuple[KnownPerson, ...]]) -> tuple[KnownPerson, ...]:
    """Return the people whom another tracker with the same face model has learned, by their codec.

    Raises:
        ResultError: an array is missing, or not as ``people_codec`` states it.
    """
    try:
        if PEOPLE not in learned:
            raise LayoutError(f"no array '{PEOPLE}'")
        return people.from_arrays(learned)
    except LayoutError as error:
        raise unusable_people(error) from error


def unusable_people(found: object) -> ResultError:
    """Return the error that says what of learned arrays is not as it must be."""
    return damaged_model(found, "a model saved by a run with this face model")


class _AlbumCodec(Codec[Album]):
    """An album's frames with their scores, page by page; of an empty one there are no scores."""

    def __init__(self, model: FaceModel) -> None:
        of_view = {name: (_second(take), codec) for name, (take, codec) in _view_parts(model).items()}
        self._frames: Stacked[_ScoredView] = Stacked(
            Fields(
                lambda scores, **view: (scores, _view(**view)),
                scores=(lambda pair: pair[0], real()),
                **of_view,
            ),
            "album",
        )

    def to_arrays(self, value: Album) -> dict[str, Array]:
        """Return the scores and what ``Stacked`` makes of the frames."""
        pages: Sequence[_ScoredView] = [scored for page in value.pages.values() for scored in page]
        return self._frames.to_arrays(pages) or {"scores": np.zeros(0)}

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layouts of frames if there are any."""
        if any(array.size for array in arrays.values()):
            return self._frames.layouts(arrays)
        return {name: floats(0) for name in arrays}

    def build(self, arrays: Arrays) -> Album:
        """Return the album that the frames were put into one after the other."""
        album = Album()
        for score, view in self._frames.build(arrays):
            album = album.with_view(view, score)
        return album


def _skin_codec(model: FaceModel) -> Codec[SkinAlbum]:
    """Return the codec of the frames that show the skin."""

    def build(placement: Array, **parts: Any) -> SkinView:
        (a, b), (c, d) = turn = placement[:, :2]
        if a * d - b * c < max(_LEAST_AREA, 0.4 * np.sum(turn**2)):  # .5 of what is only turned and scaled
            raise LayoutError("'placement' that does not just turn, scale and move a crop")
        return SkinView(placement=placement, **parts)

    view: Codec[SkinView] = Fields(
        build,
        view=Fields(_view, **_view_parts(model)),
        crop=Value(Layout("uint8", (HEIGHT, WIDTH))),
        placement=Value(floats(2, 3)),
    )
    return Fields(SkinAlbum, views=Stacked(view, "skin"), every_ns=whole())


def _map_codec() -> Codec[SkinMap]:
    """Return the codec of a map of the skin."""

    def build(views: Array, positions: Array, quaternions: Array, **parts: Any) -> SkinMap:
        if np.any(np.diff(views) < 0) or views[-1] >= len(parts["stamps"]):
            raise LayoutError("'views' that do not rise from view to view")
        return SkinMap(views=views, poses=HeadPose(positions, quaternions), **parts)

    return Fields(
        build,
        stamps=Value(stamps("map views")),
        crops=Value(Layout("uint8", ("map views", HEIGHT, WIDTH))),
        positions=(lambda found: found.poses.position, Value(floats("map views", 3))),
        quaternions=(lambda found: found.poses.quaternion, Value(units("map views", 4))),
        views=Value(counts("map points")),
        places=Value(floats("map points", 2)),
        points=Value(floats("map points", 3)),
        share=real(floats(least=0.0, most=1.0)),
    )


def _view_parts(model: FaceModel) -> dict[str, tuple[Callable[[PointView], Any], Codec[Any]]]:
    """What a view is taken apart into."""
    return {
        "stamps": (lambda view: view.stamp_ns, stamp()),
        "pixels": (lambda view: view.pixels, Value(places(POINT_COUNT, 2))),
        "weights": (lambda view: view.weights, Value(floats(POINT_COUNT, least=0.0))),
        "positions": (lambda view: view.pose.position, Value(floats(3))),
        "quaternions": (lambda view: view.pose.quaternion, Value(units(4))),
        "deformations": (lambda view: view.deformation, Value(floats(model.deformation_size))),
    }


def _view(
    stamps: int, pixels: Array, weights: Array, positions: Array, quaternions: Array, deformations: Array
) -> PointView:
    return PointView(stamps, pixels, weights, HeadPose(positions, quaternions), deformations)


def _second(take: Callable[[PointView], Any]) -> Callable[[_ScoredView], Any]:
    return lambda pair: take(pair[1])


# What a one-camera tracker knows after a frame, and whether the scene was cut to another.
#
# A video goes on with another scene, perhaps another person, from one frame to the next **[ours]**. The
# feature points cannot tell: ten small patches find something like themselves in any face. But the whole
# image changes in a cut, as it never does within a thirtieth of a second of one scene.


SCENE_WIDTH, SCENE_HEIGHT = 32, 24
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
        coefficients: of its deformation, less the mean.
    """

    pose: HeadPose
    coefficients: Annotated[FloatArray, floats(COEFFICIENTS)]


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
    checked_ns: Stamp = LONG_AGO_NS
    scene: FloatArray | None = None
    cut: bool = False
    elsewhere: bool = False
    changes: tuple[tuple[int, int], ...] = ()
    trust: Annotated[float, floats(least=0.0, most=1.0)] = 0.0
    scale: Annotated[float, floats(least=_LEAST_SCALE, most=LARGEST_SCALE)] | None = None
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
    """Return a small version (SCENE_HEIGHT * SCENE_WIDTH,) of an image, zero mean and unit norm.

    An even image gives zeros.
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
    if array.size not in (0, SCENE_WIDTH * SCENE_HEIGHT):
        raise LayoutError(f"'scene' of {array.size} pixels, not {SCENE_WIDTH * SCENE_HEIGHT}")
    return array if array.size else None


def _detected_face(stamps: int, single: np.ndarray[Any, Any], **parts: Any) -> DetectedFace:
    score, eye_distance, misfit = (float(value) for value in single)
    return DetectedFace(stamp_ns=stamps, score=score, eye_distance=eye_distance, misfit=misfit, **parts)
