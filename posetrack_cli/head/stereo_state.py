"""A stereo tracker's state as arrays and whole numbers, for checkpoints, model files and second passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from posetrack_cli.head.ccipca import Ccipca
from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.following import Following
from posetrack_cli.head.learned_arrays import check_learned
from posetrack_cli.head.learning import FaceLearning, known_face
from posetrack_cli.head.start.search import Search
from posetrack_cli.head.state_arrays import (
    Arrays,
    Numbers,
    following_of,
    following_parts,
    search_of,
    search_parts,
    template_parts,
    templates_of,
)
from posetrack_cli.head.templates import TemplateSet


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
    arrays: Arrays = search_parts(state.search)
    numbers: Numbers = {"lost": state.lost}
    if state.face is not None:
        statistics = state.face.statistics
        arrays |= {
            "face.mean": statistics.mean,
            "face.components": statistics.components,
            "face.variance": np.array(statistics.variance),
            "face.counts": np.array([statistics.count, statistics.learnt, state.face.frames]),
        } | template_parts("sets", state.sets)
    if state.following is not None:
        numbers["stamp_ns"] = state.following.stamp_ns
        arrays |= following_parts(state.following)
    return arrays, numbers


def state_of(
    arrays: Mapping[str, np.ndarray[Any, Any]], numbers: Mapping[str, int], settings: ModelSettings
) -> StereoState:
    """Put a state together from what ``parts_of`` made of it."""
    face = _face_of(arrays, settings) if "face.mean" in arrays else None
    sets = templates_of(arrays, "sets") if face is not None else ()
    following = following_of(arrays, numbers["stamp_ns"]) if "stamp_ns" in numbers else None
    search = search_of(arrays) if "search.best" in arrays else Search()
    return StereoState(face, sets, following, numbers.get("lost", 0), search)


def known_state(
    learned: Mapping[str, np.ndarray[Any, Any]], cameras: int, settings: ModelSettings
) -> StereoState:
    """Return the state that begins with a face and templates that another tracker has learned.

    Raises:
        ResultError: arrays are missing, or not what a stereo tracker with so many cameras learns.
    """
    check_learned(learned, cameras)
    return StereoState(_face_of(learned, settings), templates_of(learned, "sets"))


def _face_of(arrays: Mapping[str, np.ndarray[Any, Any]], settings: ModelSettings) -> FaceLearning:
    count, learnt, frames = (int(value) for value in arrays["face.counts"])
    variance = float(arrays["face.variance"])
    statistics = Ccipca(arrays["face.mean"], arrays["face.components"], variance, count, learnt)
    return known_face(statistics, frames, settings)
