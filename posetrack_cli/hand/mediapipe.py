"""Export of a hand track as JSON of MediaPipe's HandLandmarker: a list with one result per frame.

Joints have MediaPipe's order, which is ours. ``handLandmarks`` are in the reference camera's image: x and y
divided by width and height, and z the depth behind the wrist in the scale of x at the wrist's distance.
``handWorldLandmarks`` are in metres, in camera axes, with their mean as origin. ``handedness`` states the
hand's own side with the confidence of the estimate as score. Frames without a visible hand have empty lists.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.derived import pixels
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.units import METRES_PER_MM

FIELDS = ("frame_index", "stamp_ns", "status", "confidence", "points")
SIDES = ("left", "right")
"""In the order of MediaPipe's category indices."""
_NS_PER_MS = 1_000_000
_WRIST = 0


def mediapipe_text(source: ExportSource, side: str) -> Iterator[str]:
    """Yield the JSON of a hand track, one line per frame.

    Args:
        source: a track of our hand (``hand.bvh.check_hand``).
        side: of the hand, ``right`` or ``left``.

    Raises:
        ResultError: the result has no calibration, or see ``ExportSource.blocks``.
    """
    if not source.result.image_cameras:
        raise ResultError("has no camera calibration", where=source.result.path)
    between = "[\n"
    for block in source.begun_blocks(FIELDS):
        for line in _lines(block, source, side):
            yield between + line
            between = ",\n"
    yield "\n]\n" if between[0] == "," else "[]\n"


def _lines(block: Columns, source: ExportSource, side: str) -> Iterator[str]:
    camera = source.result.image_cameras[0]
    points, image = block["points"], np.full((*block["points"].shape[:2], 3), np.nan)
    image[..., :2] = (pixels(block, camera) + 0.5) / [camera.width, camera.height]
    seen: BoolArray = np.all(np.isfinite(image[..., :2]), axis=(1, 2))
    wrist = points[:, _WRIST : _WRIST + 1, 2]
    scale = np.divide(camera.fx / camera.width, wrist, out=np.zeros_like(wrist), where=seen[:, None])
    image[..., 2] = (points[..., 2] - wrist) * scale
    world = METRES_PER_MM * (points - points.mean(axis=1, keepdims=True))
    category = {"index": SIDES.index(side), "categoryName": side.title(), "displayName": side.title()}
    for row in range(len(points)):
        frame: dict[str, Any] = {
            "frame": int(block["frame_index"][row]),
            "timestamp_ms": round(int(block["stamp_ns"][row]) / _NS_PER_MS),
            "handedness": [[{"score": float(block["confidence"][row]), **category}]] if seen[row] else [],
            "handLandmarks": [_landmarks(image[row])] if seen[row] else [],
            "handWorldLandmarks": [_landmarks(world[row])] if seen[row] else [],
        }
        yield json.dumps(frame, separators=(",", ":"))


def _landmarks(points: FloatArray) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "z": z} for x, y, z in points.tolist()]
