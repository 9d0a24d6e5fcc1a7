"""How what head trackers keep becomes arrays: for checkpoints, model files and second passes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.head.adjustment.views import Album, PersonParameters, PointView
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.face.points import POINT_COUNT
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose, ShapeModel
from posetrack_cli.head.face.templates import WINDOW, TemplateSet
from posetrack_cli.head.initialisation.search import Search
from posetrack_cli.head.model_file import unusable
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.particles.particles import HeadParticles
from posetrack_cli.head.skin.crops import HEIGHT, WIDTH, SkinAlbum, SkinView
from posetrack_cli.head.skin.map import SkinMap
from posetrack_cli.head.subject import SIGNS
from posetrack_cli.head.tracker.frame_tracker import TrackRecord, TrackState
from posetrack_cli.head.tracker.person import IdentityHistory, KnownPerson, person_shape
from posetrack_cli.head.tracker.size import LARGEST_SIZE, SMALLEST_SIZE, Size
from posetrack_cli.results.layouts import Arrays, Layout, LayoutError, counts, floats, places, stamps, units
from posetrack_cli.tracking.confidence import signs_codec
from posetrack_cli.tracking.state_codec import (
    Array,
    Codec,
    Fields,
    Maybe,
    Numbered,
    Stacked,
    Value,
    flag,
    real,
    stamp,
    whole,
)

PEOPLE = "people"
"""Name of the array that says how many there are."""
FOCAL_PX = "focal_px"
"""Name of the array that says at which focal length people were seen."""
_ScoredView: TypeAlias = tuple[float, PointView]
POSE: Codec[HeadPose] = Fields(HeadPose, position=Value(floats(3)), quaternion=Value(units(4)))
COEFFICIENTS = "coefficients?"
"""Name of how many coefficients the deformation of a tracked face has."""
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


def template_codec(cameras: int) -> Codec[TemplateSet]:
    """Return the codec of templates of so many cameras."""
    seen = (cameras, POINT_COUNT)
    return Fields(
        TemplateSet,
        windows=Value(Layout("uint8", (*seen, WINDOW, WINDOW))),
        centres=Value(places(*seen, 2)),
        tangents=Value(places(*seen, 2, 2)),
        seen=Value(Layout("bool", seen)),
        facing=Value(units(3)),
    )


def track_codec(cameras: int) -> Codec[TrackState]:
    """Return the codec of a tracked head with so many cameras."""
    model = Fields(
        ShapeModel,
        mean=Value(floats(POINT_COUNT, 3)),
        basis=Value(floats(POINT_COUNT, 3, COEFFICIENTS)),
        deviations=Value(floats(COEFFICIENTS, least=0.0)),
    )
    particles = Fields(
        _particles,
        pose=POSE,
        coefficients=Value(floats(COEFFICIENTS)),
        deviations=Value(floats("particles", "state components")),
        weights=Value(Layout("float64", ("particles",), least=0.0, most=1.0, shares=True)),
        model=model,
    )
    return Fields(
        TrackState,
        stamp_ns=stamp(),
        pose=POSE,
        velocity=Value(floats(POSE_SIZE)),
        particles=particles,
        shape=Value(floats(POINT_COUNT, 3)),
        templates=Maybe(template_codec(cameras)),
    )


def history_codecs() -> dict[str, Codec[Any]]:
    """Return how it is kept what a track's past frames tell of it, by the state's attributes."""
    record = Fields(TrackRecord, **{name: whole() for name in TrackRecord._fields})
    return {"evidence": signs_codec(len(SIGNS)), "record": record}


def _particles(deviations: np.ndarray[Any, Any], coefficients: Array, **parts: Any) -> HeadParticles:
    wanted = POSE_SIZE + len(coefficients)
    if deviations.shape[1] != wanted:
        raise LayoutError(f"'particles.deviations' of {deviations.shape[1]} components, not {wanted}")
    return HeadParticles(deviations=deviations, coefficients=coefficients, **parts)


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
        size=Maybe(
            Fields(
                Size,
                factor=real(floats(least=SMALLEST_SIZE, most=LARGEST_SIZE)),
                sd=real(floats(least=0.0, most=1.0)),
            )
        ),
        album=_AlbumCodec(model),
        skin=_skin_codec(model),
        skin_map=Maybe(_map_codec()),
        views=Stacked(Fields(_view, **_view_parts(model)), "views"),
        sets=("templates", Stacked(template_codec(1), "sets", least=1)),
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
    return unusable(found, "what --save-model wrote of a run with this face model")


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
