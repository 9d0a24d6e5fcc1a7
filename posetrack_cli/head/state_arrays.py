"""What both head trackers keep, as arrays: templates, a head that is followed, a search."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from posetrack_cli.head.face.points import POINT_COUNT
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose
from posetrack_cli.head.face.shape_model import ShapeModel
from posetrack_cli.head.face.templates import TemplateSet
from posetrack_cli.head.initialisation.search import Search
from posetrack_cli.head.learned_arrays import template_layouts
from posetrack_cli.head.particles.filter import HeadParticles
from posetrack_cli.head.tracker.frame_tracker import TrackState
from posetrack_cli.results.layouts import Layout, counts, floats, units

Arrays = dict[str, np.ndarray[Any, Any]]
Numbers = dict[str, int]


def search_parts(search: Search) -> Arrays:
    """Take a search apart."""
    return {
        "search.best": np.array(search.best_score),
        "search.counts": np.array([search.frames, search.exchanged]),
        "search.order": np.array(search.order, dtype=np.int64),
        "search.reasons": np.array(list(search.reasons.keys()), dtype=np.str_),
        "search.times": np.array(list(search.reasons.values()), dtype=np.int64),
    }


def search_of(arrays: Mapping[str, np.ndarray[Any, Any]]) -> Search:
    """Put a search together."""
    frames, exchanged = (int(value) for value in arrays["search.counts"])
    reasons = zip(arrays["search.reasons"].tolist(), arrays["search.times"].tolist(), strict=True)
    order = tuple(int(value) for value in arrays["search.order"])
    return Search(frames, float(arrays["search.best"]), Counter(dict(reasons)), order, exchanged)


def search_layouts(cameras: int) -> dict[str, Layout]:
    """Return what the arrays of a search with so many cameras must be."""
    return {
        "search.best": floats(least=0.0),
        "search.counts": counts(2),
        "search.order": counts("order?", most=cameras - 1),
        "search.reasons": Layout("str", ("reasons?",)),
        "search.times": counts("reasons?"),
    }


def template_parts(prefix: str, sets: Sequence[TemplateSet]) -> Arrays:
    """Take templates apart, under names that begin with a prefix."""
    names = [field.name for field in fields(TemplateSet)]
    return {f"{prefix}.{name}": np.stack([getattr(one, name) for one in sets]) for name in names}


def templates_of(arrays: Mapping[str, np.ndarray[Any, Any]], prefix: str) -> tuple[TemplateSet, ...]:
    """Put templates together."""
    stacked = [arrays[f"{prefix}.{field.name}"] for field in fields(TemplateSet)]
    return tuple(TemplateSet(*parts) for parts in zip(*stacked, strict=True))


def following_parts(following: TrackState) -> Arrays:
    """Take a head that is followed apart, but for its stamp."""
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
    } | ({} if following.previous is None else template_parts("previous", [following.previous]))


def following_layouts(arrays: Mapping[str, np.ndarray[Any, Any]], cameras: int) -> dict[str, Layout]:
    """Return what the arrays of a head that is followed must be; none where there are none of it."""
    if not is_following(arrays):
        return {}
    coefficients = arrays["particles.mu"].size if "particles.mu" in arrays else 0
    previous = any(name.startswith("previous.") for name in arrays)
    return {
        "following.position": floats(3),
        "following.quaternion": units(4),
        "following.velocity": floats(POSE_SIZE),
        "following.shape": floats(POINT_COUNT, 3),
        "particles.position": floats(3),
        "particles.quaternion": units(4),
        "particles.coefficients": floats(coefficients),
        "particles.deviations": floats("particles", POSE_SIZE + coefficients),
        "particles.weights": Layout("float64", ("particles",), least=0.0, most=1.0, shares=True),
        "particles.mean": floats(POINT_COUNT, 3),
        "particles.basis": floats(POINT_COUNT, 3, coefficients),
        "particles.mu": floats(coefficients, least=0.0),
        **(template_layouts("previous", cameras, 1) if previous else {}),
    }


def is_following(arrays: Mapping[str, np.ndarray[Any, Any]]) -> bool:
    """Whether there is an array of a head that is followed."""
    return any(name.startswith(("following.", "particles.", "previous.")) for name in arrays)


def following_of(arrays: Mapping[str, np.ndarray[Any, Any]], stamp_ns: int) -> TrackState:
    """Put a head together that is followed."""
    model = ShapeModel(arrays["particles.mean"], arrays["particles.basis"], arrays["particles.mu"])
    particles = HeadParticles(
        HeadPose(arrays["particles.position"], arrays["particles.quaternion"]),
        arrays["particles.coefficients"],
        arrays["particles.deviations"],
        arrays["particles.weights"],
        model,
    )
    pose = HeadPose(arrays["following.position"], arrays["following.quaternion"])
    previous = templates_of(arrays, "previous")[0] if "previous.facing" in arrays else None
    velocity, shape = arrays["following.velocity"], arrays["following.shape"]
    return TrackState(stamp_ns, pose, velocity, particles, shape, previous)
