"""How what both head trackers keep becomes arrays: templates, a head that is followed, a search."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from posetrack_cli.head.face import POINT_COUNT
from posetrack_cli.head.following import Following
from posetrack_cli.head.particles import HeadParticles
from posetrack_cli.head.pose import POSE_SIZE, HeadPose
from posetrack_cli.head.shape_model import ShapeModel
from posetrack_cli.head.start.search import Search
from posetrack_cli.head.templates import WINDOW, TemplateSet
from posetrack_cli.results.layouts import Layout, LayoutError, counts, floats, places, units
from posetrack_cli.tracking.state_codec import Array, Codec, Fields, Maybe, Value, real, stamp

POSE: Codec[HeadPose] = Fields(HeadPose, position=Value(floats(3)), quaternion=Value(units(4)))
_COEFFICIENTS = "coefficients?"


def search_codec(cameras: int) -> Codec[Search]:
    """Return the codec of a search with so many cameras."""

    def search(best: float, counts: Array, order: Array, reasons: Array, times: Array) -> Search:
        frames, exchanged = (int(value) for value in counts)
        failures = Counter(dict(zip(reasons.tolist(), times.tolist(), strict=True)))
        return Search(frames, best, failures, tuple(order.tolist()), exchanged)

    return Fields(
        search,
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


def following_codec(cameras: int) -> Codec[Following]:
    """Return the codec of a head that is followed with so many cameras."""
    model = Fields(
        ShapeModel,
        mean=Value(floats(POINT_COUNT, 3)),
        basis=Value(floats(POINT_COUNT, 3, _COEFFICIENTS)),
        deviations=Value(floats(_COEFFICIENTS, least=0.0)),
    )
    particles = Fields(
        _particles,
        pose=POSE,
        coefficients=Value(floats(_COEFFICIENTS)),
        deviations=Value(floats("particles", "state components")),
        weights=Value(Layout("float64", ("particles",), least=0.0, most=1.0, shares=True)),
        model=model,
    )
    return Fields(
        Following,
        stamp_ns=stamp(),
        pose=POSE,
        velocity=Value(floats(POSE_SIZE)),
        particles=particles,
        shape=Value(floats(POINT_COUNT, 3)),
        previous=Maybe(template_codec(cameras)),
    )


def _particles(deviations: np.ndarray[Any, Any], coefficients: Array, **parts: Any) -> HeadParticles:
    wanted = POSE_SIZE + len(coefficients)
    if deviations.shape[1] != wanted:
        raise LayoutError(f"'particles.deviations' of {deviations.shape[1]} components, not {wanted}")
    return HeadParticles(deviations=deviations, coefficients=coefficients, **parts)
