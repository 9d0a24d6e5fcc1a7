"""A stereo tracker's state as arrays and whole numbers, for checkpoints, model files and second passes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from posetrack_cli.head.ccipca import Ccipca
from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.following import Following
from posetrack_cli.head.learned_arrays import check_learned
from posetrack_cli.head.learning import FaceLearning, known_face
from posetrack_cli.head.particles import HeadParticles
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.shape_model import ShapeModel
from posetrack_cli.head.start.search import Search
from posetrack_cli.head.templates import TemplateSet

Arrays = dict[str, np.ndarray[Any, Any]]
Numbers = dict[str, int]


@dataclass(frozen=True, eq=False)
class StereoState:
    """What a stereo tracker knows after a frame.

    Attributes:
        face: what was learnt of the face; None before it is first found.
        sets: templates, reference first; empty before.
        following: the head when it was last tracked; None before.
        lost: frames in a row, up to the last one, in which it was not.
        search: what looking for the face came to before it was first found.
    """

    face: FaceLearning | None = None
    sets: tuple[TemplateSet, ...] = ()
    following: Following | None = None
    lost: int = 0
    search: Search = field(default_factory=Search)


def parts_of(state: StereoState) -> tuple[Arrays, Numbers]:
    """Take a state apart."""
    arrays: Arrays = _search_parts(state.search)
    numbers: Numbers = {"lost": state.lost}
    if state.face is not None:
        statistics = state.face.statistics
        arrays |= {
            "face.mean": statistics.mean,
            "face.components": statistics.components,
            "face.variance": np.array(statistics.variance),
            "face.counts": np.array([statistics.count, statistics.learnt, state.face.frames]),
        } | _template_parts("sets", state.sets)
    if state.following is not None:
        numbers["stamp_ns"] = state.following.stamp_ns
        arrays |= _following_parts(state.following)
    return arrays, numbers


def state_of(
    arrays: Mapping[str, np.ndarray[Any, Any]], numbers: Mapping[str, int], settings: ModelSettings
) -> StereoState:
    """Put a state together from what ``parts_of`` made of it."""
    face = _face_of(arrays, settings) if "face.mean" in arrays else None
    sets = _templates_of(arrays, "sets") if face is not None else ()
    following = _following_of(arrays, numbers["stamp_ns"]) if "stamp_ns" in numbers else None
    search = _search_of(arrays) if "search.best" in arrays else Search()
    return StereoState(face, sets, following, numbers.get("lost", 0), search)


def known_state(
    learned: Mapping[str, np.ndarray[Any, Any]], cameras: int, settings: ModelSettings
) -> StereoState:
    """Return the state that begins with a face and templates that another tracker has learned.

    Raises:
        ResultError: arrays are missing, or not what a stereo tracker with so many cameras learns.
    """
    check_learned(learned, cameras)
    return StereoState(_face_of(learned, settings), _templates_of(learned, "sets"))


def _search_parts(search: Search) -> Arrays:
    return {
        "search.best": np.array(search.best_score),
        "search.counts": np.array([search.frames, search.exchanged]),
        "search.order": np.array(search.order, dtype=np.int64),
        "search.reasons": np.array(list(search.reasons.keys()), dtype=np.str_),
        "search.times": np.array(list(search.reasons.values()), dtype=np.int64),
    }


def _search_of(arrays: Mapping[str, np.ndarray[Any, Any]]) -> Search:
    frames, exchanged = (int(value) for value in arrays["search.counts"])
    reasons = zip(arrays["search.reasons"].tolist(), arrays["search.times"].tolist(), strict=True)
    order = tuple(int(value) for value in arrays["search.order"])
    return Search(frames, float(arrays["search.best"]), Counter(dict(reasons)), order, exchanged)


def _face_of(arrays: Mapping[str, np.ndarray[Any, Any]], settings: ModelSettings) -> FaceLearning:
    count, learnt, frames = (int(value) for value in arrays["face.counts"])
    variance = float(arrays["face.variance"])
    statistics = Ccipca(arrays["face.mean"], arrays["face.components"], variance, count, learnt)
    return known_face(statistics, frames, settings)


def _template_parts(prefix: str, sets: Sequence[TemplateSet]) -> Arrays:
    names = [field.name for field in fields(TemplateSet)]
    return {f"{prefix}.{name}": np.stack([getattr(one, name) for one in sets]) for name in names}


def _templates_of(arrays: Mapping[str, np.ndarray[Any, Any]], prefix: str) -> tuple[TemplateSet, ...]:
    stacked = [arrays[f"{prefix}.{field.name}"] for field in fields(TemplateSet)]
    return tuple(TemplateSet(*parts) for parts in zip(*stacked, strict=True))


def _following_parts(following: Following) -> Arrays:
    particles, model = following.particles, following.particles.model
    return {
        "following.position": following.pose.position,
        "following.quaternion": following.pose.quaternion,
        "following.velocity": following.velocity,
        "following.shape": following.shape,
        "particles.position": particles.pose.position,
        "particles.quaternion": particles.pose.quaternion,
        "particles.coefficients": particles.coefficients,
        "particles.deviations": particles.deviations,
        "particles.weights": particles.weights,
        "particles.mean": model.mean,
        "particles.basis": model.basis,
        "particles.mu": model.deviations,
    } | ({} if following.previous is None else _template_parts("previous", [following.previous]))


def _following_of(arrays: Mapping[str, np.ndarray[Any, Any]], stamp_ns: int) -> Following:
    model = ShapeModel(arrays["particles.mean"], arrays["particles.basis"], arrays["particles.mu"])
    particles = HeadParticles(
        HeadPose(arrays["particles.position"], arrays["particles.quaternion"]),
        arrays["particles.coefficients"],
        arrays["particles.deviations"],
        arrays["particles.weights"],
        model,
    )
    pose = HeadPose(arrays["following.position"], arrays["following.quaternion"])
    previous = _templates_of(arrays, "previous")[0] if "previous.facing" in arrays else None
    velocity, shape = arrays["following.velocity"], arrays["following.shape"]
    return Following(stamp_ns, pose, velocity, particles, shape, previous)
