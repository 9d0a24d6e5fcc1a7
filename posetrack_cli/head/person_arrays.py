"""People as arrays: for checkpoints, model files and second passes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.head.adjustment.views import Album, Person, PointView
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.face.points import POINT_COUNT
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.learned_arrays import template_layouts, unusable
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.state_arrays import Arrays, template_parts, templates_of
from posetrack_cli.head.tracker.person import IdentityHistory, KnownPerson, shape_of
from posetrack_cli.results.layouts import (
    Layout,
    LayoutError,
    check_arrays,
    counts,
    floats,
    group,
    places,
    stamps,
    units,
)

PEOPLE = "people"
"""Name of the array that says how many there are."""
_VIEW = ("stamps", "pixels", "weights", "positions", "quaternions", "deformations")


def people_parts(people: Sequence[KnownPerson]) -> Arrays:
    """Take people apart; of none, nothing."""
    if not people:
        return {}
    arrays: Arrays = {PEOPLE: np.array(len(people))}
    for index, one in enumerate(people):
        arrays |= {f"person{index}.{name}": values for name, values in _parts(one).items()}
    return arrays


def people_of(
    arrays: Mapping[str, np.ndarray[Any, Any]], model: FaceModel, settings: AdjustmentSettings
) -> tuple[KnownPerson, ...]:
    """Put people together from what ``people_parts`` made of them."""
    count = int(arrays[PEOPLE]) if PEOPLE in arrays else 0
    return tuple(_person(_of(arrays, index), model, settings) for index in range(count))


def check_people(arrays: Mapping[str, np.ndarray[Any, Any]], model: FaceModel) -> None:
    """Refuse arrays that no one-camera tracker with this face model has learned.

    Raises:
        ResultError: one is missing, or not as ``people_layouts`` states it.
    """
    try:
        if PEOPLE not in arrays:
            raise LayoutError(f"no array '{PEOPLE}'")
        check_arrays(arrays, people_layouts(arrays, model))
    except LayoutError as error:
        raise unusable_people(error) from error


def unusable_people(found: object) -> ResultError:
    """Return the error that says what of learned arrays is not as it must be."""
    return unusable(found, "what --save-model wrote of a run with this face model")


def people_layouts(arrays: Mapping[str, np.ndarray[Any, Any]], model: FaceModel) -> dict[str, Layout]:
    """Return what the arrays of the people in a file must be, frames only where there are any.

    Raises:
        LayoutError: it says wrongly how many people there are.
    """
    if not any(name == PEOPLE or name.startswith("person") for name in arrays):
        return {}
    check_arrays(arrays, {PEOPLE: counts(most=limits.PEOPLE)})
    layouts: dict[str, Layout] = {}
    for index in range(int(arrays[PEOPLE])):
        one = f"person{index}."
        of_one = _layouts(_of(arrays, index), model)
        layouts |= {f"{one}{name}": layout.named(one) for name, layout in of_one.items()}
    return layouts


def _layouts(own: Arrays, model: FaceModel) -> dict[str, Layout]:
    """What one person's arrays must be."""
    album = group("album", _view_layouts("album", model), (name for name, array in own.items() if array.size))
    scores = {"album.scores": floats("album" if album else 0)} if album or "album.scores" in own else {}
    return {
        "identity": floats(model.identity_size),
        "offsets": floats(POINT_COUNT, 3),
        "history": floats("history", model.identity_size),
        "counts": counts(),
        "single": floats(2, missing=True),
        **group("views", _view_layouts("views", model), own),
        **album,
        **scores,
        **template_layouts("sets", 1),
    }


def _view_layouts(length: str, model: FaceModel) -> dict[str, Layout]:
    """What the arrays of ``_VIEW`` must be."""
    layouts = (
        stamps(length),
        places(length, POINT_COUNT, 2),
        floats(length, POINT_COUNT, least=0.0),
        floats(length, 3),
        units(length, 4),
        floats(length, model.deformation_size),
    )
    return dict(zip(_VIEW, layouts, strict=True))


def _of(arrays: Mapping[str, np.ndarray[Any, Any]], index: int) -> Arrays:
    prefix = f"person{index}."
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _parts(one: KnownPerson) -> Arrays:
    scores = [score for page in one.album.pages.values() for score, _ in page]
    kept = [view for page in one.album.pages.values() for _, view in page]
    return (
        {
            "identity": one.person.identity,
            "offsets": one.person.offsets,
            "history": one.history.identities,
            "counts": np.array(one.adjusted_frames),
            "single": np.array([one.rms_px, one.usual_score]),
            "album.scores": np.array(scores),
        }
        | _view_parts("views", one.views)
        | _view_parts("album", kept)
        | template_parts("sets", one.sets)
    )


def _person(arrays: Arrays, model: FaceModel, settings: AdjustmentSettings) -> KnownPerson:
    person = Person(arrays["identity"], arrays["offsets"])
    album = Album()
    for view, score in zip(_views(arrays, "album"), arrays.get("album.scores", ()), strict=True):
        album = album.added(view, float(score))
    return KnownPerson(
        person,
        IdentityHistory(arrays["history"], settings.average),
        _views(arrays, "views"),
        album,
        shape_of(model, person),
        templates_of(arrays, "sets"),
        int(arrays["counts"]),
        *(float(value) for value in arrays["single"]),
    )


def _view_parts(prefix: str, views: Sequence[PointView]) -> Arrays:
    if not views:
        return {}
    columns = (
        np.array([view.stamp_ns for view in views]),
        *(np.stack([getattr(view, name) for view in views]) for name in ("pixels", "weights")),
        np.stack([view.pose.position for view in views]),
        np.stack([view.pose.quaternion for view in views]),
        np.stack([view.deformation for view in views]),
    )
    return {f"{prefix}.{name}": column for name, column in zip(_VIEW, columns, strict=True)}


def _views(arrays: Arrays, prefix: str) -> tuple[PointView, ...]:
    columns = [arrays.get(f"{prefix}.{name}", ()) for name in _VIEW]
    return tuple(
        PointView(int(stamp), pixels, weights, HeadPose(position, quaternion), deformation)
        for stamp, pixels, weights, position, quaternion, deformation in zip(*columns, strict=True)
    )
