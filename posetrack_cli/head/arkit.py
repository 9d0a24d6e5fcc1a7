"""Export of a head's expression as coefficients of ARKit's blend shapes, CSV.

There is a column for each blend shape that is measured, with values from 0 to 1. ``timestamp`` is in seconds
from the first frame. ``success`` is 0, and the coefficients are empty, where the head is lost; coefficients
of parts that no image shows are empty as well. Left and right are the subject's, as in ARKit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.head.dense.expressions import BLEND_SHAPES
from posetrack_cli.head.dense.numbers import DENSE_NUMBERS, STRENGTH_NAMES
from posetrack_cli.results.derived import is_tracked
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.results.fields import NUMBERS
from posetrack_cli.tables import csv_of
from posetrack_cli.units import NS_PER_S

FIELDS = ("frame_index", "stamp_ns", "status", "confidence", NUMBERS)
FULL_LOOK_RAD = {"side": 0.55, "up": 0.45}
"""Angles of a gaze at which a coefficient of looking is 1."""
FULL_WIDE = 0.35
"""Opening beyond the usual one, as a share of it, at which a coefficient of widened eyes is 1."""
_EYES = tuple(
    f"{shape}{side}"
    for side in ("Left", "Right")
    for shape in ("eyeBlink", "eyeWide", "eyeLookUp", "eyeLookDown", "eyeLookIn", "eyeLookOut")
)


def arkit_text(source: ExportSource) -> Iterator[str]:
    """Yield the CSV of a head's expression, header first.

    Raises:
        UsageError: the result has no dense face.
        ResultError: see ``ExportSource.blocks``.
    """
    names = source.result.subject.number_names
    if DENSE_NUMBERS[0] not in names:
        raise UsageError(
            "arkit requires a result with the dense face",
            where=source.result.path,
            found=f"a {source.result.subject.name} without it",
            hint="track again with posetrack head and face.use = true",
        )
    blocks = source.begun_blocks(FIELDS)
    yield csv_of([["frame", "timestamp", "confidence", "success", *BLEND_SHAPES, *_EYES]])
    first_ns: int | None = None
    for block in blocks:
        stated = dict(zip(names, block[NUMBERS].T, strict=True))
        tracked, stamps = is_tracked(block), block["stamp_ns"].tolist()
        first_ns = stamps[0] if first_ns is None and stamps else first_ns
        shapes = [stated[name] for name in STRENGTH_NAMES] + _eyes(stated)
        values = np.where(tracked[:, None], np.clip(np.stack(shapes, axis=1), 0.0, 1.0), np.nan)
        leading = zip(
            block["frame_index"].tolist(), stamps, block["confidence"].tolist(), tracked, strict=True
        )
        yield csv_of(
            [
                *(frame, (stamp - (first_ns or 0)) / NS_PER_S, confidence, int(success)),
                *(None if value != value else value for value in row),
            ]
            for (frame, stamp, confidence, success), row in zip(leading, values.tolist(), strict=True)
        )


def _eyes(stated: Mapping[str, FloatArray]) -> list[FloatArray]:
    """Return the coefficients (N,) of ``_EYES``, not limited to 0 to 1."""
    found = []
    for side in ("left", "right"):
        opening, up = stated[f"action_{side}_lid_open"], stated[f"{side}_gaze_up_rad"]
        outwards = stated[f"{side}_gaze_to_left_rad"] * (1.0 if side == "left" else -1.0)
        found += [1.0 - opening, (opening - 1.0) / FULL_WIDE]
        found += [up / FULL_LOOK_RAD["up"], -up / FULL_LOOK_RAD["up"]]
        found += [-outwards / FULL_LOOK_RAD["side"], outwards / FULL_LOOK_RAD["side"]]
    return found
