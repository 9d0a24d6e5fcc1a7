"""People as arrays: for checkpoints, model files and second passes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.head.adjustment.album import Album
from posetrack_cli.head.adjustment.history import IdentityHistory
from posetrack_cli.head.adjustment.views import Person, PointView
from posetrack_cli.head.face import POINT_COUNT
from posetrack_cli.head.learned_arrays import ANY, Expected, fits, template_arrays
from posetrack_cli.head.mono_config import AdjustmentSettings
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.person import KnownPerson, shape_of
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.state_arrays import Arrays, template_parts, templates_of

PEOPLE = "people"
"""Name of the array that says how many there are."""
_VIEW = ("stamps", "pixels", "weights", "positions", "quaternions", "deformations")
_MAY_BE_NAN = ("single", ".pixels", ".centres", ".tangents")
"""Ends of names: of points that no camera sees, and of what was not measured yet."""


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
        ResultError: one is missing, has another shape or kind, or is not finite where it must be.
    """
    if PEOPLE not in arrays:
        raise unusable(f"no array '{PEOPLE}'")
    count = arrays[PEOPLE]
    if count.dtype.kind not in "iu" or count.shape != ():
        raise unusable(f"'{PEOPLE}' as {count.dtype} {count.shape}")
    for index in range(int(count)):
        _check_person(_of(arrays, index), index, model)


def unusable(found: str) -> ResultError:
    """Return the error that says what of learned arrays is not as it must be."""
    expected = "what --save-model wrote of a run with this face model"
    return ResultError("model is incomplete or damaged", found=found, expected=expected)


def _check_person(own: Arrays, index: int, model: FaceModel) -> None:
    if not any(name.startswith("sets.") for name in own):
        raise unusable(f"no templates of person {index}")
    for name, (kinds, shape) in _expected(own, model).items():
        what = f"'person{index}.{name}'"
        if name not in own:
            raise unusable(f"no array {what}")
        if not fits(own[name].shape, shape):
            raise unusable(f"{what} of shape {own[name].shape}, not {shape}")
        if own[name].dtype.kind not in kinds:
            raise unusable(f"{what} as {own[name].dtype}")
        if not name.endswith(_MAY_BE_NAN) and not np.all(np.isfinite(own[name])):
            raise unusable(f"{what} with values that are not finite")
    for group in ("sets.", "views.", "album."):
        if len({len(array) for name, array in own.items() if name.startswith(group)}) > 1:
            raise unusable(f"arrays 'person{index}.{group}*' of different lengths")


def _expected(own: Arrays, model: FaceModel) -> dict[str, Expected]:
    """What one person's arrays must be; frames only where there are any."""
    identity = model.identity_size
    expected: dict[str, Expected] = {
        "identity": ("f", (identity,)),
        "offsets": ("f", (POINT_COUNT, 3)),
        "history": ("f", (ANY, identity)),
        "counts": ("iu", ()),
        "single": ("f", (2,)),
    }
    for group in ("views", "album"):
        if any(name.startswith(f"{group}.") and array.size for name, array in own.items()):
            expected |= {f"{group}.{name}": what for name, what in _expected_view(model).items()}
    scores: dict[str, Expected] = {"album.scores": ("f", (ANY,))} if "album.stamps" in expected else {}
    return expected | scores | template_arrays(1)


def _expected_view(model: FaceModel) -> dict[str, Expected]:
    """What the arrays of ``_VIEW`` must be."""
    shapes = ((POINT_COUNT, 2), (POINT_COUNT,), (3,), (4,), (model.deformation_size,))
    floats: dict[str, Expected] = {
        name: ("f", (ANY, *shape)) for name, shape in zip(_VIEW[1:], shapes, strict=True)
    }
    return {_VIEW[0]: ("iu", (ANY,))} | floats


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
