"""What both head trackers keep, as arrays: templates, a head that is followed, a search."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from posetrack_cli.head.following import Following
from posetrack_cli.head.particles import HeadParticles
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.shape_model import ShapeModel
from posetrack_cli.head.start.search import Search
from posetrack_cli.head.templates import TemplateSet

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


def template_parts(prefix: str, sets: Sequence[TemplateSet]) -> Arrays:
    """Take templates apart, under names that begin with a prefix."""
    names = [field.name for field in fields(TemplateSet)]
    return {f"{prefix}.{name}": np.stack([getattr(one, name) for one in sets]) for name in names}


def templates_of(arrays: Mapping[str, np.ndarray[Any, Any]], prefix: str) -> tuple[TemplateSet, ...]:
    """Put templates together."""
    stacked = [arrays[f"{prefix}.{field.name}"] for field in fields(TemplateSet)]
    return tuple(TemplateSet(*parts) for parts in zip(*stacked, strict=True))


def following_parts(following: Following) -> Arrays:
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


def following_of(arrays: Mapping[str, np.ndarray[Any, Any]], stamp_ns: int) -> Following:
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
    return Following(stamp_ns, pose, velocity, particles, shape, previous)
