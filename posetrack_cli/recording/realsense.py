"""What RealSense cameras say of themselves in recordings: how long a unit of depth is."""

from __future__ import annotations

import math
import re

from posetrack_cli.errors import RecordingError
from posetrack_cli.mcap.decoding import VALUE_TYPES, MessageDecoder, UndecodableMessageError
from posetrack_cli.recording.depth import MM_PER_M
from posetrack_cli.recording.message_topics import FileTopics, Topic

_SENSOR = re.compile(r"/device_\d+/sensor_\d+(?=/)")
UNIT = "/option/Depth_Units/value"
"""Of a sensor's topics: metres per code, a number or its digits."""
SHORTEST_MM, LONGEST_MM = 1e-3, 100.0
"""Cameras have from 0.025 mm, of a close-up, to 1 mm."""


def depth_unit_mm(topics: FileTopics, images: Topic) -> float | None:
    """Return how many millimetres a code of integer depth is, None if the sensor does not state it.

    Raises:
        RecordingError: what it tells is no unit.
    """
    sensor = _SENSOR.match(images.name)
    name = "" if sensor is None else sensor.group() + UNIT
    if name not in topics.by_name or topics.by_name[name].type_name not in VALUE_TYPES:
        return None
    for item in topics.file.messages([name]):
        try:
            # Stored as float32, whose nearest value to 0.001 is not it
            unit = float(f"{float(MessageDecoder().decode(*item).data) * MM_PER_M:.6g}")
        except (UndecodableMessageError, ValueError):
            unit = math.nan
        if SHORTEST_MM <= unit <= LONGEST_MM:
            return unit
        raise RecordingError(
            "depth unit cannot be used", where=f"{topics.path}, {name}", found=f"{unit:g} mm"
        )
    return None
