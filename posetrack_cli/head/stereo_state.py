"""A stereo tracker's state as arrays and whole numbers, for checkpoints, model files and second passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.face.templates import TemplateSet
from posetrack_cli.head.initialisation.search import Search
from posetrack_cli.head.learned_arrays import check_learned, face_layouts, template_layouts
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
from posetrack_cli.head.tracker.face_learning import Ccipca, FaceLearning, known_face
from posetrack_cli.head.tracker.frame_tracker import TrackState
from posetrack_cli.results.layouts import COUNTS, STAMPS_NS, Layout, check_arrays, check_numbers


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
    following: TrackState | None = None
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
    arrays: Mapping[str, np.ndarray[Any, Any]],
    numbers: Mapping[str, int],
    cameras: int,
    settings: ModelSettings,
) -> StereoState:
    """Put a state together from what ``parts_of`` made of it.

    Raises:
        LayoutError: they are of no state of a tracker with so many cameras.
    """
    check_arrays(arrays, _layouts(arrays, cameras))
    followed = is_following(arrays)
    check_numbers(numbers, {"lost": COUNTS} | ({"stamp_ns": STAMPS_NS} if followed else {}))
    face = _face_of(arrays, settings) if "face.mean" in arrays else None
    sets = templates_of(arrays, "sets") if face is not None else ()
    following = following_of(arrays, numbers["stamp_ns"]) if followed else None
    return StereoState(face, sets, following, numbers["lost"], search_of(arrays))


def known_state(
    learned: Mapping[str, np.ndarray[Any, Any]], cameras: int, settings: ModelSettings
) -> StereoState:
    """Return the state that begins with a face and templates that another tracker has learned.

    Raises:
        ResultError: arrays are missing, or not what a stereo tracker with so many cameras learns.
    """
    check_learned(learned, cameras)
    return StereoState(_face_of(learned, settings), templates_of(learned, "sets"))


def _layouts(arrays: Mapping[str, np.ndarray[Any, Any]], cameras: int) -> dict[str, Layout]:
    """What the arrays of a state must be; a head is only followed once its face is known."""
    following = following_layouts(arrays, cameras)
    found = following or any(name.startswith(("face.", "sets.")) for name in arrays)
    face = face_layouts() | template_layouts("sets", cameras) if found else {}
    return search_layouts(cameras) | face | following


def _face_of(arrays: Mapping[str, np.ndarray[Any, Any]], settings: ModelSettings) -> FaceLearning:
    count, learnt, frames = (int(value) for value in arrays["face.counts"])
    variance = float(arrays["face.variance"])
    statistics = Ccipca(arrays["face.mean"], arrays["face.components"], variance, count, learnt)
    return known_face(statistics, frames, settings)
